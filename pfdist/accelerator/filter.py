"""The intermittent particle filter with `jax.numpy`: many draws and particles at once.

It computes what `pfdist.filters.plain` computes, with noise by JAX, in float64 on a processor and
in float32 on other devices. The compiled engine computes filters that contain the truth, and log
evidences: only comparisons and bounds need them.

A block always has the same number of draws, and a draw always the same place in its block, so the
bits of a draw do not depend on the draws beside it. Instants are counted from 0, also with a prior,
and without a lag their number is a power of 2: so JAX compiles once for many starts and ends.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.accelerator.formulas import CompiledFormula
from pfdist.common.measurement_times import Times
from pfdist.errors import PfdistError
from pfdist.filters import particle_filter, plain
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

State = dict[str, Any]


@dataclass(frozen=True)
class _Filter:
    """The properties of a filter for which JAX compiles it."""

    initial: CompiledFormula
    transition: CompiledFormula
    quantity: CompiledFormula
    sensors: tuple[tuple[CompiledFormula, int, int], ...]  # with first and end of y's components
    noise: tuple[tuple[str, ...], tuple[str, ...]]
    is_angle: tuple[bool, ...]
    particles: int
    resampling: str
    threshold: float
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
    if not _computes(settings):
        return particle_filter.filter_checked_draws(
            model, draws, measurement_times, stream, settings, trajectories
        )
    start, last, device = draws.start, draws.instants[-1], jax.default_backend()
    request, filtered = _request(model, draws, settings), slice(start, last + 1)
    instants = last + 1 if request.has_lag else 1 << last.bit_length()
    size = _AT_ONCE.get(device, _ON_OTHERS) // settings.particles
    size = max(1, size // instants if request.has_lag else size)
    measured = np.zeros((instants, len(model.parts)), np.bool_)
    measured.reshape(-1)[[*measurement_times]] = True
    estimated = plain.estimated(model, draws.instants, measurement_times, settings.lag)
    ranges = np.zeros((instants, 2), int)
    ranges[filtered] = [(start + each.start, start + each.stop) for each in estimated]
    same = {
        "stream": np.array([stream >> 32, stream & 0xFFFFFFFF], np.uint32),
        "start": start,
        "last": last,
        "measured": measured,
        "estimated": ranges,
        "p": model.p._asdict(),
    }
    blocks = list[dict[str, NDArray[Any]]]()
    with jax.enable_x64(device == "cpu"):
        for begin in range(draws.index.start // size * size, draws.index.stop, size):
            own = draws[max(0, begin - draws.index.start) : begin + size - draws.index.start]
            here = slice(own.index.start - begin, own.index.stop - begin)
            y = np.zeros((instants, own.y.shape[2], size))
            y[filtered, :, here] = own.y.transpose(1, 2, 0)
            given = same | {"draws": np.arange(begin, begin + size), "y": y}
            if isinstance(settings.prior, Cloud):
                x, weight = plain.first(model, own, stream, settings)
                given["x"] = np.zeros((len(x), size, settings.particles))
                given["weight"] = np.ones(given["x"].shape[1:])
                given["x"][:, here], given["weight"][here] = x, weight
            found = _run(request, given)
            kept = found.keys() - ({} if clouds else {"cloud", "weight"})
            blocks.append({name: np.asarray(found[name], float)[here] for name in kept})
    whole: dict[str, Any] = {
        name: np.concatenate([each[name] for each in blocks]) for name in blocks[0]
    }
    for name in whole.keys() - {"cloud", "weight"}:
        whole[name] = whole[name][:, filtered]
    fails = whole.pop("fails") > 0
    whole = {"cloud": np.empty((len(fails), 0, 0))} | whole
    return plain.finished(draws, settings, fails, FilterArrays(np.empty(0), fails, **whole))


def _filter_sets(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
    errors: str = "",
) -> FilterArrays:
    """The results of `pfdist.filters.particle_filter.filter_checked_sets`."""
    filtered: Callable[..., FilterArrays] = particle_filter.filter_checked_sets
    if _computes(settings):
        filtered = partial(one_by_one, partial(filter_checked_draws, clouds=False))
    return filtered(model, draws, sets, ends, stream, settings, errors)


filter_draws = checking(filter_checked_draws)
filter_checked_sets = _filter_sets


def _computes(settings: Estimation) -> bool:
    has_evidence = ESTIMATORS[settings.estimator].weights.evidence != 0.0
    return not (ALL_SCHEMES[settings.resampling].holds_truth or has_evidence)


def _request(model: StateSpaceModel, draws: Draws, settings: Estimation) -> _Filter:
    def made(owner: StateSpaceModel, name: str) -> CompiledFormula:
        formula, instants = owner.formulas[name], range(draws.instants[-1] + 1)
        known = formula.traced if isinstance(formula, Programs) else traced(owner, name, instants)
        return CompiledFormula(known, known.hash)

    return _Filter(
        made(model, "initial"),
        made(model, "transition"),
        made(model, "quantity_of_interest"),
        tuple(
            (made(each.model, "log_likelihood"), each.y.start, each.y.stop) for each in model.parts
        ),
        (model.initial_noise, model.process_noise),
        tuple(draws.model.is_angle),
        settings.particles,
        settings.resampling,
        settings.threshold,
        bool(np.max(settings.lag)),
    )


@partial(jax.jit, static_argnums=0)
def _run(request: _Filter, given: State) -> State:
    """The results of a block, with draws first."""
    block = _Block(request, given)
    cloud, found = lax.fori_loop(given["start"], given["last"] + 1, block.instant, block.first())
    found = {name: jnp.moveaxis(each, -1, 0) for name, each in found.items()}
    return found | {"cloud": jnp.stack(cloud["x"], axis=1), "weight": cloud["weight"]}


@dataclass
class _Block:
    """The filter of a block: its state is the cloud, (D, P), and what was found, instants first."""

    request: _Filter
    given: State

    def _noise(self, kind: str, count: int, *key: Any) -> Any:
        """Variates of a kind for each draw, (D, count)."""
        root = jax.random.wrap_key_data(self.given["stream"], impl="threefry2x32")
        for part in key:
            root = jax.random.fold_in(root, part)
        keys = jax.vmap(jax.random.fold_in, (None, 0))(root, self.given["draws"])
        return jax.vmap(partial(_variates, kind, count))(keys)

    def _noise_of(self, process: int, *key: Any) -> list[Any]:
        kinds, particles = self.request.noise[process], self.request.particles
        return [self._noise(kind, particles, *key, number) for number, kind in enumerate(kinds)]

    def first(self) -> tuple[State, State]:
        """The state before the first instant."""
        request, given, (instants, _) = self.request, self.given, self.given["measured"].shape
        size = given["draws"].size, request.particles
        x = given.get("x")
        if x is None:
            w = self._noise_of(0, 0, int(FILTER_INITIAL))
            x = request.initial(0, given["p"], w=w)
        cloud = {"x": [*x], "weight": given.get("weight", jnp.ones(size))}
        q, none = len(request.is_angle), jnp.zeros(size[0], bool)
        if request.has_lag:  # z along the lines of the particles, and the particles on them
            cloud["past"] = jnp.zeros((instants, q + 1, *size))
        unknown = jnp.full((instants, q, size[0]), jnp.nan)
        found = {"estimate": unknown, "variance": unknown}
        found |= {"sizes": unknown[:, 0], "lines": unknown[:, 0]}
        found |= {"fails": jnp.zeros((instants, size[0]), bool)}
        return cloud | {"weighs": none, "fails": none}, found

    def instant(self, t: Any, state: tuple[State, State]) -> tuple[State, State]:
        """The state after the measurements at t, from that after those at t - 1."""
        request, given, (cloud, found) = self.request, self.given, state
        measured, sensors, none = (
            given["measured"][t],
            len(request.sensors),
            jnp.zeros_like(cloud["fails"]),
        )
        x = lax.cond(t > given["start"], partial(self._moved, t - 1), _same, cloud["x"])
        cloud = cloud | {"x": x, "weighs": none, "fails": none}
        for number in range(sensors):
            cloud = lax.cond(measured[number], partial(self._weighed, t, number), _same, cloud)
        z, weight = request.quantity(t, given["p"], x=cloud["x"]), cloud["weight"]
        now = dict(zip(("estimate", "variance"), self._estimated(z, weight), strict=True))
        now["fails"], now["lines"] = cloud["fails"], found["lines"][t]
        now["sizes"] = jnp.where(cloud["weighs"], _sizes(weight), jnp.nan)
        found = {name: each.at[t].set(now[name]) for name, each in found.items()}
        if request.has_lag:
            particle = jnp.broadcast_to(jnp.arange(request.particles, dtype=float), weight.shape)
            cloud["past"] = cloud["past"].at[t].set(jnp.stack([*z, particle]))
            smoothed = partial(self._smoothed, t, cloud["past"], weight)
            found = lax.cond(measured.any(), smoothed, _same, found)
        resampled = partial(self._resampled, (t + 1) * sensors - 1)
        return lax.cond(measured.any(), resampled, _same, cloud), found

    def _moved(self, t: Any, x: list[Any]) -> list[Any]:
        w = self._noise_of(1, t, int(FILTER_PROCESS))
        return self.request.transition(t, self.given["p"], x=x, w=w)

    def _weighed(self, t: Any, number: int, cloud: State) -> State:
        """Weigh the particles with the measurement of a sensor."""
        request = self.request
        if number:
            cloud = self._resampled(t * len(request.sensors) + number - 1, cloud)
        log_likelihood, begin, end = request.sensors[number]
        y = self.given["y"][t, begin:end, :, None]
        (value,) = log_likelihood(t, self.given["p"], y=y, x=cloud["x"])
        if request.threshold < np.inf:  # else weights are resampled before they are carried
            value = value + jnp.log(cloud["weight"])
        value = jnp.where(jnp.isfinite(value), value, -jnp.inf)
        highest = jnp.max(value, axis=1, keepdims=True)
        weighs = jnp.isfinite(highest)
        new = jnp.exp(jnp.float32(value - highest)).astype(float)
        weight = jnp.where(weighs, new, cloud["weight"])
        weighs = weighs[:, 0]
        return cloud | {"weight": weight, "weighs": weighs, "fails": cloud["fails"] | ~weighs}

    def _resampled(self, key: Any, cloud: State) -> State:
        """Resample the draws that a measurement has weighed, if their weights are uneven."""
        weight, particles = cloud["weight"], self.request.particles
        uneven = cloud["weighs"] & (_sizes(weight) < self.request.threshold * particles)
        uneven = (uneven & (weight.sum(axis=1) < particles))[:, None]
        found = jnp.where(uneven, self._ancestors(weight, key), jnp.arange(particles))

        def taken(values: Any) -> Any:
            at = jnp.broadcast_to(found, values.shape)
            return jnp.take_along_axis(values, at, axis=-1, mode="promise_in_bounds")

        moved = {name: jax.tree.map(taken, cloud[name]) for name in cloud.keys() & {"x", "past"}}
        return cloud | moved | {"weight": jnp.where(uneven, 1.0, weight)}

    def _ancestors(self, weight: Any, key: Any) -> Any:
        """Ancestors of each draw's particles, (D, P); see `pfdist.kernels.ancestors`."""
        count, scheme = self.request.particles, self.request.resampling
        role, cumulative = int(RESAMPLING), jnp.cumsum(weight, axis=1)
        cumulative = cumulative / cumulative[:, -1:]
        if scheme == SYSTEMATIC.name:
            ends = jnp.ceil(cumulative * count - self._noise("uniform", 1, key, role))
            rows = jnp.arange(len(weight))[:, None]
            below = jnp.zeros(weight.shape, jnp.int32)
            below = below.at[rows, jnp.int32(ends)].add(1, mode="drop")
            return jnp.minimum(jnp.cumsum(below, axis=1), count - 1)
        if scheme == STRATIFIED.name:
            points = (jnp.arange(count) + self._noise("uniform", count, key, role)) / count
        else:
            sums = jnp.cumsum(self._noise("exponential", count + 1, key, role), axis=1)
            points = sums[:, :-1] / sums[:, -1:]
        found = jax.vmap(partial(jnp.searchsorted, side="right"))(cumulative, points)
        return jnp.minimum(found, count - 1)

    def _estimated(self, z: Sequence[Any], weight: Any) -> list[Any]:
        """Mean and variance of the particles' z, (q, D) each."""
        share = weight / weight.sum(axis=1, keepdims=True)
        counted = [jnp.where(weight > 0, each, 0.0) for each in z]
        moments = map(partial(_moments, share), counted, self.request.is_angle)
        return [jnp.stack(each) for each in zip(*moments, strict=True)]

    def _smoothed(self, t: Any, past: Any, weight: Any, found: State) -> State:
        """Estimate earlier instants by the lines of the particles."""
        (first, end), instants = self.given["estimated"][t], jnp.arange(len(past))
        now, rows = (instants >= first) & (instants < end), jnp.arange(len(weight))[:, None]

        def estimated(lines: Any) -> dict[str, Any]:
            mean, variance = self._estimated(lines[:-1], weight)
            passed = jnp.zeros(weight.shape, bool).at[rows, jnp.int32(lines[-1])].max(weight > 0)
            return {"estimate": mean, "variance": variance, "lines": passed.sum(axis=1)}

        each = jax.vmap(estimated)(past)
        masks = {name: now.reshape(-1, *[1] * (each[name].ndim - 1)) for name in each}
        return found | {name: jnp.where(masks[name], each[name], found[name]) for name in each}


