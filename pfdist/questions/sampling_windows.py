"""Sampling windows: the instants to which a measurement alone can be moved at a small loss.

They are computed on the draws, and with the noise, of the worth of measurements. So the loss of a
move by one instant agrees with the table of the worth.
"""

import math
from collections.abc import Generator, Mapping
from itertools import chain
from typing import Any

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.problem.feasible import Feasible
from pfdist.questions.worth import mse_of_sets
from pfdist.results.sampling_windows import INSIDE, OPEN, OUTSIDE, RelativeLoss
from pfdist.runner.door import Batch, Session
from pfdist.runner.pace import MOST_SECONDS
from pfdist.store import WINDOW_PERCENTS

FIRST_REACH = 4
"""Number of feasible instants on each side that are filtered first; then twice as many."""

Row = dict[str, Any]
Move = tuple[int, int]  # the instant of a measurement, and the instant to which it is moved


def sampling_windows(
    session: Session, name: str, times: Times, draws: int
) -> Generator[Batch, None, list[Row]]:
    """Rows with the loss of moving one measurement at a time, and whether the levels allow it.

    They are those of the table ``sampling_windows``, without position, name and draws. The
    measurement's own instant is a row, too. The name of the set keys the noise.

    The instants lie strictly between the neighbouring measurements, and the job allows them. They
    are tried outwards from the measurement. A side ends with the first instant that is clearly
    beyond the largest level: the one-sided 95 % lower limit of its loss is above it.
    """
    reporter, feasible = session.reporter, session.built.job.problem.feasible
    start, first, size, share = reporter.progress.done, 0, FIRST_REACH, 0.5
    sides, rows = _sides(times, feasible), list[Row]()
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
    step, sides = feasible.sensors, list[list[tuple[Move, Times]]]()
    for t in times:
        own = [other for other in times if other % step == t % step]  # of the same sensor
        ends = (-1, *own, feasible.possible)
        before, _, after = ends[own.index(t) :][:3]
        for instants in (range(t - step, before, -step), range(t + step, after, step)):
            sets = (((t, to), feasible.moved(times, t, to)) for to in instants)
            side = [(move, changed) for move, changed in sets if changed is not None]
            sides += [side] if side else []
    return sides


def _up_to_the_first_beyond(
    moves: Mapping[Move, Times], losses: Mapping[Move, Row]
) -> tuple[list[Row], bool]:
    """The rows up to the first instant beyond the largest level, and whether there is one."""
    rows = list[Row]()
    for t, instant in moves:
        rows.append({"t": t, "moved_to": instant, "moved_to_instant": instant} | losses[t, instant])
        if rows[-1][f"within_{max(WINDOW_PERCENTS)}"] == OUTSIDE:
            return rows, True
    return rows, False


def _rows(
    session: Session, name: str, sets: tuple[Times, ...], draws: int, share: float
) -> Generator[Batch, None, list[Row]]:
    """Columns of the loss of each set against the first set, which loses nothing."""
    evaluator, seed, reporter = session.built.evaluator, session.built.job.seed, session.reporter
    streams = stream_of("why", seed, "filter", name), stream_of("why", seed, "draws")
    work = evaluator.work(sets, *streams, (0, draws), session.built.comparing)
    if evaluator.exact:
        (errors,), _ = yield from mse_of_sets(session, [work])
        mse_unmoved, *_ = errors
        return [
            _exact_row((error - mse_unmoved) / mse_unmoved if mse_unmoved > 0.0 else math.nan)
            for error in errors
        ]
    losses, start = [RelativeLoss() for _ in sets], reporter.progress.done
    for piece in evaluator.pieces(work, MOST_SECONDS):
        mse, _ = yield from mse_of_sets(session, [piece])
        for loss, changed in zip(losses, mse.T, strict=True):
            loss.add(changed, mse[:, 0])
        _, last = piece.draws
        reporter.reach(start + share * last / draws, evaluations=last)
    return [_row(loss) for loss in losses]


def _row(loss: RelativeLoss) -> Row:
    low, high = loss.limits
    return {
        "loss": loss.mean,
        "loss_error": loss.standard_error,
        "lower_limit": low,
        "upper_limit": high,
    } | {f"within_{percent}": loss.state(percent / 100) for percent in WINDOW_PERCENTS}


def _exact_row(loss: float) -> Row:
    states = {
        f"within_{percent}": INSIDE if loss <= percent / 100 else OUTSIDE
        for percent in WINDOW_PERCENTS
    }
    if math.isnan(loss):
        states = dict.fromkeys(states, OPEN)
    exact = {"loss": loss, "loss_error": 0.0, "lower_limit": loss, "upper_limit": loss}
    return exact | states
