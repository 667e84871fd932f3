"""The same filter in other libraries, timed in turns with pfdist on one core.

The mean MSE of each peer is compared with that of pfdist, so all compute the same.
"""

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist import load_model
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.plots.style import BLUE, COLUMN_INCHES, RED
from pfdist.times.measurement_times import regular

TITLE = "The same job by others"
TABLES: tuple[str, ...] = ("peers",)

HORIZON, BUDGET, PARTICLES, DRAWS = 60, 21, 500, 1000
SCHEMES = ("multinomial", "systematic")
REPEATS = 5
STANDARD_ERRORS = 4  # largest difference of a peer's mean from that of pfdist
OURS = "pfdist"

Filter = Callable[[str, int], NDArray[np.float64]]  # (resampling, seed) -> mse (D,)


class PeerDisagreesError(Exception):
    """A peer computes another result than pfdist, so its time means nothing."""


@dataclass(frozen=True)
class Peer:
    """A filter in another library.

    Parameters
    ----------
    name : str
    module : str
        Module in `benchmarks.peer_filters`.
    package : str
        Package that the module needs.
    dtype : str
        Type of the numbers.
    """

    name: str
    module: str
    package: str
    dtype: str


PEERS = (
    Peer("JAX", "jax_scan", "jax", "float32"),
    Peer("NumPy, batched", "numpy_batched", "numpy", "float32"),
    Peer("NumPy, a loop over draws", "numpy_naive", "numpy", "float64"),
    Peer("particles", "particles_smc", "particles", "float64"),
)


class _Turns:
    """A filter that takes another seed at each call, and keeps the results."""

    def __init__(self, function: Filter, resampling: str) -> None:
        self._function, self._resampling = function, resampling
        self.mse: list[NDArray[np.float64]] = []

    def __call__(self) -> None:
        self.mse.append(self._function(self._resampling, len(self.mse)))


