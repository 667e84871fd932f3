"""An estimate with its standard error, as every room of the program compares it.

The error of a mean over a block of values is computed here, and over blocks that are added one by
one in `pfdist.results.moments`, where the interval of a ratio of two means is, too.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.rounding import with_error

CONFIDENCE = 0.95
CLEAR_ERRORS = 4.0
"""Number of standard errors beyond which chance alone does not explain a difference."""

Interval = tuple[float, float]
UNKNOWN: Interval = (math.nan, math.nan)


@dataclass(frozen=True)
class Estimate:
    """An estimate and its standard error."""

    value: float
    standard_error: float = 0.0  # 0 if the value is exact; NaN if the error is unknown
    degrees: float = math.inf  # degrees of freedom of the error; infinite for a normal variate

    @classmethod
    def of_mean(cls, values: NDArray[Any], groups: int = 0) -> "Estimate":
        """The mean of independent values; with fewer than two, its error is unknown.

        With `groups`, the values are so many successive groups of the same size, and only the
        groups are independent.
        """
        values = values.reshape(groups, -1).mean(axis=1) if groups else values
        count = values.size
        if count < 2:
            return cls(float(values[0]) if count else math.nan, math.nan)
        with np.errstate(invalid="ignore", over="ignore"):  # infinite values have no error
            error = float(np.std(values, ddof=1) / math.sqrt(count))
            return cls(float(np.mean(values)), error, count - 1)

    @property
    def text(self) -> str:
        """The value and its error, both to the second significant digit of the error."""
        return with_error(self.value, self.standard_error)

    def interval(self, confidence: float = CONFIDENCE) -> Interval:
        """Two-sided interval, by Student's t; NaN if the value or its error is not finite."""
        if not (math.isfinite(self.value) and math.isfinite(self.standard_error)):
            return UNKNOWN
        return self._quantile((1 - confidence) / 2), self._quantile((1 + confidence) / 2)

    def at_most(self, confidence: float = CONFIDENCE) -> float:
        """Upper end of the one-sided interval, by Student's t."""
        return self._quantile(confidence)

    def plus(self, other: "Estimate") -> "Estimate":
        """Sum with an independent estimate; it has the fewer degrees of freedom of the two."""
        error = math.hypot(self.standard_error, other.standard_error)
        return Estimate(self.value + other.value, error, min(self.degrees, other.degrees))

    def times(self, factor: float) -> "Estimate":
        """Multiple of the estimate, for instance relative to an exact number."""
        return Estimate(self.value * factor, self.standard_error * abs(factor), self.degrees)

    def is_positive(self, errors: float = CLEAR_ERRORS) -> bool:
        """Whether the value lies above 0 by more than this number of standard errors."""
        return self.value > errors * self.standard_error

    def is_negative(self, errors: float = CLEAR_ERRORS) -> bool:
        """Whether the value lies below 0 by more than this number of standard errors."""
        return -self.value > errors * self.standard_error

    def _quantile(self, share: float) -> float:
        if self.standard_error == 0.0:
            return self.value
        return float(student_quantile(share, self.degrees) * self.standard_error + self.value)


def student_quantile(share: float, degrees: Any) -> Any:
    """Quantile of Student's t; normal for infinitely many degrees of freedom.

    Parameters
    ----------
    share : float
        Probability of a smaller value.
    degrees : float or array of float
    """
    from scipy import special  # noqa: PLC0415  workers estimate, but need no intervals

    if isinstance(degrees, float) and math.isinf(degrees):
        return special.ndtri(share)
    return special.stdtrit(degrees, share)


def wilson_interval(successes: int, count: int) -> Interval:
    """Wilson's 95 % interval of a share; unknown if there are no draws.

    References
    ----------
    Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
    """
    if not count:
        return UNKNOWN
    share, z = successes / count, NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    center = (2 * successes + z * z) / (2 * (count + z * z))
    half = z * math.sqrt(4 * successes * (1 - share) + z * z) / (2 * (count + z * z))
    low = 0.0 if successes == 0 else center - half
    return low, 1.0 if successes == count else center + half
