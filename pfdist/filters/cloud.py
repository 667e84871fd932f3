"""Distributions of x(s) from which draws and filters start at s, instead of `initial`."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from inspect import unwrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import PriorError, shown
from pfdist.kernels.variates import FILTER_INITIAL, TRUTH_INITIAL, variates
from pfdist.models import StateSpaceModel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_CACHE_SIZE = 2  # results in the cache: an estimator has two filters at most


@dataclass(frozen=True)
class Gaussian:
    """A normal distribution of x(t), from which the Kalman filter starts."""

    t: int
    mean: Array  # (n,)
    covariance: Array  # (n, n)

    @property
    def components(self) -> int:
        """The number n of components of x."""
        return self.mean.size

    def remembered(self, instants: int) -> "Gaussian":
        """The distribution of a state that also holds those of instants before, all alike."""
        covariance = np.tile(self.covariance, (instants + 1, instants + 1))
        return Gaussian(self.t, np.tile(self.mean, instants + 1), covariance)

    @property
    def gaussian(self) -> "Gaussian":
        """The distribution itself."""
        return self


@dataclass(frozen=True, eq=False)
class CarriedLines:
    """The lines of a cloud's particles, which can still move.

    They begin at an instant s, with the initial noise, or with a user's own particles. These have
    no noise, so they do not move.
    """

    start: int  # s
    noise: NDArray[np.float32]  # (t - s + 1, c, M): of each step; the first is that of `initial`
    states: Array  # (n, M): at s
    y: Array  # (t - s + 1, m): measurements
    counts: NDArray[np.uint8]  # (t - s + 1, sensors): which of them count
    begins: bool  # whether `initial` gave the states at s
    model: StateSpaceModel  # whose noise it is, and whose likelihoods have counted

    @property
    def has_measured(self) -> bool:
        """Whether the last instant was measured: then no other measurement may count there."""
        return bool(self.counts[-1].any())

    def fits(self, model: StateSpaceModel, t: int) -> bool:
        """Whether a filter with a model, which begins at t, can continue the lines.

        Other formulas, another clock, or other parameters until then, also of readings that come
        with theirs, would change what has happened.
        """
        own, known = self.model, self._known(t)
        return (
            len(self.noise) == t - self.start + 1
            and own.components == model.components
            and _of_first(known, own.parameters) == _of_first(known, model.parameters)
            and (own.initial_noise, own.process_noise) == (model.initial_noise, model.process_noise)
            and _formulas_of(own) == _formulas_of(model)
        )

    def given(self, model: StateSpaceModel, t: int) -> dict[str, Any]:
        """The parameters of the lines that differ from a model's only before t.

        Their values came with readings, so a model with them fits.
        """
        known, found = self._known(t), dict[str, Any]()
        for name, own in model.parameters.items():
            value = self.model.parameters.get(name)
            if not (isinstance(own, tuple) and isinstance(value, tuple) and len(own) > known):
                continue
            if own != value and own[known:] == value[known:]:
                found[name] = value
        return found

    def _known(self, t: int) -> int:
        """The number of instants whose parameters have counted."""
        return t + self.has_measured


def _of_first(instants: int, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of the first instants; values of later readings may still come."""
    return {
        name: value[:instants] if isinstance(value, tuple) else value
        for name, value in parameters.items()
    }


