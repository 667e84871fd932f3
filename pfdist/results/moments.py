"""Moments of errors over draws, gains over a reference, and the statistics of a comparison.

Blocks of draws are added one after another, so memory does not grow with the draws: they give
moments, and a histogram with fixed bins, which gives the quantiles. The same blocks in the same
order give the same bits. The gain of each draw and the gain of means are those of the paper,
section 3.

References
----------
Chan, Golub, LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances",
1979 (the rule for variances; the rule for covariances follows with a factor of each). Fieller,
"Some problems in interval estimation", Journal of the Royal Statistical Society B 16, 1954.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import (
    CONFIDENCE,
    UNKNOWN,
    Estimate,
    Interval,
    student_quantile,
    wilson_interval,
)
from pfdist.filters.estimate import largest_share

Array = NDArray[np.float64]

BLOCK = 10_000
"""Draws of a block, everywhere: blocks of another size would give other last digits."""
_KEPT = 1000  # largest draws, at least; then four times as many as `largest_share` needs


@dataclass
class Moments:
    """Count, mean and sum of squared deviations of the values added so far.

    Parameters
    ----------
    count : int
    mean : float
    squares : float
        Sum of squared deviations from the mean.
    """

    count: int = 0
    mean: float = math.nan
    squares: float = 0.0

    @classmethod
    def of_values(cls, values: Array) -> Self:
        """The moments of some values."""
        moments = cls()
        moments.add(values)
        return moments

    def add(self, values: Array) -> None:
        """Add a block of values; the same blocks in the same order give the same bits."""
        if not values.size:
            return
        with np.errstate(invalid="ignore", over="ignore"):
            mean = float(np.mean(values))
            squares = float(np.sum((values - mean) ** 2))
        if not self.count:
            self.count, self.mean, self.squares = values.size, mean, squares
            return
        count, shift = self.count + values.size, mean - self.mean
        self.squares += squares + shift * shift * self.count * values.size / count
        with_infinities = not math.isfinite(shift)
        self.mean = self.mean + mean if with_infinities else self.mean + shift * values.size / count
        self.count = count

    @property
    def standard_error(self) -> float:
        """Standard error of the mean; NaN with fewer than two values, or with infinite values."""
        if self.count < 2:
            return math.nan
        return math.sqrt(self.squares / (self.count - 1) / self.count)

    @property
    def estimate(self) -> Estimate:
        """The mean and its standard error."""
        return Estimate(self.mean, self.standard_error, self.count - 1)


@dataclass
class Pairs:
    """Moments of pairs (x, y) added so far.

    Parameters
    ----------
    x, y : Moments
    products : float
        Sum of the products of both deviations from the means.
    has_control : bool
        Whether the values are errors less their controls, see `controlled_mse`.
    """

    x: Moments = field(default_factory=Moments)
    y: Moments = field(default_factory=Moments)
    products: float = 0.0
    has_control: bool = False

    def add(self, x: Array, y: Array) -> None:
        """Add a block of pairs."""
        if not x.size:
            return
        before, mean_x, mean_y = self.x.count, self.x.mean, self.y.mean
        self.x.add(x)
        self.y.add(y)
        with np.errstate(invalid="ignore", over="ignore"):
            block_x, block_y = float(np.mean(x)), float(np.mean(y))
            self.products += float(np.sum((x - block_x) * (y - block_y)))
        if before:
            product = (block_x - mean_x) * (block_y - mean_y)
            self.products += product * before * x.size / (before + x.size)

    @property
    def too_few(self) -> bool:
        """Whether a mean less its control is not above 0, so that no ratio can be estimated."""
        return self.has_control and not min(self.x.mean, self.y.mean) > 0.0

    @property
    def _scaled(self) -> tuple[float, float, float, float]:
        """Squares and products over the square of the mean of y, and the ratio of the means."""
        scale = self.y.mean  # so that no square overflows
        sums = self.x.squares, self.y.squares, self.products
        x, y, xy = (each / scale / scale for each in sums)
        return x, y, xy, self.x.mean / scale

    @property
    def ratio_error(self) -> float:
        """Standard error of mean(x) / mean(y), by the delta method; NaN if it is unknown."""
        count = self.x.count
        if count < 2 or self.y.mean == 0.0:
            return math.nan
        x, y, xy, ratio = self._scaled
        variance = (x - 2.0 * ratio * xy + ratio * ratio * y) / count / (count - 1)
        return math.sqrt(max(0.0, variance)) if math.isfinite(variance) else math.nan

    def ratio_interval(self, confidence: float = CONFIDENCE) -> Interval:
        """Interval of mean(x) / mean(y), by Fieller's theorem with Student's t of D - 1 degrees.

        It contains all ratios r for which the mean of x - r y does not clearly differ from 0. It is
        exact for normal means, unlike the delta method. Infinite if the mean of y may be 0; NaN
        with fewer than two pairs, or if the moments are not finite.
        """
        count = self.x.count
        if count < 2 or self.y.mean == 0.0 or self.too_few:
            return UNKNOWN
        x, y, xy, ratio = self._scaled
        # t^2 / (D (D - 1)): so sums of squares become variances of means
        quantile = float(student_quantile((1 - confidence) / 2, count - 1))
        squared = quantile**2 / count / (count - 1)
        # a r^2 - 2 b r + c <= 0; `inner` is proportional to b^2 - a c without cancellation
        a, b = 1.0 - squared * y, ratio - squared * xy
        inner = x - 2.0 * ratio * xy + ratio * ratio * y - squared * (x * y - xy * xy)
        if not all(map(math.isfinite, (a, b, inner))):
            return UNKNOWN
        if a <= 0.0:
            return (-math.inf, math.inf)
        half = math.sqrt(squared * max(0.0, inner))  # rounding may make it negative
        return (b - half) / a, (b + half) / a


# --- gains ----------------------------------------------------------------------------------------


def controlled_mse(rows: Any, name: str) -> Array:
    """The error of each draw with a set, less its control if there is one; (D,).

    Its mean is the printed expected MSE, because the expectation of a control is 0. Means, their
    differences and ratios use these values. Relative gains, their quantiles and shares of draws
    use the MSE itself.

    Parameters
    ----------
    rows : table of pyarrow or DataFrame
        Rows of the table ``comparison``.
    name : str
    """
    mse: Array = np.asarray(rows[f"mse_{name}"])
    has_control = f"control_{name}" in getattr(rows, "column_names", rows)
    return mse - np.asarray(rows[f"control_{name}"]) if has_control else mse


def columns_of(block: Array, sets: int) -> tuple[Array, Array]:
    """The MSE, and the values of `controlled_mse`, of each draw with each set: (S, D) both.

    Parameters
    ----------
    block : array of float64, (D, S) or (D, 2 S)
        The MSE of each set, then its control if there is one.
    sets : int
        S.
    """
    mse, control = block.T[:sets], block.T[sets:]
    return mse, mse - control if control.size else mse


GAINS = ("gain_of_means", "mean_relative_gain", "positive_fraction", "mean_log10_ratio")
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
BIN = 0.001
_MUCH = 0.05  # two gains that differ by more need an explanation

EDGES = np.arange(-10_000, 1001) * BIN
"""Edges of the histogram's bins. A relative gain is at most 1, unless a model's own error is
negative. Gains below -10 or above 1 are counted separately."""


def disagree(
    relative: float, relative_interval: Interval, means: float, means_interval: Interval
) -> bool:
    """Whether a mean relative gain and a gain of means disagree, by their 95 % intervals.

    They disagree if their intervals lie on different sides of 0, if one alone contains 0, or if
    the intervals do not overlap and the gains differ by more than 5 percentage points.
    """
    if not all(map(math.isfinite, (*relative_interval, *means_interval))):
        return False
    signs = {(low > 0) - (high < 0) for low, high in (relative_interval, means_interval)}
    are_disjoint = (
        relative_interval[1] < means_interval[0] or means_interval[1] < relative_interval[0]
    )
    return len(signs) > 1 or (are_disjoint and abs(relative - means) > _MUCH)


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
        Moments of the pairs of mse and mse_reference, less their controls if there are any.
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

    @classmethod
    def of_draws(cls, mse: Array, reference: Array) -> Self:
        """The gain on some draws; see `add`."""
        gain = cls()
        gain.add(mse, reference)
        return gain

    def add(
        self, mse: Array, reference: Array, controlled: tuple[Array, Array] | None = None
    ) -> None:
        """Add a block of draws.

        Parameters
        ----------
        mse, reference : array of float64, (D,)
            Per-draw MSE on the same draws.
        controlled : pair of such arrays, optional
            Both less their controls; see `controlled_mse`.
        """
        self.errors.has_control = controlled is not None
        x, y = controlled or (mse, reference)
        gain = relative_gain(mse, reference)
        usable = ~np.isnan(gain)  # NaN: both errors 0, or both infinite
        gain = gain[usable]
        self.relative.add(gain)
        self.errors.add(x[usable], y[usable])
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
        """1 - E[mse] / E[mse of the reference]; NaN if a control leaves a mean not above 0."""
        mean, mean_reference = np.array(self.errors.x.mean), np.array(self.errors.y.mean)
        return math.nan if self.errors.too_few else float(relative_gain(mean, mean_reference))

    @property
    def of_means_interval(self) -> Interval:
        """95 % interval of the gain of means, Fieller's."""
        low, high = self.errors.ratio_interval()
        return (1.0 - high, 1.0 - low)

    def quantile(self, share: float) -> float:
        """Quantile of the relative gain: that of `numpy.quantile` up to the width of a bin."""
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

    def columns(self) -> dict[str, Any]:
        """Columns of the table of sets: gains with the ends of their intervals, and quantiles.

        Only draws count whose relative gain is a number. A gain that needs more draws is NaN.
        """
        count = self.relative.count
        gains: dict[str, tuple[float, Interval]] = dict.fromkeys(GAINS, (math.nan, UNKNOWN))
        if count:
            wins = self.positive / count, wilson_interval(self.positive, count)
            log10_ratio = self.log10_ratio.mean, self.log10_ratio.estimate.interval()
            gains |= {
                "gain_of_means": (self.of_means, self.of_means_interval),
                "mean_relative_gain": (self.relative.mean, self.interval),
                "positive_fraction": wins,
                "mean_log10_ratio": log10_ratio,
            }
        disagreement = disagree(*gains["mean_relative_gain"], *gains["gain_of_means"])
        columns: dict[str, Any] = {"gain_draws": count, "gains_disagree": disagreement}
        for name, (gain, (low, high)) in gains.items():
            columns |= {name: gain, f"{name}_low": low, f"{name}_high": high}
        return columns | {quantile_name(q): self.quantile(q) for q in QUANTILES if count}


