"""Evaluators of replicates, with their own clocks and parameters, and the pool that takes them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TypeVar

from pfdist.errors import TaskError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.predicted import circular_measurements, predicted
from pfdist.models import StateSpaceModel
from pfdist.models.parameters import Parameter
from pfdist.models.recorded import is_of_any_time
from pfdist.models.sensed import without_failures
from pfdist.pools.base import Pool, Task
from pfdist.problem.clock import Clock
from pfdist.problem.measurements import parameters_at
from pfdist.problem.replicates import Replicate
from pfdist.runner.build import Built, both, evaluator_of, models_of_job

W = TypeVar("W")
V = TypeVar("V")
_SECONDS = 60.0  # of a task at most: how fast a model is, is not known


def follows_clock(built: Built) -> bool:
    """Whether the models of a job can have instants that its clock lacks."""
    job, (truth, believed) = built.job, models_of_job(built.job)
    models = [truth] if believed == truth else [truth, believed]
    clock = job.problem.clock
    is_free = job.problem.has_clock and not job.problem.points.delays  # a delay is of equal steps
    return is_free and all(
        is_of_any_time(each.on_clock(clock.times, clock.dates_in_formulas)) for each in models
    )


def evaluator_for(built: Built, replicate: Replicate, *, is_predicted: bool) -> Evaluator:
    """The evaluator of a job with the clock and the parameters of a replicate.

    Parameters
    ----------
    built : Built
    replicate : Replicate
    is_predicted : bool
        Whether its quantity of interest is a measurement; see `pfdist.filters.predicted`.
    """
    problem = built.job.problem
    clock = replicate.clock if replicate.has_own_clock else None
    fails = [bool(each.fails) for each in problem.sensed.each]
    on = clock or problem.clock

    def judged(model: StateSpaceModel) -> StateSpaceModel:
        """The model that simulates values where the replicate has some."""
        made = without_failures(model, fails)
        if not is_predicted:
            return made
        always = without_failures(model, fails, none=True)
        angles = circular_measurements(
            always.on_clock(on.times, on.dates_in_formulas) if problem.has_clock else always
        )
        return predicted(made, problem.points.delays, on.horizon, angles, always)

    return evaluator_on(built, clock, replicate.parameters, judged)


def evaluator_on(
    built: Built,
    clock: Clock | None,
    parameters: Mapping[str, Parameter] = MappingProxyType({}),
    change: Callable[[StateSpaceModel], StateSpaceModel] = lambda model: model,
) -> Evaluator:
    """The evaluator of a job with another clock, if there is one, and with other parameters.

    Covariates of the job are constant from each of its instants to the next. `change` makes a model
    of each model of the job.
    """
    job, own = built.job, built.job.problem.clock

    def changed(model: StateSpaceModel) -> StateSpaceModel:
        values = {name: each for name, each in parameters.items() if name in model.parameters}
        if clock is not None:
            values = parameters_at(model.parameters, own, clock.times) | values
        return change(model.with_parameters(values))

    evaluator = evaluator_of(job, *both(models_of_job(job), changed), clock)
    estimations = (built.comparing,) if built.evaluator.has_particles else ()
    return replace(evaluator, engine=built.evaluator.engine, weights=None, estimations=estimations)


def outcomes(
    pool: Pool, function: Callable[[W], V], works: Sequence[W], purpose: str
) -> Iterator[tuple[int, V]]:
    """Yield the result of each work with its place, in any order.

    Raises `TaskError` if one fails.
    """
    tasks = [Task(str(place), function, work, _SECONDS) for place, work in enumerate(works)]
    for outcome in pool.run(iter(tasks)):
        if outcome.error is not None:
            reason = outcome.error.strip().splitlines()[-1].removeprefix("pfdist.errors.")
            raise TaskError(f"a task of {purpose} failed: {reason}", outcome.error)
        yield int(outcome.task.key), outcome.value
