"""Draws: realisations of x(0..T), y(0..T) and z(0..T) (paper, equations 1 to 4)."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import ModelError, PriorError
from pfdist.filters.cloud import Cloud, Gaussian, Prior
from pfdist.kernels.variates import TRUTH_INITIAL, TRUTH_MEASUREMENT, TRUTH_PROCESS, variates
from pfdist.models import StateSpaceModel
from pfdist.models.mistakes import place_of, place_of_function
from pfdist.models.programs import Programs


@dataclass(frozen=True)
class Draws:
    """D realisations of the true model at K successive instants, the first of which is `start`."""

    model: StateSpaceModel
    index: range  # indices of the draws in their stream
    x: NDArray[np.float64]  # (D, K, n): states
    # (D, K, m): measurements at all instants, also at those that are not measurement times
    y: NDArray[np.float64]
    z: NDArray[np.float64]  # (D, K, q): quantities of interest
    start: int = 0
    stream: int = 0  # key of their noise
    # (K,): weight of each instant's error in the MSE, with mean 1 over start..T; None: all are 1
    weights: NDArray[np.float64] | None = None

    @property
    def instant_weights(self) -> NDArray[np.float64]:
        """Weight of each instant's error in the MSE, (K,)."""
        return np.ones(self.z.shape[1]) if self.weights is None else self.weights

    @property
    def instants(self) -> range:
        """The K instants of the arrays."""
        return range(self.start, self.start + self.z.shape[1])

    def __getitem__(self, which: slice) -> "Draws":
        """Some of the draws."""
        x, y, z = self.x[which], self.y[which], self.z[which]
        return replace(self, index=self.index[which], x=x, y=y, z=z)

    def upto(self, end: int) -> "Draws":
        """The same draws up to an instant, which is included."""
        t = slice(end + 1 - self.start)
        weights = None if self.weights is None else self.weights[t]
        return replace(self, x=self.x[:, t], y=self.y[:, t], z=self.z[:, t], weights=weights)


def check_prior(
    prior: Prior, model: StateSpaceModel, horizon: int, *, by_particles: bool = False
) -> None:
    """Raise `PriorError` if a prior does not fit a model, or its instant is not in 0..T.

    A filter with particles (`by_particles`) cannot start from a normal distribution.
    """
    if by_particles and isinstance(prior, Gaussian):
        raise PriorError(
            "particles must start from particles, got a normal distribution; it is for the engine "
            "'kalman'"
        )
    if not 0 <= prior.t <= horizon:
        raise PriorError(f"a prior must be of an instant in 0..{horizon}, got {prior.t}")
    components = prior.components
    if components != model.components[0]:
        raise PriorError(
            f"a prior must have as many components of x as the model {model.name}, "
            f"{model.components[0]}, got {components}"
        )


def begun(
    model: StateSpaceModel, horizon: int, index: range, stream: int, prior: Cloud | None
) -> Draws:
    """Draws that are not yet simulated: arrays with arbitrary values, except x(s) of a prior.

    The arguments are those of `pfdist.filters.simulation.simulate`. Raises `PriorError` if the
    prior does not fit the model or the horizon.
    """
    if index.step != 1:
        raise ValueError(f"index must be a range with step 1, got {index}")
    if prior is not None:
        check_prior(prior, model, horizon)
    start = 0 if prior is None else prior.t
    shape = (len(index), horizon + 1 - start)
    x, y, z = (np.empty((*shape, count)) for count in model.components)
    if prior is not None:
        x[:, 0] = prior.starts(index, stream).T
    return Draws(model, index, x, y, z, start, stream)


def are_possible(model: StateSpaceModel, name: str, values: Any) -> NDArray[np.bool_]:
    """Whether values of x, y or z are finite; a measurement that has failed is NaN or inf."""
    possible: NDArray[np.bool_] = np.isfinite(values)
    if name == "y" and model.missing_components:
        possible |= np.isnan(values)
    if name == "y" and any(way.model.works for way in model.ways):
        possible |= np.isposinf(values)
    return possible


def check_finite(model: StateSpaceModel, draws: Draws, stream: int) -> None:
    """Raise `ModelError`, which names the formula, if a value is not finite.

    States are checked first, then measurements, then quantities of interest. The error names the
    first draw and instant. `stream` is the key of the noise with which the draws were simulated.
    """
    for name in "xyz":
        values = getattr(draws, name)
        is_right = are_possible(model, name, values)
        if is_right.all():
            continue
        row, k, component = (int(i) for i in np.argwhere(~is_right)[0])
        owner, number = model, component
        if name == "y":
            way = next(way for way in model.ways if component < way.y.stop)
            owner, number = way.model, component - way.y.start
        formula, arguments = _given(model, name, draws[row : row + 1], k, stream, component)
        got, t = values[row, k, component], draws.instants[k]
        raise ModelError(not_finite(owner, formula, arguments, f"{name}[{number}] = {got}", t))


def not_finite(
    model: StateSpaceModel, formula: str, arguments: tuple[Any, ...], got: str, t: int
) -> str:
    """The error message for a value that is not finite, with the operation and the line.

    `arguments` are those with which the formula gave the value. `got` names the value, for instance
    ``x[0] = nan``.
    """
    function = inspect.unwrap(getattr(model, formula))  # of a twin, what the user wrote
    if isinstance(function, Programs):
        cause = function.cause(*arguments)
    else:
        cause = _cause(function, arguments)
    return (
        f"model {model.name}: a simulation must stay finite, got {got} at t = {t} from {formula}"
        f"{cause}"
    )


def _cause(function: Callable[..., Any], arguments: tuple[Any, ...]) -> str:
    """NumPy's words for the operation that is not finite, with its line."""
    try:
        with np.errstate(all="raise", under="ignore"):
            function(*arguments)
    except FloatingPointError as error:
        return f": {error}{place_of(error)}"
    except Exception as error:  # the formula did not fail before: warnings are errors here
        return f": {type(error).__name__}{place_of(error)}"
    return place_of_function(function)


def _given(
    model: StateSpaceModel, name: str, draw: Draws, k: int, stream: int, component: int
) -> tuple[str, tuple[Any, ...]]:
    """The formula that gave a component of x, y or z of a single draw, and its arguments.

    k is the number of the instant in the draw.
    """

    def noise(kinds: tuple[str, ...], t: int, role: SupportsIndex) -> tuple[Any, ...]:
        return tuple(w[:, 0] for w in noise_of(kinds, 1, stream, draw.index, t, role))

    x, before = (tuple(draw.x[0, max(0, i)][:, None]) for i in (k, k - 1))
    t = draw.instants[k]
    if name == "y":
        v = noise(model.noise_of_measurements, t, TRUTH_MEASUREMENT)
        of_sensor = next(way.v for way in model.ways if component < way.y.stop)
        return "measurement", (x, t, v[of_sensor], model.p)
    if name == "z":
        return "quantity_of_interest", (x, t, model.p)
    if k == 0:
        return "initial", (noise(model.initial_noise, 0, TRUTH_INITIAL), model.p)
    w = noise(model.process_noise, t - 1, TRUTH_PROCESS)
    return "transition", (before, t - 1, w, model.p)


def noise_of(
    kinds: tuple[str, ...], particles: int, stream: int, draws: range, t: int, role: SupportsIndex
) -> tuple[NDArray[np.float64], ...]:
    """The variates of each component, (D, particles)."""
    return tuple(
        variates(kind, particles, stream, np.array(draws), t, role, component)
        for component, kind in enumerate(kinds)
    )
