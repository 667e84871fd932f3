"""One system as traced formulas, and as functions of arrays in NumPy and in JAX.

All filters have the same draws and the same noise, so their errors differ by rounding alone.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist import BatchedModel, StateSpaceModel
from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import regular
from pfdist.common.rounding import with_error
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED

TITLE = "Functions of arrays"
TABLES: tuple[str, ...] = ("simulators",)

REPEATS, HORIZON, PARTICLES, DRAWS = 7, 60, 500, 320
TIMES = regular(HORIZON, 21)
WAYS = ("formulas", "NumPy", "JAX")

System = Mapping[str, Callable[..., Any]]
"""Functions of components: initial, transition, measured (the mean of y) and sd (of y)."""


def growth(xp: Any) -> System:
    """The growth model of the paper."""
    return {
        "initial": lambda w: (5 * w[0],),
        "transition": lambda x, t, w: (
            x[0] / 2 + 25 * x[0] / (1 + x[0] ** 2) + 8 * xp.cos(1.2 * t) + w[0],
        ),
        "measured": lambda x: x[0] ** 2 / 20,
        "sd": lambda t: xp.sin(0.25 * t) + 2.0,
    }


def bearings(xp: Any) -> System:
    """A target with nearly constant velocity, of which one sensor sees the direction."""
    return {
        "initial": lambda w: (10 + w[0], 0.1 * w[1], 5 + w[2], -0.2 + 0.1 * w[3]),
        "transition": lambda x, t, w: (
            x[0] + x[1] + 0.05 * w[0],
            x[1] + 0.05 * w[1],
            x[2] + x[3] + 0.05 * w[2],
            x[3] + 0.05 * w[3],
        ),
        "measured": lambda x: xp.arctan2(x[2], x[0]),
        "sd": lambda t: 0.05,
    }


def tank(xp: Any) -> System:
    """A tank with an unknown inflow, in ten steps of Heun's method."""

    def transition(x: Any, t: Any, w: Any) -> tuple[Any, ...]:
        level, inflow = x
        for _ in range(10):
            first = inflow - 0.5 * xp.sqrt(xp.maximum(level, 0.0))
            second = inflow - 0.5 * xp.sqrt(xp.maximum(level + 0.1 * first, 0.0))
            level = level + 0.05 * (first + second)
        return level, inflow + 0.05 * w[0]

    return {
        "initial": lambda w: (4 + 0.3 * w[0], 1 + 0.2 * w[1]),
        "transition": transition,
        "measured": lambda x: x[0],
        "sd": lambda t: 0.1,
    }


SYSTEMS: Mapping[str, tuple[Callable[[Any], System], int, int]] = {
    "growth": (growth, 1, 1),
    "bearings": (bearings, 4, 4),
    "tank": (tank, 2, 1),
}
"""Each system, with its numbers of initial and of process noises."""


def model_of(name: str, way: str) -> StateSpaceModel:
    """A system as it is written in one of `WAYS`."""
    make, starts, noises = SYSTEMS[name]
    if way == "JAX":
        import jax  # noqa: PLC0415  a peer, which only this benchmark needs

        jax.config.update("jax_enable_x64", True)
        system, jit = make(jax.numpy), jax.jit
    else:
        system, jit = make(np), _as_it_is
    arrays = way != "formulas"

    def gathered(rows: Sequence[Any]) -> Any:
        return np.stack([np.asarray(row) for row in rows]) if arrays else tuple(rows)

    step, fit = jit(system["transition"]), jit(partial(_log_density, system))
    kind: Any = BatchedModel if arrays else StateSpaceModel
    made: StateSpaceModel = kind(
        f"{name} by {way}",
        lambda w, p: gathered(system["initial"](w)),
        lambda x, t, w, p: gathered(step(x, 1.0 * t, w)),
        measurement=lambda x, t, v, p: gathered(
            [np.asarray(system["measured"](x)) + system["sd"](1.0 * t) * v[0]]
            if arrays
            else [system["measured"](x) + system["sd"](1.0 * t) * v[0]]
        ),
        log_likelihood=lambda y, x, t, p: fit(y, x, 1.0 * t),
        quantity_of_interest=lambda x, t, p: x[:1],
        initial_noise=("normal",) * starts,
        process_noise=("normal",) * noises,
        measurement_noise=("normal",),
        **({"version": "1"} if arrays else {}),
    )
    return made


