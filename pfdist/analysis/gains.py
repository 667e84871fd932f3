"""Gains over the reference, draw by draw and of the means (paper, section 3).

Statistics are accumulated block by block, so that memory does not grow with the draws: moments,
and a histogram of fixed bins, from which the quantiles are.

References
----------
Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pfdist.analysis.moments import CONFIDENCE, UNKNOWN, Array, Interval, Moments, Pairs

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
BIN = 0.001
_MUCH = 0.05  # by which two gains differ, where that wants a word
BLOCK = 10_000
"""Draws that are added at a time, everywhere: another block would give other last digits."""

EDGES = np.arange(-10_000, 1001) * BIN
"""Of the histogram's bins. A relative gain is at most 1, unless a model's own error is negative;
what lies below -10 or above 1 is counted apart."""


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
    gain_of_means_interval : (float, float)
        95 %, Fieller's: both means are of the same draws.
    mean_log10_ratio : float
        Mean of log10(mse / mse_reference): unlike a relative gain it only changes sign where the
        two change places, and half the error weighs as much as twice. NaN where an error is
        negative, as a model's own may be.
    mean_log10_ratio_interval : (float, float)
        95 %, Student's t.
    quantiles : dict of float to float
        Of the relative gain, to 0.001; -inf below -10, inf above 1.
    """

    draws: int
    mean_relative_gain: float
    mean_relative_gain_interval: Interval
    positive_fraction: float
    positive_fraction_interval: Interval
    gain_of_means: float
    gain_of_means_interval: Interval
    mean_log10_ratio: float
    mean_log10_ratio_interval: Interval
    quantiles: dict[float, float]

    @property
    def disagree(self) -> bool:
        """Whether the mean relative gain and the gain of means tell different stories.

        Their intervals lie apart, and the two differ in sign or by more than 5 percentage points.
        """
        relative, means = self.mean_relative_gain_interval, self.gain_of_means_interval
        if not all(map(math.isfinite, (*relative, *means))):
            return False
        apart = relative[1] < means[0] or means[1] < relative[0]
        different = abs(self.mean_relative_gain - self.gain_of_means) > _MUCH
        return apart and (different or self.mean_relative_gain * self.gain_of_means < 0)


