"""The error over time of a set of times, the worth of its measurements, and sampling windows.

A sampling window has the instants to which a measurement alone can be moved at a small loss.
Everything is computed on new draws, which neither chose the times nor compared them. The windows
are computed on the draws, and with the noise, of the worth. So the loss of a move by one instant
agrees with the table of the worth.
"""

import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import Interval
from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_by_instant, exact_mse
from pfdist.filters.work import FilterWork, Result, ranges_of_draws
from pfdist.problem.feasible import Feasible
from pfdist.results import Moments
from pfdist.results.columns import Results
from pfdist.results.over_time import Range, joined_ranges, longest_range, profile_of
from pfdist.results.sampling_windows import OUTSIDE, TWO_SIDED, RelativeLoss, state_of
from pfdist.runner.by_instant import evaluations_of_groups
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.particles import mean_effective_sizes
from pfdist.runner.searches import deciding_of
from pfdist.store import WINDOW_PERCENTS

Array = NDArray[np.float64]

CHANGES = ("removed", "earlier", "later")
_COLUMNS = [f"{change}{part}" for change in CHANGES for part in ("", "_error")]

Move = tuple[int, int]  # the instant of a measurement, and the instant to which it is moved

FIRST_REACH = 4
"""Feasible instants on each side to which a measurement is moved first; then twice as many."""


def worth_of(
    session: RunSession, name: str, times: Times, draws: int
) -> Generator[WorkBatch, None, tuple[Results, list[Results], list[Results]]]:
    """The error of a set, its rows of the table ``profile``, and those of the table ``worth``.

    The rows lack position and name, and those of the worth lack draws. The worth is that by the
    criterion of the job. The set up to every instant and all its changes share draws and noise. So
    common prefixes are filtered once, and differences are paired. The name of the set keys the
    noise. The effective sample size is a mean over the first draws.
    """
    built = session.built
    evaluator, instants = built.evaluator, built.evaluator.horizon + 1
    changed, is_mean = [*_changes(times, built.job.problem.feasible)], built.job.criterion.is_mean
    after, others = evaluator.points.first, [other for _, _, other in changed]
    sets = [tuple(t for t in times if t < after(end + 1)) for end in range(instants)]
    sets += others if is_mean else ()
    ends = (*range(instants), *(evaluator.horizon,) * (len(sets) - instants))
    work = _work(session, name, sets, draws, ends=ends)
    (mse, *rises), degenerate = yield from _means(session, work)
    if not is_mean:
        own, *judged = yield from _judged(session, name, (times, *others), draws)
        rises = [(d.value, d.standard_error) for d in (each.difference(own) for each in judged)]
    alone = _work(session, name, (times,), draws)
    ranges = yield from _ranges(session, alone)
    sizes: Any = mean_effective_sizes(evaluator, alone) if evaluator.has_particles else {}
    columns = ["t", "measured", "draws", "weight", "error", "standard_error"]
    profile = profile_of(built.job.problem, times, ranges, 0)[columns].assign(
        t=range(instants),
        degenerate_draws=degenerate,
        effective_sample_size=[sizes.get(t, math.nan) for t in range(instants)],
    )
    worth = {t: {"t": t} | dict.fromkeys(_COLUMNS, math.nan) for t in times}
    for (t, change, _), (mean, error) in zip(changed, rises, strict=True):
        worth[t] |= {change: mean, f"{change}_error": error}
    summary = {"expected_mse": mse[0], "standard_error": mse[1]}
    rows: list[Results] = profile.to_dict("records")  # type: ignore[assignment]
    return summary | {"degenerate_draws": degenerate[-1]}, rows, [*worth.values()]


def _ranges(session: RunSession, work: FilterWork) -> Generator[WorkBatch, None, list[Range]]:
    """The errors of the sets of a work at each instant, over ranges of draws."""
    evaluator, (_, draws), ranges = session.built.evaluator, work.draws, list[Range]()
    exact = exact_by_instant(evaluator, work.measurement_times)
    if exact is not None:
        return [Range(0, 0, exact)]
    work = replace(work, over_time=longest_range(draws))

    def learn(piece: FilterWork, result: Result) -> None:
        of_piece = ranges_of_draws(*piece.draws, piece.over_time)
        ranges.extend(map(Range, *zip(*of_piece, strict=True), result.errors))

    pieces = evaluator.pieces(work, MOST_SECONDS)
    yield WorkBatch(session, "why", pieces, None, learn, part="why")
    return joined_ranges(sorted(ranges, key=lambda each: each.first), work.over_time)


def _work(
    session: RunSession, name: str, sets: Sequence[Times], draws: int, **others: Any
) -> FilterWork:
    """The work of filtering some sets; all work about a set has the same draws and noise."""
    built, seed = session.built, session.built.job.seed
    others |= {"controlled": built.job.is_controlled}
    return built.evaluator.work(
        sets,
        stream_of("why", seed, "filter", name),
        stream_of("why", seed, "draws"),
        (0, draws),
        built.comparing,
        **others,
    )