def _formulas_of(model: StateSpaceModel) -> list[Any]:
    """The formulas on which a path and its likelihood depend, as the user wrote them."""
    parts = [way.model for way in model.ways]
    likelihoods: list[Any] = [
        *(each.log_likelihood for each in parts),
        *(each.works for each in parts),
    ]
    return [*map(unwrap, (model.initial, model.transition, *likelihoods))]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Weighted particles of x(t), from which draws and filters start.

    Parameters
    ----------
    t : int
        The instant of the states.
    x : array of float64, (n, M)
        States, one column a particle.
    weight : array of float64, (M,), optional
        Weights, in any unit; by default all are equal.
    truths : Cloud, optional
        An independent cloud of the same distribution, from which draws start. By default, draws
        start from this cloud, which then is itself the distribution.
    lines : CarriedLines, optional
        The lines of the particles, if these move.

    Raises
    ------
    PriorError
        A state or a weight is not finite, a weight is negative, or all weights are 0.
    """

    t: int
    x: Array
    weight: Array | None = None
    truths: "Cloud | None" = None
    lines: CarriedLines | None = None

    def __post_init__(self) -> None:
        if isinstance(self.t, bool) or not isinstance(self.t, int | np.integer):
            raise PriorError(f"a prior must be of an instant t, an integer, got {shown(self.t)}")
        is_array = isinstance(self.x, np.ndarray) and self.x.dtype.kind in "biuf"
        if not is_array or self.x.ndim != 2 or not self.x.size:
            raise PriorError(
                "a prior must have an array x (components, particles) with one particle or more, "
                f"got {shown(self.x.shape if is_array else self.x)}"
            )
        if not np.isfinite(self.x).all():
            component, particle = np.argwhere(~np.isfinite(self.x))[0].tolist()
            got = f"x[{component}] = {self.x[component, particle]} of particle {particle}"
            raise PriorError(f"a prior must have finite states, got {got}")
        weight, particles = self.weight, self.x.shape[1]
        if weight is not None and not (
            weight.shape == (particles,) and np.isfinite(weight).all()
            and weight.min() >= 0.0 and weight.any()
        ):  # fmt: skip
            raise PriorError(
                f"a prior must have one weight for each of its {particles} particles, finite, at "
                f"least 0, and not all 0, got {shown(weight)}"
            )

    def lines_for(self, model: StateSpaceModel) -> CarriedLines | None:
        """The lines, if a filter with this model can continue them."""
        return self.lines if self.lines is not None and self.lines.fits(model, self.t) else None

    @property
    def components(self) -> int:
        """The number n of components of x."""
        return int(self.x.shape[0])

    def remembered(self, instants: int) -> "Cloud":
        """The cloud of states that also hold those of instants before, all alike."""
        truths = None if self.truths is None else self.truths.remembered(instants)
        return replace(self, x=np.tile(self.x, (instants + 1, 1)), truths=truths)

    @property
    def particles(self) -> int:
        """The number M of particles."""
        return int(self.x.shape[1])

    @cached_property
    def share(self) -> Array:
        """The weights, with a sum of 1, (M,)."""
        if self.weight is None:
            return np.full(self.particles, 1 / self.particles)
        share: Array = self.weight / self.weight.sum()
        return share

    @cached_property
    def gaussian(self) -> Gaussian:
        """The normal distribution with the mean and the covariance of the particles."""
        mean = self.x @ self.share
        deviation = self.x - mean[:, None]
        return Gaussian(self.t, mean, (deviation * self.share) @ deviation.T)

    def starts(self, draws: range, stream: int) -> Array:
        """The state from which each of D draws starts, (n, D): a particle of `truths`, by weight.

        `draws` are the draws' indices in their stream, and `stream` is the key of their noise.
        """
        source = self.truths or self
        uniform = variates("uniform", 1, stream, np.array(draws), self.t, TRUTH_INITIAL, 0)
        return source.x[:, _at(source._ends, uniform[:, 0] * source._ends[-1])]

    def chosen_for_filters(self, particles: int, draws: range, stream: int) -> Indices:
        """Choose the particles from which each draw's filter starts, (D, P): systematic resampling.

        A cloud of P particles with equal weights is used unchanged. `draws` are indices in the
        stream, and `stream` is the key of the filters' noise.
        """
        arguments = particles, draws, stream
        chosen = self._chosen.get(arguments)  # a search asks for the same particles again and again
        if chosen is None:
            if len(self._chosen) == _CACHE_SIZE:
                self._chosen.clear()  # another thread may clear it, too
            offset = variates("uniform", 1, stream, np.array(draws), self.t, FILTER_INITIAL, 0)
            points = (np.arange(particles) + offset) / particles  # in (0, 1)
            chosen = self._chosen[arguments] = _at(self._ends, points * self._ends[-1])
        return chosen

    def weight_of_filters(self, particles: int) -> Array | None:
        """The weights, (P,), of filters that carry weights and use the cloud unchanged.

        None if they choose particles from it: it has no weights, or another number of particles.
        """
        return self.weight if self.particles == particles else None

    @cached_property
    def _chosen(self) -> dict[Any, Indices]:
        """The last results of `chosen_for_filters`, by their arguments."""
        return {}

    @cached_property
    def _ends(self) -> Array:
        """Where each particle ends on a line on which its length is its weight, (M,)."""
        if self.weight is None:
            return np.arange(1.0, self.particles + 1)
        return np.cumsum(self.weight)


Prior = Cloud | Gaussian


def _at(ends: Array, points: Array) -> Indices:
    """The particle on which each point of the line of weights lies."""
    last = int(np.searchsorted(ends, ends[-1]))  # particles behind it have no weight
    return np.minimum(np.searchsorted(ends, points, side="right"), last)
