"""Whether an estimator can be trusted: comparisons with the squared error of the job's own filter.

If the particles of a filter have collapsed onto a wrong state, their variance is tiny and the error
is large. An estimator that uses this variance is too small there, and a search seeks exactly the
sets where it is smallest. Two tests detect this: the estimate lies far below the squared error on
some set, or it reverses the order of two finalists.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pfdist.common.estimate import CLEAR_ERRORS, Estimate
from pfdist.filters.estimate import Evaluation, difference
from pfdist.times.measurement_times import Times

BELOW = 0.15
"""An estimator fails if it lies this share, and `CLEAR_ERRORS`, below the squared error."""

_SURE = 2.0  # standard errors above the limit, from which an estimator passes


class Verdict(NamedTuple):
    """Result of the test of an estimator on one set."""

    # Number of standard errors by which the estimate lies below the limit; negative if above.
    excess: float
    fails: bool
    open: bool  # whether more draws may change the result
    is_known: bool = True  # whether there were enough usable draws for a result


def judged(estimated: Evaluation, squared: Evaluation) -> Verdict:
    """Test an estimator on one set, on the draws in which neither filter was degenerate.

    `squared` is the evaluation by the squared error of the job's own filter. Both evaluations have
    the same times, end and draws.
    """
    usable = np.isfinite(estimated.mse) & np.isfinite(squared.mse)
    if np.sum(usable) < 2:
        return Verdict(-math.inf, fails=False, open=False, is_known=False)
    estimates, errors = estimated.mse[usable], squared.mse[usable]
    excess = _standard_scores((1 - BELOW) * errors - estimates)
    below = _standard_scores(errors - estimates)
    fails = excess > 0 and below > CLEAR_ERRORS
    return Verdict(excess, fails, open=not fails and excess > -_SURE)


def _standard_scores(values: np.ndarray) -> float:
    mean = Estimate.of_mean(values)
    if mean.standard_error > 0:
        return mean.value / mean.standard_error
    return math.copysign(math.inf, mean.value) if mean.value else 0.0


def misordered(
    believed: Mapping[Times, Evaluation], squared: Sequence[Evaluation]
) -> tuple[Evaluation, Evaluation] | None:
    """Two finalists that an estimator puts in the wrong order, the better first; None if none.

    `believed` has the evaluations by the estimator, and `squared` those by the squared error of the
    job's own filter on common draws. The squared error must distinguish the two, and the estimator
    must contradict it: the two differences have opposite signs, and chance does not explain this.
    """
    for first, second in combinations(squared, 2):
        real = difference(first, second)
        better, worse = (first, second) if real.value < 0 else (second, first)
        is_clear = real.is_positive() or real.is_negative()
        if not math.isfinite(real.value) or not is_clear:
            continue
        seen = difference(*(believed[each.measurement_times] for each in (better, worse)))
        contradiction = seen.plus(real.times(math.copysign(1.0, real.value)))
        if seen.value > 0 and contradiction.is_positive():
            return better, worse
    return None


def failed_probe(estimated: Evaluation, squared: Evaluation) -> str:
    """A sentence that says how far an estimate is too small on a set; arguments as of `judged`."""
    usable = np.isfinite(estimated.mse) & np.isfinite(squared.mse)
    estimate, error = np.mean(estimated.mse[usable]), Estimate.of_mean(squared.mse[usable])
    up_to = "" if estimated.end is None else f" up to t = {estimated.end}"
    return (
        f"it gives {estimate:.4g} for {_text(estimated.measurement_times)}{up_to}, where the "
        f"squared error of the job's own filter is {error.value:.4g} ± {error.standard_error:.2g}"
    )


def unchecked_probe(estimated: Evaluation, squared: Evaluation) -> str:
    """A sentence about the set on which an estimator could not be tested, as for `judged`."""
    usable = int(np.sum(np.isfinite(estimated.mse) & np.isfinite(squared.mse)))
    return (
        f"in {_text(estimated.measurement_times)} only {usable} of {estimated.mse.size} draws had "
        "no degenerate filter, and 2 are needed; more particles would help"
    )


def wrong_order(better: Evaluation, worse: Evaluation) -> str:
    """A sentence that says which two finalists an estimator puts in the wrong order.

    Both evaluations are by the squared error, on common draws.
    """
    apart = difference(worse, better)
    return (
        f"it prefers {_text(worse.measurement_times)} to {_text(better.measurement_times)}, where "
        f"the squared error of the job's own filter is larger by {apart.value:.4g} ± "
        f"{apart.standard_error:.2g}"
    )


def _text(times: Times) -> str:
    return f"{{{', '.join(map(str, times))}}}"
