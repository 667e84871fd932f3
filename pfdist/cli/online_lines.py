"""The lines of a summary about times that are chosen one after another."""

from typing import Any

from pfdist.cli.gain_lines import (
    gain_of_means_line,
    mean_relative_gain_line,
    positive_gains_line,
    why_gains_disagree,
)
from pfdist.cli.layout import line
from pfdist.common.percent import cost, percent, range_of
from pfdist.common.rounding import with_error, with_interval


def online_lines(online: dict[str, Any], noise: float | None) -> list[str]:
    """Say what it is worth to choose each time when the last measurement is known.

    Parameters
    ----------
    online : dict
        As under the key ``online`` of `pfdist.analysis.Run.summary`.
    noise : float or None
        The gain of the reference over itself, if it is known.
    """
    plan, reference = online["plan"], online["reference"]
    others = f"{_cost_of(plan)}, {_cost_of(reference)}"
    lines = [
        f"online: times chosen one after another, {online['draws']:,} draws",
        line("expected MSE", f"{_cost(online)}  (standard error)"),
        line("on the same draws", others),
    ]
    if online["degenerate_draws"]:
        lines.append(line("degenerate draws", f"{online['degenerate_draws']:,} (left out)"))
    differ = f"{percent(online['differs_from_plan'], 1)} of draws"
    lines += [
        line(f"not as {plan['name']}", f"{differ}, which are measured at other times"),
        gain_of_means_line(plan, plan["name"]),
        line("mean difference", _difference(plan)),
        positive_gains_line(plan),
        gain_of_means_line(reference, reference["name"]),
        mean_relative_gain_line(reference),
        positive_gains_line(reference),
    ]
    return lines + (why_gains_disagree(noise) if reference["gains_disagree"] else [])


def _cost(result: dict[str, Any]) -> str:
    return with_error(cost(result["expected_mse"]), result["standard_error"])


def _cost_of(result: dict[str, Any]) -> str:
    return f"{result['name']} {_cost(result)}"


def _difference(result: dict[str, Any]) -> str:
    value, *ends = with_interval(result["difference"], *result["difference_interval"])
    return f"{value}  (95 %: {range_of(*ends)})"
