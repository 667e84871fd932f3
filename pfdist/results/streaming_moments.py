"""Means, their standard errors and their ratio, accumulated block by block.

Memory does not grow with the values, and the same blocks in the same order give the same bits.

References
----------
Chan, Golub, LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances",
1979 (the rule for variances; the rule for covariances follows with a factor of each). Fieller,
"Some problems in interval estimation", Journal of the Royal Statistical Society B 16, 1954.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE, UNKNOWN, Estimate, Interval, student_quantile

Array = NDArray[np.float64]


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
        count, apart = self.count + values.size, mean - self.mean
        self.squares += squares + apart * apart * self.count * values.size / count
        with_infinities = not math.isfinite(apart)
        self.mean = self.mean + mean if with_infinities else self.mean + apart * values.size / count
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
    """

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
    def ratio_error(self) -> float:
        """Standard error of mean(x) / mean(y), by the delta method; NaN if it is unknown."""
        count, scale = self.x.count, self.y.mean  # so that no square overflows
        if count < 2 or scale == 0.0:
            return math.nan
        x, y = self.x.squares / scale / scale, self.y.squares / scale / scale
        xy, ratio = self.products / scale / scale, self.x.mean / scale
        variance = (x - 2.0 * ratio * xy + ratio * ratio * y) / count / (count - 1)
        return math.sqrt(max(0.0, variance)) if math.isfinite(variance) else math.nan

    def ratio_interval(self, confidence: float = CONFIDENCE) -> Interval:
        """Interval of mean(x) / mean(y), by Fieller's theorem with Student's t of D - 1 degrees.

        It contains all ratios r for which the mean of x - r y does not differ from 0. It is exact
        for normal means, unlike the delta method. Infinite if the mean of y may be 0; NaN with
        fewer than two pairs, or if the moments are not finite.
        """
        count = self.x.count
        if count < 2 or self.y.mean == 0.0:
            return UNKNOWN
        scale = self.y.mean  # so that no square overflows
        # t^2 / (D (D - 1)): so sums of squares become variances of means
        quantile = float(student_quantile((1 - confidence) / 2, count - 1))
        squared = quantile**2 / count / (count - 1)
        x, y = self.x.squares / scale / scale, self.y.squares / scale / scale
        xy, ratio = self.products / scale / scale, self.x.mean / scale
        # a r^2 - 2 b r + c <= 0; `inner` is proportional to b^2 - a c without cancellation
        a, b = 1.0 - squared * y, ratio - squared * xy
        inner = x - 2.0 * ratio * xy + ratio * ratio * y - squared * (x * y - xy * xy)
        if not all(map(math.isfinite, (a, b, inner))):
            return UNKNOWN
        if a <= 0.0:
            return (-math.inf, math.inf)
        half = math.sqrt(squared * max(0.0, inner))  # rounding may make it negative
        return (b - half) / a, (b + half) / a
