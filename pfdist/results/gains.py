"""Gains over the reference: the gain of each draw, and the gain of the means (paper, section 3).

Statistics are accumulated block by block, so that memory does not grow with the draws: moments,
and a histogram with fixed bins, which gives the quantiles.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import UNKNOWN, Interval, wilson_interval
from pfdist.filters.estimate import top_percent_share
from pfdist.results.streaming_moments import Array, Moments, Pairs

GAINS = ("gain_of_means", "mean_relative_gain", "positive_fraction", "mean_log10_ratio")
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
BIN = 0.001
_MUCH = 0.05  # two gains that differ by more need an explanation
BLOCK = 10_000
"""Draws that are added at a time, everywhere: other blocks would give other last digits."""

EDGES = np.arange(-10_000, 1001) * BIN
"""Edges of the histogram's bins. A relative gain is at most 1, unless a model's own error is
negative. Gains below -10 or above 1 are counted separately."""


@dataclass(frozen=True)
class GainSummary:
    """Gain of a set of times over the reference, on the draws whose relative gain is a number.

    Parameters
    ----------
    draws : int
        Number of these draws.
    mean_relative_gain : float
        Mean of 1 - mse / mse_reference, the paper's figure. Filter noise biases it low.
    mean_relative_gain_interval : (float, float)
        95 %, Student's t.
    positive_fraction : float
        Share of draws with a positive relative gain.
    positive_fraction_interval : (float, float)
        95 %, Wilson's.
    gain_of_means : float
        1 - E[mse] / E[mse_reference], without this bias.
    gain_of_means_interval : (float, float)
        95 %, Fieller's: both means come from the same draws.
    mean_log10_ratio : float
        Mean of log10(mse / mse_reference). Unlike a relative gain it is symmetric: exchanging the
        two sets changes only its sign. NaN if an error is negative, which a model may define.
    mean_log10_ratio_interval : (float, float)
        95 %, Student's t.
    quantiles : dict of float to float
        Quantiles of the relative gain, to 0.001 and exact at 0; -inf below -10, inf above 1.
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

    def columns(self) -> dict[str, Any]:
        """Columns of the table of sets: all figures, the ends of intervals, gains_disagree."""
        columns: dict[str, Any] = {"gain_draws": self.draws, "gains_disagree": self.disagree}
        for name in GAINS:
            low, high = getattr(self, f"{name}_interval")
            columns |= {name: getattr(self, name), f"{name}_low": low, f"{name}_high": high}
        return columns | {quantile_name(q): value for q, value in self.quantiles.items()}

    @property
    def disagree(self) -> bool:
        """Whether the mean relative gain and the gain of means disagree.

        They disagree if their intervals lie on different sides of 0, if one alone contains 0, or if
        the intervals do not overlap and the gains differ by more than 5 percentage points.
        """
        relative, means = self.mean_relative_gain_interval, self.gain_of_means_interval
        if not all(map(math.isfinite, (*relative, *means))):
            return False
        signs = {(low > 0) - (high < 0) for low, high in (relative, means)}
        apart = relative[1] < means[0] or means[1] < relative[0]
        different = abs(self.mean_relative_gain - self.gain_of_means) > _MUCH
        return len(signs) > 1 or (apart and different)


def quantile_name(share: float) -> str:
    """The column of a quantile of the relative gain.

    >>> quantile_name(0.05)
    'gain_quantile_5'
    """
    return f"gain_quantile_{round(100 * share)}"


