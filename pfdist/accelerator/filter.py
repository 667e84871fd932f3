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

from pfdist.accelerator.formulas import CompiledFormula
from pfdist.accelerator.noise import KeyOfDraws, noise_of_particles
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

_AT_ONCE = {"cpu": 2**14}
_ON_OTHERS = 2**22
"""Particles of all draws that are filtered together."""
_OF_DRAWS = ("fails", "log_likelihoods", "estimate", "variance", "ranks", "sizes", "lines")


@dataclass(frozen=True)
class _Filter:
    """The properties of a filter for which JAX compiles it."""

    initial: CompiledFormula
    transition: CompiledFormula
    quantity: CompiledFormula
    error: CompiledFormula | None  # of the truth, if the mean error of particles is wanted
    sensors: tuple[
        tuple[CompiledFormula, int, int], ...
    ]  # log-likelihoods, and their components of y
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
        (model.initial_noise, model.process_noise), tuple(draws.model.is_angle),
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
            arrays: dict[str, NDArray[Any]] = {"draws": np.arange(begin, begin + size)}
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
            kept = found.keys() - ({} if clouds else {"cloud", "weight"})
            blocks.append({name: np.asarray(found[name], float)[here] for name in kept})
    whole: dict[str, Any] = {
        name: np.concatenate([each[name] for each in blocks]) for name in blocks[0]
    }
    for name in whole.keys() - {"cloud", "weight"}:
        whole[name] = whole[name][:, start : last + 1]
    fails = whole.pop("fails") > 0
    for name in ("ranks", "log_likelihoods"):
        whole[name] = np.moveaxis(whole[name], -1, 0)
    whole = {"cloud": np.empty((count, 0, 0))} | whole
    return plain.finished(draws, settings, fails, FilterArrays(np.empty(0), fails, **whole))


def _formula(model: StateSpaceModel, instants: range, name: str) -> CompiledFormula:
    return CompiledFormula.made(traced(model, name, instants))


@partial(jax.jit, static_argnums=0)
def _run(request: _Filter, given: dict[str, Any]) -> dict[str, Any]:
    """The results of a block, with draws first."""
    block = _Block(request, given)
    state = lax.fori_loop(given["start"], given["last"] + 1, block.instant, block.first())
    found = {name: jnp.moveaxis(state[name], -1, 0) for name in _OF_DRAWS}
    return found | {"cloud": jnp.stack(state["x"], axis=1), "weight": state["weight"]}


