"""Sensors chosen by Stone Soup's sensor manager, beside a plan of pfdist, on the same draws.

A target moves at nearly constant velocity. One sensor sees its position, another its velocity, and
only one may measure at a time. The greedy manager chooses one time after another: it takes the
sensor that reduces the norm of the covariance most. It has no budget over time, so it gets regular
times.
"""

import tempfile
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.common.measurement_times import EVEN
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED
from pfdist.results.stored_run import found_sets

TITLE = "Sensors chosen by others"
TABLES: tuple[str, ...] = ("stone_soup",)

PACKAGE = "stonesoup"
OURS = "pfdist"
HORIZON, PARTICLES, DRAWS = 20, 1000, 4000
BUDGETS = (21, 8, 5)
SENSORS, SDS = ("position", "velocity"), (1.0, 0.1)
ROWS = ((1.0, 0.0), (0.0, 1.0))
TRANSITION = ((1.0, 1.0), (0.0, 0.9))
PROCESS_SDS = (0.1, 0.5)
BEFORE = 2.0  # variance of both components a step before time 0


def target() -> pfdist.StateSpaceModel:
    """Position and velocity of a target, with a sensor for each of them."""
    process = np.diag(PROCESS_SDS)
    at_start = BEFORE * np.array(TRANSITION) @ np.array(TRANSITION).T + process**2
    (a, _), (b, c) = np.linalg.cholesky(at_start).tolist()
    damping = TRANSITION[1][1]
    return pfdist.StateSpaceModel(
        name="target",
        initial=lambda w, p: (a * w[0], b * w[0] + c * w[1]),
        transition=lambda x, t, w, p: (x[0] + x[1] + 0.1 * w[0], damping * x[1] + 0.5 * w[1]),
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        sensors={
            "position": pfdist.Sensor(
                lambda x, t, v, p: (x[0] + 1.0 * v[0],),
                lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
                ("normal",),
            ),
            "velocity": pfdist.Sensor(
                lambda x, t, v, p: (x[1] + 0.1 * v[0],),
                lambda y, x, t, p: -0.5 * ((y[0] - x[1]) / 0.1) ** 2,
                ("normal",),
            ),
        },
        linear_gaussian=True,
    )


def measure(quick: bool, say: Say) -> Tables:
    """Give the expected errors of sets that pfdist and Stone Soup choose.

    Parameters
    ----------
    quick : bool
        The smallest budget, few draws.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        stone_soup: a row for each number of measurements and each set. Columns: measurements, set,
        exact_mse (Kalman filter), expected_mse and standard_error on draws that all sets share,
        above_pfdist and above_pfdist_error of the paired difference, bound (of the Kalman filter),
        times.
    """
    rows = []
    for number in BUDGETS[-1:] if quick else BUDGETS:
        problem = pfdist.Problem(
            target(), horizon=HORIZON, measurement_budget=number, minimum_spacing=1,
            engine="kalman",
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            run = pfdist.plan(
                problem, results=f"{folder}/run", pool="serial", figures=False, report=False,
                changes=("comparison.draws=10",),
            )  # fmt: skip
            (name,), sets = found_sets(run), run.sets
            bound = run.table("sets").set_index("name")["bound"][name]
        written = {each: [*map(str, times)] for each, times in sets.items()}
        chosen = {OURS: written.pop(name)} | written
        chosen |= _chosen_by_the_manager(written[EVEN], say)
        exact = pfdist.evaluate(problem, chosen)
        drawn = pfdist.evaluate(
            problem.with_changes(engine="compiled", particles=100 if quick else PARTICLES), chosen,
            draws=100 if quick else DRAWS,
        )  # fmt: skip
        for each, times in chosen.items():
            apart = drawn[each].mse - drawn[OURS].mse
            rows.append(
                {
                    "measurements": number,
                    "set": each,
                    "exact_mse": exact[each].expected_mse,
                    "expected_mse": drawn[each].expected_mse,
                    "standard_error": drawn[each].standard_error,
                    "above_pfdist": apart.mean(),
                    "above_pfdist_error": apart.std(ddof=1) / np.sqrt(apart.size),
                    "bound": bound,
                    "times": ", ".join(map(str, times)),
                }
            )
        say(f"{number} measurements")
    return {"stone_soup": pd.DataFrame(rows)}


def _chosen_by_the_manager(even: list[str], say: Say) -> dict[str, list[str]]:
    """The sensors that the manager of Stone Soup chooses at these times; empty without it."""
    if find_spec(PACKAGE) is None:
        say(f"left out: {PACKAGE} is not installed (pip install {PACKAGE})")
        return {}
    peer = import_module("benchmarks.peer_filters.stone_soup_manager")
    times = [int(each.split()[0]) for each in even]
    modes = peer.chosen(TRANSITION, np.diag(PROCESS_SDS) ** 2, BEFORE * np.eye(2), ROWS, SDS, times)
    say(f"{PACKAGE} {version(PACKAGE)}")
    names = [f"{t} {SENSORS[mode]}" for t, mode in zip(times, modes, strict=True)]
    return {"stone_soup_greedy": names}


def summary(tables: Tables) -> str:
    """Give the errors of all sets as a table."""
    header = ("measurements, set", "exact error", "above the bound, %", "on the same draws")
    rows = [
        (
            f"{row['measurements']}, {row['set']}",
            f"{row['exact_mse']:.4f}",
            f"{100 * (row['exact_mse'] / row['bound'] - 1):.2f}",
            f"{row['expected_mse']:.4f} ± {row['standard_error']:.4f}",
        )
        for row in tables["stone_soup"].to_dict("records")
    ]
    return (
        "A target whose position or velocity is measured. Rotation takes both in turn, at regular "
        f"times.\n\n{markdown(header, rows)}"
    )


def plot(tables: Tables) -> Figure:
    """Give the exact error of each set, for each number of measurements."""
    table = tables["stone_soup"]
    figure = Figure(figsize=(COLUMN_INCHES, 0.3 + 0.2 * len(table)))
    ax = figure.subplots()
    labels = [f"{row['measurements']}, {row['set']}" for row in table.to_dict("records")]
    colors = [RED if name == OURS else BLUE for name in table["set"]]
    ax.barh(labels, table["exact_mse"] / table["bound"], color=colors)
    ax.invert_yaxis()
    ax.set_xlabel("exact error / lower bound")
    return figure
