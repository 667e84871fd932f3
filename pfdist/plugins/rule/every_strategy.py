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
from pfdist.filters.engines import COMPILED
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import EACH_DRAW, weighed
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import PROPOSALS
from pfdist.filters.variants import knowing_truth
from pfdist.filters.work import FilterWork, Result, with_truth
from pfdist.kernels.replicates import REPLICATES
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.row_formats import PER_DRAW
from pfdist.search.first_windows import MOST_UNITS, WINDOW, relaxation_for
from pfdist.search.least import Array, best_price, bounds_of_draws, least_of_draw
from pfdist.search.relaxation import Relaxation
from pfdist.store import RULE_PHASE

CHOICE_DRAWS, DRAWS = 20, 240
# Factors of the penalty: the choice draws decide. The bound is concave in the factor, and flat near
# the best one, which was -0.9 to -4 for the shipped jobs.
PENALTIES = 0.0, -1.0, -2.0
_LEAST_PARTICLES = 500  # the bound is lower with fewer
_MOST_CELLS = 20_000  # errors of a draw
_TOGETHER = 4  # draws whose errors are kept at the same time


@dataclass(frozen=True)
class LeastWork(FilterWork):
    """Draws with the errors of all windows; a column for each sum that is spent, in units."""

    relaxation: Relaxation | None = None
    steps_of_windows: int = 0  # of one draw

    def result(self, evaluator: Evaluator) -> Result:
        """The least relaxed MSE of each draw with each sum, (D, most+1)."""
        relaxation = self.relaxation
        if evaluator.scenarios or relaxation is None:
            return evaluator.filtered(self)
        draws, least = evaluator.draws(range(*self.draws), self.draws_stream), list[Array]()
        windows = relaxation.counted(range(len(relaxation.windows)))
        given = windows.sets, windows.ends.tolist(), self.filter_streams[0], self.estimation
        for first in range(0, len(draws.index), _TOGETHER):
            some = draws[first : first + _TOGETHER]
            each = weighed(
                evaluator.filter_sets(some, *given, EACH_DRAW).errors,
                some.instant_weights * evaluator.scale,
            )
            errors = map(windows.of_instants, each)
            least += [least_of_draw(relaxation, own, len(self.ids) - 1) for own in errors]
        values = np.array(least)
        return Result(values, degenerate=np.isnan(values))

    @property
    def steps_a_draw(self) -> int:
        """Particle-steps of one draw."""
        return self.steps_of_windows


def bound_of_strategies(
    session: RunSession, *, is_hard: bool
) -> Generator[WorkBatch, None, Estimate | None]:
    """A number that the expected MSE of no strategy is below, with its error.

    A strategy spends at most the job's number of measurements or total price, on average or in each
    draw. Windows, the multiplier of what is spent and the factor of the penalty are chosen on
    separate draws: on its own draws, the largest bound is too high. They are chosen for the
    average, so the bound with a hard limit, on the same draws, is at least that on average. None if
    no bound is known, if its windows are too many, or if a draw is degenerate or infinite.
    """
    built, relaxations = session.built, list[Relaxation]()
    evaluator, usual = built.evaluator, built.study.usual
    is_known = built.job.criterion.is_mean and not evaluator.lag
    for window in (1, WINDOW) if is_known and knowing_truth(evaluator).variance_is_error else ():
        with contextlib.suppress(JobError):
            fine = relaxation_for(built.feasible, window, usual, _MOST_CELLS)
            relaxations.append(fine.coarse(MOST_UNITS))
    best: tuple[float, float, Relaxation | None, float] = -math.inf, math.nan, None, 0.0
    # Guided particles are redrawn for the true y; other engines draw no replicates.
    is_plain = PROPOSALS[built.job.filter.proposal].beside_truth == PLAIN.name
    has_penalty = is_plain and knowing_truth(evaluator).computed_by is COMPILED
    for each, penalty in product(relaxations, PENALTIES if has_penalty else PENALTIES[:1]):
        least = yield from _least(session, each, penalty, "choice", CHOICE_DRAWS)
        price = best_price(least, each.number)
        value = float(bounds_of_draws(least, each.number, price).mean())
        best = (value, price, each, penalty) if value > best[0] else best
    _, price, relaxation, penalty = best
    if relaxation is None:
        return None
    least = yield from _least(session, relaxation, penalty, "draws", DRAWS)
    bounds = bounds_of_draws(least, relaxation.number, math.inf if is_hard else price)
    return Estimate.of_mean(bounds) if np.isfinite(bounds).all() else None


def _least(
    session: RunSession,
    relaxation: Relaxation,
    penalty: float,
    role: str,
    draws: int,
) -> Generator[WorkBatch, None, Array]:
    """The least relaxed MSE of each draw with each sum that is spent, in units, (D, most+1)."""
    built, feasible, most = session.built, session.built.feasible, relaxation.most
    particles = max(built.comparing.particles, _LEAST_PARTICLES)
    estimation = with_truth(particles, built.job.filter.proposal)
    estimation = replace(estimation, penalty=penalty or None)
    stream = stream_of("bound", built.job.seed, "strategies", role, "filter")
    of_draws = stream_of("bound", built.job.seed, "strategies", role)
    truth, windows = knowing_truth(built.evaluator), relaxation.sets
    truth.compile(estimation)
    of_windows = truth.work(
        windows, stream, of_draws, (0, 1), estimation, ends=tuple(relaxation.ends.tolist())
    )
    compared = len(windows) * (REPLICATES + 1) if penalty else 0
    limits = feasible.step_limits.recorded, [*feasible.allowed]
    parts = relaxation.windows, relaxation.ends.tolist(), stream, of_draws, limits, relaxation.unit
    ids = tuple(truth.id_of(estimation, *parts, most, n) for n in range(most + 1))
    given = [()] * len(ids), stream, of_draws, (0, draws), estimation
    work = LeastWork(
        **vars(truth.work(*given, ids=ids, knows_truth=True)),
        relaxation=relaxation,
        steps_of_windows=of_windows.steps + compared * particles,
    )
    least, reporter = np.full((draws, len(ids)), np.nan), session.reporter
    reporter.foresee(work.steps)

    def learn(piece: FilterWork, result: Result) -> None:
        least[slice(*piece.draws)] = result.mse
        reporter.reach(reporter.progress.done + piece.steps)

    phase = f"{RULE_PHASE}.bound"
    yield WorkBatch(session, phase, [work], PER_DRAW, learn, more_follows=True, part="rule")
    return least
