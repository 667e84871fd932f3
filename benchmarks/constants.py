"""Unknown constants: particle-steps until the error is nearly that of the exact filter.

All filters of a system have the same draws. The numbers of particles are doubled until the error is
clearly within 5 % of the exact one, which is that of a Kalman filter, or of many moved particles.
A static posterior is also computed by the SMC sampler of the package `particles` (IBIS).
"""

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist import StateSpaceModel, load_model
from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times
from pfdist.errors import ModelError
from pfdist.filters import kalman
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.proposal import PLAIN
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREEN, RED
from pfdist.plugins.guided.proposal import GUIDED
from pfdist.plugins.moving.proposal import MOVING

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from oracles.unknown import HOURS, constants, drug, level_and_slope

TITLE = "Unknown constants"
TABLES: tuple[str, ...] = ("constants", "static")

ENOUGH = 0.05  # of the exact error
_DRAWS, _EXACT = 400, 1000
_NUMBERS = {PLAIN.name: (250, 2**17), GUIDED.name: (250, 2**15), MOVING.name: (25, 1600)}
_COLORS = {PLAIN.name: RED, GUIDED.name: GREEN, MOVING.name: BLUE}
_SENSOR, _READINGS = 0.2, 8  # sharper ones make covariances of IBIS singular
_OWN, _OF_PEER = (100, 300), (4000, 16_000)  # particles


@dataclass(frozen=True)
class System:
    """A model with measurement times; a filter of its constants is exact, or Kalman's."""

    model: StateSpaceModel
    times: Times
    horizon: int
    is_linear: bool = False
    lag: int = 0


def systems() -> Mapping[str, System]:
    """The systems by their names."""
    every4 = (*range(4, 41, 4),)
    growth = load_model("ungm")
    samples = tuple(HOURS.index(t) for t in (0.5, 3.0, 4.0, 6.0, 16.0, 24.0))
    return {
        "level and slope, process noise .02": System(
            level_and_slope(0.02, 0.05), every4, 40, is_linear=True
        ),
        "level and slope, process noise .1": System(
            level_and_slope(0.1, 0.05), every4, 40, is_linear=True
        ),
        "drug, error 15 %, afterwards": System(drug(0.15).on_clock(HOURS), samples, 13, lag=13),
        "drug, error 3 %, afterwards": System(drug(0.03).on_clock(HOURS), samples, 13, lag=13),
        "ten constants, 20 readings": System(constants(10, 0.05), (*range(1, 21),), 20),
        "growth model, no constant": System(growth, (*range(0, 61, 3),), 60),
    }


def measure(quick: bool, say: Say) -> Tables:
    """Give the excess of each system with each proposal and number of particles.

    Parameters
    ----------
    quick : bool
        Few draws and particles.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        constants: a row for each system, proposal and number of particles, with excess (of the
        expected MSE over that of the exact filter, as a fraction), excess_error, and steps
        (particle-steps of a draw). static: a row for each program, with particles, excess (squared
        distance to the exact mean over the exact variance), and ms (a posterior).
    """
    rows = list[dict[str, Any]]()
    for name, system in systems().items():
        for proposal in _NUMBERS:
            rows += _of_proposal(name, system, proposal, 16 if quick else _DRAWS, quick)
        say(name)
    return {"constants": pd.DataFrame(rows), "static": _static(8 if quick else 100)}


def _of_proposal(
    name: str, system: System, proposal: str, count: int, quick: bool
) -> list[dict[str, Any]]:
    draws, rows = simulate(system.model, system.horizon, range(count), 1), list[dict[str, Any]]()
    own = Estimation(1, "systematic", proposal=proposal, lag=system.lag)
    if system.is_linear:
        exact = kalman.filter_checked_draws(system.model, draws, system.times, 1, own).mse
    else:
        many = replace(own, particles=100 if quick else _EXACT, proposal=MOVING.name)
        exact = filter_checked_draws(system.model, draws, system.times, 3, many).mse
    number, most = _NUMBERS[proposal]
    while number <= (number if quick and not rows else most):
        settings = replace(own, particles=number)
        try:
            found = filter_checked_draws(system.model, draws, system.times, 2, settings)
        except ModelError:  # it cannot be guided
            break
        excess = Estimate.of_mean(found.mse - exact).times(1.0 / exact.mean())
        steps = (system.horizon + 1) * number
        if proposal == MOVING.name:
            steps = round(float(found.work[0]) / count)
        rows.append({
            "system": name, "proposal": proposal, "particles": number, "excess": excess.value,
            "excess_error": excess.standard_error, "steps": steps,
        })  # fmt: skip
        if quick or excess.value + excess.standard_error < ENOUGH:
            break
        number *= 2
    return rows