def measure(quick: bool, say: Say) -> Tables:
    """Give the times of pfdist and of every installed peer, in turns on the same draws.

    Parameters
    ----------
    quick : bool
        A tenth of the draws, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        peers: a row for each peer and resampling scheme. Columns: ns, ns_median, ns_max and ns_wall
        of a particle-step; ratio of the least time to that of pfdist, with ratio_low and
        ratio_high of single rounds; expected_mse, difference from pfdist, and standard_error of the
        difference; repeats.

    Raises
    ------
    PeerDisagreesError
        The mean MSE of a peer lies more than four standard errors from that of pfdist.
    """
    draws = simulate(load_model("ungm"), HORIZON, range(DRAWS // 10 if quick else DRAWS), 1)
    repeats = 2 if quick else REPEATS
    with one_core():  # before a peer is imported, so that its threads stay on this core, too
        entrants = {(OURS, "float64"): _ours(draws)}
        for peer in PEERS:
            if find_spec(peer.package) is None:
                say(f"{peer.name} is skipped: {peer.package} is not installed")
                continue
            entrants[f"{peer.name}{_version(peer)}", peer.dtype] = _theirs(draws, peer)
        turns = {
            (*entrant, scheme): _Turns(function, scheme)
            for scheme in SCHEMES
            for entrant, function in entrants.items()
        }
        timings = take_turns(turns, repeats, say)
    steps = len(draws.index) * (HORIZON + 1) * PARTICLES
    rows = []
    for (who, dtype, scheme), timing in timings.items():
        ours = timings[OURS, "float64", scheme]
        rounds = np.array(timing.processor) / ours.processor
        rows.append(
            {"who": who, "dtype": dtype, "resampling": scheme}
            | timing.nanoseconds(steps)
            | {
                "ratio": min(timing.processor) / min(ours.processor),
                "ratio_low": rounds.min(),
                "ratio_high": rounds.max(),
            }
            | _agreement(turns[who, dtype, scheme], turns[OURS, "float64", scheme])
            | {"repeats": repeats, "draws": len(draws.index)}
        )
    _check(rows)
    return {"peers": pd.DataFrame(rows)}


def _ours(draws: Draws) -> Filter:
    times = regular(HORIZON, BUDGET)

    def filter_ours(resampling: str, seed: int) -> NDArray[np.float64]:
        return filter_draws(draws.model, draws, times, PARTICLES, seed + 1, resampling).mse

    return filter_ours


def _theirs(draws: Draws, peer: Peer) -> Filter:
    function = importlib.import_module(f"benchmarks.peer_filters.{peer.module}").filter_draws
    measured = np.zeros(HORIZON + 1, np.bool_)
    measured[list(regular(HORIZON, BUDGET))] = True
    filled: Filter = partial(function, draws.y[:, :, 0], draws.z[:, :, 0], measured, PARTICLES)
    return filled


def _version(peer: Peer) -> str:
    return "" if peer.package == "numpy" else f" {version(peer.package)}"


def _agreement(turns: _Turns, ours: _Turns) -> dict[str, float]:
    """Give the mean MSE and its paired difference from pfdist, averaged over all repeats."""
    mse, reference = np.mean(turns.mse, axis=0), np.mean(ours.mse, axis=0)
    difference = mse - reference
    return {
        "expected_mse": float(mse.mean()),
        "difference": float(difference.mean()),
        "standard_error": float(difference.std(ddof=1) / math.sqrt(difference.size)),
    }


def _check(rows: list[dict[str, float | str]]) -> None:
    for row in rows:
        difference, error = float(row["difference"]), float(row["standard_error"])
        if not abs(difference) <= STANDARD_ERRORS * error:
            raise PeerDisagreesError(
                f"{row['who']} ({row['dtype']}, {row['resampling']}) must have the mean MSE of "
                f"pfdist within {STANDARD_ERRORS} standard errors of the paired difference, got "
                f"{difference:+.3f} ± {error:.3f}: its time means nothing"
            )


def summary(tables: Tables) -> str:
    """Give a summary of the times and the agreement in Markdown."""
    rows = tables["peers"]
    lines = []
    for (who, dtype), filters in rows.groupby(["who", "dtype"], sort=False):
        cells = [f"{who}, {dtype}"]
        for scheme in SCHEMES:
            row = filters[filters["resampling"] == scheme].iloc[0]
            cells += [
                f"{row['ns']:.2f}",
                f"{row['ratio']:.1f} ({row['ratio_low']:.1f} to {row['ratio_high']:.1f})",
                f"{row['difference']:+.3f} ± {row['standard_error']:.3f}",
            ]
        lines.append(cells)
    header = ["one core"]
    for scheme in SCHEMES:
        header += [f"{scheme}: ns a particle-step", "times ours", "MSE minus ours"]
    first = rows.iloc[0]
    busy = max(0.0, (rows["ns_wall"] / rows["ns"]).median() - 1)
    return (
        f"UNGM, T = {HORIZON}, {BUDGET} regular times, {PARTICLES} particles, "
        f"{first['draws']:,} draws. Processor time, least of {first['repeats']} repeats in turns "
        f"(the least wall time lies {busy:.0%} higher); in brackets the ratios of single rounds. "
        f"Each peer is written by its own best idioms (`peer_filters/`) and has our mean MSE "
        f"within {STANDARD_ERRORS} standard errors of the paired difference, or nothing is "
        f"written.\n\n{markdown(header, lines)}"
    )


def plot(tables: Tables) -> Figure:
    """Draw the nanoseconds of a particle-step of each peer."""
    rows = tables["peers"].assign(label=lambda all_: all_["who"] + ", " + all_["dtype"])
    names = list(dict.fromkeys(rows["label"]))[::-1]
    figure = Figure(figsize=(1.5 * COLUMN_INCHES, COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    styles = zip(SCHEMES, (RED, BLUE), "os", (0.17, -0.17), strict=True)
    for scheme, colour, marker, aside in styles:
        chosen = rows[rows["resampling"] == scheme].set_index("label").loc[names]
        places = np.arange(len(names)) + aside
        axes.plot(chosen["ns"], places, marker, color=colour, ms=4, label=scheme)
        for ns, place in zip(chosen["ns"], places, strict=True):
            text = f"{ns:.{1 if ns > 10 else 2}f}"
            axes.annotate(text, (ns, place), (5, 0), textcoords="offset points", va="center")
    axes.set_xscale("log")
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel("ns a particle-step, one core")
    axes.set_xlim(right=2 * rows["ns"].max())
    axes.grid(axis="y", lw=0.3)
    axes.legend(loc="upper right")
    return figure
