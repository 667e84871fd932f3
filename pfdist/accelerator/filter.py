"""The intermittent particle filter with `jax.numpy`: many draws and particles at once.

It computes what `pfdist.filters.plain` computes, with the same noise, in float64 on a processor,
and in float32 on other devices. A block always has the same number of draws, and a draw always the
same place in its block, so the bits of a draw do not depend on the draws beside it. Instants are
counted from 0, also with a prior, so JAX compiles once for all starts and ends.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.accelerator.formulas import Formula
from pfdist.accelerator.noise import Key, variates
from pfdist.common.measurement_times import Times
from pfdist.errors import PfdistError
from pfdist.filters import plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws
from pfdist.filters.interface import checking, one_by_one
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.schemes import ALL_SCHEMES, STRATIFIED, SYSTEMATIC
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, RESAMPLING
from pfdist.models import StateSpaceModel
from pfdist.models.programs import Programs
from pfdist.models.twin import traced

try:
    import jax
    import jax.numpy as jnp
    from jax import lax
except ModuleNotFoundError as error:
    raise PfdistError(
        f"filter.engine = 'jax' needs pip install 'pfdist[jax]', got {error}"
    ) from error

_AT_ONCE = {"cpu": 2**13}
_ON_OTHERS = 2**22
"""Particles of all draws that are filtered together."""
_CLOUDS, _OF_Z = ("cloud", "weight"), ("mean", "variance", "ranks")


@dataclass(frozen=True)
class _Filter:
    """What JAX compiles a filter for."""

    initial: Formula
    transition: Formula
    quantity: Formula
    error: Formula | None  # of the truth, if the mean error of particles is wanted
    sensors: tuple[tuple[Formula, int, int], ...]  # log-likelihoods, and their components of y
    noise: tuple[tuple[str, ...], tuple[str, ...]]
    is_angle: tuple[bool, ...]
    draws: int
    particles: int
    resampling: str
    threshold: float
    has_prior: bool
    has_lag: bool


def filter_checked_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    stream: int,
    settings: Estimation,
    trajectories: bool = False,
    *,
    clouds: bool = True,
) -> FilterArrays:
    """The results of `pfdist.filters.particle_filter.filter_checked_draws`."""
    known = model.formulas["quantity_of_interest"]
    last, start, count = draws.instants[-1], draws.start, len(draws.index)
    instants = known.traced.instants if isinstance(known, Programs) else range(last + 1)
    made, prior, particles = partial(_formula, model, instants), settings.prior, settings.particles
    by_error, device = ESTIMATORS[settings.estimator].by_error, jax.default_backend()
    most = _AT_ONCE.get(device, _ON_OTHERS) // particles
    has_lag, sensors = bool(np.max(settings.lag)), len(model.parts)
    size = max(1, most // len(instants) if has_lag else most)
    request = _Filter(
        made("initial"), made("transition"), made("quantity_of_interest"),
        _formula(draws.model, instants, "error") if by_error else None,
        tuple(
            (_formula(part.model, instants, "log_likelihood"), part.y.start, part.y.stop)
            for part in model.parts
        ),
        (tuple(model.initial_noise), tuple(model.process_noise)), tuple(draws.model.is_angle),
        size, particles, settings.resampling, settings.threshold, prior is not None, has_lag,
    )  # fmt: skip
    measured = np.zeros((len(instants), sensors), np.bool_)
    measured.reshape(-1)[[*measurement_times]] = True
    estimates = np.zeros((len(instants),) * 2, np.bool_)
    for k, at in enumerate(plain.estimated(model, draws.instants, measurement_times, settings.lag)):
        estimates[start + k, [start + each for each in at]] = True
    same = {
        "stream": np.array([stream & 0xFFFFFFFF, stream >> 32], np.uint32), "start": start,
        "last": last, "measured": measured, "estimates": estimates, "p": model.p._asdict(),
        "of_truth": draws.model.p._asdict(),
    }  # fmt: skip
    blocks = list[dict[str, NDArray[Any]]]()
    with jax.enable_x64(device == "cpu"):
        for begin in range(draws.index.start // size * size, draws.index.stop, size):
            own = draws[max(0, begin - draws.index.start) : begin + size - draws.index.start]
            here = slice(own.index.start - begin, own.index.stop - begin)
            arrays = {"draws": np.arange(begin, begin + size)}
            for name in ("x", "y") if own.x.size else ("y",):
                values = getattr(own, name)
                arrays[name] = np.zeros((len(instants), values.shape[2], size))
                arrays[name][start : last + 1, :, here] = values.transpose(1, 2, 0)
            if isinstance(prior, Cloud):
                cloud, weight = plain.first(model, own, stream, settings)
                arrays["cloud"] = np.zeros((len(cloud), size, particles))
                arrays["weight"] = np.ones((size, particles))
                arrays["cloud"][:, here], arrays["weight"][here] = cloud, weight
            found = _run(request, same | arrays)
            kept = {name: each for name, each in found.items() if clouds or name not in _CLOUDS}
            blocks.append({name: np.asarray(each)[..., here] for name, each in kept.items()})
    whole = {name: np.concatenate([each[name] for each in blocks], -1) for name in blocks[0]}
    at, nothing = slice(start, last + 1), np.empty((count, 0, 0))
    mean, variance, ranks = (whole[n][..., at, :, :].astype(float) for n in _OF_Z)
    results = FilterArrays(
        np.empty(0), np.zeros(count, np.bool_),
        estimate=mean.transpose(2, 0, 1), variance=variance.transpose(2, 0, 1),
        sizes=whole["sizes"][at].T.astype(float), ranks=ranks.transpose(0, 3, 1, 2),
        cloud=whole["cloud"].transpose(2, 0, 1).astype(float) if clouds else nothing,
        weight=whole["weight"].T.astype(float) if clouds else nothing[0],
        lines=whole["lines"][at].T.astype(float),
        log_likelihoods=whole["log_likelihoods"][at].transpose(1, 2, 0).astype(float),
    )  # fmt: skip
    return plain.finished(draws, settings, whole["fails"][at].T, results)


def _formula(model: StateSpaceModel, instants: range, name: str) -> Formula:
    return Formula.made(traced(model, name, instants))


@partial(jax.jit, static_argnums=0)
def _run(request: _Filter, given: dict[str, Any]) -> dict[str, Any]:
    """The results of a block, with instants first and draws last."""
    count, particles, quantities = request.draws, request.particles, len(request.is_angle)
    scheme, p, measured = ALL_SCHEMES[request.resampling], given["p"], given["measured"]
    instants, has_lag = len(measured), request.has_lag
    key = partial(Key, tuple(given["stream"]), draws=given["draws"])

    def noise(kinds: tuple[str, ...], t: Any, role: Any) -> list[Any]:
        at = key(t=t, role=role)
        return [variates(kind, particles, at, number) for number, kind in enumerate(kinds)]

    def estimated(t: Any, z: Any, weight: Any) -> tuple[Any, Any]:
        """Mean and variance of the particles' z, (q, D) each."""
        share = weight / weight.sum(axis=1, keepdims=True)
        counted = [jnp.where(weight > 0, each, 0.0) for each in z]
        found = [_moments(*each, share) for each in zip(counted, request.is_angle, strict=True)]
        mean, variance = (jnp.stack(each) for each in zip(*found, strict=True))
        if request.error is not None:
            (error,) = request.error(t, given["of_truth"], z=z, estimate=mean[..., None])
            of_mean = jnp.sum(share * jnp.where(share > 0, error, 0.0), axis=1)
            variance = jnp.zeros_like(variance).at[0].set(of_mean)
        return mean, variance

    def resampled(at: Any, t: Any, s: dict[str, Any]) -> dict[str, Any]:
        """Resample the draws that a measurement has weighed, if their weights are uneven."""
        weight = s["weight"]
        uneven = s["weighs"] & (_sizes(weight) < request.threshold * particles)
        uneven = (uneven & (weight.sum(axis=1) < particles))[:, None]
        found = _ancestors(request.resampling, weight, key(t=at, role=RESAMPLING))
        found = jnp.where(uneven, found, jnp.arange(particles))

        def of_ancestors(values: Any) -> Any:
            return jnp.take_along_axis(values, jnp.broadcast_to(found, values.shape), axis=-1)

        past = of_ancestors(s["past"])
        weight = jnp.where(uneven, 1.0, weight)
        return s | {"x": [*map(of_ancestors, s["x"])], "past": past, "weight": weight}

    def weighed(number: int, t: Any, s: dict[str, Any]) -> dict[str, Any]:
        """Weigh the particles with the measurement of a sensor."""
        point = t * len(request.sensors) + number
        if number:
            s = resampled(point - 1, t, s)
        formula, begin, end = request.sensors[number]
        (value,) = formula(t, p, y=given["y"][t, begin:end, :, None], x=s["x"])
        value = value + jnp.log(s["weight"])
        highest = jnp.max(jnp.where(jnp.isfinite(value), value, -jnp.inf), axis=1, keepdims=True)
        new = jnp.where(jnp.isfinite(value), jnp.exp(value - highest), 0.0)
        weighs = jnp.isfinite(highest[:, 0])
        evidence = highest[:, 0] + jnp.log(new.mean(axis=1))
        explained = jnp.sum(new * jnp.where(new > 0, value, 0.0), axis=1) / new.sum(axis=1)
        added = jnp.where(weighs, jnp.stack([evidence, explained]), jnp.array([[-jnp.inf], [0.0]]))
        return s | {
            "weight": jnp.where(weighs[:, None], new, s["weight"]), "weighs": weighs,
            "fails": s["fails"].at[t].set(s["fails"][t] | ~weighs),
            "log_likelihoods": s["log_likelihoods"].at[t].add(added),
        }  # fmt: skip

    def smoothed(t: Any, s: dict[str, Any]) -> dict[str, Any]:
        """Estimates of earlier instants by the lines of the particles."""
        weight, now = s["weight"], given["estimates"][t][:, None, None]
        each = jax.vmap(estimated, (0, 0, None))
        mean, variance = each(jnp.arange(instants), s["past"][:, :-1], weight)
        through, rows = jnp.int32(s["past"][:, -1]), jnp.arange(count)[:, None]
        hit = jax.vmap(lambda at: jnp.zeros(weight.shape, bool).at[rows, at].max(weight > 0))(
            through
        )
        return s | {
            "mean": jnp.where(now, mean, s["mean"]), "variance": jnp.where(now, variance, s["variance"]),
            "lines": jnp.where(now[..., 0], hit.sum(axis=2), s["lines"]),
        }  # fmt: skip

    def instant(t: Any, s: dict[str, Any]) -> dict[str, Any]:
        def moved(x: list[Any]) -> list[Any]:
            return request.transition(
                t - 1, p, x=x, w=noise(request.noise[1], t - 1, FILTER_PROCESS)
            )

        s = s | {"x": lax.cond(t > given["start"], moved, lambda x: x, s["x"])}
        if scheme.holds_truth:
            s["x"] = [each.at[:, 0].set(given["x"][t, n]) for n, each in enumerate(s["x"])]
        s["weighs"] = jnp.zeros(count, bool)
        for number in range(len(request.sensors)):
            s = lax.cond(measured[t, number], partial(weighed, number, t), lambda s: s, s)
        here, weight, z = measured[t].any(), s["weight"], request.quantity(t, p, x=s["x"])
        mean, variance = estimated(t, jnp.stack(z), weight)
        own = given["estimates"][t, t]
        for name, found in (("mean", mean), ("variance", variance)):
            s[name] = s[name].at[t].set(jnp.where(own, found, s[name][t]))
        s["sizes"] = s["sizes"].at[t].set(jnp.where(s["weighs"], _sizes(weight), jnp.nan))
        if scheme.holds_truth:
            below = jnp.stack([_shares_below(each, weight) for each in z], axis=1)
            s["ranks"] = s["ranks"].at[:, t].set(jnp.where(here, below, jnp.nan))
        if has_lag:
            each = jnp.broadcast_to(jnp.arange(particles, dtype=float), weight.shape)
            s["past"] = s["past"].at[t].set(jnp.stack([*z, each]))
            s = lax.cond(here, partial(smoothed, t), lambda s: s, s)
        point = (t + 1) * len(request.sensors) - 1
        return lax.cond(here, partial(resampled, point, t), lambda s: s, s)

    x, weight = given.get("cloud"), given.get("weight", jnp.ones((count, particles)))
    if x is None:
        x = request.initial(0, p, w=noise(request.noise[0], 0, FILTER_INITIAL))
    of_z, of_draws = (instants, quantities, count), (instants, count)
    state = {
        "x": [*x], "weight": weight, "weighs": jnp.zeros(count, bool),
        "past": jnp.zeros((instants * has_lag, quantities + 1, count, particles)),
        "fails": jnp.zeros(of_draws, bool), "log_likelihoods": jnp.zeros((instants, 2, count)),
        "mean": jnp.full(of_z, jnp.nan), "variance": jnp.full(of_z, jnp.nan),
        "ranks": jnp.full((2, *of_z), jnp.nan), "sizes": jnp.full(of_draws, jnp.nan),
        "lines": jnp.full(of_draws, jnp.nan),
    }  # fmt: skip
    state = lax.fori_loop(given["start"], given["last"] + 1, instant, state)
    cloud = jnp.stack(state.pop("x")).swapaxes(1, 2)
    del state["past"], state["weighs"]
    return state | {"cloud": cloud, "weight": state["weight"].T}


