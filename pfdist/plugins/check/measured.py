"""Checks of densities that a model declares: of y, and of y without a component."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import Estimate
from pfdist.filters.draws import Draws
from pfdist.models import StateSpaceModel
from pfdist.runner.likelihood import (
    Within,
    formatted_state,
    instants_of_draws,
    likelihood,
    measured,
    values_of_formula,
)

Array = NDArray[np.float64]
Likelihood = Callable[[Array], Array]

MOST_ON_A_GRID = 2  # components; with more the likelihood is sampled
_INSIDE = (0.005, 0.995)  # quantiles of measurements between which the integral lies
_KNOTS = {1: 257, 2: 17}  # of an axis, by the number of components
_ORDER = 16  # of the Gauss-Legendre rule between two knots
_MOST_SUMMED = 200_000  # points of a grid with whole numbers
_TIES = 0.01  # share of equal measurements above which there is no density
_DEPENDENT = 1e-9  # smallest eigenvalue of a correlation matrix of components with a density
_NARROWER = 0.7  # deviation of the test density, over that of the measurements


class NoIntegralError(Exception):
    """Values have no density, and are not whole numbers; the message is the reason."""


@dataclass(frozen=True)
class _Axis:
    """Nodes and weights of an integral or a sum from low to high."""

    nodes: Array
    weights: Array
    low: float
    high: float


def whole(y: Array) -> NDArray[np.bool_]:
    """Whether all values of each component of measurements (m, K) are whole numbers, (m,)."""
    are_whole: NDArray[np.bool_] = (y == np.round(y)).all(axis=1)
    return are_whole


def integral(likelihood: Likelihood, y: Array) -> Estimate:
    """The integral of a likelihood over y, near simulated measurements; whole numbers are summed.

    With one or two components, the integral over a central region must be the share of measurements
    in it. With more, the mean over the measurements of a narrower normal density over the
    likelihood must be 1 (importance sampling).

    `likelihood` takes points (m, L) and gives the likelihood of each, (L,). y, (m, K), has
    measurements at one state. Raises `NoIntegralError` if there is no density, or if whole numbers
    are too many.
    """
    counts = whole(y)
    for component in np.flatnonzero(~counts):
        values, counts_of = np.unique(y[component], return_counts=True)
        if values.size < (1 - _TIES) * y.shape[1]:
            tied = values[counts_of > _TIES * y.shape[1]]
            few = "few values, which are not whole numbers"
            masses = f"a point mass at {' and '.join(f'{each:g}' for each in tied)}, as of a limit"
            raise NoIntegralError(f"component {component} has {masses if tied.size < 3 else few}")
    fitted, others = y[:, ::2], y[:, 1::2]  # the region must not depend on what is counted in it
    if len(y) <= MOST_ON_A_GRID:
        return _on_a_grid(likelihood, fitted, others, counts)
    if counts.any():
        raise NoIntegralError("there are more than two components, and whole numbers among them")
    return _sampled(likelihood, fitted, others)


def _on_a_grid(
    likelihood: Likelihood, fitted: Array, others: Array, counts: NDArray[np.bool_]
) -> Estimate:
    """The integral over a box, along the axes of the measurements' covariance."""
    along = np.eye(len(fitted)) if counts.any() else _moments(fitted)[1]
    axes = [
        _summed(values) if is_whole else _between(values, _KNOTS[len(fitted)])
        for values, is_whole in zip(np.linalg.solve(along, fitted), counts, strict=True)
    ]
    if counts.any() and math.prod(axis.nodes.size for axis in axes) > _MOST_SUMMED:
        raise NoIntegralError("there are too many whole numbers")
    nodes = np.meshgrid(*(axis.nodes for axis in axes), indexing="ij")
    weights = np.meshgrid(*(axis.weights for axis in axes), indexing="ij")
    points = along @ np.stack([part.ravel() for part in nodes])
    weight = np.prod([part.ravel() for part in weights], axis=0) * abs(np.linalg.det(along))
    inside = np.ones(others.shape[1], np.bool_)
    for values, axis in zip(np.linalg.solve(along, others), axes, strict=True):
        inside &= (axis.low <= values) & (values <= axis.high)
    share = float(np.mean(inside))
    error = math.sqrt((share * (1 - share) + 1 / inside.size) / inside.size)
    ratio = float(weight @ likelihood(points)) / share
    return Estimate(ratio, ratio * error / share)


def _sampled(likelihood: Likelihood, fitted: Array, others: Array) -> Estimate:
    mean, root = _moments(fitted)
    root = _NARROWER * root
    distance = np.linalg.solve(root, others - mean[:, None])
    log_determinant = float(np.log(np.abs(np.diag(root))).sum())
    constant = log_determinant + len(others) * math.log(2 * math.pi) / 2
    ratio = np.exp(-np.sum(distance**2, axis=0) / 2 - constant) / likelihood(others)
    inverse = Estimate.of_mean(ratio)
    return Estimate(1 / inverse.value, inverse.standard_error / inverse.value**2)