def relative_gain(mse: Array, reference: Array) -> Array:
    """Relative gain of each draw, 1 - mse / reference; NaN if both are 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return 1.0 - mse / reference


def gain_over_itself(mse: Array, again: Array) -> Moments:
    """Moments of the relative gain of a set over itself under other filter noise.

    The mean is the effect of filter noise alone on a mean relative gain. The two filters are
    exchangeable, so both gains are averaged: -(mse - again)^2 / (2 mse again). The average has the
    expectation of each gain and a far smaller error.

    Parameters
    ----------
    mse, again : array of float64, (D,)
        Per-draw MSE on the same draws.
    """
    both, moments = (relative_gain(mse, again) + relative_gain(again, mse)) / 2, Moments()
    moments.add(both[~np.isnan(both)])
    return moments


@dataclass
class Gain:
    """The gain of one set of times over the reference, on the draws added so far.

    Parameters
    ----------
    relative : Moments
        Moments of the relative gain.
    log10_ratio : Moments
        Moments of log10(mse / mse_reference).
    errors : Pairs
        Moments of the pairs of mse and mse_reference.
    positive, zeros : int
        Number of draws with a positive relative gain, and with one of exactly 0.
    below, above : int
        Number of draws with a relative gain below and above the histogram.
    counts : array of int64
        Number of draws in each bin of the histogram.
    """

    relative: Moments = field(default_factory=Moments)
    log10_ratio: Moments = field(default_factory=Moments)
    errors: Pairs = field(default_factory=Pairs)
    positive: int = 0
    zeros: int = 0
    below: int = 0
    above: int = 0
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(EDGES.size - 1, np.int64))

    def add(self, mse: Array, reference: Array) -> None:
        """Add a block of draws.

        Parameters
        ----------
        mse, reference : array of float64, (D,)
            Per-draw MSE on the same draws.
        """
        gain = relative_gain(mse, reference)
        usable = ~np.isnan(gain)  # NaN: both errors 0, or both infinite
        gain = gain[usable]
        self.relative.add(gain)
        self.errors.add(mse[usable], reference[usable])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            self.log10_ratio.add(np.log10(mse[usable] / reference[usable]))
        self.positive += int(np.sum(gain > 0))
        self.zeros += int(np.sum(gain == 0))
        self.below += int(np.sum(gain < EDGES[0]))
        self.above += int(np.sum(gain > EDGES[-1]))
        self.counts += np.histogram(gain, EDGES)[0]

    @property
    def interval(self) -> Interval:
        """95 % interval of the mean relative gain."""
        return self.relative.estimate.interval()

    @property
    def of_means(self) -> float:
        """1 - E[mse] / E[mse of the reference]."""
        mean, mean_reference = np.array(self.errors.x.mean), np.array(self.errors.y.mean)
        return float(relative_gain(mean, mean_reference))

    @property
    def of_means_interval(self) -> Interval:
        """95 % interval of the gain of means, Fieller's."""
        low, high = self.errors.ratio_interval()
        return (1.0 - high, 1.0 - low)

    def quantile(self, share: float) -> float:
        """Quantile of the relative gain, as `numpy.quantile` gives it up to the width of a bin."""
        rank = share * (self.relative.count - 1)
        low, high = self._sorted(math.floor(rank)), self._sorted(math.ceil(rank))
        if low == high or math.isinf(low):
            return low
        return low + (high - low) * (rank - math.floor(rank))

    def _sorted(self, place: int) -> float:
        """The gain at a place in ascending order, if gains but 0 lie evenly within each bin."""
        if place < self.below:
            return -math.inf
        if place >= self.relative.count - self.above:
            return math.inf
        upto = self.below + np.cumsum(self.counts)
        number = int(np.searchsorted(upto, place, side="right"))
        zeros = self.zeros if EDGES[number] == 0.0 else 0  # they come first in this bin
        to_the_end, others = upto[number] - place, self.counts[number] - zeros
        if to_the_end > others:
            return 0.0
        inside = 1.0 - (to_the_end - 0.5) / others
        return float(EDGES[number] + BIN * inside)

    def summary(self) -> GainSummary:
        """Summary of all added draws; NaN for a figure that needs more draws."""
        count = self.relative.count
        if not count:
            nothing = (math.nan, UNKNOWN)
            return GainSummary(0, *nothing, *nothing, *nothing, *nothing, {})
        return GainSummary(
            draws=count,
            mean_relative_gain=self.relative.mean,
            mean_relative_gain_interval=self.interval,
            positive_fraction=self.positive / count,
            positive_fraction_interval=wilson_interval(self.positive, count),
            gain_of_means=self.of_means,
            gain_of_means_interval=self.of_means_interval,
            mean_log10_ratio=self.log10_ratio.mean,
            mean_log10_ratio_interval=self.log10_ratio.estimate.interval(),
            quantiles={share: self.quantile(share) for share in QUANTILES},
        )


class ComparisonStatistics:
    """Statistics of all compared sets, on the draws added so far.

    Parameters
    ----------
    names : list of str
        Names of the sets, the reference first.
    total : int, optional
        Number of draws that will be added; `top_percent_share` needs it.
    references : mapping of str to str, optional
        The set over which each other set gains, by name. By default the first gains nothing, and
        all others gain over it.

    Attributes
    ----------
    draws : int
        Number of added draws.
    mse : dict of str to Moments
        Moments of each set's MSE.
    degenerate_draws : dict of str to int
        Number of draws that are degenerate with each set.
    gains : dict of str to Gain
        Gain of each set over its reference.
    """

    def __init__(
        self, names: list[str], total: int = 0, references: Mapping[str, str] | None = None
    ) -> None:
        self.names, self.draws, self._most = names, 0, total // 100
        self.references = dict.fromkeys(names[1:], names[0]) if references is None else references
        self._largest = {name: np.empty(0) for name in names}
        self.mse = {name: Moments() for name in names}
        self.degenerate_draws = dict.fromkeys(names, 0)
        self.gains = {name: Gain() for name in self.references}

    def add(self, block: Array, degenerate: Array | None = None) -> None:
        """Add a block of draws.

        Parameters
        ----------
        block : array of float64, (D, S)
            Per-draw MSE of each set.
        degenerate : array of bool, (D, S), optional
            Whether each draw is degenerate with each set; by default none is.
        """
        self.draws += len(block)
        columns = dict(zip(self.names, block.T, strict=True))
        for place, (name, column) in enumerate(columns.items()):
            self.mse[name].add(column)
            self._largest[name] = _largest(np.append(self._largest[name], column), self._most)
            if degenerate is not None:
                self.degenerate_draws[name] += int(degenerate[:, place].sum())
        for name, reference in self.references.items():
            self.gains[name].add(columns[name], columns[reference])

    def top_percent_share(self, name: str) -> float:
        """Share of the expected MSE of a set that 1 % of the draws carry; NaN if it is unknown."""
        mse = self.mse[name]
        return top_percent_share(self._largest[name], mse.count, mse.mean)

    def half_width(self) -> float:
        """Half width of the widest interval of a mean relative gain."""
        widths = [(high - low) / 2 for low, high in (gain.interval for gain in self.gains.values())]
        return math.inf if any(map(math.isnan, widths)) else max(widths)


def _largest(values: Array, number: int) -> Array:
    first = values.size - number
    return np.partition(values, first)[first:] if 0 < first < values.size else values[:number]


def summarise_gain(mse: Array, reference: Array) -> GainSummary:
    """Summary of the gain, on the draws whose relative gain is a number.

    Parameters
    ----------
    mse, reference : array of float64, (D,)
        Per-draw MSE on the same draws.
    """
    gain = Gain()
    gain.add(mse, reference)
    return gain.summary()
