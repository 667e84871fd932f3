"""A unit of work: draws whose measurement times are chosen online."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.errors import MeasurementsError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.formulas import operations_of
from pfdist.filters.one_filter import Followed, OneFilter, seen
from pfdist.filters.proposal import PLAIN
from pfdist.filters.strategy import follow
from pfdist.filters.work import FilterWork, Result
from pfdist.plugins.online.planning import Now, Planning, Replanner, Replanning, planning_of
from pfdist.problem.feasible import Feasible
from pfdist.runner.build import Built

# A step of a plan takes longer than a step of the comparison: measurements are near each other,
# particles are few, and the search itself takes time.
_SLOWER = 2.0
_MOST_OPERATIONS = 60 * 4e9  # of a plan with moved particles: a core does 4e9 in a second, about


@dataclass(frozen=True, kw_only=True)
class OnlineWork(FilterWork):
    """Draws that are measured at the next planned time and replanned, until the budget is spent.

    The other fields are those of `FilterWork`, with one set: the initial plan.
    """

    feasible: Feasible
    planning: Planning
    planning_stream: int  # key of the noise of the planning
    shown: int = 0  # number of first draws whose estimates are wanted

    def result(self, evaluator: Evaluator) -> Result:
        """Per-draw MSE, (D, 1), and the times that were chosen for each draw.

        The estimates are (E, T+1, q), for the E draws that need them.
        """
        chosen = tuple(self.chosen(evaluator, draw) for draw in range(*self.draws))
        results = [
            evaluator.filtered(
                replace(self, measurement_times=(times,), draws=(draw, draw + 1),
                        trajectories=draw < self.shown)
            )
            for draw, times in enumerate(chosen, self.draws[0])
        ]  # fmt: skip
        estimates = [result.estimates[0, 0] for result in results if result.estimates.size]
        return Result(
            np.concatenate([result.mse for result in results]),
            degenerate=np.concatenate([result.degenerate for result in results]),
            estimates=np.array(estimates),
            measurement_times=chosen,
        )

    @property
    def steps_a_draw(self) -> int:
        """Approximate number of particle-steps of a draw; nearly all are for planning."""
        return _steps(self.feasible, self.planning) + super().steps_a_draw

    def chosen(self, evaluator: Evaluator, draw: int) -> Times:
        """The chosen times of one draw; a degenerate draw keeps its last plan."""
        replanner = Replanner(evaluator, self.feasible, self.planning, self.planning_stream)
        strategy = Replanning(replanner, self.measurement_times[0], Now(), draw)
        y = evaluator.draws(range(draw, draw + 1), self.draws_stream).y[0]
        engine, noise = evaluator.computed_by.name, self.filter_streams[0]
        first = OneFilter(evaluator.believed, self.estimation, noise, draw, engine)
        points, instants = self.feasible.points, range(evaluator.horizon + 1)

        def look(t: int, sensors: Sequence[str]) -> NDArray[np.float64]:
            here = tuple(points.first(t) + points.names.index(sensor) for sensor in sensors)
            return seen(evaluator.model, y[t], here)

        delays = dict(zip(points.names, points.delays, strict=False))
        with suppress(MeasurementsError):  # the draw is degenerate
            follow(strategy, Followed(first), look, instants, delays)
        return (*strategy.taken, *strategy.plan)


def affordable(built: Built, feasible: Feasible, planning: Planning) -> Planning:
    """The planning of what is left, with plain particles if a plan with moved ones takes too long.

    A minute of one core is too long, by counted work.
    """
    own, evaluator = built.job.filter, built.evaluator
    if not planning.estimation.moves:
        return planning
    sets = planning.optimiser(feasible).evaluations * planning.draws
    steps = sets * (feasible.horizon + 1) * planning.estimation.steps_an_instant
    operations = operations_of(evaluator.believed, range(evaluator.horizon + 1))
    if steps * operations <= _MOST_OPERATIONS:
        return planning
    filtered = own.chosen(PLAIN.name, own.particles, None, 1.0)
    job = built.job.model_copy(update={"filter": filtered})
    plain = planning_of(job, evaluator.variance_is_error).estimation
    return replace(planning, estimation=plain)


@lru_cache(maxsize=4)
def _steps(feasible: Feasible, planning: Planning) -> int:
    """Particle-steps of the plans of one draw, approximately, if it is measured at regular times.

    Raises `JobError` if the method of the planning cannot search this problem.
    """
    planning.optimiser(feasible)  # checks that the method can search; any rest has fewer sets
    times, steps = feasible.regular(), 0.0
    for number in range(1, len(times)):
        rest = feasible.rest(times[:number], feasible.points.instant(times[number - 1]) + 1)
        if rest is not None:
            sets = planning.optimiser(rest).evaluations * planning.draws
            steps += (rest.horizon + 1) * (sets + 2 * planning.judging_draws)
    return round(_SLOWER * steps * planning.estimation.steps_an_instant)
