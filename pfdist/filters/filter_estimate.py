"""A filter's distribution of z(t), the surprise of a measurement, and the user's estimate."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr, ndtri

from pfdist.errors import ArgumentError, shown
from pfdist.filters import kalman
from pfdist.filters.cloud import Cloud, Gaussian
from pfdist.filters.one_filter import circular_components, log_likelihood
from pfdist.filters.proposals import FEW_VALUES, FOR_CONSTANTS
from pfdist.kernels.variates import TRUTH_MEASUREMENT, variates
from pfdist.models import StateSpaceModel
from pfdist.models.base import within_half_turn
from pfdist.models.twin import twin_of

Array = NDArray[np.float64]

PREDICTIVE = 20_000
"""Least number of simulated measurements behind a p-value. The p-value of a component that lies
beyond all of them is below 2 over their number."""
_OF_DENSITY = 2_000  # particles whose likelihoods give the density of a component
_GRID = 401  # values of the component
_ENDS = 30.0  # so far below its maximum, in logarithms, the density ends
_WIDENED = 20  # times
FEW = 5.0
"""An effective sample size below which an estimate is that of a few particles, not the model's."""


def few_particles(where: str, or_else: str = "") -> str:
    """The sentence about a filter of which few particles are left; see `FilterEstimate`."""
    learn = f"{FOR_CONSTANTS} for constants (those of a prior of your own do not move), "
    learn *= bool(FOR_CONSTANTS)
    return (
        "The estimate is that of a few particles, not the model's: the effective sample size falls "
        f"below {FEW:.0f} {where}, or fewer than {FEW_VALUES} values of a constant are left. What "
        f"may help: more particles, {learn}{or_else}or the engine kalman if the model is linear "
        "and Gaussian."
    )


@dataclass(frozen=True, eq=False)
class Particles:
    """Weighted values of z(t)."""

    z: Array  # (q, P)
    weight: Array  # (P,), in any unit
    moved: bool = False  # whether all have moved: then they are independent, and weights are equal

    def effective_sample_size(self) -> float:
        """The squared sum of the weights over the sum of their squares."""
        return float(self.weight.sum() ** 2 / np.sum(self.weight**2))

    def quantiles(self, levels: Array) -> Array:
        """The smallest values of z at which the cumulative weight reaches the levels, (L, q).

        Those of P moved particles lie at the positions p (P + 1): so the next value from the same
        distribution lies below with probability p.
        """
        if self.moved:
            return np.quantile(self.z, levels, axis=1, method="weibull")
        z, weight = self.z[:, self.weight > 0], self.weight[self.weight > 0]
        quantiles = np.empty((levels.size, len(z)))
        for component, values in enumerate(z):
            order = np.argsort(values, kind="stable")
            reached = np.cumsum(weight[order])
            places = np.searchsorted(reached, levels * reached[-1])
            quantiles[:, component] = values[order][np.minimum(places, order.size - 1)]
        return quantiles


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal distributions of the components of z(t)."""

    mean: Array  # (q,)
    standard_deviation: Array  # (q,)

    def effective_sample_size(self) -> None:
        """None, because there are no particles."""

    def quantiles(self, levels: Array) -> Array:
        """Quantiles of the normal distributions, (L, q)."""
        quantiles: Array = self.mean + self.standard_deviation * ndtri(levels)[:, None]
        return quantiles


Belief = Particles | Normal
"""A filter's distribution of each component of z(t)."""


# --- particles ----------------------------------------------------------------------------------


def weights_given(model: StateSpaceModel, cloud: Cloud, y: Array) -> tuple[Array, float]:
    """Weights of particles after the measurement y(t), (m,), at their instant; their sum is 1.

    The second result is the logarithm of the mean weight before that: log p(y(t) | earlier
    measurements) if the model's log-likelihood is normalised. At least one particle must have a
    finite log-likelihood.
    """
    own = np.ones(cloud.particles) if cloud.weight is None else cloud.weight
    with np.errstate(all="ignore"):
        log_weight = log_likelihood(model, cloud, y)
        log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf) + np.log(own)
    log_sum = float(logsumexp(log_weight))
    share: Array = np.exp(log_weight - log_sum)
    return share, log_sum - math.log(own.sum())


def quantity(model: StateSpaceModel, cloud: Cloud, mean: Array) -> Array:
    """Quantity of interest z of each particle, (q, P); angles at most half a turn from the mean."""
    twin = twin_of(model, range(cloud.t, cloud.t + 1))
    with np.errstate(all="ignore"):
        z = twin.quantity_of_interest(tuple(cloud.x), cloud.t, model.p)
    parts = [np.broadcast_to(np.asarray(each, np.float64), cloud.particles) for each in z]
    around: Array = within_half_turn(np.stack(parts, axis=1), mean, model.is_angle)
    return around.T