def _as_it_is(function: Callable[..., Any]) -> Callable[..., Any]:
    return function


def _log_density(system: System, y: Any, x: Any, t: Any) -> Any:
    return -0.5 * ((y[0] - system["measured"](x)) / system["sd"](t)) ** 2


def measure(quick: bool, say: Say) -> Tables:
    """Give the time of a particle-step and the expected MSE of each system, written in each way.

    Parameters
    ----------
    quick : bool
        Few draws, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        simulators: a row for each system and way, with ns, ns_of_functions (of transition and
        likelihood alone, on arrays of 8,192 particles) and the expected MSE.
    """
    count = 32 if quick else DRAWS
    functions: dict[tuple[str, str, str], Callable[[], object]] = {}
    rows = list[dict[str, Any]]()
    for name in SYSTEMS:
        models = {way: model_of(name, way) for way in WAYS}
        draws = simulate(models["formulas"], HORIZON, range(count), 1)
        for way, model in models.items():
            filtered = partial(filter_checked_draws, model, draws, TIMES, 2, Estimation(PARTICLES))
            functions[name, way, "ns"] = filtered
            if way != "formulas":
                functions[name, way, "ns_of_functions"] = _alone(model)
            estimate = Estimate.of_mean(filtered().mse)
            rows.append(
                {
                    "system": name,
                    "way": way,
                    "expected_mse": estimate.value,
                    "standard_error": estimate.standard_error,
                }
            )
        say(name)
    with one_core():
        timings = take_turns(functions, 2 if quick else REPEATS, say)
    for row in rows:
        for column, steps in (
            ("ns", count * (HORIZON + 1) * PARTICLES),
            ("ns_of_functions", _CALLS * _TOGETHER),
        ):
            timing = timings.get((row["system"], row["way"], column))
            row[column] = np.nan if timing is None else timing.nanoseconds(steps)["ns"]
    return {"simulators": pd.DataFrame(rows)}


_CALLS, _TOGETHER = 60, 8192


def _alone(model: StateSpaceModel) -> Callable[[], None]:
    """The functions of a batched model as a filter calls them: 60 steps and 21 likelihoods."""
    rng, (states, _, _) = np.random.default_rng(0), model.components
    x = rng.uniform(1.0, 2.0, (states, _TOGETHER))
    w = rng.normal(size=(len(model.process_noise), _TOGETHER))
    transition, likelihood = (
        getattr(model, name).function for name in ("transition", "log_likelihood")
    )

    def call() -> None:
        for t in range(_CALLS):
            np.asarray(transition(x, t, w, model.p))
            if t in TIMES:
                np.asarray(likelihood(x[:1], x, t, model.p))

    return call


def summary(tables: Tables) -> str:
    """Give a summary in Markdown."""
    rows = tables["simulators"]
    table = markdown(
        ["system", "written as", "ns a particle-step", "of these, the functions", "expected MSE"],
        (
            [
                row["system"],
                row["way"],
                f"{row['ns']:.1f}",
                "" if np.isnan(row["ns_of_functions"]) else f"{row['ns_of_functions']:.1f}",
                with_error(row["expected_mse"], row["standard_error"]),
            ]
            for _, row in rows.iterrows()
        ),
    )
    return (
        f"One core, {PARTICLES} particles, {DRAWS} draws of {HORIZON + 1} instants, 21 regular "
        f"times, processor time, least of {REPEATS} repeats in turns. The same draws and the same "
        f"noise.\n\n{table}"
    )


def plot(tables: Tables) -> Figure:
    """Draw the times of all ways."""
    rows = tables["simulators"].iloc[::-1]
    figure = Figure(figsize=(COLUMN_INCHES, 0.9 * COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    names = rows["system"] + ", " + rows["way"]
    axes.plot(rows["ns"], names, "o", color=BLUE, ms=3, label="filter")
    axes.plot(rows["ns_of_functions"], names, "s", color=RED, ms=3, label="functions alone")
    axes.set_xscale("log")
    axes.set_xlabel("ns a particle-step")
    axes.legend(loc="upper right")
    return figure
