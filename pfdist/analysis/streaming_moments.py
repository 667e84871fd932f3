"""Means, their errors and their ratio, accumulated block by block.

Memory does not grow with what is added, and the same blocks in the same order give the same bits.

References
----------
Chan, Golub, LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances",
1979: the rule for variances; that for covariances is the same with one factor of each. Fieller,
"Some problems in interval estimation", Journal of the Royal Statistical Society B 16, 1954.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]
Interval = tuple[float, float]
CONFIDENCE = 0.95
UNKNOWN: Interval = (math.nan, math.nan)


@dataclass
class Moments:
    """Count, mean and sum of squared deviations of what was added so far."""

    count: int = 0
    mean: float = math.nan
    squares: float = 0.0

    def add(self, values: Array) -> None:
        """Add a block; blocks in the same order give the same bits."""
        if not values.size:
            return
        with np.errstate(invalid="ignore", over="ignore"):
            mean = float(np.mean(values))
            squares = float(np.sum((values - mean) ** 2))
        if not self.count:
            self.count, self.mean, self.squares = values.size, mean, squares
            return
        count, apart = self.count + values.size, mean - self.mean
        self.squares += squares + apart * apart * self.count * values.size / count
        with_infinities = not math.isfinite(apart)
        self.mean = self.mean + mean if with_infinities else self.mean + apart * values.size / count
        self.count = count

    @property
    def standard_error(self) -> float:
        """Of the mean; NaN with fewer than two values, or infinite ones."""
        if self.count < 2:
            return math.nan
        return math.sqrt(self.squares / (self.count - 1) / self.count)

    @property
    def interval(self) -> Interval:
        """Of the mean: 95 %, Student's t."""
        return self.interval_of(CONFIDENCE)

    def interval_of(self, confidence: float) -> Interval:
        """Of the mean, Student's t, with any confidence."""
        mean, error = self.mean, self.standard_error
        if not (math.isfinite(mean) and math.isfinite(error)):
            return UNKNOWN
        if error == 0.0:
            return (mean, mean)
        low, high = stats.t.interval(confidence, self.count - 1, mean, error)
        return float(low), float(high)


@dataclass
class Pairs:
    """Moments of pairs (x, y), and the sum of the products of their deviations."""

    x: Moments = field(default_factory=Moments)
    y: Moments = field(default_factory=Moments)
    products: float = 0.0

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
            apart = (block_x - mean_x) * (block_y - mean_y)
            self.products += apart * before * x.size / (before + x.size)

    @property
    def ratio_interval(self) -> Interval:
        """Of the mean of x over the mean of y: 95 %, Fieller's theorem with Student's t.

        All ratios r for which the mean of x - r y does not differ from 0: so it is exact for
        normal means, where the delta method only comes near. Infinite where the mean of y may be
        0, NaN where there are fewer than two pairs or the moments are not finite.
        """
        count = self.x.count
        if count < 2 or self.y.mean == 0.0:
            return UNKNOWN
        scale = self.y.mean  # so that no square overflows
        squared = float(stats.t.isf((1 - CONFIDENCE) / 2, count - 1)) ** 2 / count / (count - 1)
        x, y = self.x.squares / scale / scale, self.y.squares / scale / scale
        xy, ratio = self.products / scale / scale, self.x.mean / scale
        # a r^2 - 2 b r + c <= 0, and b^2 - a c without what cancels in it
        a, b = 1.0 - squared * y, ratio - squared * xy
        inner = x - 2.0 * ratio * xy + ratio * ratio * y - squared * (x * y - xy * xy)
        if not all(map(math.isfinite, (a, b, inner))):
            return UNKNOWN
        if a <= 0.0:
            return (-math.inf, math.inf)
        half = math.sqrt(squared * max(0.0, inner))  # below 0 by rounding alone
        return (b - half) / a, (b + half) / a
