"""The loss when all measurements are jittered at random within their sampling windows.

The draws and the noise are fresh: the draws that chose the windows would flatter them.
"""

from collections.abc import Generator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.analysis.relative_loss import RelativeLoss
from pfdist.common.streams import stream_of
from pfdist.evaluation.work import Work, cut
from pfdist.kernels.noise import generator
from pfdist.runner.door import Batch, Session
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.worth import mse_of_sets
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

MOST_EXACT = 2000
"""Largest number of random sets whose expected MSE an exact engine computes."""
_BLOCK = 200  # sets of times whose exact errors are computed at a time
_ATTEMPTS = 200  # to draw times that the job allows together

Windows = Sequence[Times]
Row = dict[str, Any]


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
    return [_row(percent, losses[percent], draws * (percent in moving)) for percent in windows]


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


class _Jittering:
    """Errors of the original times and of random times for each level, on the same draws."""

    def __init__(
        self, session: Session, name: str, times: Times, windows: Mapping[int, Windows]
    ) -> None:
        self._session, self._built = session, session.built
        self._name, self._times, self._windows = name, times, windows

    def pieces(self, draws: int) -> list[tuple[int, int]]:
        """Ranges of draws, each of which takes about as long as a task."""
        evaluator = self._built.evaluator
        if evaluator.exact:
            return cut(range(draws), _BLOCK)
        seconds = MOST_SECONDS / (1 + len(self._windows))
        pieces = evaluator.pieces(self._work((0, draws), (self._times,)), seconds)
        return [piece.draws for piece in pieces]

    def mse(self, draws: range) -> Generator[Batch, None, NDArray[np.float64]]:
        """MSE of each draw, (D, 1+L): with the original times, and with those of L levels."""
        evaluator = self._built.evaluator
        sets = [self._sets(draw) for draw in draws]
        if not evaluator.exact:
            works = [
                self._work((draw, draw + 1), of_a_draw)
                for draw, of_a_draw in zip(draws, sets, strict=True)
            ]
            return (yield from mse_of_sets(self._session, works))
        different = list(dict.fromkeys(times for of_a_draw in sets for times in of_a_draw))
        cost_of_set = dict(zip(different, evaluator.expected_mse(different).tolist(), strict=True))
        return np.array([[cost_of_set[times] for times in of_a_draw] for of_a_draw in sets])

    def _sets(self, draw: int) -> tuple[Times, ...]:
        """The original times, and the random times of a draw for each level."""
        problem, seed = self._built.job.problem, self._built.job.seed
        random_sets = (
            jittered(
                self._times,
                windows,
                problem.feasible,
                stream_of("why", seed, "jitter times", self._name, percent, draw),
            )
            for percent, windows in self._windows.items()
        )
        return (self._times, *random_sets)

    def _work(self, draws: tuple[int, int], sets: tuple[Times, ...]) -> Work:
        seed = self._built.job.seed
        return Work(
            measurement_times=sets,
            ends=(self._built.evaluator.horizon,) * len(sets),
            filter_streams=(stream_of("why", seed, "jitter filter", self._name),) * len(sets),
            draws_stream=stream_of("why", seed, "jitter draws"),
            draws=draws,
            estimation=self._built.comparing,
        )


def _row(percent: int, loss: RelativeLoss, draws: int) -> Row:
    if not draws:  # nothing moves
        still = dict.fromkeys(("loss", "loss_error", "low", "high"), 0.0)
        return {"percent": percent, "draws": 0, "degenerate_draws": 0} | still
    low, high = loss.interval
    return {
        "percent": percent,
        "draws": draws,
        "loss": loss.mean,
        "loss_error": loss.standard_error,
        "degenerate_draws": loss.degenerate_draws,
        "low": low,
        "high": high,
    }
