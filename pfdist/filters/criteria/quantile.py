"""A quantile over the draws of the MSE: that of the bad draws.

Reference: David, Nagaraja, "Order statistics", 3rd edition, 2003, section 7.1 (intervals).
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import UNKNOWN, Estimate
from pfdist.filters.criterion import (
    SIDES,
    Array,
    CriterionValue,
    Errors,
    OtherCriterion,
    Sample,
    criterion,
)

_SHARE = re.compile(r"quantile ?(0?\.\d{1,6})")
_KEPT = 50_000_000  # bytes of resamples
_SPREADS = 6  # the number of a resample's draws up to a quantile varies by sqrt(count) / 2
_RESAMPLES, _FEW_RESAMPLES = 500, 100  # of a bootstrap, for an answer and in a search
_IN_TAIL = 20  # draws beyond a quantile, or before it, from which on its standard error is known


@criterion
@dataclass(frozen=True)
class Quantile(OtherCriterion):
    """A quantile over the draws of the MSE: that of the bad draws."""

    name: str = "quantile"
    written: str = "quantile 0.9"
    short: str = "quantile of the MSE"
    meaning: str = "quantile of the MSE over draws; interval from order statistics"
    needs_draws: bool = True
    share: float = 0.9

    @classmethod
    def read(cls, written: str) -> Self | None:
        """The quantile of a share, as ``quantile 0.9``."""
        found = _SHARE.fullmatch(written)
        if not found or not 0 < (share := float(found[1])) < 1:
            return None
        fewest = round(_IN_TAIL / min(share, 1 - share))
        label = f"{100 * share:g} % quantile of the MSE"
        return cls(label=label, fewest=fewest, share=share)

    def value(self, errors: Errors) -> Estimate:
        """The quantile; its standard error is that of a normal variate with the same interval."""
        found = self.of_sample(Sample(errors.mse))
        if not math.isfinite(found.value):
            return Estimate(math.inf, math.inf)
        return Estimate(found.value, found.standard_error)

    def difference(self, first: Errors, second: Errors) -> Estimate:
        """The difference of two quantiles on the same draws, by a paired bootstrap."""
        both = np.stack([first.mse, second.mse])
        differences = -np.diff(self._again(both, _FEW_RESAMPLES), axis=0)[0]
        value, other = self._values(both)
        return Estimate(float(value - other), float(np.std(differences, ddof=1)))

    def of_sample(self, sample: Sample) -> CriterionValue:
        """The quantile, and an interval from two order statistics for any distribution."""
        from scipy.stats import binom  # noqa: PLC0415  workers need no intervals

        count = sample.mse.size
        if not count:
            return CriterionValue(math.nan, *UNKNOWN)
        low, high = (int(binom.ppf(side, count, self.share)) for side in SIDES)
        ordered = np.concatenate([[0.0], np.sort(sample.mse), [math.inf]])
        (value,) = self._values(sample.mse[None])
        return CriterionValue(
            float(value), float(ordered[low]), float(ordered[min(high, count) + 1])
        )

    def change(self, sample: Sample, other: Sample) -> CriterionValue:
        """The share by which a set's quantile is lower than another's, by a paired bootstrap."""
        both = np.stack([sample.mse, other.mse])
        value, of_other = self._values(both)
        again, of_other_again = self._again(both, _RESAMPLES)
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = 1 - again / of_other_again
            return CriterionValue(
                float(1 - value / of_other), *np.quantile(changes, SIDES).tolist()
            )

    def _values(self, mse: Array) -> Array:
        """The quantile of each set, (S,), of errors (S, D)."""
        rank = max(0, math.ceil(self.share * mse.shape[1]) - 1)
        values: Array = np.partition(mse, rank, axis=1)[:, rank]
        return values

    def _again(self, mse: Array, resamples: int) -> Array:
        """The quantiles of resampled draws, the same for all sets, (S, resamples)."""
        count, again = mse.shape[1], np.empty((len(mse), resamples))
        rank = max(0, math.ceil(self.share * count) - 1)
        # No resample has its quantile before this one of the ordered draws.
        first = max(0, rank - _SPREADS * math.isqrt(count))
        orders = np.argsort(mse, axis=1)[:, first:]
        for k, times in enumerate(_resampled(resamples, count)):
            for s, order in enumerate(orders):
                number = np.cumsum(times[order], dtype=np.int64)
                place = np.searchsorted(number, rank - (count - number[-1]), "right")
                again[s, k] = mse[s, order[place]]
        return again


def _resampled(resamples: int, count: int) -> Iterable[NDArray[np.uint8]]:
    """How often each draw comes in each resample; a search asks for the same ones very often."""
    if resamples * count <= _KEPT:
        return _kept_resamples(resamples, count)
    rng = np.random.default_rng(0)
    return (_times(rng, count) for _ in range(resamples))


@lru_cache(maxsize=2)
def _kept_resamples(resamples: int, count: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(0)
    return np.stack([_times(rng, count) for _ in range(resamples)])


def _times(rng: np.random.Generator, count: int) -> NDArray[np.uint8]:
    return np.bincount(rng.integers(0, count, count), minlength=count).astype(np.uint8)
