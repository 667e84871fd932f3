"""Sampling windows, and the loss of times that are random within them.

A sampling window holds the instants to which a measurement alone can be moved at a small loss.

It is computed on the draws, and with the noise, of the worth of measurements. So the loss of a move
by one instant agrees with the table of the worth. The loss of random times is computed on fresh
draws: the draws that chose the windows would flatter them.
"""

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.work import Work, cut
from pfdist.kernels.variates import generator
from pfdist.problem.feasible import Feasible
from pfdist.questions.worth import mse_of_sets
from pfdist.results.relative_loss import INSIDE, OPEN, OUTSIDE, RelativeLoss
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


def windows_by_percent(rows: Sequence[Row], times: Times) -> dict[int, list[Times]]:
    """The instants inside the windows of all measurements, for each level in per cent.

    A measurement's own instant always belongs to its window.
    """
    return {
        percent: [
            tuple(
                row["moved_to"]
                for row in rows
                if row["t"] == t and (row["moved_to"] == t or row[f"within_{percent}"] == INSIDE)
            )
            for t in times
        ]
        for percent in WINDOW_PERCENTS
    }


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


# --- random times within the windows --------------------------------------------------------------

MOST_EXACT = 2000
"""Largest number of random sets whose expected MSE an exact engine computes."""
_BLOCK = 200  # sets of times whose exact errors are computed at a time
_ATTEMPTS = 200  # to draw times that the job allows together

Windows = Sequence[Times]


def jitter(
    session: Session, name: str, times: Times, windows: Mapping[int, Windows], draws: int
) -> Generator[Batch, None, list[Row]]:
    """Rows of the table ``jitter``, without position and name: the loss at each level.

    Each draw has random times of its own within the windows, and the original times beside them.
    The name of the set keys the noise and the random times. For each level in per cent, `windows`
    has the instants to which each time may move, itself among them. A level at which nothing can
    move has no draws.
    """
    built, reporter = session.built, session.reporter
    start, losses = reporter.progress.done, {percent: RelativeLoss() for percent in windows}
    moving = {
        percent: instants
        for percent, instants in windows.items()
        if any(len(window) > 1 for window in instants)
    }
    if moving:
        draws = min(draws, MOST_EXACT) if built.evaluator.exact else draws
        jittering = _Jittering(session, name, times, moving)
        for first, last in jittering.pieces(draws):
            original, *others = (yield from jittering.mse(range(first, last))).T
            for percent, mse in zip(moving, others, strict=True):
                losses[percent].add(mse, original)
            reporter.reach(start + last / draws, evaluations=last)
    reporter.reach(start + 1)
    return [
        _jitter_row(percent, losses[percent], draws * (percent in moving)) for percent in windows
    ]


def jittered(times: Times, windows: Windows, feasible: Feasible, *key: Any) -> Times:
    """Random times within windows: a pure function of the key, which has JSON values.

    The job must allow the times, and each window has the time's own instant. Each measurement takes
    an instant of its window, all with the same probability and independently of the others. If the
    job does not allow the times together, or two of them are equal, all are drawn anew. After 200
    failed attempts, the original times move in random order, each to an instant of its window that
    the job allows beside the others.
    """
    rng, sizes = generator(*key), [len(window) for window in windows]
    for _ in range(_ATTEMPTS):
        picked = {window[k] for window, k in zip(windows, rng.integers(sizes), strict=True)}
        if len(picked) == len(times) and feasible.allows(picked):
            return tuple(sorted(picked))
    present = list(times)
    for place in rng.permutation(len(times)):
        others = {*present} - {present[place]}
        free = [
            t
            for t in windows[place]
            if t == present[place] or (t not in others and feasible.allows(others | {t}))
        ]
        present[place] = free[rng.integers(len(free))]
    return tuple(sorted(present))


@dataclass(frozen=True)
class _Jittering:
    """Errors of the original times and of random times for each level, on the same draws."""

    session: Session
    name: str
    times: Times
    windows: Mapping[int, Windows]

    def pieces(self, draws: int) -> list[tuple[int, int]]:
        """Ranges of draws, each of which takes about as long as a task."""
        evaluator = self.session.built.evaluator
        if evaluator.exact:
            return cut(range(draws), _BLOCK)
        seconds = MOST_SECONDS / (1 + len(self.windows))
        pieces = evaluator.pieces(self._work((0, draws), (self.times,)), seconds)
        return [piece.draws for piece in pieces]

    def mse(self, draws: range) -> Generator[Batch, None, NDArray[np.float64]]:
        """MSE of each draw, (D, 1+L): with the original times, and with those of L levels."""
        evaluator = self.session.built.evaluator
        sets = [self._sets(draw) for draw in draws]
        if not evaluator.exact:
            works = [
                self._work((draw, draw + 1), of_a_draw)
                for draw, of_a_draw in zip(draws, sets, strict=True)
            ]
            return (yield from mse_of_sets(self.session, works))[0]
        different = list(dict.fromkeys(times for of_a_draw in sets for times in of_a_draw))
        mse_of_set = dict(zip(different, evaluator.expected_mse(different).tolist(), strict=True))
        return np.array([[mse_of_set[times] for times in of_a_draw] for of_a_draw in sets])

    def _sets(self, draw: int) -> tuple[Times, ...]:
        """The original times, and the random times of a draw for each level."""
        problem, seed = self.session.built.job.problem, self.session.built.job.seed
        random_sets = (
            jittered(
                self.times,
                windows,
                problem.feasible,
                stream_of("why", seed, "jitter times", self.name, percent, draw),
            )
            for percent, windows in self.windows.items()
        )
        return (self.times, *random_sets)

    def _work(self, draws: tuple[int, int], sets: tuple[Times, ...]) -> Work:
        built = self.session.built
        noise = stream_of("why", built.job.seed, "jitter filter", self.name)
        of_draws = stream_of("why", built.job.seed, "jitter draws")
        return built.evaluator.work(sets, noise, of_draws, draws, built.comparing)


def _jitter_row(percent: int, loss: RelativeLoss, draws: int) -> Row:
    if not draws:  # nothing moves
        still = dict.fromkeys(("loss", "loss_error", "low", "high"), 0.0)
        return {"percent": percent, "draws": 0} | still
    low, high = loss.interval
    return {
        "percent": percent,
        "draws": draws,
        "loss": loss.mean,
        "loss_error": loss.standard_error,
        "low": low,
        "high": high,
    }
