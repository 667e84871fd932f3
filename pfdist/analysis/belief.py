"""Why the cost that a search believed of its set is not the cost on fresh draws."""

import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import Any

from pfdist.search.paired import CLEAR_ERRORS

_ROUNDING = 1e-9
_CHOSE = "its draws chose the set"
_UNDERESTIMATES = "the search's filter underestimates its error"
_ERRS_MORE = "the search's filter errs more than the job's own"


def cause_of_excess(
    result: Mapping[str, Any], own: Mapping[str, Any], run: str, evaluations: int = 1
) -> str:
    """Say why a search's cost is not the fresh one.

    A search takes the set that its draws flatter: its cost is the smallest of many. Up to what the
    smallest of so many normal variates may lie below their mean, the draws explain a difference.

    Parameters
    ----------
    result : mapping
        With search_cost, search_standard_error, expected_mse and standard_error.
    own : mapping
        How the search estimates otherwise than the comparison.
    run : str
        The run's folder.
    evaluations : int
        How many evaluations the search chose from.
    """
    apart = result["search_cost"] - result["expected_mse"]
    error = math.hypot(result["search_standard_error"], result["standard_error"])
    limit = largest_of(evaluations) if apart < 0 and not _is_biased(own) else CLEAR_ERRORS
    rounding = _ROUNDING * abs(result["expected_mse"])  # of costs that are both exact
    if not abs(apart) > limit * error + rounding:
        return _CHOSE
    if apart > 0 and own:
        return _ERRS_MORE
    if _is_biased(own):
        return _UNDERESTIMATES
    by = f"{abs(apart) / error:.1f} standard errors" if error else "both are exact"
    return f"unexplained: {by}; `pfdist verify {run}` checks the files"


def largest_of(count: int) -> float:
    """Give what the largest of some standard normal variates stays below.

    It exceeds this no more often than a single variate exceeds `CLEAR_ERRORS`, by Boole's
    inequality.

    Examples
    --------
    >>> [round(largest_of(count), 2) for count in (1, 1000, 1_000_000)]
    [4.0, 5.41, 6.54]
    """
    normal = NormalDist()
    return -normal.inv_cdf(normal.cdf(-CLEAR_ERRORS) / max(1, count))


def _is_biased(own: Mapping[str, Any]) -> bool:
    return bool(own.get("estimator", "squared_error") != "squared_error")