def surprise_of_particles(
    model: StateSpaceModel, cloud: Cloud, y: Array, stream: int, draw: int
) -> float:
    """The p-value of a measurement among simulated measurements of predicted particles.

    Under the right model, the rank of each component among its simulated values is uniform. The
    p-value of a component is two-sided, and ties are broken at random. Angles are compared on the
    circle that is cut opposite to the mean direction of the simulated values. The result is the
    smallest p-value of the components, times the number of components measured (Bonferroni).
    Components that depend on neither x nor noise, as the standard error of a reading, are given and
    not tested. If they differ from the model's, the ranks follow from the likelihood. That a sensor
    with `works` failed is one of its values, larger than all others.

    Parameters
    ----------
    model : StateSpaceModel
    cloud : Cloud
        Particles, predicted for the instant of the measurement.
    y : array of float64, (m,)
        The measurement; NaN marks a missing component.
    stream, draw : int
        Key of the filter's noise. The simulated measurements use the keys of the truth's
        measurement noise, which the filter itself does not use.
    """
    copies = -(-PREDICTIVE // cloud.particles)
    number, kinds = copies * cloud.particles, model.noise_of_measurements
    v = tuple(
        variates(kind, number, stream, draw, cloud.t, TRUTH_MEASUREMENT, component)
        for component, kind in enumerate(kinds)
    )
    states = cloud.x
    if cloud.weight is not None:  # of a filter that carries weights
        (chosen,) = cloud.chosen_for_filters(cloud.particles, range(draw, draw + 1), stream)
        states = states[:, chosen]
    x = tuple(np.tile(states, copies))
    twin = twin_of(model, range(cloud.t, cloud.t + 1))
    with np.errstate(all="ignore"):
        by_sensor = (way.model.measurement(x, cloud.t, v[way.v], model.p) for way in twin.ways)
        simulated = tuple(chain.from_iterable(by_sensor))
    measured = np.flatnonzero(~np.isnan(y))
    given = [k for k in measured if np.ndim(simulated[k]) == 0]
    measured, is_other = np.setdiff1d(measured, given), any(y[k] != simulated[k] for k in given)
    smallest, angles = 1.0, circular_components(model, cloud, y)
    may_fail = np.repeat(
        [bool(way.model.works) for way in model.ways],
        [way.y.stop - way.y.start for way in model.ways],
    )
    for component in measured:
        values = np.broadcast_to(np.asarray(simulated[component], np.float64), (number,))
        values, value = (
            values[np.isfinite(values) | (may_fail[component] & (values > 0))],
            y[component],
        )
        if component in angles:
            values = values[np.isfinite(values)]
            centre = np.angle(np.exp(1j * values).mean())
            values, value = (np.angle(np.exp(1j * (each - centre))) for each in (values, value))
        if is_other and np.isfinite(value):
            rank = _rank_by_likelihood(
                model, replace(cloud, x=states, weight=None), y, component, values
            )
            smallest = min(smallest, 2 * rank, 2 * (1 - rank))
            continue
        (tie,) = variates(
            "uniform", 1, stream, draw, cloud.t, TRUTH_MEASUREMENT, len(kinds) + int(component)
        )
        below, equal = np.sum(values < value), np.sum(values == value)
        rank = float((below + tie * (equal + 1)) / (values.size + 1))
        smallest = min(smallest, 2 * rank, 2 * (1 - rank))
    return min(1.0, measured.size * smallest)


def _rank_by_likelihood(
    model: StateSpaceModel,
    cloud: Cloud,
    y: Array,
    component: int | np.integer[Any],
    simulated: Array,
) -> float:
    """The probability that a component is below y, given the other components of y.

    The density of the component is the likelihood's mean over particles, normalised on a grid. The
    grid is widened from the simulated values until the density ends inside it.
    """
    few = replace(cloud, x=np.repeat(cloud.x[:, :_OF_DENSITY], _GRID, axis=1))
    count, centre = few.particles // _GRID, float(np.median(simulated))
    reach = max(abs(y[component] - centre), float(np.ptp(simulated)), 1e-300)
    low, high = centre - 2 * reach, centre + 2 * reach
    for _ in range(_WIDENED):
        grid = np.linspace(low, high, _GRID)
        values = np.tile(y[:, None], few.particles)
        values[component] = np.tile(grid, count)
        log = log_likelihood(model, few, values).reshape(count, _GRID)
        log = logsumexp(np.where(np.isfinite(log), log, -np.inf), axis=0)
        if log.max() == -np.inf:
            return 0.0
        (inside,) = np.nonzero(log > log.max() - _ENDS)
        is_inside = inside[0] > 0 and inside[-1] < _GRID - 1
        if is_inside and inside.size > _GRID // 2:
            break
        first, last = grid[max(inside[0] - 1, 0)], grid[min(inside[-1] + 1, _GRID - 1)]
        low, high = (first, last) if is_inside else (low - reach, high + reach)
        reach *= 2
    below = np.concatenate([[0.0], np.cumsum(np.exp(log - log.max()))])
    edges = np.append(grid, 2 * grid[-1] - grid[-2]) - (grid[1] - grid[0]) / 2
    return float(np.interp(y[component], edges, below / below[-1]))


# --- normal distributions -----------------------------------------------------------------------


def explained_by_normal(model: StateSpaceModel, state: Gaussian, y: Array) -> tuple[float, float]:
    """Log-density and p-value of a measurement, (m,), if x(t) has a normal distribution.

    The model is linear-Gaussian, and `state` is the distribution of x(t) before the measurement.
    NaN marks a missing component; at least one component is measured. The p-value is that of
    `surprise_of_particles`, with exact probabilities instead of ranks.
    """
    measured = ~np.isnan(y)
    expected = kalman.predicted_measurement(model, state)
    innovation = y[measured] - expected.mean[measured]
    covariance = expected.covariance[np.ix_(measured, measured)]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.abs(innovation) / np.sqrt(np.diag(covariance))
    # A component without variance is as expected (0 / 0) or impossible (its distance is infinite).
    distance = np.where(np.isnan(distance), 0.0, distance)
    smallest = float(np.min(2 * ndtr(-distance)))
    return float(kalman.log_density(innovation, covariance)), min(1.0, innovation.size * smallest)


@dataclass(frozen=True, eq=False)
class FilterEstimate:
    """A filter's estimate of z at an instant.

    Parameters
    ----------
    t : int
    measured : bool
        Whether the filter has received a measurement at t.
    mean, standard_deviation : array of float64, (q,)
        For an angle the mean direction in -pi..pi, and sqrt(-2 log R), where R is the length of the
        mean of the particles' unit vectors. For a narrow distribution, this is the usual standard
        deviation.
    spread : float
        The standard deviation of all components together, which rules compare: the root of the sum
        of their variances; that of an angle is 1 - R.
    effective_sample_size : float or None
        Number of particles with equal weights that would be as informative as the weighted
        particles; None for the engine "kalman".
    surprise : float or None
        The p-value of the measurement at t: the probability, under the model, of one at least as
        extreme; None if t was not measured. See
        `pfdist.filters.filter_estimate.surprise_of_particles`.
    collapsed : int or None
        The first measured instant up to t at which the effective sample size fell below 5, or
        fewer than 20 different values of a component of x that does not move were left, if there
        is one. From it on, mean and quantiles are those of a few particles, not the model's.
    """

    t: int
    measured: bool
    mean: Array
    standard_deviation: Array
    spread: float
    effective_sample_size: float | None
    surprise: float | None
    _belief: Belief = field(repr=False)
    collapsed: int | None = None

    def quantiles(self, levels: float | Sequence[float]) -> Array:
        """Quantiles of each component of z, (levels, q).

        Parameters
        ----------
        levels : float or sequence of float
            Above 0 and below 1. Quantiles of an angle are at most half a turn from the mean.
        """
        try:
            wanted = np.atleast_1d(np.array(levels, np.float64))
        except (TypeError, ValueError):
            wanted = np.array([np.nan])
        if wanted.ndim != 1 or not ((wanted > 0) & (wanted < 1)).all():
            raise ArgumentError(f"levels must lie between 0 and 1, got {shown(levels)}")
        return self._belief.quantiles(wanted)


def estimate_of(
    t: int,
    mean: Array,
    variance: Array,
    is_angle: Sequence[bool],
    belief: Belief,
    surprise: float | None = None,
    collapsed: int | None = None,
    *,
    has_lost: bool = False,
) -> FilterEstimate:
    """The estimate at t, from its moments; t was measured if there is a surprise.

    `collapsed` is that of the estimate before t, and `has_lost` says whether few values of a
    constant are left.
    """
    size = belief.effective_sample_size()
    is_few = has_lost or (size is not None and size < FEW)
    if collapsed is None and surprise is not None and is_few:
        collapsed = t
    with np.errstate(all="ignore"):  # 1 - variance is below 0 where z is no angle
        squares = np.where(is_angle, -2 * np.log1p(-variance), variance)
    return FilterEstimate(
        t,
        surprise is not None,
        mean,
        np.sqrt(squares),
        float(np.sqrt(variance.sum())),
        size,
        surprise,
        belief,
        collapsed,
    )
