"""The error over time of a set of times, and the worth of each of its measurements.

Everything is computed on new draws, which neither chose the times nor compared them.
"""

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.work import Result, Work
from pfdist.problem.feasible import Feasible
from pfdist.results import Moments
from pfdist.runner.door import Batch, Session
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.particles import mean_effective_sizes

Array = NDArray[np.float64]

CHANGES = ("removed", "earlier", "later")
_COLUMNS = [f"{change}{part}" for change in CHANGES for part in ("", "_error")]

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Worth:
    """The error over time of a set, and the worth of its measurements."""

    summary: dict[str, Any]  # expected_mse, standard_error and degenerate_draws of the set
    profile: Rows  # of the table of this name, without position, name and draws
    worth: Rows  # likewise


def worth_of(
    session: Session, name: str, times: Times, draws: int
) -> Generator[Batch, None, Worth]:
    """The error of a set over time, and the worth of each measurement.

    The set up to every instant and all its changes share draws and noise. So common prefixes are
    filtered once, and differences are paired. The name of the set keys the noise. The effective
    sample size is a mean over the first draws.
    """
    built = session.built
    evaluator, seed, instants = built.evaluator, built.job.seed, built.evaluator.horizon + 1
    changed = list(_changes(times, built.job.problem.feasible))
    sensors = evaluator.sensors
    sets = [tuple(t for t in times if t // sensors <= end) for end in range(instants)]
    sets += [other for _, _, other in changed]
    stream = stream_of("why", seed, "filter", name)
    ends = (*range(instants), *(evaluator.horizon,) * len(changed))
    of_draws = stream_of("why", seed, "draws")
    work = evaluator.work(sets, stream, of_draws, (0, draws), built.comparing, ends=ends)
    (mse, *estimates), degenerate = yield from _means(session, work)
    at = {t // sensors for t in times}
    alone = evaluator.work((times,), stream, of_draws, (0, draws), built.comparing)
    sizes: Any = {} if evaluator.exact else mean_effective_sizes(evaluator, alone)
    weights = built.job.problem.weights or (1.0,) * instants
    profile = [
        {
            "t": t,
            "measured": t in at,
            "error": mean,
            "standard_error": error,
            "weight": weights[t],
            "degenerate_draws": degenerate[t],
            "effective_sample_size": sizes.get(t, math.nan),
        }
        for t, (mean, error) in enumerate(estimates[:instants])
    ]
    worth = {t: {"t": t} | dict.fromkeys(_COLUMNS, math.nan) for t in times}
    for (t, change, _), (mean, error) in zip(changed, estimates[instants:], strict=True):
        worth[t] |= {change: mean, f"{change}_error": error}
    summary = {"expected_mse": mse[0], "standard_error": mse[1]}
    return Worth(summary | {"degenerate_draws": degenerate[-1]}, profile, list(worth.values()))


def _changes(times: Times, feasible: Feasible) -> Iterator[tuple[int, str, Times]]:
    """Yield each measurement with each change of it, and the changed set.

    A measurement that moves is made by the same sensor.

    Every measurement may be removed, but it moves only to instants that the job allows.
    """
    for t in times:
        yield t, "removed", tuple(other for other in times if other != t)
        for change, to in (("earlier", t - feasible.sensors), ("later", t + feasible.sensors)):
            changed = feasible.moved(times, t, to)
            if changed is not None:
                yield t, change, changed


def _means(
    session: Session, work: Work
) -> Generator[Batch, None, tuple[list[tuple[float, float]], list[int]]]:
    """Mean and standard error of each column of `_columns`, and degenerate draws up to each t."""
    evaluator, reporter = session.built.evaluator, session.reporter
    instants, (_, draws), start = evaluator.horizon + 1, work.draws, reporter.progress.done
    pieces = [work] if evaluator.exact else evaluator.pieces(work, MOST_SECONDS)
    columns = [Moments() for _ in range(1 + len(work.ends))]
    degenerate = np.zeros(instants, np.int64)
    for piece in pieces:
        mse, flags = yield from mse_of_sets(session, [piece])
        prefixes = replace(piece.part(piece.draws, range(instants)), weighted=False)
        if evaluator.weights is None:
            unweighted = mse[:, :instants]
        else:
            unweighted, _ = yield from mse_of_sets(session, [prefixes])
        degenerate += flags[:, :instants].sum(axis=0)
        for moments, values in zip(columns, _columns(mse, unweighted).T, strict=True):
            moments.add(values[~np.isnan(values)])  # infinite errors have no difference
        _, compared = piece.draws
        reporter.reach(start + compared / draws, evaluations=compared)
    errors = [0.0 if evaluator.exact else moments.standard_error for moments in columns]
    means = [moments.mean for moments in columns]
    return list(zip(means, errors, strict=True)), degenerate.tolist()


def mse_of_sets(
    session: Session, works: list[Work]
) -> Generator[Batch, None, tuple[Array, NDArray[np.bool_]]]:
    """MSE of each set for each draw, and which are degenerate, (D, S); for an exact engine (1, S).

    The draws of the works follow each other. An exact engine takes one work.
    """
    (first, _), (_, last) = works[0].draws, works[-1].draws
    evaluator, (work, *_) = session.built.evaluator, works
    if evaluator.exact:
        exact = evaluator if work.weighted else replace(evaluator, weights=None)
        errors = exact.expected_mse(work.measurement_times, work.ends)[None]
        return errors, np.zeros(errors.shape, np.bool_)
    mse = np.empty((last - first, len(work.ends)))
    degenerate = np.empty(mse.shape, np.bool_)

    def learn(piece: Work, result: Result) -> None:
        here = slice(piece.draws[0] - first, piece.draws[1] - first)
        mse[here], degenerate[here] = result.mse, result.degenerate

    yield Batch(session, "why", works, None, learn)
    return mse, degenerate


def _columns(mse: Array, unweighted: Array) -> Array:
    """MSE, error at every instant, and rise of the MSE by each change, (D, 1+T+1+V).

    `mse`, (D, T+1+V), has the sum of the weighted errors up to every instant over T+1, then the MSE
    of each of V changed sets. `unweighted`, (D, T+1), has the same sums of errors without weights.
    """
    instants = unweighted.shape[1]
    whole = mse[:, instants - 1 : instants]
    with np.errstate(invalid="ignore"):  # infinite errors have no difference
        errors = np.diff(unweighted, axis=1, prepend=0.0) * instants
        rises = mse[:, instants:] - whole
    return np.concatenate([whole, errors, rises], axis=1)