@dataclass
class _Block:
    """The filter of a block; its state `s` has arrays by name, instants first and draws last."""

    request: _Filter
    given: dict[str, Any]

    def _key(self, t: Any, role: Any) -> KeyOfDraws:
        return KeyOfDraws(tuple(self.given["stream"]), t, int(role), self.given["draws"])

    def _noise(self, kinds: tuple[str, ...], t: Any, role: Any) -> list[Any]:
        key, particles = self._key(t, role), self.request.particles
        return [
            noise_of_particles(kind, particles, key, number) for number, kind in enumerate(kinds)
        ]

    def first(self) -> dict[str, Any]:
        request, instants = self.request, len(self.given["measured"])
        cloud = (request.draws, request.particles)
        x, weight = self.given.get("cloud"), self.given.get("weight", jnp.ones(cloud))
        if x is None:
            w = self._noise(request.noise[0], 0, FILTER_INITIAL)
            x = request.initial(0, self.given["p"], w=w)
        q, unknown = len(request.is_angle), partial(jnp.full, fill_value=jnp.nan)
        of_z, of_draws = (instants, q, request.draws), (instants, request.draws)
        past = jnp.zeros((instants * request.has_lag, q + 1, *cloud))
        return {
            "x": [*x], "weight": weight, "weighs": jnp.zeros(request.draws, bool), "past": past,
            "fails": jnp.zeros(of_draws, bool), "estimate": unknown(of_z),
            "variance": unknown(of_z), "sizes": unknown(of_draws), "lines": unknown(of_draws),
            "ranks": unknown((instants, q, 2, request.draws)),
            "log_likelihoods": jnp.zeros((instants, 2, request.draws)),
        }  # fmt: skip

    def instant(self, t: Any, s: dict[str, Any]) -> dict[str, Any]:
        """The state after the measurements at t, from that after those at t - 1."""
        request, given, p = self.request, self.given, self.given["p"]
        here, sensors, same = given["measured"][t].any(), len(request.sensors), _same

        def moved(x: list[Any]) -> list[Any]:
            w = self._noise(request.noise[1], t - 1, FILTER_PROCESS)
            return request.transition(t - 1, p, x=x, w=w)

        s = s | {"x": lax.cond(t > given["start"], moved, same, s["x"])}
        if ALL_SCHEMES[request.resampling].holds_truth:
            s["x"] = [each.at[:, 0].set(given["x"][t, n]) for n, each in enumerate(s["x"])]
        s["weighs"] = jnp.zeros(request.draws, bool)
        for number in range(sensors):
            s = lax.cond(given["measured"][t, number], partial(self._weighed, t, number), same, s)
        weight, z = s["weight"], jnp.stack(request.quantity(t, p, x=s["x"]))
        estimates = zip(("estimate", "variance"), self._estimated(t, z, weight), strict=True)
        for name, found in estimates:
            s[name] = s[name].at[t].set(jnp.where(given["estimates"][t, t], found, s[name][t]))
        s["sizes"] = s["sizes"].at[t].set(jnp.where(s["weighs"], _sizes(weight), jnp.nan))
        if ALL_SCHEMES[request.resampling].holds_truth:
            share, true = weight / weight.sum(axis=1, keepdims=True), z[:, :, :1]
            below = jnp.stack([jnp.sum(share * each, 2) for each in (z < true, z == true)], axis=1)
            s["ranks"] = s["ranks"].at[t].set(jnp.where(here, below, jnp.nan))
        if request.has_lag:
            each = jnp.broadcast_to(jnp.arange(request.particles, dtype=float), weight.shape)
            s["past"] = s["past"].at[t].set(jnp.stack([*z, each]))
            s = lax.cond(here, partial(self._smoothed, t), same, s)
        after: dict[str, Any] = lax.cond(
            here, partial(self._resampled, (t + 1) * sensors - 1), same, s
        )
        return after

    def _weighed(self, t: Any, number: int, s: dict[str, Any]) -> dict[str, Any]:
        """Weigh the particles with the measurement of a sensor."""
        if number:
            s = self._resampled(t * len(self.request.sensors) + number - 1, s)
        formula, begin, end = self.request.sensors[number]
        y = self.given["y"][t, begin:end, :, None]
        (value,) = formula(t, self.given["p"], y=y, x=s["x"])
        value = value + jnp.log(s["weight"])
        highest = jnp.max(jnp.where(jnp.isfinite(value), value, -jnp.inf), axis=1, keepdims=True)
        new = jnp.where(jnp.isfinite(value), jnp.exp(value - highest), 0.0)
        weighs = jnp.isfinite(highest[:, 0])
        evidence = highest[:, 0] + jnp.log(new.mean(axis=1))
        explained = jnp.sum(new * jnp.where(new > 0, value, 0.0), axis=1) / new.sum(axis=1)
        nothing = jnp.array([[-jnp.inf], [0.0]])
        added = jnp.where(weighs, jnp.stack([evidence, explained]), nothing)
        return s | {
            "weight": jnp.where(weighs[:, None], new, s["weight"]), "weighs": weighs,
            "fails": s["fails"].at[t].set(s["fails"][t] | ~weighs),
            "log_likelihoods": s["log_likelihoods"].at[t].add(added),
        }  # fmt: skip

    def _resampled(self, key: Any, s: dict[str, Any]) -> dict[str, Any]:
        """Resample the draws that a measurement has weighed, if their weights are uneven."""
        weight, particles = s["weight"], self.request.particles
        uneven = s["weighs"] & (_sizes(weight) < self.request.threshold * particles)
        uneven = (uneven & (weight.sum(axis=1) < particles))[:, None]
        found = _ancestors(self.request.resampling, weight, self._key(key, RESAMPLING))
        found = jnp.where(uneven, found, jnp.arange(particles))

        def of_ancestors(values: Any) -> Any:
            at = jnp.broadcast_to(found, values.shape)
            return jnp.take_along_axis(values, at, axis=-1)

        states, weight = (
            jax.tree.map(of_ancestors, (s["x"], s["past"])),
            jnp.where(uneven, 1.0, weight),
        )
        return s | {"x": states[0], "past": states[1], "weight": weight}

    def _estimated(self, t: Any, z: Any, weight: Any) -> tuple[Any, Any]:
        """Mean and variance of the particles' z, (q, D) each."""
        share = weight / weight.sum(axis=1, keepdims=True)
        counted, are_angles = jnp.where(weight > 0, z, 0.0), self.request.is_angle
        found = [_moments(*each, share) for each in zip(counted, are_angles, strict=True)]
        mean, variance = (jnp.stack(each) for each in zip(*found, strict=True))
        if self.request.error is not None:
            p = self.given["of_truth"]
            (error,) = self.request.error(t, p, z=z, estimate=mean[..., None])
            of_mean = jnp.sum(share * jnp.where(share > 0, error, 0.0), axis=1)
            variance = jnp.zeros_like(variance).at[0].set(of_mean)
        return mean, variance

    def _smoothed(self, t: Any, s: dict[str, Any]) -> dict[str, Any]:
        """Estimate earlier instants by the lines of the particles."""
        weight, now = s["weight"], self.given["estimates"][t][:, None]
        instants, rows = jnp.arange(len(now)), jnp.arange(len(weight))[:, None]
        each = jax.vmap(self._estimated, (0, 0, None))
        mean, variance = each(instants, s["past"][:, :-1], weight)
        empty = jnp.zeros(weight.shape, bool)
        lines = jax.vmap(lambda at: empty.at[rows, at].max(weight > 0).sum(axis=1))
        found = {"estimate": mean, "variance": variance}
        found |= {"lines": lines(jnp.int32(s["past"][:, -1]))}
        masks = {"estimate": now[..., None], "variance": now[..., None], "lines": now}
        return s | {name: jnp.where(masks[name], found[name], s[name]) for name in found}


