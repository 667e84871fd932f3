"""Expected errors that an exact engine computes without draws."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.filters import kalman
from pfdist.filters.criterion import MEAN, Criterion
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import weighed
from pfdist.filters.variants import of_information


def exact_mse(
    evaluator: Evaluator,
    sets: Sequence[Times],
    ends: Sequence[int] | None = None,
    criterion: Criterion = MEAN,
) -> NDArray[np.float64] | None:
    """Exact value of the criterion for each set of times, (S,); None if it takes draws.

    `ends` are the last instants whose errors count, by default T.
    """
    if not evaluator.exact or criterion.needs_draws:
        return None
    if criterion.aspects and not evaluator.gives_information:
        return exact_mse(of_information(evaluator), sets, ends)
    if criterion.by_instant:
        errors = _mean_errors(evaluator, evaluator.shares, sets)
        return criterion.of_instants(errors[:, evaluator.relative_weights > 0.0])
    errors = _mse_of_scenarios(evaluator, sets, ends)
    return _mean(errors, criterion.shares(errors, evaluator.shares))


def exact_by_instant(
    evaluator: Evaluator, sets: Sequence[Times], *, weighted: bool = False
) -> NDArray[np.float64] | None:
    """Exact expected error of each instant with each set, (S, T+1); None if it takes draws.

    The expected MSE is the mean over all instants of the weighted errors.
    """
    if not evaluator.exact:
        return None
    return _mean_errors(evaluator, evaluator.shares, sets, weighted)


def exact_over_time(
    evaluator: Evaluator, times: Times, criterion: Criterion
) -> NDArray[np.float64] | None:
    """Exact expected error of each instant, (1, T+1), in the scenarios that decide."""
    if not (evaluator.exact and evaluator.scenarios):
        return exact_by_instant(evaluator, [times])
    shares = criterion.shares(_mse_of_scenarios(evaluator, [times]), evaluator.shares)
    return _mean_errors(evaluator, shares[:, 0], [times])


def _errors(evaluator: Evaluator, sets: Sequence[Times], weighted: bool) -> NDArray[np.float64]:
    errors = kalman.expected_errors(
        evaluator.model, evaluator.horizon, evaluator.arriving(sets), evaluator.prior,
        evaluator.lag, gives_information=evaluator.gives_information, believed=evaluator.believed,
    )  # fmt: skip
    if weighted and evaluator.instant_weights is not None:
        return weighed(errors, evaluator.instant_weights)
    return errors / evaluator.scale


def _mean_errors(
    evaluator: Evaluator, shares: Iterable[float], sets: Sequence[Times], weighted: bool = False
) -> NDArray[np.float64]:
    """The mean over scenarios, by their shares; a share of 0 costs nothing."""
    parts = zip(evaluator.of_scenarios or (evaluator,), shares, strict=True)
    found = [(_errors(each, sets, weighted), share) for each, share in parts if share]
    errors, own = zip(*found, strict=True)
    return _mean(np.array(errors), np.array(own)[:, None, None])


def _mse_of_scenarios(
    evaluator: Evaluator, sets: Sequence[Times], ends: Sequence[int] | None = None
) -> NDArray[np.float64]:
    """Exact expected MSE of each set in each scenario, (C, S)."""
    each = [_errors(part, sets, True) for part in evaluator.of_scenarios or (evaluator,)]
    return np.array([kalman.mean_until(errors, evaluator.horizon, ends) for errors in each])


def _mean(of_scenarios: NDArray[np.float64], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    mean: NDArray[np.float64] = np.sum(weighed(of_scenarios, shares), axis=0)
    return mean