def _sizes(weight: Any) -> Any:
    return weight.sum(axis=1) ** 2 / jnp.sum(weight**2, axis=1)


def _moments(values: Any, is_angle: bool, share: Any) -> tuple[Any, Any]:
    """Mean and variance of weighted particles, (D,); for an angle its direction, and 1 - R."""
    if is_angle:
        sine, cosine = (jnp.sum(share * part(values), axis=1) for part in (jnp.sin, jnp.cos))
        mean = jnp.arctan2(sine, cosine)
        return mean, jnp.sum(share * (1.0 - jnp.cos(values - mean[:, None])), axis=1)
    mean = jnp.sum(share * values, axis=1)
    return mean, jnp.sum(share * (values - mean[:, None]) ** 2, axis=1)


def _shares_below(z: Any, weight: Any) -> Any:
    share = weight / weight.sum(axis=1, keepdims=True)
    return jnp.sum(share * jnp.stack([z < z[:, :1], z == z[:, :1]]), axis=2)


def _ancestors(scheme: str, weight: Any, key: Key) -> Any:
    """Ancestors of each draw's particles, (D, P); see `pfdist.kernels.ancestors`."""
    kept = int(ALL_SCHEMES[scheme].holds_truth)
    count, most = weight.shape[1] - kept, weight.shape[1] - 1
    cumulative = jnp.cumsum(weight, axis=1)
    cumulative = cumulative / cumulative[:, -1:]
    if scheme == SYSTEMATIC.name:
        ends = jnp.ceil(cumulative * count - variates("uniform", 1, key, 0)).astype(jnp.int32)
        rows = jnp.arange(len(weight))[:, None]
        below = jnp.zeros(weight.shape, jnp.int32).at[rows, ends].add(1, mode="drop")
        return jnp.minimum(jnp.cumsum(below, axis=1), most)
    if scheme == STRATIFIED.name:
        points = (jnp.arange(count) + variates("uniform", count, key, 0)) / count
    else:
        sums = jnp.cumsum(variates("exponential", count + 1, key, 0), axis=1)
        points = sums[:, :-1] / sums[:, -1:]
    found = jax.vmap(partial(jnp.searchsorted, side="right"))(cumulative, points)
    return jnp.minimum(jnp.pad(found, ((0, 0), (kept, 0))), most)


filter_draws: Callable[..., FilterArrays] = checking(filter_checked_draws)
filter_checked_sets = partial(one_by_one, partial(filter_checked_draws, clouds=False))
