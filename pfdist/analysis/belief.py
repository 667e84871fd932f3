"""Why the cost that a search believed of its set is not the cost on fresh draws."""

import math
from collections.abc import Mapping
from typing import Any

_ERRORS = 4.0  # standard errors, by which a difference is more than chance and choice


def cause_of_excess(result: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    """Say why a search's cost is not the fresh one.

    A difference within a few standard errors is that of the draws: a search takes the set that they
    flatter. A larger one has another cause, unless the search estimates as the comparison does.

    Parameters
    ----------
    result : mapping
        With search_cost, search_standard_error, expected_mse and standard_error.
    own : mapping
        How the search estimates otherwise than the comparison.
    """
    apart = result["search_cost"] - result["expected_mse"]
    error = math.hypot(result["search_standard_error"], result["standard_error"])
    if not abs(apart) > _ERRORS * error or not own:
        return "its draws chose the set"
    if apart > 0:
        return "the search's filter errs more than the job's own"
    biased = own.get("estimator", "squared_error") != "squared_error"
    return "the search's filter underestimates its error" if biased else "its draws chose the set"
