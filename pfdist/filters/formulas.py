"""The formulas of simulations and filters, traced and compiled for the instants at hand."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pfdist.filters.work import Estimation
from pfdist.kernels import filter as rows
from pfdist.kernels import simulation
from pfdist.kernels.blocks import Compiled, Source, compile_blocks
from pfdist.kernels.guiding import log_density
from pfdist.kernels.lowering import Layout
from pfdist.models import StateSpaceModel
from pfdist.models.base import angular_error
from pfdist.models.tracing import trace


def filter_blocks(
    model: StateSpaceModel, truth: StateSpaceModel, settings: Estimation, instants: range
) -> Compiled:
    """The blocks of a filter, whose errors the truth defines; see `pfdist.kernels.filter`.

    A `TraceError` says that a formula cannot be traced.
    """
    guided = settings.guides(model)
    key = "filter", instants, guided, truth.formulas["error"], truth.parameters, truth.is_angle
    ...


def _at_slots(*groups: str, **first: int) -> Layout:
    """Groups whose components are rows of slots, one group after another."""


class _Formulas:
    """Formulas of a filter that are made from those of a model."""

    def __init__(self, model: StateSpaceModel, is_angle: Sequence[bool]) -> None:
        self.model, self.is_angle = model, is_angle

    def quantity(self, x: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """z, then cosine and sine of each component that is an angle."""
        z = self.model.quantity_of_interest(x, t, p)
        angles = [value for value, is_angle in zip(z, self.is_angle, strict=True) if is_angle]
        return (*z, *(part(angle) for angle in angles for part in (np.cos, np.sin)))

    def estimate(self, x: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """The mean of z from the weighted means of `quantity`."""
        means, directions = x[: len(self.is_angle)], iter(x[len(self.is_angle) :])
        return tuple(
            _direction(next(directions), next(directions)) if is_angle else mean
            for mean, is_angle in zip(means, self.is_angle, strict=True)
        )

    def deviations(self, x: Any, y: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """The squared deviation of each component of z from its mean; 1 - cos of an angle's."""
        z = self.model.quantity_of_interest(x, t, p)
        return tuple(
            angular_error(value, mean) if is_angle else (value - mean) ** 2
            for value, mean, is_angle in zip(z, y, self.is_angle, strict=True)
        )

    def distance(self, x: Any, t: Any, p: Any) -> Any:
        """The squared distance of the means of two filters; see `pfdist.filters.interface`."""
        count, total = len(self.is_angle), 0.0
        of_components = zip(x[:count], x[count : 2 * count], x[2 * count :], self.is_angle)
        for mean, variance, first, is_angle in of_components:
            angular = (1.0 - variance) * angular_error(first, mean) if is_angle else 0.0
            total = total + (angular if is_angle else (first - mean) ** 2)
        return total

    def guided(self, x: Any, y: Any, t: Any, u: Any, p: Any) -> tuple[Any, ...]:
        """x(t + 1) by the proposal, and the logarithm of p(w) / q(w | x, y)."""
        w = self.model.proposal(x, y, t, u, p)
        by_model = log_density(self.model.process_noise, w)
        by_proposal = self.model.proposal_log_density(w, x, y, t, p)
        return (*self.model.transition(x, t, w, p), by_model - by_proposal)


def _direction(cosine: Any, sine: Any) -> Any:
    return np.arctan2(sine, cosine)


def _logarithm(w: Any, p: Any) -> tuple[Any, ...]:
    return (np.log(w[0]),)
