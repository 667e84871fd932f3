"""The error that a search estimated of its set, and why the error on fresh draws is another."""

import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any

from pfdist.common.estimate import CLEAR_ERRORS
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.results.stored_run import StoredRun, copies_of, distrust_of, own_estimation

_ROUNDING = 1e-9
_EXACT = "exact"
_CHOSE = "its draws chose the set"
_UNDERESTIMATES = "the search's filter underestimates its error"
_ERRS_MORE = "the search's filter errs more than the job's own"


def belief_of(run: StoredRun, search: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """How far the estimated error of a set is from the error on fresh draws, and why.

    Parameters
    ----------
    run : StoredRun
    search : str
        The search that found the set.
    result : mapping
        With search_mse, search_standard_error, expected_mse and standard_error.

    Returns
    -------
    dict
        The columns of the table of sets that begin with search_.
    """
    mse = result["expected_mse"]
    comparable = mse != 0.0 and math.isfinite(mse)
    distrust, copies = distrust_of(run, search), copies_of(run).get(search, [1])
    # After a second search the race gives the error, and it estimates as the comparison.
    own = {} if distrust else own_estimation(run, search)
    return {
        "search_excess": result["search_mse"] / mse - 1.0 if comparable else math.nan,
        "search_settings": ", ".join(f"{key} = {value}" for key, value in own.items()),
        "search_cause": cause_of_excess(result, own, str(run.path), len(copies)),
        "search_distrust": distrust,
    }


def cause_of_excess(
    result: Mapping[str, Any], own: Mapping[str, Any], run: str, evaluations: int = 1
) -> str:
    """The reason why a search's estimate differs from the error on fresh draws.

    A search chooses the set with the smallest of many estimates, so the estimate is too low. The
    draws explain a difference up to the likely minimum of as many normal variates.

    Parameters
    ----------
    result : mapping
        With search_mse, search_standard_error, expected_mse and standard_error.
    own : mapping
        How the search estimates otherwise than the comparison.
    run : str
        The run's folder.
    evaluations : int
        Number of evaluations from which the search chose.
    """
    apart = result["search_mse"] - result["expected_mse"]
    error = math.hypot(result["search_standard_error"], result["standard_error"])
    limit = largest_of(evaluations) if apart < 0 and not _is_biased(own) else CLEAR_ERRORS
    rounding = _ROUNDING * abs(result["expected_mse"])  # matters where both errors are exact
    if not abs(apart) > limit * error + rounding:
        return _CHOSE if error else _EXACT
    if apart > 0 and own:
        return _ERRS_MORE
    if _is_biased(own):
        return _UNDERESTIMATES
    size = f"{abs(apart) / error:.1f} standard errors" if error else "both are exact"
    return f"unexplained: {size}; `pfdist verify {run}` checks the files"


def largest_of(count: int) -> float:
    """A bound that the largest of some standard normal variates rarely exceeds.

    The largest exceeds it at most as often as a single variate exceeds `CLEAR_ERRORS`, by Boole's
    inequality.

    Examples
    --------
    >>> [round(largest_of(count), 2) for count in (1, 1000, 1_000_000)]
    [4.0, 5.41, 6.54]
    """
    normal = NormalDist()
    return -normal.inv_cdf(normal.cdf(-CLEAR_ERRORS) / max(1, count))


def _is_biased(own: Mapping[str, Any]) -> bool:
    return bool(own.get("estimator", SQUARED_ERROR.name) != SQUARED_ERROR.name)
