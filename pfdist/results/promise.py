"""Whether the gain that a model foresees is found in real measurements: ratios and verdicts.

Source: Fieller, "Some problems in interval estimation", Journal of the Royal Statistical Society B
16, 1954.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE, Interval
from pfdist.results.moments import Pairs

Array = NDArray[np.float64]
KEPT, NOT_KEPT, NOT_DECIDED, NOTHING_FORESEEN = (
    "kept", "not kept", "not decided", "no gain was foreseen"
)  # fmt: skip
HALF = 0.5
"""A promise is kept if at least this part of the foreseen gain is found."""
LEAST_GAIN = 0.02
"""A smaller foreseen gain is no promise."""
_ROUNDED = 100  # a larger number of replicates is rounded to two digits
_Z = 1.959963984540054  # of a 95 % interval from very many draws


@dataclass(frozen=True)
class Errors:
    """The errors of a set with R replicates, relative to the variance of what is judged.

    Parameters
    ----------
    real : array of float64, (R,)
    foreseen : array of float64, (R, D)
        Errors of each simulated system; NaN if they are not finite.
    """

    real: Array
    foreseen: Array

    @property
    def means(self) -> Array:
        """Mean foreseen error of each replicate, (R,)."""
        return np.asarray(np.nanmean(self.foreseen, axis=1), np.float64)


@dataclass(frozen=True)
class Promise:
    """The gain of a plan over other times: foreseen by the model, and found in real data.

    Parameters
    ----------
    foreseen, found : float
        Gain of means, 1 - mean error of the plan / mean error of the other times.
    foreseen_interval, found_interval : tuple of float
        95 % intervals, over simulated systems and over replicates.
    ratio : float
        Mean found difference of the errors over the mean foreseen difference.
    interval : tuple of float
        95 % interval of the ratio over blocks of replicates (Fieller).
    replicates : int
    correlation : float
        Lag-1 correlation of the found differences; NaN with fewer than three replicates.
    """

    foreseen: float
    foreseen_interval: Interval
    found: float
    found_interval: Interval
    ratio: float
    interval: Interval
    replicates: int
    correlation: float

    @property
    def verdict(self) -> str:
        """One of `KEPT`, `NOT_KEPT`, `NOT_DECIDED` and `NOTHING_FORESEEN`."""
        if not (self.foreseen >= LEAST_GAIN and self.foreseen_interval[0] > 0.0):
            return NOTHING_FORESEEN
        low, high = self.interval
        if low >= HALF:
            return KEPT
        return NOT_KEPT if high < HALF else NOT_DECIDED

    @property
    def deciding(self) -> int | None:
        """Number of replicates that would decide, if the ratio stays; None if it is unknown."""
        low, high = self.interval
        width = self.ratio - low if self.ratio > HALF else high - self.ratio
        apart = abs(self.ratio - HALF)
        if not (math.isfinite(width) and apart):
            return None
        needed = max(self.replicates + 1, math.ceil(self.replicates * (width / apart) ** 2))
        return int(float(f"{needed:.2g}")) if needed > _ROUNDED else needed


def promise(plan: Errors, other: Errors, block: int = 1) -> Promise:
    """The promise of a plan against other times.

    Parameters
    ----------
    plan, other : Errors
        Their errors with the same replicates and the same simulated systems.
    block : int
        Number of consecutive replicates whose differences may depend on each other.
    """
    found, foreseen = other.real - plan.real, other.means - plan.means
    pairs = _pairs(found, foreseen, block)
    gain = 1 - float(plan.means.sum() / other.means.sum())
    rest = other.foreseen * (1 - gain) - plan.foreseen
    variances = np.nanvar(rest, axis=1, ddof=1) / np.sum(~np.isnan(rest), axis=1)
    low, high = _pairs(plan.real, other.real, block).ratio_interval()
    half = _Z * float(np.sqrt(variances.sum()) / other.means.sum())
    return Promise(
        gain,
        (gain - half, gain + half),
        1 - float(plan.real.sum() / other.real.sum()),
        (1 - high, 1 - low),
        pairs.x.mean / pairs.y.mean if pairs.y.mean else math.nan,
        pairs.ratio_interval(),
        found.size,
        _correlation(found),
    )


def real_over_foreseen(errors: Errors, sets: int, block: int = 1) -> tuple[float, Interval]:
    """The real error of a set over the foreseen one, with its interval.

    The intervals of all sets hold together with 95 % confidence (Bonferroni).
    """
    pairs = _pairs(errors.real, errors.means, block)
    return pairs.x.mean / pairs.y.mean, pairs.ratio_interval(1 - (1 - CONFIDENCE) / sets)


def _pairs(x: Array, y: Array, block: int) -> Pairs:
    """The moments of the means of blocks."""
    blocks = np.array_split(np.stack([x, y]), max(1, x.size // block), axis=1)
    pairs = Pairs()
    pairs.add(*np.array([each.mean(axis=1) for each in blocks]).T)
    return pairs


def _correlation(values: Array) -> float:
    apart = values - values.mean()
    squares = float(np.sum(apart**2))
    return (
        float(np.sum(apart[1:] * apart[:-1])) / squares if values.size > 2 and squares else math.nan
    )
