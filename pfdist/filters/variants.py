"""Evaluators that follow from another one: with the truth, of the information, of other estimates.

Each is made once for its evaluator, so that its formulas are compiled once.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial, wraps
from typing import TypeVar

from pfdist.filters.aspects import ErrorBeside
from pfdist.filters.beside import errors_beside
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork, Result
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.models.recorded import recorded
from pfdist.models.sensed import late

_Variant = TypeVar("_Variant")


def _once(make: Callable[[Evaluator], _Variant]) -> Callable[[Evaluator], _Variant]:
    @wraps(make)
    def variant(evaluator: Evaluator) -> _Variant:
        made, name = evaluator.variants, make.__name__
        if name not in made:
            made[name] = make(evaluator)
        found: _Variant = made[name]
        return found

    return variant


@_once
def knowing_truth(evaluator: Evaluator) -> Evaluator:
    """The same evaluator with a filter that has the true model and the draw's scenario."""
    if _is_told(evaluator):
        return evaluator
    knows = bool(evaluator.scenarios)
    return replace(evaluator, filter_model=None, estimations=(), knows_scenario=knows)


@_once
def self_consistent(evaluator: Evaluator) -> Evaluator:
    """The same evaluator with draws of the filter's model."""
    if _is_told(evaluator):
        return evaluator
    return replace(
        evaluator,
        model=evaluator.believed,
        filter_model=None,
        estimations=(),
        scenarios=evaluator.scenarios if evaluator.knows_scenario else (),
    )


def _is_told(evaluator: Evaluator) -> bool:
    is_same = evaluator.believed == evaluator.model
    return is_same and evaluator.knows_scenario == bool(evaluator.scenarios)


@_once
def of_information(evaluator: Evaluator) -> Evaluator:
    """The evaluator of the information; its "MSE" is minus the nats of a draw.

    The sum over all instants is a mean of errors that are scaled by their number.
    """
    instants = evaluator.horizon + 1 - evaluator.start
    mean = replace(evaluator, lag=0, weights=None, scale=1 / instants, estimations=(), delays=())
    return replace(mean, gives_information=True)


@_once
def afterwards(evaluator: Evaluator) -> Evaluator:
    """The evaluator of the estimate from all measurements."""
    return replace(evaluator, lag=evaluator.horizon, estimations=())


@_once
def at_the_moment(evaluator: Evaluator) -> Evaluator:
    """The evaluator of the filtered estimate, which has a value when it has arrived."""
    filtered, delays = replace(evaluator, lag=0, estimations=()), evaluator.delays
    if not delays:
        return filtered
    known, instants = (
        [each.parameters for each in evaluator.scenarios],
        range(evaluator.horizon + 1),
    )
    model, believed = (
        recorded(late(each, delays), instants, known)
        for each in (evaluator.model, evaluator.believed)
    )
    return replace(
        filtered,
        model=model,
        filter_model=None if believed == model else believed,
        prior=evaluator.prior and evaluator.prior.remembered(max(delays)),
    )


def shown_beside(evaluator: Evaluator) -> list[ErrorBeside]:
    """The errors that answers show beside that of an evaluator."""
    return errors_beside(evaluator.lag, evaluator.weights, evaluator.delays)


def of_error(evaluator: Evaluator, error: str) -> Evaluator:
    """The evaluator of an error beside the own, by its name."""
    (found,) = (each for each in shown_beside(evaluator) if each.named == error)
    return afterwards(evaluator) if found.is_smoothed else at_the_moment(evaluator)


def is_limit(evaluator: Evaluator, error: ErrorBeside) -> bool:
    """Whether an error beside the own is an upper limit: the model has its own error."""
    return error.is_raised and evaluator.has_particles and not evaluator.has_particle_loss


def for_estimation(evaluator: Evaluator, estimation: Estimation, *, knows_truth: bool) -> Evaluator:
    """The evaluator of what an estimation estimates: the error, or the information."""
    known = knowing_truth(evaluator) if knows_truth else evaluator
    is_wanted = ESTIMATORS[estimation.estimator].weights.evidence != 0
    return of_information(known) if is_wanted and not known.gives_information else known


def for_work(evaluator: Evaluator, work: FilterWork) -> Evaluator:
    """The evaluator with the filter's model of a work, and the estimate that it wants."""
    known = for_estimation(evaluator, work.estimation, knows_truth=work.knows_truth)
    return of_error(known, work.beside) if work.beside else known


def results(evaluator: Evaluator, works: Iterable[FilterWork]) -> list[Result]:
    """Results of works, as a task computes them; the caller has checked settings and times.

    Raises `ModelError` if a formula failed.
    """
    return [work.result(for_work(evaluator, work)).in_ranges(work) for work in works]


@_once
def task(evaluator: Evaluator) -> Callable[[Iterable[FilterWork]], list[Result]]:
    """`results` with this evaluator: what a pool sends to its workers, once."""
    return partial(results, evaluator)


def with_shares(evaluator: Evaluator, shares: Sequence[float]) -> Evaluator:
    """The same evaluator with other shares of its scenarios."""
    pairs = zip(evaluator.scenarios, shares, strict=True)
    scenarios = tuple(replace(each, share=share) for each, share in pairs)
    return replace(evaluator, scenarios=scenarios, estimations=())