def relative_gain(mse: Array, reference: Array) -> Array:
    """Relative gain of each draw, 1 - mse / reference; NaN where either is degenerate."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return 1.0 - mse / reference


def gain_over_itself(mse: Array, again: Array) -> Moments:
    """Accumulate the relative gain of a set over itself, filtered under other noise.

    Its mean is what the filters' noise alone does to a mean relative gain. As either may stand in
    the other's place, the mean of both gains is taken, -(mse - again)^2 / (2 mse again): its
    expectation is that of one, and its error far smaller.

    Parameters
    ----------
    mse, again : array of float64, (D,)
        Per-draw MSE on the same draws; NaN for a degenerate draw.
    """
    both, moments = (relative_gain(mse, again) + relative_gain(again, mse)) / 2, Moments()
    moments.add(both[~np.isnan(both)])
    return moments


@dataclass
class Gain:
    """The gain of one set of times over the reference, as far as it was added."""

    relative: Moments = field(default_factory=Moments)
    log10_ratio: Moments = field(default_factory=Moments)
    errors: Pairs = field(default_factory=Pairs)  # mse and reference
    positive: int = 0
    below: int = 0
    above: int = 0  # 1, where a model's own error may be negative
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(EDGES.size - 1, np.int64))

    def add(self, mse: Array, reference: Array) -> None:
        """Add a block of draws.

        Parameters
        ----------
        mse, reference : array of float64, (D,)
            Per-draw MSE on the same draws; NaN for a degenerate draw.
        """
        gain = relative_gain(mse, reference)
        usable = ~np.isnan(gain)  # degenerate with either set; or both errors 0, or both infinite
        gain = gain[usable]
        self.relative.add(gain)
        self.errors.add(mse[usable], reference[usable])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            self.log10_ratio.add(np.log10(mse[usable] / reference[usable]))
        self.positive += int(np.sum(gain > 0))
        self.below += int(np.sum(gain < EDGES[0]))
        self.above += int(np.sum(gain > EDGES[-1]))
        self.counts += np.histogram(gain, EDGES)[0]

    @property
    def interval(self) -> Interval:
        """Of the mean relative gain."""
        return self.relative.interval

    @property
    def of_means(self) -> float:
        """1 - E[mse] / E[mse of the reference]."""
        mean, mean_reference = np.array(self.errors.x.mean), np.array(self.errors.y.mean)
        return float(relative_gain(mean, mean_reference))

    @property
    def of_means_interval(self) -> Interval:
        """Of the gain of means: 95 %, Fieller's."""
        low, high = self.errors.ratio_interval
        return (1.0 - high, 1.0 - low)

    def quantile(self, share: float) -> float:
        """Gain below which a share of the draws lies: `numpy.quantile`, but for a bin's width."""
        rank = share * (self.relative.count - 1)
        low, high = self._sorted(math.floor(rank)), self._sorted(math.ceil(rank))
        if low == high or math.isinf(low):
            return low
        return low + (high - low) * (rank - math.floor(rank))

    def _sorted(self, place: int) -> float:
        """The gain at a place in their order, as if a bin's lay evenly in it."""
        if place < self.below:
            return -math.inf
        if place >= self.relative.count - self.above:
            return math.inf
        upto = self.below + np.cumsum(self.counts)
        number = int(np.searchsorted(upto, place, side="right"))
        inside = 1.0 - (upto[number] - place - 0.5) / self.counts[number]
        return float(EDGES[number] + BIN * inside)

    def summary(self) -> GainSummary:
        """Summarise what was added; NaN where there are too few draws for a figure."""
        count = self.relative.count
        if not count:
            nothing = (math.nan, UNKNOWN)
            return GainSummary(0, *nothing, *nothing, *nothing, *nothing, {})
        positive = stats.binomtest(self.positive, count)
        wilson = positive.proportion_ci(CONFIDENCE, method="wilson")
        return GainSummary(
            draws=count,
            mean_relative_gain=self.relative.mean,
            mean_relative_gain_interval=self.interval,
            positive_fraction=float(positive.statistic),
            positive_fraction_interval=(float(wilson.low), float(wilson.high)),
            gain_of_means=self.of_means,
            gain_of_means_interval=self.of_means_interval,
            mean_log10_ratio=self.log10_ratio.mean,
            mean_log10_ratio_interval=self.log10_ratio.interval,
            quantiles={share: self.quantile(share) for share in QUANTILES},
        )


@dataclass
class Comparison:
    """What is known of all sets that are compared.

    Parameters
    ----------
    names : list of str
        The reference first.
    """

    names: list[str]
    draws: int = 0
    mse: dict[str, Moments] = field(init=False)
    gains: dict[str, Gain] = field(init=False)

    def __post_init__(self) -> None:
        self.mse = {name: Moments() for name in self.names}
        self.gains = {name: Gain() for name in self.names[1:]}

    def add(self, block: Array) -> None:
        """Add a block of draws, (D, S): per-draw MSE, NaN for a degenerate one."""
        self.draws += len(block)
        for name, column in zip(self.names, block.T, strict=True):
            self.mse[name].add(column[~np.isnan(column)])
        for name, column in zip(self.names[1:], block.T[1:], strict=True):
            self.gains[name].add(column, block[:, 0])

    def half_width(self) -> float:
        """Largest half width of the intervals of the mean relative gains."""
        widths = [(high - low) / 2 for low, high in (gain.interval for gain in self.gains.values())]
        return math.inf if any(map(math.isnan, widths)) else max(widths)


def summarise_gain(mse: Array, reference: Array) -> GainSummary:
    """Summarise the gain over all draws that have one.

    Parameters
    ----------
    mse, reference : array of float64, (D,)
        Per-draw MSE on the same draws; NaN for a degenerate draw.
    """
    gain = Gain()
    gain.add(mse, reference)
    return gain.summary()
