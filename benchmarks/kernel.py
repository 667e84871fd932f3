"""The speed of the kernel on one core, in nanoseconds for a particle-step, and how it scales.

A particle-step is the work for one particle at one instant. A call has draws x (T + 1) x particles
particle-steps.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.first_call import measure_first_calls
from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown, with_range
from pfdist import load_model
from pfdist.common.measurement_times import regular
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.settings import RESAMPLING
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.rules import Applied, Thresholds
from pfdist.models.base import StateSpaceModel
from pfdist.models.library.linear_gaussian import linear_gaussian
from pfdist.models.loader import installed_models
from pfdist.pages.style import COLUMN_INCHES, SERIES

TITLE = "The kernel"
TABLES: tuple[str, ...] = ("kernel", "first_call")

MODELS = ("ungm", "bearings_only")
REPEATS = 9
LEAST_STEPS = 15_000_000  # particle-steps of a measurement; short cases are called several times

SIZES = {
    "particles": (50, 200, 500, 1000, 2000, 5000, 10_000, 50_000, 200_000, 1_000_000),
    "horizon": (15, 30, 60, 120, 240, 480, 1000, 2000),
    "measurement_budget": (2, 11, 21, 31, 61),
    "draws": (1, 10, 100, 1000, 10_000),
    "components": (1, 2, 3, 4, 6, 8, 12, 20),
    "sub_steps": (1, 2, 5, 10, 20),
}
"""The quantities that are varied, one at a time, and their values."""

_PARTS = ("import", "first_call")
_LABELS = {
    "particles": "particles $P$",
    "horizon": "horizon $T$, $N = T/3 + 1$",
    "measurement_budget": "measurement budget $N$, $T = 60$",
    "draws": "draws $K$",
    "components": "components of a linear system",
    "sub_steps": "Runge-Kutta steps of prey and predators",
}


@dataclass(frozen=True)
class Case:
    """A case that is timed. The defaults are the base case.

    Parameters
    ----------
    series : str
        The varied quantity: a key of `SIZES`, ``kind`` for model and resampling, or ``rule`` for
        filters that measure by a rule, with as many measurements on average.
    """

    series: str = "kind"
    model: str = "ungm"
    resampling: str = "multinomial"
    particles: int = 500
    horizon: int = 60
    measurement_budget: int = 21
    draws: int = 1000
    components: int = 0  # of a linear system in the place of the model
    sub_steps: int = 0  # of a differential equation in the place of the model

    @property
    def steps(self) -> int:
        """Number of particle-steps of a call."""
        return self.draws * (self.horizon + 1) * self.particles

    @property
    def calls(self) -> int:
        """Number of calls of a measurement."""
        return max(1, LEAST_STEPS // self.steps)


def cases(quick: bool) -> Iterator[Case]:
    """Give all cases; with `quick` every second size up to the middle."""
    for model in installed_of(MODELS):
        for resampling in RESAMPLING:
            yield Case(model=model, resampling=resampling)
    for size in SIZES["particles"][1:5]:
        yield Case("rule", particles=size, draws=Case().draws * 500 // size)
    for series, sizes in SIZES.items():
        for resampling in ("multinomial", "systematic"):
            for size in sizes[: len(sizes) // 2 + 1 : 2] if quick else sizes:
                changed: dict[str, Any] = {series: size}
                case = replace(Case(series, resampling=resampling), **changed)
                if series == "horizon":
                    case = replace(case, measurement_budget=size // 3 + 1)
                if series in ("components", "sub_steps"):
                    case = replace(case, draws=100)
                if series in ("particles", "horizon"):  # keeps the work about the same
                    case = replace(case, draws=max(1, case.draws * Case().steps // case.steps))
                yield case


def installed_of(names: tuple[str, ...]) -> list[str]:
    """Give those names that are models of this version."""
    installed = installed_models()
    return [name for name in names if name in installed]


def measure(quick: bool, say: Say) -> Tables:
    """Give the times of all cases, measured in turns, and of first calls.

    Parameters
    ----------
    quick : bool
        Few cases, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        kernel: a row for each case, with ns, ns_median, ns_max and ns_wall of a particle-step, and
        repeats; first_call: see `measure_first_calls`.
    """
    models = installed_of(MODELS)
    for name in set(MODELS) - set(models):
        say(f"{name} is skipped: this version has no such model")
    repeats = 2 if quick else REPEATS
    with one_core():
        functions = {case: _calls(case) for case in cases(quick)}
        say(f"{len(functions)} cases")
        timings = take_turns(functions, repeats, say)
        first_calls = measure_first_calls(models, 1 if quick else 3)
    rows = [
        asdict(case) | timing.nanoseconds(case.steps * case.calls) | {"repeats": repeats}
        for case, timing in timings.items()
    ]
    return {"kernel": pd.DataFrame(rows), "first_call": first_calls}


def _calls(case: Case) -> Callable[[], None]:
    model = _model(case.model, case.components, case.sub_steps)
    draws = simulate(model, case.horizon, range(case.draws), stream=1)
    times = regular(case.horizon, case.measurement_budget)
    settings = Estimation(case.particles, case.resampling)
    if case.series == "rule":
        times, settings = (
            tuple(range(case.horizon + 1)),
            replace(settings, rule=Applied(Thresholds((6.18,)))),
        )
    once = partial(filter_checked_draws, model, draws, times, 2, settings)

    def call() -> None:
        for _ in range(case.calls):
            once()

    return call


@cache
def _model(name: str, components: int, sub_steps: int) -> StateSpaceModel:
    """The model of a name, independent components that decay, or a differential equation."""
    if sub_steps:
        return _prey_and_predators(sub_steps)
    if not components:
        return load_model(name)
    unit = np.eye(components)
    return linear_gaussian(
        f"{components} components",
        initial_noise=unit.tolist(),
        transition=(0.9 * unit).tolist(),
        process_noise=unit.tolist(),
        measurement=unit.tolist(),
        measurement_noise=unit.tolist(),
        quantity_of_interest=unit.tolist(),
    )


def _prey_and_predators(steps: int) -> StateSpaceModel:
    """The equation of Lotka and Volterra by so many steps of Runge and Kutta an instant."""
    h = 1.0 / steps

    def rate(s: Any) -> Any:
        return np.array([0.5 * s[0] - 0.025 * s[0] * s[1], 0.025 * s[0] * s[1] - 0.3 * s[1]])

    def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
        s = np.array(x)
        for _ in range(steps):
            k1 = rate(s)
            k2 = rate(s + h / 2 * k1)
            k3 = rate(s + h / 2 * k2)
            k4 = rate(s + h * k3)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return s[0] * np.exp(0.05 * w[0]), s[1] * np.exp(0.05 * w[1])

    return StateSpaceModel(
        f"prey and predators, {steps} steps",
        initial=lambda w, p: (20 + w[0], 20 + w[1]),
        transition=transition,
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        measurement_noise=("normal",),
    )


def summary(tables: Tables) -> str:
    """Give a summary in Markdown: the cost of a step, how it scales, and the first call."""
    rows = tables["kernel"]
    kinds = rows[rows["series"] == "kind"]
    by_kind = markdown(
        ["model, resampling", "ns a particle-step"],
        (
            [f"{model}, {resampling}", f"{ns:.2f}"]
            for model, resampling, ns in kinds[["model", "resampling", "ns"]].to_numpy()
        ),
    )
    spread = (kinds["ns_median"] / kinds["ns"]).max() - 1
    busy = max(0.0, (rows["ns_wall"] / rows["ns"]).median() - 1)
    return "\n\n".join(
        [
            f"One core, UNGM, T = 60, 21 regular times, 500 particles, 1,000 draws, unless it says "
            f"otherwise. Processor time, least of {rows['repeats'].iloc[0]} repeats in turns; the "
            f"median lies up to {spread:.0%} higher, the least wall time {busy:.0%}.",
            by_kind,
            *_rule_table(rows),
            "How it grows (multinomial). Power: time grows as size to it, least squares "
            "over all sizes.",
            _growth_table(rows),
            "The first call of a fresh process, simulation and filter, in seconds: the "
            "median of processes of their own, on one core; in brackets the least and the largest.",
            _first_call_table(tables["first_call"]),
        ]
    )


def _rule_table(rows: pd.DataFrame) -> list[str]:
    fixed = rows[(rows["series"] == "particles") & (rows["resampling"] == "multinomial")]
    both = rows[rows["series"] == "rule"].merge(fixed, on="particles", suffixes=("", "_fixed"))
    lines = (
        [f"{particles:,.0f}", f"{ns:.2f}", f"{fixed_ns:.2f}", f"{ns / fixed_ns:.2f}"]
        for particles, ns, fixed_ns in both[["particles", "ns", "ns_fixed"]].to_numpy(float)
    )
    head = ["particles", "by a rule, ns a particle-step", "fixed times", "ratio"]
    return [markdown(head, lines)] if len(both) else []


def _growth_table(rows: pd.DataFrame) -> str:
    def line(series: str) -> list[str]:
        chosen = rows[(rows["series"] == series) & (rows["resampling"] == "multinomial")]
        pairs = zip(chosen[series], chosen["ns"], strict=True)
        costs = ", ".join(f"{size:,}: {ns:.2f}" for size, ns in pairs)
        seconds = chosen["ns"] * chosen["particles"] * (chosen["horizon"] + 1)
        seconds *= chosen["draws"] if series == "draws" else 1
        power = np.polyfit(np.log(chosen[series]), np.log(seconds), 1)[0]
        return [series.replace("_", " "), costs, f"{power:.2f}"]

    return markdown(["what is varied", "size: ns a particle-step", "power"], map(line, SIZES))


def _first_call_table(rows: pd.DataFrame) -> str:
    return markdown(
        ["model, cache", "import", "first call"],
        (
            [f"{model}, {state}", *(with_range(calls[f"{part}_seconds"], ".2f") for part in _PARTS)]
            for (model, state), calls in rows.groupby(["model", "cache"])
        ),
    )


def plot(tables: Tables) -> Figure:
    """Draw the nanoseconds of a particle-step against each size."""
    rows = tables["kernel"]
    figure = Figure(figsize=(2 * COLUMN_INCHES, 1.9 * COLUMN_INCHES), layout="constrained")
    panels = figure.subplots(3, 2)
    for axes, series in zip(panels.flat, SIZES, strict=True):
        _plot_series(axes, rows[rows["series"] == series], series)
        axes.set_ylim(bottom=0)
    for axes in panels[:, 0]:
        axes.set_ylabel("ns a particle-step")
    panels[0, 0].legend()
    return figure


def _plot_series(axes: Axes, rows: pd.DataFrame, series: str) -> None:
    styles = zip(SERIES, "os", rows.groupby("resampling"), strict=False)
    for colour, marker, (name, chosen) in styles:
        axes.plot(chosen[series], chosen["ns"], color=colour, marker=marker, ms=2.5, label=name)
        axes.fill_between(
            chosen[series], chosen["ns"], chosen["ns_median"], color=colour, alpha=0.2, lw=0
        )
    if series != "measurement_budget":
        axes.set_xscale("log")
    sizes = sorted(rows[series].unique())
    if len(sizes) > 6:
        sizes = sizes[::3]
    axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
    axes.minorticks_off()
    axes.set_xlabel(_LABELS[series])