def _changes(times: Times, feasible: Feasible) -> Iterator[tuple[int, str, Times]]:
    """Yield each measurement with each change of it, and the changed set.

    Every measurement may be removed. It moves only to instants that the job allows.
    """
    step = feasible.points.ways
    for t in times:
        yield t, "removed", tuple(other for other in times if other != t)
        for change, to in (("earlier", t - step), ("later", t + step)):
            changed = feasible.moved(times, t, to)
            if changed is not None:
                yield t, change, changed


def _means(
    session: RunSession, work: FilterWork
) -> Generator[WorkBatch, None, tuple[list[tuple[float, float]], list[int]]]:
    """Mean and standard error of each column of `_columns`, and degenerate draws up to each t.

    The first T+1 sets of the work are the set up to each instant. With a control, the first error
    counts the largest draw in addition, as in `pfdist.results.ComparisonStatistics.estimate`.
    """
    evaluator, reporter = session.built.evaluator, session.reporter
    instants, (_, draws), start = evaluator.horizon + 1, work.draws, reporter.progress.done
    degenerate, largest = np.zeros(instants, np.int64), 0.0
    exact = exact_mse(evaluator, work.measurement_times, work.ends)
    if exact is not None:
        reporter.reach(start + 1, evaluations=draws)
        (means,) = _columns(exact[None, instants - 1 :]).tolist()
        return [(mean, 0.0) for mean in means], degenerate.tolist()
    columns = [Moments() for _ in work.ends[instants - 1 :]]
    for piece in evaluator.pieces(work, MOST_SECONDS):
        mse, flags, most = yield from _mse(session, piece)
        largest = max(largest, most[instants - 1])
        degenerate += flags[:, :instants].sum(axis=0)
        for moments, values in zip(columns, _columns(mse[:, instants - 1 :]).T, strict=True):
            moments.add(values[~np.isnan(values)])  # infinite errors have no difference
        _, compared = piece.draws
        reporter.reach(start + compared / draws, evaluations=compared)
    errors = [moments.standard_error for moments in columns]
    means = [moments.mean for moments in columns]
    errors[0] = math.hypot(errors[0], (largest - means[0]) / draws * work.controlled)
    return list(zip(means, errors, strict=True)), degenerate.tolist()


def _mse(
    session: RunSession, work: FilterWork
) -> Generator[WorkBatch, None, tuple[Array, NDArray[np.bool_], Array]]:
    """MSE of each set for each draw, and which are degenerate, (D, S).

    The control is subtracted from the MSE, because only means are computed from it. The last array
    has the largest MSE of each set, with its control.
    """
    first, last = work.draws
    mse, largest = np.empty((last - first, len(work.ends))), np.zeros(len(work.ends))
    degenerate = np.empty(mse.shape, np.bool_)

    def learn(piece: FilterWork, result: Result) -> None:
        here = slice(piece.draws[0] - first, piece.draws[1] - first)
        mse[here] = result.mse - result.control if work.controlled else result.mse
        degenerate[here] = result.degenerate
        np.maximum(largest, result.mse.max(axis=0), out=largest)

    yield WorkBatch(session, "why", [work], None, learn, part="why")
    return mse, degenerate, largest


def _judged(
    session: RunSession, name: str, sets: Sequence[Times], draws: int
) -> Generator[WorkBatch, None, list[Evaluation]]:
    """The evaluation of each set by a criterion other than the expected MSE."""
    built, form = session.built, session.built.job.criterion
    evaluator, weights = built.evaluator, built.evaluator.relative_weights
    exact = exact_mse(evaluator, sets, criterion=form)
    if exact is not None:
        return [*map(Evaluation.exactly, sets, exact.tolist(), repeat(form))]
    work = replace(_work(session, name, sets, draws), estimation=deciding_of(built.job))
    work = replace(work, controlled=False)
    if form.by_instant:
        ranges, size = (yield from _ranges(session, work)), longest_range(draws)
        groups = np.array([each.sums / size for each in ranges if each.draws == size])
        return evaluations_of_groups(form, sets, groups[:, :, weights > 0.0])
    pieces = list[Array]()
    for piece in evaluator.pieces(work, MOST_SECONDS):
        mse, *_ = yield from _mse(session, piece)
        pieces.append(mse)
    scenarios = evaluator.scenarios_of(work.draws_stream, range(draws))
    return [
        Evaluation(t, mse, scenarios=scenarios, criterion=form)
        for t, mse in zip(sets, np.concatenate(pieces).T.copy(), strict=True)
    ]


def _columns(mse: Array) -> Array:
    """MSE, and its rise by each change, (D, 1+V), from that of the set and of V changed sets."""
    whole = mse[:, :1]
    with np.errstate(invalid="ignore"):  # infinite errors have no difference
        return np.concatenate([whole, mse[:, 1:] - whole], axis=1)


