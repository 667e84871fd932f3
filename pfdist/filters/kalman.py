"""The exact filter of a model that declares itself linear and Gaussian, and the exact expected MSE.

The covariances do not depend on the measured values, so the expected MSE needs no draws.

The matrices of a model come from the values of its formulas at 0 and at unit vectors, so the user
writes only formulas. Linearity is tested at four random points.

Sources: Kalman, "A new approach to linear filtering and prediction problems", Journal of Basic
Engineering 82, 1960. Sinopoli et al., "Kalman filtering with intermittent observations", IEEE
Transactions on Automatic Control 49, 2004. Bierman, "Fixed interval smoothing with discrete
measurements", International Journal of Control 18, 1973 (the estimates that use later measurements;
it inverts no covariance of the state).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial, reduce
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Lag, ManySets, Times, last_used
from pfdist.common.points import PointNumbers
from pfdist.common.stopping import check
from pfdist.errors import ModelError
from pfdist.filters.cloud import Gaussian, Prior
from pfdist.filters.draws import Draws
from pfdist.filters.interface import checking, one_by_one, validated_from, weighed
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import FilterArrays
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.twin import twin_of

Array = NDArray[np.float64]
_ROUNDING = 1e-12  # of an eigenvalue, relative to the largest
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


def matrices_of(model: StateSpaceModel, horizon: int, start: int = 0) -> LinearGaussian:
    """The matrices of a model for t = start..horizon.

    Raises `ModelError` if the model does not declare linear_gaussian, or is not: a noise is not
    normal, the error is not the squared Euclidean norm, or a formula is not linear.
    """
    for way in model.ways:
        _check_declared(way.model)
    instants = range(start, horizon + 1)
    p, states, twin = model.p, model.components[0], twin_of(model, instants)

    def affine(
        name: str, instants: range, split: int, inputs: int, owner: StateSpaceModel = twin
    ) -> list[Affine]:
        formula = getattr(owner, name)

        def at(u: Array, t: Any) -> tuple[Any, ...]:
            x, noise = tuple(u[:split]), tuple(u[split:])
            given = {"initial": (noise,), "quantity_of_interest": (x, t)}.get(name, (x, t, noise))
            value: tuple[Any, ...] = formula(*given, p)
            return value

        return _probed(at, inputs, instants, formula, f"model {owner.name}: {name}")

    process_inputs = states + len(model.process_noise)
    check()
    (initial,) = affine("initial", range(1), 0, len(model.initial_noise))
    by_sensor = [
        affine("measurement", instants, states, states + len(each.measurement_noise), each)
        for each in (way.model for way in twin.ways)
    ]
    return LinearGaussian(
        initial,
        tuple(affine("transition", instants[:-1], states, process_inputs)),
        tuple(chain.from_iterable(zip(*by_sensor, strict=True))),
        tuple(affine("quantity_of_interest", instants, states, states)),
    )


def _probed(
    at: Callable[[Array, Any], tuple[Any, ...]],
    inputs: int,
    instants: range,
    formula: Any,
    what: str,
) -> list[Affine]:
    """Offset and matrix of a linear function of each instant, from its values at some points.

    The points are 0, unit vectors, and others, where the values must be as foreseen.
    """
    if not instants:
        return []
    points, each = _points(inputs), instants if formula.reads_time else instants[:1]
    elsewhere, size = points[:, inputs + 1 :], (len(each), points.shape[1])
    if formula.takes_instants:
        columns = np.array(each)[:, None]
        values = np.stack([np.broadcast_to(value, size) for value in at(points, columns)])
    else:
        rows = ([np.broadcast_to(value, size[1]) for value in at(points, t)] for t in each)
        values = np.stack([np.stack(row) for row in rows], axis=1)
    offset = values[..., 0]
    matrix = values[..., 1 : inputs + 1] - offset[..., None]
    if not np.isfinite(values[..., : inputs + 1]).all():
        component, row = np.argwhere(~np.isfinite(values).all(axis=-1))[0]
        at_t = f"at t = {each[row]}"
        raise ModelError(f"{what} {at_t} must be finite, but component {component} is not")
    predicted = offset[..., None] + matrix @ elsewhere
    scale = np.abs(offset)[..., None] + np.abs(matrix) @ np.abs(elsewhere) + 1e-300
    wrong = ~(np.abs(values[..., inputs + 1 :] - predicted) <= _TOLERANCE * scale)
    if wrong.any():
        component, row, _ = np.argwhere(wrong)[0]
        at_t = f"at t = {each[row]}"
        raise ModelError(f"{what} {at_t} must be linear, but component {component} is not")
    found = [Affine(offset[:, k].copy(), matrix[:, k].copy()) for k in range(len(each))]
    return found if len(each) == len(instants) else found * len(instants)


@cache
def _points(inputs: int) -> Array:
    elsewhere = np.random.default_rng(0).normal(size=(inputs, 4)) * [0.1, 1, 10, 100]
    return np.concatenate([np.zeros((inputs, 1)), np.eye(inputs), elsewhere], axis=1)


def _check_declared(model: StateSpaceModel) -> None:
    if any(way.model.works for way in model.ways):
        raise ModelError(
            f"the Kalman filter needs sensors without works, got {model.name}: other engines take "
            "them"
        )
    if not model.linear_gaussian:
        raise ModelError(
            f"the Kalman filter needs a model with linear_gaussian=True, got {model.name}, which "
            "does not declare it: other engines take every model"
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


def cached_matrices(model: StateSpaceModel, horizon: int, start: int = 0) -> LinearGaussian:
    """The matrices for t = start..horizon, computed once for each model; raises as `matrices_of`.

    Searches and comparisons need them again and again.
    """
    matrices: LinearGaussian = model.kept(
        ("matrices", horizon, start), lambda: matrices_of(model, horizon, start)
    )
    return matrices


def expected_mse(
    model: StateSpaceModel,
    horizon: int,
    sets: Sequence[Times],
    ends: Sequence[int] | None = None,
    prior: Prior | None = None,
    weights: Array | None = None,
    lag: Lag = 0,
) -> Array:
    """Exact expected MSE with each set of times, (S,): no draws are needed.

    The estimate of z(t) uses measurements until t + lag, by default those of the filter. The
    weights of the instants have mean 1; by default all are 1. For the other arguments see
    `mean_until`, for the errors `expected_errors`.
    """
    errors = expected_errors(model, horizon, sets, prior, lag)
    return mean_until(errors if weights is None else weighed(errors, weights), horizon, ends)


def mean_until(errors: Array, horizon: int, ends: Sequence[int] | None = None) -> Array:
    """The mean over t = s..T of the errors of each set, (S,), from (S, T-s+1).

    If `ends` are given, each set's errors count up to its end only, and are divided by the number
    of all instants.
    """
    sets, instants = errors.shape
    last = [-1] * sets if ends is None else [end - horizon - 1 for end in ends]
    mse: Array = np.cumsum(errors, axis=1)[range(sets), last] / instants
    return mse


def expected_errors(
    model: StateSpaceModel,
    horizon: int,
    sets: Sequence[Times],
    prior: Prior | None = None,
    lag: Lag = 0,
    *,
    gives_information: bool = False,
    believed: StateSpaceModel | None = None,
) -> Array:
    """Exact expected error of each instant with each set of times, (S, T+1).

    With a prior of x(s), the instants are s..T. If information is wanted, the error is minus
    that of an instant's measurements, in nats: log det(H P H' + R) / 2 - log det(R) / 2. The filter
    has the model `believed`, by default the true one; if it is another, the lag must be 0. Raises
    MeasurementTimesError if a set lies outside these instants, and ModelError if a model is not
    linear-Gaussian.
    """
    if believed not in (None, model):
        return _errors_of_wrong_filter(model, believed, horizon, sets, prior)
    start = 0 if prior is None else prior.t
    matrices, points = cached_matrices(model, horizon), model.points
    measured = measured_points(points, horizon, sets, start)
    _, begin = _begin(matrices, prior)
    covariance = np.repeat(begin[None], len(sets), axis=0)
    errors = np.zeros((len(sets), horizon + 1 - start))
    kept = list[tuple[Array, Array, Array]]()
    for t in range(start, horizon + 1):
        check()
        through, information = _unmeasured(matrices, t, start, covariance)
        for place in points.at(t):
            here = measured[:, place]
            gain, observation_matrix, weight, spread, noise = _gain(
                covariance[here], matrices.measurement[place]
            )
            if gives_information:
                nats = np.linalg.slogdet(spread)[1] - np.linalg.slogdet(noise)[1]
                errors[here, t - start] -= nats / 2
            if lag:
                seen = observation_matrix @ through[here]
                information[here] += through[here].swapaxes(1, 2) @ weight @ seen
                through[here] -= gain @ seen
            covariance[here] -= gain @ observation_matrix @ covariance[here]
        kept += [(covariance.copy(), through, information)] if lag else []
        if not gives_information:
            h = matrices.quantity_of_interest[t].matrix
            errors[:, t - start] = np.trace(h @ covariance @ h.T, axis1=1, axis2=2)
        if t < horizon:
            covariance = _propagated(covariance, matrices.transition[t])
    if lag:
        covariances, maps, gained = (np.array(each) for each in zip(*kept, strict=True))
        last = last_used(lag, range(start, horizon + 1))
        covariances -= covariances @ later(maps, gained, last, both=True) @ covariances
        for k, each in enumerate(covariances):
            h = matrices.quantity_of_interest[start + k].matrix
            errors[:, k] = np.trace(h @ each @ h.T, axis1=1, axis2=2)
    return errors


def measured_points(
    points: PointNumbers, horizon: int, sets: Sequence[Times], start: int
) -> NDArray[np.bool_]:
    """Whether each set has each point."""
    if isinstance(sets, ManySets):
        return sets.points()
    measured = np.zeros((len(sets), points.first(horizon + 1)), np.bool_)
    for row, times in zip(measured, sets, strict=True):
        row[[*validated_from(start, times, horizon, points)]] = True
    return measured


def _errors_of_wrong_filter(
    model: StateSpaceModel,
    believed: StateSpaceModel,
    horizon: int,
    sets: Sequence[Times],
    prior: Prior | None,
) -> Array:
    """As `expected_errors`, if the filter believes another model.

    Its gains follow from the model that it believes. So (x, estimate, 1) is a linear function of
    itself and the true noise, and its second moments have a recursion.
    """
    start, points = 0 if prior is None else prior.t, model.points
    truth, own = cached_matrices(model, horizon), cached_matrices(believed, horizon)
    measured = measured_points(points, horizon, sets, start)
    (mean, spread), (guess, begin) = _begin(truth, prior), _begin(own, prior)
    n, last = mean.size, mean.size + guess.size
    joint = np.concatenate([mean, guess, [1.0]])
    moments = np.repeat(np.outer(joint, joint)[None], len(sets), axis=0)
    moments[:, :n, :n] += spread
    covariance = np.repeat(begin[None], len(sets), axis=0)
    errors = np.empty((len(sets), horizon + 1 - start))
    for t in range(start, horizon + 1):
        check()
        for place in points.at(t):
            here, y, foreseen = measured[:, place], truth.measurement[place], own.measurement[place]
            gain, h, *_ = _gain(covariance[here], foreseen)
            covariance[here] -= gain @ h @ covariance[here]
            into = np.repeat(np.eye(last + 1)[None], len(gain), axis=0)
            into[:, n:last, :n] = gain @ y.matrix[:, :n]
            into[:, n:last, n:last] -= gain @ h
            into[:, n:last, last] = gain @ (y.offset - foreseen.offset)
            moments[here] = into @ moments[here] @ into.swapaxes(1, 2)
            noise = gain @ y.matrix[:, n:]
            moments[here, n:last, n:last] += noise @ noise.swapaxes(1, 2)
        z, estimate = truth.quantity_of_interest[t], own.quantity_of_interest[t]
        difference = np.hstack([z.matrix, -estimate.matrix, (z.offset - estimate.offset)[:, None]])
        errors[:, t - start] = np.trace(difference @ moments @ difference.T, axis1=1, axis2=2)
        if t < horizon:
            moves, believes = truth.transition[t], own.transition[t]
            into = np.zeros((last + 1, last + 1))
            into[:n, :n], into[:n, last] = moves.matrix[:, :n], moves.offset
            into[n:last, n:last], into[n:last, last] = (
                believes.matrix[:, : last - n],
                believes.offset,
            )
            into[last, last] = 1.0
            moments = into @ moments @ into.T
            moments[:, :n, :n] += _square(moves.matrix[:, n:])
            covariance = _propagated(covariance, believes)
    return errors


def _unmeasured(
    matrices: LinearGaussian, t: int, start: int, covariance: Array
) -> tuple[Array, Array]:
    """The map of an error from t - 1 to t, one for each covariance, and no information yet."""
    states = covariance.shape[-1]
    step = matrices.transition[t - 1].matrix[:, :states] if t > start else np.eye(states)
    return np.broadcast_to(step, covariance.shape).copy(), np.zeros(covariance.shape)


def later(maps: Array, gained: Array, last: NDArray[np.int64], *, both: bool) -> Array:
    """The part of measurements after t, until `last`, in the estimate of x(t), at all K instants.

    That of measurements at t, in x(t - 1), is ``gained[t]``. That of later ones goes through
    ``maps[t]``, (..., n, n), from an error at t - 1 to the error behind the measurements at t; the
    information, a square array, goes through it on both sides.
    """
    total, count, lags = np.zeros_like(gained), len(maps), last - np.arange(len(maps))

    def fill(now: Any, after: Any, known: Array) -> None:
        through = maps[after].swapaxes(-1, -2) @ known
        total[now] = gained[after] + (through @ maps[after] if both else through)

    if (last == count - 1).all():
        for k in range(count - 2, -1, -1):
            fill(k, k + 1, total[k + 1])
    else:  # the windows of all instants, from their ends
        for k in range(lags.max(), 0, -1):
            (now,) = np.nonzero(lags >= k)
            fill(now, now + k, total[now])
    return total


def filter_checked_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    stream: int,
    settings: Estimation,
    trajectories: bool = False,
) -> FilterArrays:
    """The exact filter of draws, with the arguments of the function in `particle_filter`.

    The filter has no particles. It uses only the prior and the lag of the settings, and no noise. A
    component of y that is NaN in every draw was not measured.
    """
    matrices = cached_matrices(model, draws.instants[-1], draws.start)
    kept, _ = _forward(matrices, model, draws, measurement_times, settings)
    estimate, variance = np.empty_like(draws.z), np.empty_like(draws.z)
    means, covariances, maps, gained, pulls = (np.array(each) for each in zip(*kept, strict=True))
    if settings.lag:
        last_measured = last_used(settings.lag, draws.instants)
        pull = later(maps[:, None], pulls[..., None], last_measured, both=False)
        means += (covariances[:, None] @ pull)[..., 0]
        information = later(maps, gained, last_measured, both=True)
        covariances -= covariances @ information @ covariances
    for k, quantity in enumerate(matrices.quantity_of_interest):
        h = quantity.matrix
        estimate[:, k] = quantity.offset + _times(h, means[k])
        variance[:, k] = np.maximum(np.diag(h @ covariances[k] @ h.T), 0.0)
    errors = np.sum((draws.z - estimate) ** 2, axis=2)
    mse = np.mean(weighed(errors, draws.instant_weights), axis=1)
    degenerate = np.zeros(mse.shape, np.bool_)
    found = FilterArrays(mse, degenerate, estimate, variance)
    if not trajectories:
        return found
    mean, covariance, *_ = kept[-1]
    last = np.concatenate([mean[:, :, None], np.tile(covariance, (len(mean), 1, 1))], axis=2)
    return found._replace(cloud=last)


def _forward(
    matrices: LinearGaussian,
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Iterable[int],
    settings: Estimation,
) -> tuple[list[tuple[Array, ...]], list[tuple[Array, Array]]]:
    """The moments of each instant, and each innovation with its covariance."""
    instants, points, measured = draws.instants, model.points, {*measurement_times}
    begin, covariance = _begin(matrices, settings.prior)
    mean = np.repeat(begin[None], len(draws.index), axis=0)
    kept, innovations = list[tuple[Array, ...]](), list[tuple[Array, Array]]()
    for k, t in enumerate(instants):
        through, information = _unmeasured(matrices, k, 0, covariance)
        pull = np.zeros_like(mean)
        for point, place, way in zip(points.at(t), points.at(k), model.ways, strict=True):
            if point not in measured:
                continue
            seen, measurement = _seen(draws.y[:, k, way.y], matrices.measurement[place])
            gain, observation_matrix, weight, spread, _ = _gain(covariance, measurement)
            innovation = seen - measurement.offset - _times(observation_matrix, mean)
            innovations.append((innovation, spread))
            if settings.lag:
                back = through.T @ weight
                pull += _times(back, innovation)
                information += back @ observation_matrix @ through
                through -= gain @ observation_matrix @ through
            mean = mean + _times(gain, innovation)
            covariance = covariance - gain @ observation_matrix @ covariance
        kept.append((mean, covariance, through, information, pull))
        if t < instants[-1]:
            step = matrices.transition[k]
            mean = step.offset + _times(step.matrix[:, : mean.shape[1]], mean)
            covariance = _propagated(covariance, step)
    return kept, innovations


def log_evidence(model: StateSpaceModel, y: Array) -> Array:
    """The log evidence of measurements, (R,), for R replicates (R, T+1, m) with the same gaps.

    Raises `ModelError` if the model is not linear-Gaussian.
    """
    draws = Draws(model, range(len(y)), y, y, np.empty((*y.shape[:2], 0)))
    measured = (
        point
        for t in draws.instants
        for point, way in zip(model.points.at(t), model.ways, strict=True)
        if not np.isnan(y[:, t, way.y]).all()
    )
    matrices = cached_matrices(model, y.shape[1] - 1)
    _, innovations = _forward(matrices, model, draws, measured, Estimation(1))
    return reduce(np.add, (log_density(*each) for each in innovations), np.zeros(len(y)))


def log_density(innovation: Array, covariance: Array) -> Any:
    """Log-density of normal vectors, (..., m), in the space that their covariance spans."""
    values, vectors = covariance[0], np.eye(1)  # of one component
    if len(covariance) != 1:
        values, vectors = np.linalg.eigh(covariance)
    spanned = values > _ROUNDING * max(float(values.max()), 0.0)
    values, along = values[spanned], (innovation @ vectors)[..., spanned]
    return -np.sum(np.log(2 * np.pi * values) + along**2 / values, axis=-1) / 2


def predicted_measurement(model: StateSpaceModel, state: Gaussian) -> Gaussian:
    """The normal distribution of y(t), given that of x(t).

    Raises `ModelError` if the model is not linear-Gaussian.
    """
    sensors, states = matrices_of(model, state.t, state.t).measurement, state.components
    matrix = np.concatenate([each.matrix[:, :states] for each in sensors])
    noise = np.zeros((matrix.shape[0], matrix.shape[0]))
    for way, each in zip(model.ways, sensors, strict=True):
        noise[way.y, way.y] = _square(each.matrix[:, states:])
    mean = np.concatenate([each.offset for each in sensors]) + matrix @ state.mean
    return Gaussian(state.t, mean, matrix @ state.covariance @ matrix.T + noise)


def _times(matrix: Array, vectors: Array) -> Array:
    """Multiply each vector (D, c) by a matrix, one after another.

    BLAS rounds the product of many rows otherwise than that of few, and a draw must have the same
    bits with whatever other draws it is filtered.
    """
    product: Array = (matrix @ vectors[:, :, None])[:, :, 0]
    return product


def _seen(y: Array, measurement: Affine) -> tuple[Array, Affine]:
    """The measurements y (D, m) without the components that are NaN in every draw."""
    missing = np.isnan(y).all(axis=0)
    if not missing.any():
        return y, measurement
    return y[:, ~missing], Affine(measurement.offset[~missing], measurement.matrix[~missing])


def _begin(matrices: LinearGaussian, prior: Prior | None) -> tuple[Array, Array]:
    if prior is None:
        return matrices.initial.offset, _square(matrices.initial.matrix)
    return prior.gaussian.mean, prior.gaussian.covariance


def _gain(covariance: Array, measurement: Affine) -> tuple[Array, ...]:
    """Kalman gain K, observation matrix and inverse(P) K, for one covariance P or many.

    Then the covariance of the innovation, and that of the noise.
    """
    states = covariance.shape[-1]
    observation_matrix, noise = (
        measurement.matrix[:, :states],
        _square(measurement.matrix[:, states:]),
    )
    innovation_covariance = observation_matrix @ covariance @ observation_matrix.T + noise
    # Without measurement noise this covariance may be singular: hence the pseudo-inverse.
    if innovation_covariance.shape[-1] == 1:  # pinv takes 20 times as long
        some = innovation_covariance != 0.0
        inverse = np.divide(1.0, innovation_covariance, where=some, out=np.zeros(some.shape))
    else:
        inverse = np.linalg.pinv(innovation_covariance, hermitian=True)
    weight = observation_matrix.T @ inverse
    return covariance @ weight, observation_matrix, weight, innovation_covariance, noise


def _propagated(covariance: Array, transition: Affine) -> Array:
    states = covariance.shape[-1]
    matrix, noise = transition.matrix[:, :states], transition.matrix[:, states:]
    return matrix @ covariance @ matrix.T + _square(noise)


def _square(matrix: Array) -> Array:
    return matrix @ matrix.T


filter_draws = checking(filter_checked_draws)
filter_checked_sets = partial(one_by_one, filter_checked_draws)
