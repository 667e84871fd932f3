"""The bound for every strategy of a job: least relaxed errors of draws, on separate draws."""

import contextlib
import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from pfdist.common.estimate import Estimate
from pfdist.common.streams import stream_of
from pfdist.errors import JobError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import EACH_DRAW, weighed
from pfdist.filters.work import PLAIN, FilterWork, Result, with_truth
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.row_formats import PER_DRAW
from pfdist.search.first_windows import WINDOW, relaxation_for
from pfdist.search.least import Array, best_price, bounds_of_draws, least_of_draw
from pfdist.search.relaxation import Relaxation
from pfdist.store import RULE_PHASE

CHOICE_DRAWS, DRAWS = 30, 130
# Factors of the penalty: the choice draws decide. The bound is concave in the factor, and flat near
# the best one, which was -0.9 to -4 for the shipped jobs; each factor takes a programme a draw.
PENALTIES = 0.0, -1.0, -2.0
REPLICATES = 8  # of the last measurement of each window; with 5, the bound is 1 % lower
_LEAST_PARTICLES = 500  # the bound is lower with fewer
_MOST_CELLS = 20_000  # errors of a draw
_TOGETHER = 4  # draws whose errors are kept at the same time


@dataclass(frozen=True)
class LeastWork(FilterWork):
    """Draws with the errors of all windows; a column for each penalty and number."""

    relaxation: Relaxation | None = None
    steps_of_windows: int = 0  # of one draw, with those of replicates
    penalties: tuple[float, ...] = (0.0,)  # factors of the penalty

    def result(self, evaluator: Evaluator) -> Result:
        """The least relaxed MSE of each draw, with each penalty, with 0..most measurements."""
        relaxation = self.relaxation
        if evaluator.scenarios or relaxation is None:
            return evaluator.filtered(self)
        draws, least = evaluator.draws(range(*self.draws), self.draws_stream), list[Array]()
        counted, stream = relaxation.counted(range(len(relaxation.windows))), self.filter_streams[0]
        most = len(self.ids) // len(self.penalties) - 1
        given = relaxation.sets, relaxation.ends.tolist(), stream, self.estimation
        for first in range(0, len(draws.index), _TOGETHER):
            some = draws[first : first + _TOGETHER]
            found = evaluator.filter_sets(some, *given, EACH_DRAW)
            errors = weighed(found.errors, some.instant_weights * evaluator.scale)
            penalties = found.penalty * some.instant_weights
            for own, penalty in zip(errors, penalties, strict=True):
                windows, fees = counted.of_instants(own), counted.of_instants(penalty)
                rows = (least_of_draw(relaxation, windows + c * fees, most) for c in self.penalties)
                least.append(np.concatenate([*rows]))
        values = np.array(least)
        return Result(values, degenerate=np.zeros(values.shape, np.bool_))

    @property
    def steps_a_draw(self) -> int:
        """Particle-steps of one draw."""
        return self.steps_of_windows


def bound_of_strategies(
    session: RunSession, number: float, *, is_hard: bool
) -> Generator[WorkBatch, None, Estimate | None]:
    """A number that the expected MSE of no strategy is below, with its error.

    A strategy has at most so many measurements on average, or in each draw. Windows, the price of a
    measurement and the factor of its penalty are chosen on separate draws: on its own draws, the
    largest bound is too high. None if no bound is known, or if its windows are too many.
    """
    built, relaxations = session.built, list[Relaxation]()
    is_plain = built.job.filter.proposal == PLAIN  # guided particles are redrawn for the true y
    penalties = PENALTIES if is_plain else (0.0,)
    evaluator, usual = built.evaluator, built.study.usual
    is_known = built.job.criterion.is_mean and built.feasible.counted and not evaluator.lag
    for window in (1, WINDOW) if is_known and evaluator.truth.variance_is_error else ():
        with contextlib.suppress(JobError):
            relaxations.append(relaxation_for(built.feasible, window, usual, _MOST_CELLS))
    best: tuple[float, float, float, Relaxation | None] = -math.inf, math.nan, 0.0, None
    for each in relaxations:
        found = yield from _least(session, each, penalties, "choice", CHOICE_DRAWS, number, is_hard)
        for penalty, least in zip(penalties, found, strict=True):
            price = math.inf if is_hard else best_price(least, number)
            value = float(bounds_of_draws(least, number, price).mean())
            best = (value, price, penalty, each) if value > best[0] else best
    _, price, penalty, relaxation = best
    if relaxation is None:
        return None
    (least,) = yield from _least(session, relaxation, (penalty,), "draws", DRAWS, number, is_hard)
    return Estimate.of_mean(bounds_of_draws(least, number, price))


def _least(
    session: RunSession,
    relaxation: Relaxation,
    penalties: tuple[float, ...],
    role: str,
    draws: int,
    number: float,
    is_hard: bool,
) -> Generator[WorkBatch, None, Array]:
    """The least relaxed MSE with each penalty, of each draw, with each number: (C, D, most+1)."""
    built, feasible = session.built, session.built.feasible
    most = int(number) if is_hard else len(feasible.allowed)
    particles, proposal = built.comparing.particles, built.job.filter.proposal
    estimation = with_truth(max(particles, _LEAST_PARTICLES), proposal)
    if any(penalties):
        estimation = replace(estimation, replicates=REPLICATES)
    stream = stream_of("bound", built.job.seed, "strategies", "filter")
    of_draws = stream_of("bound", built.job.seed, "strategies", role)
    truth, windows = built.evaluator.truth, relaxation.sets
    truth.compile(estimation)
    of_windows = truth.work(
        windows, stream, of_draws, (0, 1), estimation, ends=tuple(relaxation.ends.tolist())
    )
    compared = len(windows) * (REPLICATES + 1) if estimation.replicates else 0
    parts = relaxation.windows, relaxation.ends.tolist(), stream, of_draws
    columns = product(penalties, range(most + 1))
    ids = tuple(truth.id_of(estimation, *parts, most, penalties, *each) for each in columns)
    given = [()] * len(ids), stream, of_draws, (0, draws), estimation
    work = LeastWork(
        **vars(truth.work(*given, ids=ids, knows_truth=True)),
        relaxation=relaxation,
        steps_of_windows=of_windows.steps + compared * estimation.particles,
        penalties=penalties,
    )
    least, reporter = np.full((draws, len(ids)), np.nan), session.reporter
    reporter.foresee(work.steps)

    def learn(piece: FilterWork, result: Result) -> None:
        least[slice(*piece.draws)] = result.mse
        reporter.reach(reporter.progress.done + piece.steps)

    phase = f"{RULE_PHASE}.bound"
    yield WorkBatch(session, phase, [work], PER_DRAW, learn, more_follows=True, part="rule")
    return least.reshape(draws, len(penalties), -1).swapaxes(0, 1)