# --- sampling windows -----------------------------------------------------------------------------


def sampling_windows(
    session: RunSession, name: str, times: Times, draws: int
) -> Generator[WorkBatch, None, list[Results]]:
    """Rows with the loss of moving one measurement at a time, and whether the levels allow it.

    They are those of the table ``sampling_windows``, without position, name and draws. The
    measurement's own instant is a row, too. The name of the set keys the noise.

    The instants lie strictly between the neighbouring measurements, and the job allows them. They
    are tried outwards from the measurement. A side ends with the first instant that is clearly
    beyond the largest level: the one-sided 95 % lower limit of its loss is above it.
    """
    reporter, feasible = session.reporter, session.built.job.problem.feasible
    start, first, size, share = reporter.progress.done, 0, FIRST_REACH, 0.5
    sides, rows = _sides(times, feasible), list[Results]()
    while not first or sides:
        moves = dict(chain.from_iterable(side[first:size] for side in sides))
        rows_of_sets = yield from _rows(session, name, (times, *moves.values()), draws, share)
        unmoved, losses = rows_of_sets[0], dict(zip(moves, rows_of_sets[1:], strict=True))
        if not first:
            rows += [{"t": t, "moved_to": t, "moved_to_instant": t} | unmoved for t in times]
        for side in list(sides):
            tried, ended = _up_to_the_first_beyond(dict(side[first:size]), losses)
            rows += tried
            if ended or len(side) <= size:
                sides.remove(side)
        first, size, share = size, 2 * size, share / 2
    reporter.reach(start + 1)
    return sorted(rows, key=lambda row: (row["t"], row["moved_to"]))


def _sides(times: Times, feasible: Feasible) -> list[list[tuple[Move, Times]]]:
    """The feasible moves of each measurement to one side, outwards, with the moved sets."""
    sides = list[list[tuple[Move, Times]]]()
    for t in times:
        alike = feasible.points.alike(t)
        own = [-1, *(alike.index(other) for other in times if other in alike), len(alike)]
        place = alike.index(t)
        before, _, after = own[own.index(place) - 1 :][:3]
        for side_of_t in (alike[before + 1 : place][::-1], alike[place + 1 : after]):
            sets = (((t, to), feasible.moved(times, t, to)) for to in side_of_t)
            side = [(move, changed) for move, changed in sets if changed is not None]
            sides += [side] if side else []
    return sides


def _up_to_the_first_beyond(
    moves: Mapping[Move, Times], losses: Mapping[Move, Results]
) -> tuple[list[Results], bool]:
    """The rows up to the first instant beyond the largest level, and whether there is one."""
    rows = list[Results]()
    for t, instant in moves:
        rows.append({"t": t, "moved_to": instant, "moved_to_instant": instant} | losses[t, instant])
        if rows[-1][f"within_{max(WINDOW_PERCENTS)}"] == OUTSIDE:
            return rows, True
    return rows, False


def _rows(
    session: RunSession, name: str, sets: tuple[Times, ...], draws: int, share: float
) -> Generator[WorkBatch, None, list[Results]]:
    """Columns of the loss of each set against the first set, which loses nothing.

    It is that of the criterion of the job, relative to the number of the first set.
    """
    evaluator, reporter = session.built.evaluator, session.reporter
    if not session.built.job.criterion.is_mean:
        judged = yield from _judged(session, name, sets, draws)
        unit = 1 / (abs(judged[0].expected_mse) or math.nan)
        rises = [each.difference(judged[0]).times(unit) for each in judged]
        return [_row(e.value, e.standard_error, e.interval(TWO_SIDED)) for e in rises]
    work = _work(session, name, sets, draws)
    exact = exact_mse(evaluator, work.measurement_times, work.ends)
    if exact is not None:
        mse_unmoved, *_ = exact
        loss = (exact - mse_unmoved) / mse_unmoved if mse_unmoved > 0.0 else math.nan + exact
        return [_row(each, 0.0, (each, each)) for each in loss.tolist()]
    losses, start = [RelativeLoss() for _ in sets], reporter.progress.done
    for piece in evaluator.pieces(work, MOST_SECONDS):
        mse, *_ = yield from _mse(session, piece)
        for loss, changed in zip(losses, mse.T, strict=True):
            loss.add(changed, mse[:, 0])
        _, last = piece.draws
        reporter.reach(start + share * last / draws, evaluations=last)
    return [_row(loss.mean, loss.standard_error, loss.limits) for loss in losses]


def _row(loss: float, error: float, limits: Interval) -> Results:
    row = {"loss": loss, "loss_error": error, "lower_limit": limits[0], "upper_limit": limits[1]}
    states = {f"within_{percent}": state_of(limits, percent / 100) for percent in WINDOW_PERCENTS}
    return row | states