class ComparisonStatistics:
    """Statistics of all compared sets, on the draws added so far.

    Parameters
    ----------
    names : list of str
        Names of the sets, the reference first.
    references : mapping of str to str, optional
        The reference of each set that has one, by name. By default the first set is the reference
        of all others.

    Attributes
    ----------
    draws : int
        Number of added draws.
    mse : dict of str to Moments
        Moments of each set's MSE, less its control if there is one.
    has_control : bool
        Whether there are controls.
    degenerate_draws : dict of str to int
        Number of draws that are degenerate with each set.
    gains : dict of str to Gain
        Gain of each set over its reference.
    """

    def __init__(self, names: list[str], references: Mapping[str, str] | None = None) -> None:
        self.names, self.draws = names, 0
        self.references = dict.fromkeys(names[1:], names[0]) if references is None else references
        self._largest = {name: np.empty(0) for name in names}
        self.mse = {name: Moments() for name in names}
        self.has_control, self.degenerate_draws = False, dict.fromkeys(names, 0)
        self.gains = {name: Gain() for name in self.references}

    def add(self, block: Array, degenerate: Array | None = None) -> None:
        """Add a block of draws.

        Parameters
        ----------
        block : array of float64, (D, S) or (D, 2 S)
            Per-draw MSE of each set, then its control if there is one.
        degenerate : array, (D, S), optional
            Whether each draw is degenerate with each set, or 1 and 0; by default none is.
        """
        self.draws += len(block)
        self.has_control = block.shape[1] > len(self.names)
        mse, controlled = (
            dict(zip(self.names, each, strict=True)) for each in columns_of(block, len(self.names))
        )
        for place, (name, column) in enumerate(controlled.items()):
            self.mse[name].add(column)
            known, most = np.append(self._largest[name], mse[name]), max(_KEPT, self.draws // 25)
            self._largest[name] = np.sort(known)[-most:]
            if degenerate is not None:
                self.degenerate_draws[name] += int(degenerate[:, place].sum())
        for name, reference in self.references.items():
            both = (controlled[name], controlled[reference]) if self.has_control else None
            self.gains[name].add(mse[name], mse[reference], both)

    def estimate(self, name: str) -> Estimate:
        """The expected MSE of a set; with a control its error counts the largest draw in addition.

        A control fails where a filter loses the state. Such draws are rare and have large errors,
        and most of the variance that a control leaves is theirs, so few draws show too little of
        it. The variance counts one more such draw, as large as the largest, without its control.
        """
        mse = self.mse[name].estimate
        if not self.has_control:
            return mse
        alone = (self._largest[name].max(initial=mse.value) - mse.value) / self.draws
        return replace(mse, standard_error=math.hypot(mse.standard_error, alone))

    def largest_share(self, name: str) -> float:
        """Share of the mean MSE of a set due to the largest 1 % of the draws; NaN if unknown."""
        return largest_share(self._largest[name], self.draws, self.mse[name].mean)
