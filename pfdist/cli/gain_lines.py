"""The lines of a summary about the gain of a set of times over another."""

from typing import Any

from pfdist.cli.layout import line, paragraph
from pfdist.common.percent import percent, percent_with_interval, range_of, times_100
from pfdist.common.rounding import with_interval


def gain_of_means_line(result: dict[str, Any], reference: str) -> str:
    """Give by how much the expected MSE is lower than the reference's.

    Parameters
    ----------
    result : dict
        Has the fields of `pfdist.analysis.GainSummary` as JSON.
    reference : str
        Name of the reference.
    """
    gain, interval = result["gain_of_means"], result["gain_of_means_interval"]
    side = "lower"
    if gain is not None and gain < 0:
        side, gain = "higher", -gain
        interval = [None if end is None else -end for end in reversed(interval)]
    value, low, high = with_interval(*(times_100(part) for part in (gain, *interval)))
    text = f"{value} % {side}  (95 %: {range_of(low, high)}; gain of means)"
    return line(f"against {reference}", text)


def mean_relative_gain_line(result: dict[str, Any]) -> str:
    """Give the mean relative gain, the paper's figure."""
    interval = result["mean_relative_gain_interval"]
    return line("mean relative gain", percent_with_interval(result["mean_relative_gain"], interval))


def positive_gains_line(result: dict[str, Any]) -> str:
    """Give the share of draws with a positive gain."""
    positive = percent_with_interval(
        result["positive_fraction"], result["positive_fraction_interval"], " of draws"
    )
    return line("positive gains", positive)


def why_gains_disagree(noise: float | None) -> list[str]:
    """Say why the mean relative gain differs from the gain of means.

    Parameters
    ----------
    noise : float or None
        The gain of the reference over itself, if it is known.
    """
    reason = "a relative gain weighs a draw with a small error as much as a draw with a large error"
    if noise is None:
        reason += ", and the noise of the filters biases its mean low"
    elif noise:
        reason += f", and the noise of the filters alone gives it a mean of {percent(noise)}"
    return paragraph(f"The two gains differ: {reason}.")