def _same(state: Any) -> Any:
    return state


def _variates(kind: str, count: int, key: Any) -> Any:
    if kind == "normal":
        return jax.random.normal(key, (count,), jnp.float32)
    # a model may take the logarithm of the distance from 0 of "centred" noise
    uniform = jax.random.uniform(key, (count,), float if kind == "centred" else jnp.float32)
    uniform += jnp.finfo(uniform.dtype).eps / 2  # neither 0 nor 1
    return {"uniform": uniform, "centred": uniform - 0.5, "exponential": -jnp.log(uniform)}[kind]


def _sizes(weight: Any) -> Any:
    return weight.sum(axis=1) ** 2 / jnp.sum(weight**2, axis=1)


def _moments(share: Any, values: Any, is_angle: bool) -> tuple[Any, Any]:
    """Mean and variance of each draw; of an angle, see `pfdist.filters.interface`."""
    if is_angle:
        sine, cosine = (jnp.sum(share * part(values), axis=1) for part in (jnp.sin, jnp.cos))
        mean = jnp.arctan2(sine, cosine)
        return mean, jnp.sum(share * (1.0 - jnp.cos(values - mean[:, None])), axis=1)
    mean = jnp.sum(share * values, axis=1)
    return mean, jnp.sum(share * (values - mean[:, None]) ** 2, axis=1)
