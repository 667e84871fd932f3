"""The matrices of a model that declares itself linear and Gaussian.

They come from the values of its formulas at 0 and at unit vectors: the user writes only formulas.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import ModelError
from pfdist.kernels.formulas import formulas_of
from pfdist.models import StateSpaceModel, squared_error

Array = NDArray[np.float64]

_TOLERANCE = 1e-9  # relative, for the rounding errors of a linear formula


@dataclass(frozen=True)
class Affine:
    """``offset + matrix @ u``."""

    offset: Array  # (r,)
    matrix: Array  # (r, c)


@dataclass(frozen=True)
class LinearGaussian:
    """Matrices of a model's formulas, for t = s..T."""

    initial: Affine  # from w to x(0)
    transition: tuple[Affine, ...]  # (T-s,): from (x(t), w) to x(t+1)
    # (S (T-s+1),): from (x(t), v) to y(t), for each instant and each of S sensors
    measurement: tuple[Affine, ...]
    quantity_of_interest: tuple[Affine, ...]  # (T-s+1,): from x(t) to z(t)

    def since(self, start: int) -> "LinearGaussian":
        """The matrices without those of the first `start` instants."""
        sensors = len(self.measurement) // len(self.quantity_of_interest)
        return LinearGaussian(
            self.initial,
            self.transition[start:],
            self.measurement[start * sensors :],
            self.quantity_of_interest[start:],
        )


class _SameModel:
    """A model as a key of a cache: only the very same object is the same key."""

    def __init__(self, model: StateSpaceModel) -> None:
        self.model = model

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SameModel) and other.model is self.model

    def __hash__(self) -> int:
        return id(self.model)


@lru_cache(maxsize=8)
def _cached(key: _SameModel, horizon: int) -> LinearGaussian:
    """The cached matrices for t = 0..horizon: a search needs them again and again."""
    return matrices_of(key.model, horizon)


def matrices_of(model: StateSpaceModel, horizon: int, start: int = 0) -> LinearGaussian:
    """Find the matrices of a model, for t = start..horizon.

    A `ModelError` says that the model does not declare itself linear-Gaussian, or is not: a noise
    is not normal, the error is not the squared Euclidean norm, or a formula is not linear.
    """
    for part in model.parts:
        _check_declared(part.model)
    p, states = model.p, model.components[0]

    def affine(
        name: str, t: int, split: int, inputs: int, owner: StateSpaceModel = model
    ) -> Affine:
        formula = getattr(owner, name)

        def at(u: Array) -> tuple[Any, ...]:
            x, noise = tuple(u[:split]), tuple(u[split:])
            given = {"initial": (noise,), "quantity_of_interest": (x, t)}.get(name, (x, t, noise))
            value: tuple[Any, ...] = formula(*given, p)
            return value

        return _probed(at, inputs, f"model {owner.name}: {name} at t = {t}")

    instants = range(start, horizon + 1)
    process_inputs = states + len(model.process_noise)
    with formulas_of(model.name, model.formulas):
        return LinearGaussian(
            affine("initial", 0, 0, len(model.initial_noise)),
            tuple(affine("transition", t, states, process_inputs) for t in instants[:-1]),
            tuple(
                affine("measurement", t, states, states + len(each.measurement_noise), each)
                for t in instants
                for each in (part.model for part in model.parts)
            ),
            tuple(affine("quantity_of_interest", t, states, states) for t in instants),
        )


def _probed(at: Callable[[Array], tuple[Any, ...]], inputs: int, what: str) -> Affine:
    """Offset and matrix of a linear function, found from its values at 0 and at unit vectors."""
    elsewhere = np.random.default_rng(0).normal(size=(inputs, 4)) * [0.1, 1, 10, 100]
    points = np.concatenate([np.zeros((inputs, 1)), np.eye(inputs), elsewhere], axis=1)
    values = np.stack([np.broadcast_to(value, points.shape[1]) for value in at(points)])
    offset = values[:, 0]
    matrix = values[:, 1 : inputs + 1] - offset[:, None]
    predicted = offset[:, None] + matrix @ elsewhere
    size = np.abs(offset)[:, None] + np.abs(matrix) @ np.abs(elsewhere) + 1e-300
    wrong = ~(np.abs(values[:, inputs + 1 :] - predicted) <= _TOLERANCE * size)
    if wrong.any():
        component = int(np.argwhere(wrong)[0, 0])
        raise ModelError(f"{what} must be linear, but component {component} is not")
    return Affine(offset, matrix)


def _check_declared(model: StateSpaceModel) -> None:
    if not model.linear_gaussian:
        raise ModelError(
            f"the Kalman filter needs a model that declares itself linear_gaussian, "
            f"got {model.name}"
        )
    for name in ("initial_noise", "process_noise", "measurement_noise"):
        kinds = set(getattr(model, name)) - {"normal"}
        if kinds:
            raise ModelError(
                f"model {model.name}: {name} of a linear-Gaussian model must be normal, "
                f"got {kinds.pop()!r}"
            )
    if model.error is not squared_error:
        raise ModelError(
            f"model {model.name}: error of a linear-Gaussian model must be the squared Euclidean "
            "norm, got its own error"
        )


def cached_matrices(model: StateSpaceModel, horizon: int) -> LinearGaussian:
    """The matrices for t = 0..horizon, computed once for each model; raises as `matrices_of`."""
    return _cached(_SameModel(model), horizon)
