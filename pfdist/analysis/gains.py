"""Gains over the reference, draw by draw and of the means (paper, section 3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Interval = tuple[float, float]
CONFIDENCE = 0.95
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True)
class GainSummary:
    """Gain of a set of times over the reference, over draws degenerate with neither.

    Parameters
    ----------
    draws : int
        Draws that count.
    mean_relative_gain : float
        Mean of 1 - mse / mse_reference, the paper's figure. Noise of the filters biases it low.
    mean_relative_gain_interval : (float, float)
        95 %, Student's t.
    positive_fraction : float
        Share of draws with a positive relative gain.
    positive_fraction_interval : (float, float)
        95 %, Wilson's.
    gain_of_means : float
        1 - E[mse] / E[mse_reference], without that bias.
    quantiles : dict of float to float
        Of the relative gain.
    """

    draws: int
    mean_relative_gain: float
    mean_relative_gain_interval: Interval
    positive_fraction: float
    positive_fraction_interval: Interval
    gain_of_means: float
    quantiles: dict[float, float]


def relative_gain(mse: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Relative gain of each draw, 1 - mse / reference; NaN where either is degenerate."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return 1.0 - mse / reference


def summarise_gain(mse: NDArray[np.float64], reference: NDArray[np.float64]) -> GainSummary:
    """Summarise the gain over all draws that have one.

    Parameters
    ----------
    mse, reference : array of float64, (D,)
        Per-draw MSE on the same draws; NaN for a degenerate draw.

    Returns
    -------
    GainSummary
        NaN where there are too few draws for a figure.
    """
    gain = relative_gain(mse, reference)
    usable = ~np.isnan(gain)  # degenerate with either set; or both errors 0, or both infinite
    mse, reference, gain = mse[usable], reference[usable], gain[usable]
    count = gain.size
    if not count:
        nothing = (np.nan, np.nan)
        return GainSummary(0, np.nan, nothing, np.nan, nothing, np.nan, {})
    mean = float(np.mean(gain))
    interval = (np.nan, np.nan)
    if count > 1 and np.isfinite(mean):
        interval = stats.t.interval(CONFIDENCE, count - 1, mean, stats.sem(gain))
    quantiles = np.quantile(gain, QUANTILES, method="inverted_cdf")  # also of infinite gains
    positive = stats.binomtest(int(np.sum(gain > 0)), count)
    wilson = positive.proportion_ci(CONFIDENCE, method="wilson")
    return GainSummary(
        draws=count,
        mean_relative_gain=mean,
        mean_relative_gain_interval=(float(interval[0]), float(interval[1])),
        positive_fraction=float(positive.statistic),
        positive_fraction_interval=(float(wilson.low), float(wilson.high)),
        gain_of_means=float(1.0 - np.mean(mse) / np.mean(reference)),
        quantiles=dict(zip(QUANTILES, quantiles.tolist(), strict=True)),
    )
