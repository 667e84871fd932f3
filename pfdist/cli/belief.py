"""The cost that a search believed, and the distance of this cost from that on fresh draws."""

from typing import Any

from pfdist.cli.layout import line
from pfdist.common.percent import percent
from pfdist.common.rounding import rounded, with_error


def belief_line(result: dict[str, Any]) -> str:
    """Give the line of a summary with the cost that a search believed.

    Parameters
    ----------
    result : dict
        The set that the search found, as in `pfdist.analysis.Run.summary`.
    """
    if result["search_standard_error"] == 0.0:
        return line("exactly", f"{rounded(result['search_cost'])}, as the search knew")
    believed = with_error(result["search_cost"], result["search_standard_error"])
    told = line("the search believed", believed)
    excess = result.get("search_excess")
    return told if excess is None else f"{told}, {distance(excess, result)}"


def distance(excess: float, result: dict[str, Any]) -> str:
    """Give the distance of a believed cost from the fresh cost, and the reasons.

    Parameters
    ----------
    excess : float
        Believed cost / fresh cost - 1.
    result : dict
        As of `belief_line`.
    """
    side = "below" if excess < 0 else "above"
    settings = ", ".join(f"{key} = {value}" for key, value in result["search_estimation"].items())
    reasons = "; ".join(filter(None, [result["search_cause"], settings]))
    return f"{percent(abs(excess))} {side} the fresh cost ({reasons})"
