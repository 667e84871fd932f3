"""The gain and the cost of windows that grow where they matter.

Exact systems of growing horizons show how large a proof becomes. The paper's problem shows the
bound against its work, with windows that grow and with windows of one length.
"""

import tempfile
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist import StateSpaceModel, linear_gaussian, load_model
from pfdist.filters.estimate import Evaluation
from pfdist.filters.kalman import expected_errors
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED
from pfdist.problem.feasible import Feasible
from pfdist.search import Candidate
from pfdist.search.state_space_relaxation import RelaxationState, StateSpaceRelaxation

TITLE = "Windows that grow"
TABLES: tuple[str, ...] = ("growth", "growth_work")

SECONDS = 60.0  # of one core, after which no window grows
HORIZONS = (60, 200, 1000)
WORK: dict[str, list[dict[str, Any]]] = {
    "windows grow": [{"draws": draws} for draws in (480, 1920, 7680)],
    "windows of two": [{"draws": draws, "work": 0.0} for draws in (480, 1920, 7680)],
    "windows of three": [{"draws": 480, "window": 3, "work": 0.0}],
}
LOOKS = {"windows grow": (RED, "o"), "windows of two": (BLUE, "s"), "windows of three": (BLUE, "^")}


def _systems() -> dict[str, StateSpaceModel]:
    velocity = linear_gaussian(
        "constant velocity",
        initial_noise=[[1.0, 0.0], [0.0, 1.0]],
        transition=[[1.0, 1.0], [0.0, 1.0]],
        process_noise=[[0.1], [0.2]],
        measurement=[[1.0, 0.0]],
        measurement_noise=[[0.5]],
        quantity_of_interest=[[1.0, 0.0]],
    )
    return {
        "random walk": load_model("random_walk"),
        "constant velocity": velocity,
        "oscillator": load_model("linear_gaussian"),
    }


def measure(quick: bool, say: Say) -> Tables:
    """Prove plans of exact systems, and bound the paper's problem with different work.

    Parameters
    ----------
    quick : bool
        One short horizon, and one bound.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        growth: a row for each system and horizon, with measurements, windows_first, windows, bytes
        (of the errors that count), rounds, seconds, gap_first and gap (of cost and bound);
        growth_work: a row for each bound, with kind, draws, work, steps, windows, bound,
        bound_error, gap and gap_at_most.
    """
    horizons = (12,) if quick else HORIZONS
    rows = []
    for horizon in horizons:
        for name, model in _systems().items():
            rows.append({"system": name, **_proved(model, horizon, SECONDS)})
            say(f"T = {horizon}, {name}: gap {100 * rows[-1]['gap']:.2g} %")
    return {"growth": pd.DataFrame(rows), "growth_work": _bounded(quick, say)}


