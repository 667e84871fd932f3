"""The loss by a finite number of particles: how far a filter's MSE lies above the exact filter's.

Two figures enclose the loss. Half the squared distance between the estimates of two independent
filters is right to order 1/P. The squared error, less the variance of particles among which the
truth stands (`pfdist.kernels.schemes.CONDITIONAL`), is at least the loss for any number of
particles: it counts what both filters lack, and the price of a wrong filter model. In a collapse
both filters agree with each other, and only the second figure shows the loss.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from pfdist.analysis.streaming_moments import Array, Moments
from pfdist.common.estimate import Estimate
from pfdist.common.percent import particle_loss_text

SMALL, SMALL_AT_MOST = 0.01, 0.05
"""Fractions of the expected MSE: with a loss by two filters and a limit below, P is enough."""
_NOTABLE, _NOTABLE_AT_MOST = 0.05, 0.2
_HARDLY = 0.95  # of the error without a measurement
_QUANTILE = NormalDist().inv_cdf(0.95)


@dataclass(frozen=True)
class ParticleLoss:
    """The loss by a finite number of particles, as a fraction of the expected MSE.

    Parameters
    ----------
    particles : int
        P.
    by_two_filters : Estimate
        Right to order 1/P.
    at_most : Estimate
        At least the loss, for any number of particles.
    left_out : int
        Draws with a degenerate or infinite filter, which do not count.
    """

    particles: int
    by_two_filters: Estimate
    at_most: Estimate
    left_out: int = 0

    @property
    def is_large(self) -> bool:
        """Whether a lower 95 % limit exceeds 5 % by two filters, or 20 % for the upper figure."""
        pairs = (self.by_two_filters, _NOTABLE), (self.at_most, _NOTABLE_AT_MOST)
        return any(loss.value - _QUANTILE * loss.standard_error > most for loss, most in pairs)

    @property
    def is_small(self) -> bool:
        """Whether two filters lose at most 1 %, the limit is below 5 %, and all draws count."""
        is_small = self.by_two_filters.value <= SMALL and self.limit < SMALL_AT_MOST
        return is_small and not self.left_out

    @property
    def may_be_small(self) -> bool:
        """Whether more draws might show that the loss is small."""
        low = self.at_most.value - _QUANTILE * self.at_most.standard_error
        is_open = self.by_two_filters.value <= SMALL and low < SMALL_AT_MOST
        return is_open and not self.left_out

    @property
    def text(self) -> str:
        """Both figures in words."""
        return particle_loss_text(self.by_two_filters.value, self.limit)

    @property
    def limit(self) -> float:
        """The upper 95 % limit of the loss."""
        return self.at_most.value + _QUANTILE * self.at_most.standard_error

    @property
    def warning(self) -> str:
        """A sentence if the loss is large, else nothing."""
        if not self.is_large:
            return ""
        return (
            f"{self.particles} particles may be too few: they lose {self.text}. "
            "pfdist check-model looks for a number that is enough."
        )

    def columns(self) -> dict[str, Any]:
        """The values as a summary gives them."""
        return {
            "particle_loss": self.by_two_filters.value,
            "particle_loss_error": self.by_two_filters.standard_error,
            "particle_loss_at_most": self.at_most.value,
            "particle_loss_at_most_error": self.at_most.standard_error,
            "particle_loss_limit": self.limit,
        }


def particle_loss(
    particles: int, whole: Moments, squared: Array, distance: Array, variance: Array
) -> ParticleLoss:
    """The loss of one set of times.

    Parameters
    ----------
    particles : int
    whole : Moments
        Moments of the squared errors of all draws, the first of which are `squared`.
    squared, distance, variance : array of float64, (D,)
        Squared error, half the squared distance of two filters, and variance beside the truth, of
        the same draws. Draws with a degenerate filter are left out.
    """
    usable = np.isfinite(squared + distance + variance)
    squared, distance, variance = squared[usable], distance[usable], variance[usable]
    scale = 1 / whole.mean if whole.mean > 0 else 0.0
    apart = Moments()
    apart.add(distance)
    most = less(whole, squared, variance)
    return ParticleLoss(
        particles, apart.estimate.times(scale), most.times(scale), int(usable.size - usable.sum())
    )


def less(whole: Moments, first: Array, other: Array) -> Estimate:
    """A mean over all draws, less the mean of other errors over the first draws.

    Parameters
    ----------
    whole : Moments
        Moments of all draws, the first of which are `first`.
    first, other : array of float64, (D,)
        Both errors of the same draws.
    """
    if first.size < 2:
        return Estimate(math.nan, math.nan)
    with np.errstate(over="ignore", invalid="ignore"):  # errors may be huge
        # Not by np.cov: BLAS rounds differently on other processors.
        products = (first - np.mean(first)) * (other - np.mean(other))
        common = float(np.sum(products)) / (first.size - 1)
        error = whole.standard_error**2 + float(np.var(other, ddof=1)) / other.size
    error -= 2 * common / whole.count
    return Estimate(whole.mean - float(np.mean(other)), math.sqrt(max(0.0, error)))


def hardly_measured(expected_mse: float, unmeasured: float) -> str:
    """A sentence if a set of times hardly beats no measurement, else nothing.

    Parameters
    ----------
    expected_mse, unmeasured : float
        With the times, and the exact filter's without a measurement.
    """
    if not expected_mse > _HARDLY * unmeasured:
        return ""
    return (
        "These times hardly beat no measurement at all, which has an expected MSE of "
        f"{unmeasured:.4g}."
    )
