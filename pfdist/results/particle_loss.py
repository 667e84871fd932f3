"""The particle loss: how far a filter's MSE lies above that of the exact filter.

Two estimates enclose it. Half the squared distance between the estimates of two independent
filters is right to order 1/P. The squared error, less the variance of particles one of which is
the truth (`pfdist.kernels.schemes.CONDITIONAL`), is at least the loss for any number of particles:
it includes an error that both filters share, and that of a wrong filter model. If both filters
collapse alike, only the second estimate shows the loss.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from pfdist.common.estimate import Estimate
from pfdist.common.percent import particle_loss_text, percent
from pfdist.filters.aspects import DISTANCE, VARIANCE
from pfdist.filters.estimate import largest_share
from pfdist.filters.proposals import FEW_VALUES, FOR_CONSTANTS, PROPOSALS
from pfdist.results.moments import Array, ComparisonStatistics, Moments, controlled_mse
from pfdist.results.stored_run import StoredRun, on_common_draws, statistics_of

SMALL, SMALL_AT_MOST = 0.01, 0.05
"""Fractions of the expected MSE: P is enough if the loss by two filters and the limit are lower."""
TOO_FEW = "particles may be too few"
LOST = 0.05
"""A larger share of draws that lose a constant is said, and lets particles move."""
_NOTABLE, _NOTABLE_AT_MOST = 0.05, 0.2
_ALARMING = 0.2
_NOTABLE_TOP, _HEAVY = 0.1, 0.25
_HARDLY = 0.95  # of the error without a measurement
_QUANTILE = NormalDist().inv_cdf(0.95)


@dataclass(frozen=True)
class ParticleLoss:
    """The particle loss, as a fraction of the expected MSE.

    If an estimate is infinite, the loss and its limit are 1.

    Parameters
    ----------
    particles : int
        P.
    by_two_filters : Estimate
        Right to order 1/P.
    at_most : Estimate
        At least the loss, for any number of particles.
    top_share : float
        Share of the expected MSE, or of its excess over the variance, that 1 % of the draws carry.
    """

    particles: int
    by_two_filters: Estimate
    at_most: Estimate
    top_share: float = 0.0
    moves: bool = False  # whether particles move: then the upper estimate is that of others

    @property
    def is_large(self) -> bool:
        """Whether a lower 95 % limit exceeds 5 % by two filters, or 20 % for the upper estimate."""
        pairs = [(self.by_two_filters, _NOTABLE), (self.at_most, _NOTABLE_AT_MOST)]
        pairs = pairs[: 1 if self.moves else 2]
        return any(loss.value - _QUANTILE * loss.standard_error > most for loss, most in pairs)

    @property
    def is_small(self) -> bool:
        """Whether the loss is at most 1 %, its limit is below 5 %, and `rare` is empty."""
        is_small = self.by_two_filters.value <= SMALL and self.limit < SMALL_AT_MOST
        return is_small and not self.rare

    @property
    def may_be_small(self) -> bool:
        """Whether more draws might show that the loss is small."""
        return self.by_two_filters.value <= SMALL and self.at_least < SMALL_AT_MOST

    @property
    def text(self) -> str:
        """The loss and its limit in words."""
        if self.moves:
            return f"about {percent(self.by_two_filters.value)} of the expected MSE"
        return particle_loss_text(self.by_two_filters.value, self.limit)

    @property
    def rare(self) -> str:
        """A sentence if a few draws carry much of the error, else nothing."""
        share = percent(min(1.0, self.top_share), 0)
        return (
            f"1 % of the draws carry {share} of the error of {self.particles:,} particles, or of "
            "its excess over the variance, so few draws do not show the loss."
        ) * (self.top_share > _HEAVY)

    @property
    def at_least(self) -> float:
        """The lower 95 % limit of the upper estimate."""
        return self.at_most.value - _QUANTILE * self.at_most.standard_error

    @property
    def limit(self) -> float:
        """The upper 95 % limit of the loss, at most 1."""
        return min(1.0, self.at_most.value + _QUANTILE * self.at_most.standard_error)

    @property
    def large(self) -> str:
        """Sentences if the loss is large, else nothing."""
        more = "pfdist check-model looks for a number that is enough, and compares proposals."
        if self.moves:
            more = "More moved particles help (filter.moved_particles)."
        few = f"{self.particles} {TOO_FEW}: they lose {self.text}. {more}"
        return few * self.is_large

    @property
    def alarm(self) -> str:
        """A sentence if more than a fifth may be lost, so that it comes before the answer."""
        losses = (self.by_two_filters,) if self.moves else (self.by_two_filters, self.at_most)
        if not any(e.value - _QUANTILE * e.standard_error > _ALARMING for e in losses):
            return ""
        more = "More moved particles help (filter.moved_particles)."
        if not self.moves:
            others = f", or {FOR_CONSTANTS} where x has constants" * bool(FOR_CONSTANTS)
            more = f"More particles help{others}."
        lost = f"{self.particles:,} particles lose {self.text}"
        return f"{lost}, so all errors are those of this filter. {more}"

    @property
    def warning(self) -> str:
        """Sentences if the loss is large, or if few draws carry much of the error; else nothing."""
        return " ".join(filter(None, (self.large, self.rare)))

    def columns(self) -> dict[str, Any]:
        """Columns of the table of sets."""
        return {
            "particle_loss": self.by_two_filters.value,
            "particle_loss_error": self.by_two_filters.standard_error,
            "particle_loss_at_most": self.at_most.value,
            "particle_loss_at_most_error": self.at_most.standard_error,
            "particle_loss_limit": self.limit,
        }


def particle_loss(
    particles: int,
    whole: Moments,
    squared: Array,
    distance: Array,
    variance: Array,
    *,
    moves: bool = False,
) -> ParticleLoss:
    """The particle loss of one set of times.

    Parameters
    ----------
    particles : int
    whole : Moments
        Moments of the squared errors of all draws, the first of which are `squared`.
    squared, distance, variance : array of float64, (D,)
        Squared error, less its control if there is one, half the squared distance of two filters,
        and variance beside the truth, of the same draws.
    """
    if not np.isfinite(squared + distance + variance).all():
        return ParticleLoss(particles, Estimate(1.0), Estimate(1.0), moves=moves)
    scale = 1 / whole.mean if whole.mean > 0 else 0.0
    return ParticleLoss(
        particles,
        Moments.of_values(distance).estimate.times(scale),
        less(whole, squared, variance).times(scale),
        _top_share(squared, variance),
        moves,
    )


def lost_text(share: float) -> str:
    """The sentence about draws that lose a constant; empty if they are few."""
    return (
        f"In {percent(share, 0)} of the draws, the filter ends with fewer than {FEW_VALUES} values "
        "of a constant" + f": take {FOR_CONSTANTS}" * bool(FOR_CONSTANTS) + "."
    ) * (share > LOST)


def _top_share(squared: Array, variance: Array) -> float:
    """The larger share of the error, or of its excess over the variance, that 1 % of draws carry.

    A small excess is mostly chance. So it counts only if these draws alone add a tenth to the rest
    of the error.
    """
    if squared.size < 100:
        return 0.0
    excess = squared - variance
    of_error, of_excess = top_percent_share(squared), top_percent_share(excess)
    is_notable = of_excess * np.mean(excess) > _NOTABLE_TOP * np.mean(squared)
    return max(of_error, of_excess if is_notable else 0.0)


def top_percent_share(values: Array) -> float:
    """Share of a mean over draws that is due to the 1 % of the draws with the largest values."""
    return largest_share(values, values.size, float(np.mean(values)))


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
    """A warning if a set of times is hardly better than no measurement, else nothing.

    Parameters
    ----------
    expected_mse, unmeasured : float
        With the times, and of the exact filter without a measurement.
    """
    if not expected_mse > _HARDLY * unmeasured:
        return ""
    return (
        "These times are hardly better than no measurement, whose expected MSE is "
        f"{unmeasured:.4g}."
    )


def particle_losses_of(
    run: StoredRun, statistics: ComparisonStatistics | None = None
) -> dict[str, ParticleLoss]:
    """The particle loss of each compared set, by name.

    It is empty for exact engines, and errors other than the squared norm.
    """
    tables = [each.table for each in (DISTANCE, VARIANCE)]
    if not all(map(run._store.has, tables)):
        return {}
    rows = on_common_draws(run, *tables)
    own, whole = run.job["filter"], (statistics or statistics_of(run)).mse
    moves = PROPOSALS[own["proposal"]].moves
    particles = own["moved_particles"] if moves else own["particles"]
    return {
        name: particle_loss(
            particles,
            whole[name],
            controlled_mse(rows, name),
            *(rows[f"{each.named}_{name}"].to_numpy() for each in (DISTANCE, VARIANCE)),
            moves=moves,
        )
        for name in run.sets
    }