def _static(count: int) -> pd.DataFrame:
    """The same posteriors of three constants by both programs."""
    model, times = constants(3, _SENSOR), (*range(1, _READINGS + 1),)
    draws = simulate(model, _READINGS, range(count), 5)
    series: Any = model.parameters
    factors = np.array([series[f"factor_{c}"][1 : _READINGS + 1] for c in range(3)]).T
    covariance = np.linalg.inv(np.eye(3) + factors.T @ factors / _SENSOR**2)
    exact = draws.y[:, 1:, 0] @ factors @ covariance / _SENSOR**2
    rows = list[tuple[str, int, Any, float]]()
    for number in _OF_PEER if find_spec("particles") is not None else ():
        peer = import_module("benchmarks.peer_filters.particles_ibis")
        begun = time.perf_counter()
        means = [peer.posterior_mean(y, factors, _SENSOR, number) for y in draws.y[:, 1:, 0]]
        rows.append(("particles, IBIS", number, np.array(means), time.perf_counter() - begun))
    for number in _OWN:
        settings = Estimation(number, "systematic", proposal=MOVING.name)
        filter_checked_draws(model, draws[:1], times, 3, settings, True)  # it is compiled
        begun = time.perf_counter()
        found = filter_checked_draws(model, draws, times, 3, settings, True)
        seconds = time.perf_counter() - begun
        rows.append(("pfdist, moving", number, found.estimate[:, -1], seconds))
    return pd.DataFrame([
        {
            "program": program, "particles": number,
            "excess": float(np.mean((mean - exact) ** 2 / np.diag(covariance))),
            "ms": 1000 * seconds / count,
        }
        for program, number, mean, seconds in rows
    ])  # fmt: skip


def needed(table: pd.DataFrame, system: str, proposal: str) -> str:
    """The particle-steps of a draw that a proposal needs, in words."""
    rows = table[(table["system"] == system) & (table["proposal"] == proposal)]
    if not len(rows):
        return "not possible"
    last = rows.iloc[-1]
    if last["excess"] + last["excess_error"] < ENOUGH:
        return f"{last['steps']:,.0f} ({last['particles']:,.0f} particles)"
    return f"more than {last['steps']:,.0f}: {100 * last['excess']:+,.0f} %"


def summary(tables: Tables) -> str:
    """Give a summary in Markdown."""
    table, static = tables["constants"], tables["static"]
    names = dict.fromkeys(table["system"])
    steps = markdown(
        ["system", *_NUMBERS],
        ([name, *(needed(table, name, each) for each in _NUMBERS)] for name in names),
    )
    peers = markdown(
        ["program", "particles", "excess", "ms a posterior"],
        (
            [row["program"], f"{row['particles']}", f"{row['excess']:.3f}", f"{row['ms']:.1f}"]
            for _, row in static.iterrows()
        ),
    )
    return (
        f"Particle-steps of a draw until the expected MSE is within {ENOUGH:.0%} of the exact one, "
        f"on {_DRAWS} draws.\n\n{steps}\n\nThree constants by {_READINGS} readings; the excess is "
        f"the squared distance to the exact mean over the exact variance.\n\n{peers}"
    )


def plot(tables: Tables) -> Figure:
    """Draw the excess against the particle-steps."""
    table = tables["constants"]
    names = [*dict.fromkeys(table["system"])]
    figure = Figure(figsize=(2 * COLUMN_INCHES, 1.6 * COLUMN_INCHES), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, name in zip(panels.flat, names, strict=False):
        for proposal, color in _COLORS.items():
            rows = table[(table["system"] == name) & (table["proposal"] == proposal)]
            axes.plot(rows["steps"], 100 * rows["excess"], "o-", ms=3, color=color, label=proposal)
        axes.axhline(100 * ENOUGH, color="0.5", lw=0.6)
        axes.set(xscale="log", yscale="symlog", title=name, xlabel="particle-steps of a draw")
    figure.axes[0].legend()
    figure.axes[0].set_ylabel("error over the exact one [%]")
    return figure