def _same(state: Any) -> Any:
    return state


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


def _ancestors(scheme: str, weight: Any, key: KeyOfDraws) -> Any:
    """Ancestors of each draw's particles, (D, P); see `pfdist.kernels.ancestors`."""
    kept = int(ALL_SCHEMES[scheme].holds_truth)
    count, most = weight.shape[1] - kept, weight.shape[1] - 1
    cumulative = jnp.cumsum(weight, axis=1)
    cumulative = cumulative / cumulative[:, -1:]
    if scheme == SYSTEMATIC.name:
        ends = jnp.ceil(cumulative * count - noise_of_particles("uniform", 1, key, 0)).astype(
            jnp.int32
        )
        rows = jnp.arange(len(weight))[:, None]
        below = jnp.zeros(weight.shape, jnp.int32).at[rows, ends].add(1, mode="drop")
        return jnp.minimum(jnp.cumsum(below, axis=1), most)
    if scheme == STRATIFIED.name:
        points = (jnp.arange(count) + noise_of_particles("uniform", count, key, 0)) / count
    else:
        sums = jnp.cumsum(noise_of_particles("exponential", count + 1, key, 0), axis=1)
        points = sums[:, :-1] / sums[:, -1:]
    found = jax.vmap(partial(jnp.searchsorted, side="right"))(cumulative, points)
    return jnp.minimum(jnp.pad(found, ((0, 0), (kept, 0))), most)


filter_draws: Callable[..., FilterArrays] = checking(filter_checked_draws)
filter_checked_sets = partial(one_by_one, partial(filter_checked_draws, clouds=False))