def _moments(y: Array) -> tuple[Array, Array]:
    """Mean, and a triangular root of the covariance, without the outermost measurements."""
    low, high = np.quantile(y, _INSIDE, axis=1)
    central = np.clip(y, low[:, None], high[:, None])
    covariance = np.atleast_2d(np.cov(central)).astype(np.float64)
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / deviation / deviation[:, None]
    if np.linalg.eigvalsh(correlation)[0] < _DEPENDENT:
        raise NoIntegralError("a component follows from the others")
    return central.mean(axis=1), np.asarray(np.linalg.cholesky(covariance), np.float64)


def _summed(values: Array) -> _Axis:
    low, high = np.round(np.quantile(values, _INSIDE))
    if high - low > _MOST_SUMMED:
        raise NoIntegralError("there are too many whole numbers")
    nodes = np.arange(low, high + 1)
    return _Axis(nodes, np.ones(nodes.size), low, high)


def _between(values: Array, knots: int) -> _Axis:
    """Gauss-Legendre rules between quantiles of the measurements."""
    ends = np.unique(np.quantile(values, np.linspace(*_INSIDE, knots)))
    node, weight = np.polynomial.legendre.leggauss(_ORDER)
    half = np.diff(ends)[:, None] / 2
    nodes = (ends[:-1, None] + half * (node + 1)).ravel()
    return _Axis(nodes, (half * weight).ravel(), float(ends[0]), float(ends[-1]))


# --- the checks -----------------------------------------------------------------------------------

_STATES = 3  # at each of a few instants
_LARGEST_Z = 5.0  # standard errors; 1 in 10^6 of right models is blamed for each state
_FEW_VALUES = 1000
_INTEGRATION = 1e-4  # error of the integration, which is not in the standard error


def normalised(model: StateSpaceModel, draws: Draws, within: Within) -> tuple[str, str]:
    """State and text: exp(log_likelihood) must have the integral 1 at a few simulated states."""
    rng, summed, states = np.random.default_rng(0), False, 0
    for t in instants_of_draws(draws):
        some = rng.choice(draws.x[:, t], size=_STATES, replace=False)
        for number, x in enumerate(within(some)):
            y = np.stack(measured(model, x, t, number))
            y = y[:, np.isfinite(y).all(axis=0)]  # failed measurements have no density

            def density(points: Array, x: Array = x, t: int = t) -> Array:
                arguments = tuple(points), tuple(x.tolist()), t, model.p
                (log,) = values_of_formula(model, "log_likelihood", arguments, points.shape[1])
                values: Array = np.exp(log)
                return values

            gives = 1.0 - density(np.full((len(y), 1), np.inf)).item() if model.works else 1.0
            if y.shape[1] < _FEW_VALUES:  # the sensor hardly works there
                continue
            try:
                total = integral(density, y)
            except NoIntegralError as reason:
                return "note", f"the integral over y cannot be checked: {reason}"
            states, summed = states + 1, summed or bool(whole(y).all())
            total = Estimate(total.value / gives, total.standard_error / gives)
            if not abs(total.value - 1) < _LARGEST_Z * total.standard_error + _INTEGRATION:
                return "wrong", (
                    "exp(log_likelihood) must have the integral 1 over y, as normalised=True "
                    f"declares, got {total.text} at x = {formatted_state(x)}, "
                    f"t = {t} (a constant left out, such as -log(sd) - log(2 pi) / 2?)"
                )
    if summed:
        return "ok", f"as it declares: the probabilities of whole y add up to 1 at {states} states"
    how = "" if len(y) <= MOST_ON_A_GRID else ", by importance sampling"
    return "ok", f"as it declares: the integral over y is 1 at {states} states{how}"


def missing_components(model: StateSpaceModel, draws: Draws, within: Within) -> tuple[str, str]:
    """State and text: the log-likelihood must be right with each component of y missing."""
    count = model.components[1]
    if count == 1:
        return "note", "y has one component: a time without it is not measured"
    for component in range(count):
        looks = [likelihood(_without(model, component), draws, within)]
        if model.normalised:
            looks.append(normalised(_rest(model, component), draws, within))
        for state, text in looks:
            if state == "wrong":
                return "wrong", f"where y[{component}] is missing (NaN): {text}"
    return "ok", f"as it declares: each of {count} components of y may be NaN"


def _without(model: StateSpaceModel, component: int) -> StateSpaceModel:
    """The model whose measurements lack a component."""

    def measurement(x: Any, t: Any, v: Any, p: Any) -> Any:
        y = model.measurement(x, t, v, p)
        return tuple(part * np.nan if k == component else part for k, part in enumerate(y))

    return replace(model, measurement=measurement)


def _rest(model: StateSpaceModel, component: int) -> StateSpaceModel:
    """The model that measures only the other components."""

    def measurement(x: Any, t: Any, v: Any, p: Any) -> Any:
        y = model.measurement(x, t, v, p)
        return (*y[:component], *y[component + 1 :])

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        missing = y[0] * np.nan
        return model.log_likelihood((*y[:component], missing, *y[component:]), x, t, p)

    return replace(model, measurement=measurement, log_likelihood=log_likelihood, y_names=())