def _proved(model: StateSpaceModel, horizon: int, limit: float) -> dict[str, Any]:
    """Let windows grow for a while, and give how far the proof is."""
    feasible, start = Feasible(horizon, (horizon + 1) // 3), process_time()
    search = StateSpaceRelaxation(feasible)
    state, solved, first = search.init(), list[RelaxationState](), None
    while not search.done(state) and process_time() - start < limit:
        asked = search.ask(state, np.random.default_rng(0))
        told = [_exactly(model, horizon, each) for each in asked]
        solved = [state]
        state = search.tell(state, told)
        first = first or state
    seconds = process_time() - start
    known = _known(state)
    return {
        "horizon": horizon,
        "measurements": feasible.total,
        "windows_first": len(solved and search.init().relaxation.windows),
        "windows": len(known.relaxation.windows),
        "bytes": 8 * int(known.relaxation.offsets[-1]),
        "rounds": state.round,
        "seconds": seconds,
        "gap_first": _gap(_known(first or state), state, feasible.total),
        "gap": _gap(known, state, feasible.total),
    }


def _exactly(model: StateSpaceModel, horizon: int, asked: Candidate) -> Evaluation:
    """Evaluate a set, or the filters of windows."""
    times, end, counted = asked.measurement_times, asked.end, asked.counted
    if counted is not None:
        errors = counted.of_instants(expected_errors(model, horizon, counted.sets))
        return Evaluation.exactly(times, np.nan, end=end, errors=errors)
    return Evaluation.exactly(
        times, float(expected_errors(model, horizon, [times]).mean()), end=end
    )


def _known(state: RelaxationState) -> RelaxationState:
    """Give the state without windows that are asked for and not known yet."""
    lacking = {state.relaxation.windows[number] for number in state.lacking}
    relaxation = state.relaxation.without(lacking)
    return replace(state, relaxation=replace(relaxation, far=relaxation.far - lacking))


def _gap(state: RelaxationState, last: RelaxationState, total: int) -> float:
    return 1 - float(state.programmes([total])[total].mse[total]) / last.least(total)


def _bounded(quick: bool, say: Say) -> pd.DataFrame:
    rows = []
    changes = ["comparison.draws=20000"] + (["problem.horizon=14"] if quick else [])
    changes += ["problem.measurement_budget=4", "filter.particles=50"] if quick else []
    with tempfile.TemporaryDirectory(prefix="run-") as folder:
        run = pfdist.plan("jobs/plan.toml", folder, changes=changes, bound_draws=0, figures=False)
        for kind, every in WORK.items():
            for settings in every[: 1 if quick else None]:
                found = pfdist.bound(run, **settings, figures=False)
                proved = run.table("bound")
                last = proved[
                    (proved["draws"] == found.draws) & (proved["windows"] == found.windows)
                ].iloc[-1]
                columns = ["draws", "work", "steps", "windows", "bound", "bound_error"]
                columns += ["relaxation", "relaxation_error", "gap", "gap_at_most"]
                rows.append({"kind": kind, **last[columns].to_dict()})
                say(f"{kind} {settings}: bound {rows[-1]['bound']:.3f}")
    return pd.DataFrame(rows)


def summary(tables: Tables) -> str:
    """Give both tables in Markdown."""
    exact, work = tables["growth"], tables["growth_work"]
    proofs = [
        [
            row["system"],
            f"{row['horizon']}",
            f"{row['measurements']}",
            f"{row['windows_first']:,}",
            f"{row['windows']:,}",
            f"{row['bytes'] / 2**20:.1f}",
            f"{row['seconds']:.1f}",
            f"{100 * row['gap_first']:.2g}",
            f"{max(0.0, 100 * row['gap']):.2g}",
        ]
        for _, row in exact.iterrows()
    ]
    bounds = [
        [
            row["kind"],
            f"{row['draws']:,}",
            f"{row['steps']:.2g}",
            f"{row['windows']:,}",
            f"{row['bound']:.3f} ± {row['bound_error']:.3f}",
            f"{100 * row['gap']:.2f}",
        ]
        for _, row in work.iterrows()
    ]
    header = [
        "system",
        "T",
        "N",
        "windows at first",
        "windows",
        "MiB",
        "seconds",
        "gap at first, %",
    ]
    return "\n\n".join(
        [
            f"Exact systems: windows grow for at most {SECONDS:.0f} s of one core. The gap is that "
            "of the best set found and the bound; a gap of 0 is a proof that the set is optimal.",
            markdown([*header, "gap, %"], proofs),
            "The paper's problem: the bound of a plan against the particle-steps of windows and "
            "bound. The gap includes the parts that no relaxation causes.",
            markdown(["kind", "draws", "steps", "windows", "bound", "gap, %"], bounds),
        ]
    )


def plot(tables: Tables) -> Figure:
    """Draw the bound of the paper's problem against the work of the proof."""
    figure = Figure(figsize=(COLUMN_INCHES, 0.75 * COLUMN_INCHES), layout="constrained")
    axes = figure.add_subplot()
    for kind, rows in tables["growth_work"].groupby("kind", sort=False):
        colour, marker = LOOKS[str(kind)]
        row = rows.sort_values("steps")
        axes.errorbar(
            row["steps"] / 1e9, row["bound"], row["bound_error"], label=str(kind),
            color=colour, marker=marker, ms=3.5, lw=0.8, elinewidth=0.6,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xticks([2, 5, 10, 20], ["2", "5", "10", "20"])
    axes.set_xticks([], minor=True)
    axes.set_xlabel(r"particle-steps [$10^9$]")
    axes.set_ylabel("lower bound of the expected MSE")
    axes.legend(loc="lower right")
    return figure
