"""Whether the gain that a model foresees is found in real measurements: ratios and verdicts.

Source: Fieller, "Some problems in interval estimation", Journal of the Royal Statistical Society B
16, 1954.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE, UNKNOWN, Interval, student_quantile
from pfdist.results.moments import Pairs

Array = NDArray[np.float64]
KEPT, NOT_KEPT, NOT_DECIDED, NOTHING_FORESEEN = (
    "kept", "not kept", "not decided", "no gain was foreseen"
)  # fmt: skip
HALF = 0.5
"""A promise is kept if at least this part of the foreseen gain is found."""
LEAST_GAIN = 0.02
"""A smaller foreseen gain is no promise."""
_FEWEST = 2  # blocks that have an interval
_Z = 1.959963984540054  # of a 95 % interval from very many draws


@dataclass(frozen=True)
class RelativeErrors:
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


def promise(plan: RelativeErrors, other: RelativeErrors, block: int = 1) -> Promise:
    """The promise of a plan against other times.

    Parameters
    ----------
    plan, other : RelativeErrors
        Their errors with the same replicates and the same simulated systems.
    block : int
        Number of consecutive replicates whose differences may depend on each other.
    """
    found = other.real - plan.real
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
        *_ratio(found, other.foreseen - plan.foreseen, block),
        found.size,
        _correlation(found),
    )


def _ratio(found: Array, foreseen: Array, block: int) -> tuple[float, Interval]:
    """The mean found difference over the mean foreseen one, with Fieller's interval.

    Found differences are skew, so their variance is often too small among few replicates. The
    interval is therefore at least as wide as the model foresees if half of the gain is found.
    """
    pairs = _pairs(found, np.nanmean(foreseen, axis=1), block)
    ratio = pairs.x.mean / pairs.y.mean if pairs.y.mean else math.nan
    if not math.isfinite(ratio) or pairs.x.count < _FEWEST:
        return ratio, UNKNOWN
    low, high = pairs.ratio_interval()
    half = HALF * _quantile(CONFIDENCE, pairs) * _error_by_model(foreseen) / abs(pairs.y.mean)
    return ratio, (min(low, ratio - half), max(high, ratio + half))


def real_over_foreseen(errors: RelativeErrors, sets: int, block: int = 1) -> tuple[float, Interval]:
    """The real error of a set over the foreseen one, with its interval.

    The intervals of all sets hold together with 95 % confidence (Bonferroni). They are those of the
    logarithm, because errors are skew: small errors vary little among few replicates. For the same
    reason, the standard error is at least that which the model foresees.
    """
    pairs = _pairs(errors.real, errors.means, block)
    ratio = pairs.x.mean / pairs.y.mean if pairs.y.mean else math.nan
    if not ratio > 0.0 or pairs.x.count < _FEWEST:
        return ratio, UNKNOWN
    relative = max(pairs.ratio_error / ratio, _error_by_model(errors.foreseen) / pairs.y.mean)
    factor = math.exp(_quantile(1 - (1 - CONFIDENCE) / sets, pairs) * relative)
    return ratio, (ratio / factor, ratio * factor)


def _quantile(confidence: float, pairs: Pairs) -> float:
    """Student's t of a two-sided interval."""
    return float(student_quantile((1 + confidence) / 2, pairs.x.count - 1))


def _error_by_model(foreseen: Array) -> float:
    """Standard error of the mean of R systems, given simulated values of each, (R, D)."""
    return float(np.sqrt(np.nanvar(foreseen, axis=1, ddof=1).sum())) / len(foreseen)


def _pairs(x: Array, y: Array, block: int) -> Pairs:
    blocks = np.array_split(np.stack([x, y]), max(1, x.size // block), axis=1)
    pairs = Pairs()
    pairs.add(*np.array([each.mean(axis=1) for each in blocks]).T)
    return pairs


def _correlation(values: Array) -> float:
    deviations = values - values.mean()
    squares = float(np.sum(deviations**2))
    return (
        float(np.sum(deviations[1:] * deviations[:-1])) / squares
        if values.size > 2 and squares
        else math.nan
    )
