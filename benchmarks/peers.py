"""The same filter in other libraries, timed in turns with pfdist on one core and on two.

The mean MSE of each peer is compared with that of pfdist, so all compute the same. A loop that only
makes the noise and moves the particles is the limit.
"""

import importlib
import math
import os
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from unittest.mock import patch

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.measure import Say, Timing, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist import load_model
from pfdist.common.measurement_times import regular
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.kernels.cached import FOLDER_VARIABLE
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED

TITLE = "The same job by others"
TABLES: tuple[str, ...] = ("peers",)

HORIZON, BUDGET, PARTICLES, DRAWS = 60, 21, 500, 1000
SCHEMES = ("multinomial", "systematic")
REPEATS = 5
STANDARD_ERRORS = 4  # largest difference of a peer's mean from that of pfdist
OURS = "pfdist"
THREADS = 2
_BUSY = 0.1  # share of wall time above which the machine does other things

Filter = Callable[[Draws, str, int], NDArray[np.float64]]  # (draws, resampling, seed) -> mse (D,)


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
    threads : bool
        Whether threads can filter side by side. Loops over draws in Python hold Python's lock.
    """

    name: str
    module: str
    package: str
    dtype: str
    threads: bool = True


LIMIT = Peer("Limit: noise and copies alone", "bare_loop", "numpy", "float64")
PEERS = (
    LIMIT,
    Peer("JAX", "jax_scan", "jax", "float32"),
    Peer("PyTorch", "torch_compiled", "torch", "float32"),
    Peer("cuthbert", "cuthbert_smc", "cuthbert", "float32"),
    Peer("NumPy, batched", "numpy_batched", "numpy", "float32"),
    Peer("NumPy, a loop over draws", "numpy_naive", "numpy", "float64", threads=False),
    Peer("particles", "particles_smc", "particles", "float64", threads=False),
)


class _Turns:
    """A filter that takes another seed at each call, and keeps the results."""

    def __init__(self, function: Filter, draws: Draws, resampling: str) -> None:
        self._function, self._draws, self._resampling = function, draws, resampling
        self.mse: list[NDArray[np.float64]] = []

    def __call__(self) -> None:
        self.mse.append(self._function(self._draws, self._resampling, len(self.mse)))


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
        of a particle-step on one core; ratio of the least time to that of pfdist, with ratio_low
        and ratio_high of single rounds; first_seconds, the wall time that the first call takes more
        than the least of the others; speedup, the least wall time over that of two threads with
        half of the draws each, NaN if threads cannot filter side by side; expected_mse, difference
        from pfdist, and standard_error of the difference, NaN for the limit; repeats.

    Raises
    ------
    PeerDisagreesError
        The mean MSE of a peer lies more than four standard errors from that of pfdist.
    """
    draws = simulate(load_model("ungm"), HORIZON, range(DRAWS // 10 if quick else DRAWS), 1)
    repeats = 2 if quick else REPEATS
    with (
        tempfile.TemporaryDirectory(prefix="cache-") as cache,  # so first calls compile
        patch.dict(os.environ, {FOLDER_VARIABLE: cache, "TORCHINDUCTOR_CACHE_DIR": cache}),
    ):
        with one_core():  # before a peer is imported, so that its threads stay on this core, too
            filters, turns = _entrants(draws, say)
            timings = take_turns(turns, repeats, say)
        on_threads = _on_threads(filters, draws, repeats, say)
    steps = len(draws.index) * (HORIZON + 1) * PARTICLES
    rows = []
    for (who, dtype, scheme), timing in timings.items():
        ours = timings[OURS, "float64", scheme]
        rounds = np.array(timing.processor) / ours.processor
        beside = on_threads.get((who, dtype, scheme))
        rows.append(
            {"who": who, "dtype": dtype, "resampling": scheme}
            | timing.nanoseconds(steps)
            | {
                "ratio": min(timing.processor) / min(ours.processor),
                "ratio_low": rounds.min(),
                "ratio_high": rounds.max(),
                "first_seconds": timing.first - min(timing.wall),
                "speedup": min(timing.wall) / min(beside.wall) if beside else math.nan,
            }
            | _agreement(turns[who, dtype, scheme], turns[OURS, "float64", scheme], who)
            | {"repeats": repeats, "draws": len(draws.index)}
        )
    _check(rows)
    return {"peers": pd.DataFrame(rows)}


def _entrants(
    draws: Draws, say: Say
) -> tuple[dict[tuple[str, str], Filter], dict[tuple[str, str, str], _Turns]]:
    """The filters that threads can call side by side, and the turns of all filters."""
    filters: dict[tuple[str, str], Filter] = {(OURS, "float64"): _filter_ours}
    beside = {**filters}
    for peer in PEERS:
        if find_spec(peer.package) is None:
            say(f"{peer.name} is skipped: {peer.package} is not installed")
            continue
        key = f"{peer.name}{_version(peer)}", peer.dtype
        filters[key] = _theirs(peer)
        if peer.threads:
            beside[key] = filters[key]
    turns = {
        (*entrant, scheme): _Turns(function, draws, scheme)
        for scheme in SCHEMES
        for entrant, function in filters.items()
    }
    return beside, turns


def _on_threads(
    filters: dict[tuple[str, str], Filter], draws: Draws, repeats: int, say: Say
) -> dict[tuple[str, str, str], Timing]:
    """The times of filters on two threads with half of the draws each; none on a single core."""
    if len(os.sched_getaffinity(0)) < THREADS:
        say("two threads are skipped: there is one core")
        return {}
    half = len(draws.index) // THREADS
    halves = draws[:half], draws[half:]
    with ThreadPoolExecutor(THREADS) as threads:

        def both(function: Filter, scheme: str) -> None:
            list(threads.map(lambda part: function(part, scheme, 0), halves))

        turns = {
            (*entrant, scheme): partial(both, function, scheme)
            for scheme in SCHEMES
            for entrant, function in filters.items()
        }
        return take_turns(turns, repeats, say)


def _filter_ours(draws: Draws, resampling: str, seed: int) -> NDArray[np.float64]:
    model, times = draws.model, regular(HORIZON, BUDGET)
    return filter_draws(model, draws, times, PARTICLES, seed + 1, resampling).mse


def _theirs(peer: Peer) -> Filter:
    function = importlib.import_module(f"benchmarks.peer_filters.{peer.module}").filter_draws
    measured = np.zeros(HORIZON + 1, np.bool_)
    measured[list(regular(HORIZON, BUDGET))] = True

    def filter_theirs(draws: Draws, resampling: str, seed: int) -> NDArray[np.float64]:
        y, z = draws.y[:, :, 0], draws.z[:, :, 0]
        mse: NDArray[np.float64] = function(y, z, measured, PARTICLES, resampling, seed)
        return mse

    return filter_theirs


def _version(peer: Peer) -> str:
    return "" if peer.package == "numpy" else f" {version(peer.package)}"


def _agreement(turns: _Turns, ours: _Turns, who: str) -> dict[str, float]:
    """Give the mean MSE and its paired difference from pfdist, averaged over all repeats."""
    if who == LIMIT.name:
        return dict.fromkeys(("expected_mse", "difference", "standard_error"), math.nan)
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
        if row["who"] != LIMIT.name and not abs(difference) <= STANDARD_ERRORS * error:
            raise PeerDisagreesError(
                f"{row['who']} ({row['dtype']}, {row['resampling']}) must have the mean MSE of "
                f"pfdist within {STANDARD_ERRORS} standard errors of the paired difference, got "
                f"{difference:+.3f} ± {error:.3f}: its time means nothing"
            )


def summary(tables: Tables) -> str:
    """Give a summary of the times and the agreement in Markdown."""
    rows = tables["peers"]
    busy = max(0.0, (rows["ns_wall"] / rows["ns"]).median() - 1)
    is_idle, lines = busy < _BUSY, []
    for (who, dtype), filters in rows.groupby(["who", "dtype"], sort=False):
        cells = [f"{who}, {dtype}"]
        for scheme in SCHEMES:
            row = filters[filters["resampling"] == scheme].iloc[0]
            cells += [
                f"{row['ns']:.2f}",
                f"{row['ratio']:.1f} ({row['ratio_low']:.1f} to {row['ratio_high']:.1f})",
                _shown("{:+.3f} ± {:.3f}", row["difference"], row["standard_error"]),
            ]
            if is_idle:
                cells += [f"{row['first_seconds']:.1f}", _shown("{:.2f}", row["speedup"])]
        lines.append(cells)
    header = ["one core"]
    for scheme in SCHEMES:
        header += [f"{scheme}: ns a particle-step", "times ours", "MSE minus ours"]
        header += ["first call, s", "two threads"] if is_idle else []
    first = rows.iloc[0]
    wall = (
        "First call: its seconds, less those of a later call; that of the first scheme also makes "
        "all that both need. Two threads: how many times faster they are, with half of the draws "
        "each."
        if is_idle
        else "The machine was busy: wall times, of first calls and of two threads, are left out."
    )
    return (
        f"UNGM, T = {HORIZON}, {BUDGET} regular times, {PARTICLES} particles, "
        f"{first['draws']:,} draws. Processor time, least of {first['repeats']} repeats in turns "
        f"(the least wall time lies {busy:.0%} higher); in brackets the ratios of single rounds. "
        f"Each peer is written by its own best idioms (`peer_filters/`) and has our mean MSE "
        f"within {STANDARD_ERRORS} standard errors of the paired difference, or nothing is "
        f"written. The limit makes the same noise, moves and copies the states, and filters "
        f"nothing. {wall}\n\n{markdown(header, lines)}"
    )


def _shown(form: str, *values: float) -> str:
    return "" if math.isnan(values[0]) else form.format(*values)


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
