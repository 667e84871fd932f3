"""The intermittent particle filter with `jax.numpy`: many sets, draws and particles at once.

It computes what `pfdist.filters.plain` computes, with noise by JAX, in float64 on a processor and
in float32 on other devices. The compiled engine computes what few jobs need, see `_computes`.

A row is a draw with a set. A block always has as many rows, so JAX compiles it once, and the bits
of a row do not depend on its place or on other rows. Without a lag, the number of instants is a
power of 2, so that a block fits many starts and ends.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from pfdist.common.measurement_times import Lag, Times
from pfdist.filters import particle_filter, plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws
from pfdist.filters.interface import SUMS, all_or_none, checking, errors_of_filters, weighed
from pfdist.filters.work import Estimation, filter_streams, sum_of_draws
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.follows import ROUNDING, StepLimits
from pfdist.kernels.rules import Applied
from pfdist.kernels.schemes import ALL_SCHEMES, STRATIFIED, SYSTEMATIC
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, RESAMPLING
from pfdist.models import StateSpaceModel
from pfdist.models.base import squared_error
from pfdist.models.programs import Programs
from pfdist.models.twin import traced
from pfdist.plugins.accelerator.with_jax.formulas import CompiledFormula

_ON_CPU, _ON_OTHERS = 2**13, 2**22
"""Particles of all rows that are filtered together."""
_KEPT = 2**27
"""Numbers of all instants that are kept: one of each particle with a lag, else some of a row."""

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
    settings: Estimation  # without prior and rule; any lag is 1
    holds_truth: bool


def filter_checked_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    stream: int,
    settings: Estimation,
    trajectories: bool = False,
) -> FilterArrays:
    """The results of `pfdist.filters.particle_filter.filter_checked_draws`."""
    if not _computes(draws, settings, trajectories):
        return particle_filter.filter_checked_draws(
            model, draws, measurement_times, stream, settings, trajectories
        )
    only, end = [measurement_times], [draws.instants[-1]]
    names = ("estimate", "variance", "sizes", "lines", "cloud", "weight")
    found, fails = _filtered(model, draws, only, end, stream, settings, names)
    return plain.finished(draws, settings, fails, found)


filter_draws = checking(filter_checked_draws)


def filter_checked_sets(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
    errors: str = "",
) -> FilterArrays:
    """The results of `pfdist.filters.particle_filter.filter_checked_sets`."""
    if not _computes(draws, settings):
        return particle_filter.filter_checked_sets(
            model, draws, sets, ends, stream, settings, errors
        )
    shape = len(sets), *draws.z.shape[:2]
    keys = filter_streams(stream, settings.estimator)
    filters, fails = zip(
        *(_filtered(model, draws, sets, ends, key, settings) for key in keys), strict=True
    )
    rows = replace(draws, index=range(shape[0] * shape[1]), z=np.tile(draws.z, (len(sets), 1, 1)))
    counts = np.array(draws.instants) <= np.array(ends)[:, None, None]
    with np.errstate(all="ignore"):
        each = errors_of_filters(filters, rows, ESTIMATORS[settings.estimator]).reshape(shape)
        weighted = weighed(each, counts * draws.instant_weights)
        total, sums = np.cumsum(weighted, axis=2), sum_of_draws(weighted.swapaxes(0, 1))
    before = np.pad(total[..., :-1], ((0, 0), (0, 0), (1, 0))) < np.inf
    degenerate = np.any(np.any(fails, axis=0).reshape(shape) & counts & before, axis=2).T
    mse = np.where(total[..., -1] < np.inf, total[..., -1] / shape[2], np.inf).T
    mse[degenerate & ALL_SCHEMES[settings.resampling].holds_truth] = np.nan
    if errors == SUMS:
        sums[~np.isfinite(mse).all(axis=0)] = np.nan
        return FilterArrays(mse, degenerate, errors=sums)
    each = all_or_none(each.swapaxes(0, 1), mse)[..., : shape[2] if errors else 0]
    return FilterArrays(mse, degenerate, errors=each, measured=filters[0].measured)


def _computes(draws: Draws, settings: Estimation, wants_ranks: bool = False) -> bool:
    """Whether this module computes a filter: no log evidence, nor what few jobs need."""
    estimator, rule, model = ESTIMATORS[settings.estimator], settings.rule, draws.model
    others: list[Any] = [not draws.index, settings.penalty, estimator.weights.evidence]
    others += [wants_ranks and ALL_SCHEMES[settings.resampling].holds_truth]
    others += [estimator.by_error and model.error is not squared_error]
    if rule is not None:
        prices = rule.follows.prices
        others += [rule != Applied(rule.rule, StepLimits(prices=prices)), {*prices} - {1.0}]
        others += [np.any(settings.lag), len(model.ways) > 1]
    return not any(others)


def _request(model: StateSpaceModel, draws: Draws, settings: Estimation) -> _Filter:
    def made(name: str, owner: StateSpaceModel = model) -> CompiledFormula:
        formula, known = owner.formulas[name], traced(owner, name, range(draws.instants[-1] + 1))
        if isinstance(formula, Programs):
            known = formula.traced  # one program for all starts and ends
        return CompiledFormula(known, known.hash)

    return _Filter(
        made("initial"),
        made("transition"),
        made("quantity_of_interest"),
        tuple(
            (made("log_likelihood", each.model), each.y.start, each.y.stop) for each in model.ways
        ),
        (model.initial_noise, model.process_noise),
        tuple(draws.model.is_angle),
        replace(settings, prior=None, rule=None, lag=int(np.any(settings.lag)), estimator=""),
        ALL_SCHEMES[settings.resampling].holds_truth,
    )


def _filtered(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
    wanted: tuple[str, ...] = ("estimate", "variance"),
) -> tuple[FilterArrays, NDArray[np.bool_]]:
    """Some results of all rows, set by set, and the instants at which no particle explains y."""
    request, is_cpu = _request(model, draws, settings), jax.default_backend() == "cpu"
    start, (count, own, _) = draws.start, draws.z.shape
    instants = own if request.settings.lag else 1 << (own - 1).bit_length()
    most = _KEPT // instants // (settings.particles if request.settings.lag else 16)
    size = max(1, min(most, (_ON_CPU if is_cpu else _ON_OTHERS) // settings.particles))
    unused = (0, 0), (0, instants - own), (0, 0)
    masks = zip(*map(partial(_masks, model, draws, settings.lag), sets, ends), strict=True)
    measured, lines = (np.pad(np.array(each), unused) for each in masks)
    of_draws = {"y": np.pad(draws.y, unused)}
    if request.holds_truth:
        of_draws["truth"] = np.pad(draws.x, unused)
    if isinstance(settings.prior, Cloud):
        x, weight = plain.first(model, draws, stream, settings)
        of_draws |= {"x": np.stack(x, 1), "weight": weight / weight.max(axis=1, keepdims=True)}
    same: State = {"start": start, "instants": own, "p": model.p._asdict()}
    same["stream"] = np.array([stream >> 32, stream & 0xFFFFFFFF], np.uint32)
    if settings.rule is not None:
        rule, points = settings.rule.rule, range(start, start + instants)
        same["rule"] = rule._replace(thresholds=tuple(rule.thresholds_of(points)))
        wanted = (*wanted, "measured")
    end_of_row = np.repeat(ends, count) + 1 - start
    order, blocks, wanted = np.argsort(end_of_row, kind="stable"), list[State](), (*wanted, "fails")
    with jax.enable_x64(is_cpu):
        for begin in range(0, len(order), size):  # the device computes while the next is prepared
            rows = order[begin : begin + size]
            number, draw = np.divmod(np.resize(rows, size), count)
            of_rows: State = {name: each[draw] for name, each in of_draws.items()}
            of_rows |= {"measured": measured[number], "lines": lines[number]}
            given = same | {name: np.moveaxis(each, 0, -1) for name, each in of_rows.items()}
            given |= {"end": end_of_row[rows[-1]], "draws": draws.index.start + draw}
            blocks.append(_run(request, wanted, given))
    whole, back = State(), np.argsort(order)
    for name in wanted:
        each = np.concatenate([np.asarray(block[name], float) for block in blocks])[back]
        whole[name] = each if name in ("cloud", "weight") else each[:, :own]
    fails = whole.pop("fails") > 0
    if "measured" in whole:
        whole["measured"] = np.uint8(whole["measured"][..., 0])
    return FilterArrays(np.empty(0), np.empty(0, np.bool_), **whole), fails


def _masks(
    model: StateSpaceModel, draws: Draws, lag: Lag, times: Times, end: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Whether each sensor measures at each instant; with a lag, which instants it estimates."""
    instants = len(draws.instants)
    measured = np.zeros((instants, len(model.ways)), np.bool_)
    measured.reshape(-1)[np.array(times, int) - model.points.first(draws.start)] = True
    lines = np.zeros((instants if np.any(lag) else 0, 2), int)
    if lines.size:
        own = plain.estimated(model, range(draws.start, end + 1), times, lag)
        lines[: len(own)] = [(each.start, each.stop) for each in own]
    return measured, lines


@partial(jax.jit, static_argnums=(0, 1))
def _run(request: _Filter, wanted: tuple[str, ...], given: State) -> State:
    """The wanted results of a block, with rows first."""
    block = _Block(request, given)
    cloud, found = lax.fori_loop(0, given["end"], block.instant, block.first())
    rows_last = {"cloud": jnp.moveaxis(jnp.stack(cloud["x"]), 1, -1), "weight": cloud["weight"].T}
    return {name: jnp.moveaxis((found | rows_last)[name], -1, 0) for name in wanted}


@dataclass
class _Block:
    """The filter of R rows: its state is the cloud, (R, P), and what was found, instants first."""

    request: _Filter
    given: State

    def _noise(self, kind: str, count: int, *key: Any) -> Any:
        """Variates of a kind for each row, (R, count), by its draw."""
        root = jax.random.wrap_key_data(self.given["stream"], impl="threefry2x32")
        for number in key:
            root = jax.random.fold_in(root, number)
        keys = jax.vmap(jax.random.fold_in, (None, 0))(root, self.given["draws"])
        return jax.vmap(partial(_variates, kind, count))(keys)

    def _noise_of(self, process: int, *key: Any) -> list[Any]:
        """The noise of each component, (R, P); a kind is drawn at once, which compiles faster."""
        kinds, particles = self.request.noise[process], self.request.settings.particles
        found = dict[int, Any]()
        for kind in dict.fromkeys(kinds):
            own = [number for number, each in enumerate(kinds) if each == kind]
            together = self._noise(kind, len(own) * particles, *key, own[0])
            found |= zip(own, jnp.split(together, len(own), axis=1), strict=True)
        return [found[number] for number in range(len(kinds))]

    @property
    def _every(self) -> Any:
        """The number of each particle, (R, P)."""
        size = self.given["draws"].size, self.request.settings.particles
        return jnp.broadcast_to(jnp.arange(size[1], dtype=float), size)

    def first(self) -> tuple[State, State]:
        """The state before the first instant."""
        request, given, (instants, *_) = self.request, self.given, self.given["measured"].shape
        size = given["draws"].size, request.settings.particles
        none, q, x = jnp.zeros(size[0], bool), len(request.is_angle), given.get("x")
        if x is None:
            w = self._noise_of(0, 0, int(FILTER_INITIAL))
            x = [each.T for each in request.initial(0, given["p"], w=w)]
        cloud = {"x": [jnp.broadcast_to(each.T, size) for each in x], "weighs": none, "fails": none}
        cloud |= {"weight": given.get("weight", jnp.ones(size[::-1])).T}
        cloud |= {"spent": jnp.zeros(size[0]), "measured": given["measured"][0]}
        unknown = jnp.full((instants, q, size[0]), jnp.nan)
        found = {"estimate": unknown, "variance": unknown, "sizes": unknown[:, 0]}
        found |= {"lines": unknown[:, 0], "fails": jnp.zeros((instants, size[0]), bool)}
        if request.settings.lag:  # z of the particles, and the particle at the instant before
            found["past"], cloud["parent"] = jnp.zeros((instants, q + 1, *size)), self._every
        return cloud, found | {"measured": given["measured"]}

    def instant(self, k: Any, state: tuple[State, State]) -> tuple[State, State]:
        """The state after the measurements at t = start + k, from that after those before."""
        request, given, (cloud, found) = self.request, self.given, state
        sensors, none, t = len(request.sensors), jnp.zeros_like(cloud["fails"]), given["start"] + k
        x = _where(k > 0, partial(self._moved, t - 1), cloud["x"])
        if request.holds_truth:
            x = [each.at[:, 0].set(true) for each, true in zip(x, given["truth"][k], strict=True)]
        cloud = cloud | {"x": x, "weighs": none, "fails": none, "measured": given["measured"][k]}
        if "rule" in given:
            cloud = self._decided(t, k, cloud)
        for number in range(sensors):
            weighed = partial(self._weighed, t, given["y"][k], number)
            cloud = _where(cloud["measured"][number].any(), weighed, cloud)
        z, weight = request.quantity(t, given["p"], x=cloud["x"]), cloud["weight"]
        now = cloud | self._estimated(z, weight)
        now["sizes"] = jnp.where(cloud["weighs"], _sizes(weight), jnp.nan)
        found |= {name: found[name].at[k].set(now[name]) for name in found if name in now}
        if request.settings.lag:
            found["past"] = found["past"].at[k].set(jnp.stack([*z, cloud["parent"]]))
            cloud["parent"] = self._every
            smoothed = partial(self._smoothed, k, found["past"], weight)
            changed = {name: found[name] for name in ("estimate", "variance", "lines")}
            found |= _where(cloud["measured"].any(), smoothed, changed)
        resampled = partial(self._resampled, (t + 1) * sensors - 1, True)
        return _where(cloud["weighs"].any(), resampled, cloud), found

    def _decided(self, t: Any, k: Any, cloud: State) -> State:
        """Let a rule decide at which of the given points of a sensor each row is measured."""
        given, rule = self.given, self.given["rule"]
        z = self.request.quantity(t, given["p"], x=cloud["x"])
        deviation = jnp.sqrt(self._estimated(z, cloud["weight"])["variance"].sum(axis=0))
        left = rule.limit - cloud["spent"]
        factor = ((given["instants"] - k) / jnp.where(left > 0, left, 1.0)) ** rule.exponent
        level = jnp.array(rule.thresholds)[k] * jnp.where(rule.limit > 0, factor, 1.0)
        may = (left >= 1 - ROUNDING * rule.limit) | (rule.limit == 0)
        measured = cloud["measured"] & may & (deviation > level)
        return cloud | {"measured": measured, "spent": cloud["spent"] + measured[0]}

    def _moved(self, t: Any, x: list[Any]) -> list[Any]:
        w = self._noise_of(1, t, int(FILTER_PROCESS))
        return self.request.transition(t, self.given["p"], x=x, w=w)

    def _weighed(self, t: Any, y: Any, number: int, cloud: State) -> State:
        """Weigh the particles of the rows that a sensor measures."""
        request, measured = self.request, cloud["measured"][number]
        if number:
            cloud = self._resampled(t * len(request.sensors) + number - 1, measured, cloud)
        log_likelihood, begin, end = request.sensors[number]
        (value,) = log_likelihood(t, self.given["p"], y=y[begin:end, :, None], x=cloud["x"])
        if request.settings.carries:
            value = value + jnp.log(cloud["weight"])
        value = jnp.where(jnp.isfinite(value), value, -jnp.inf)
        highest = jnp.max(value, axis=1, keepdims=True)
        weighs = jnp.isfinite(highest[:, 0]) & measured
        new = jnp.exp(jnp.float32(value - highest)).astype(float)
        weight = jnp.where(weighs[:, None], new, cloud["weight"])
        fails = cloud["fails"] | (measured & ~weighs)
        weighs = jnp.where(measured, weighs, cloud["weighs"])
        return cloud | {"weight": weight, "weighs": weighs, "fails": fails}

    def _resampled(self, key: Any, rows: Any, cloud: State) -> State:
        """Resample those rows that a measurement has weighed, if their weights are uneven."""
        weight, settings = cloud["weight"], self.request.settings
        uneven = rows & cloud["weighs"] & (weight.sum(axis=1) < settings.particles)
        uneven &= _sizes(weight) < settings.threshold * settings.particles
        found = self._ancestors(weight, key)
        found = jnp.where(uneven[:, None], found, jnp.arange(settings.particles))
        taken = partial(jnp.take_along_axis, indices=found, axis=1, mode="promise_in_bounds")
        moved: State = {name: cloud[name] for name in ("x", "parent") if name in cloud}
        moved = jax.tree.map(taken, moved)
        return cloud | moved | {"weight": jnp.where(uneven[:, None], 1.0, weight)}

    def _ancestors(self, weight: Any, key: Any) -> Any:
        """Ancestors of each row's particles, (R, P); see `pfdist.kernels.ancestors`."""
        count, scheme = self.request.settings.particles, self.request.settings.resampling
        kept = int(self.request.holds_truth)
        role, cumulative = int(RESAMPLING), jnp.cumsum(weight, axis=1)
        # a particle without weight is never chosen, however sums are rounded
        cumulative = lax.cummax(jnp.where(weight > 0, cumulative, 0.0), axis=1)
        cumulative = cumulative / cumulative[:, -1:]
        last = jnp.argmax(cumulative, axis=1)[:, None]
        if scheme == SYSTEMATIC.name:
            ends = jnp.ceil(cumulative * count - self._noise("uniform", 1, key, role))
            rows = jnp.arange(len(weight))[:, None]
            below = jnp.zeros(weight.shape, jnp.int32)
            below = below.at[rows, jnp.int32(ends)].add(1, mode="drop")
            return jnp.minimum(jnp.cumsum(below, axis=1), last)
        if scheme == STRATIFIED.name:
            points = (jnp.arange(count) + self._noise("uniform", count, key, role)) / count
        else:
            sums = jnp.cumsum(self._noise("exponential", count + 1 - kept, key, role), axis=1)
            points = sums[:, :-1] / sums[:, -1:]
        found = jax.vmap(partial(jnp.searchsorted, side="right"))(cumulative, points)
        return jnp.pad(jnp.minimum(found, last), ((0, 0), (kept, 0)))

    def _estimated(self, z: Sequence[Any], weight: Any) -> dict[str, Any]:
        """Mean and variance of the particles' z, (q, R) each."""
        share, is_angle = weight / weight.sum(axis=1, keepdims=True), self.request.is_angle
        counted = jnp.where(weight > 0, jnp.stack(z), 0.0)
        mean = jnp.sum(share * counted, axis=2)
        if any(is_angle):  # see `pfdist.filters.interface`
            sine, cosine = (jnp.sum(share * each(counted), axis=2) for each in (jnp.sin, jnp.cos))
            mean = jnp.where(np.array(is_angle)[:, None], jnp.arctan2(sine, cosine), mean)
        deviation = counted - mean[:, :, None]
        error = deviation**2
        if any(is_angle):
            angular = 2.0 * jnp.sin(deviation / 2) ** 2
            error = jnp.where(np.array(is_angle)[:, None, None], angular, error)
        return {"estimate": mean, "variance": jnp.sum(share * error, axis=2)}

    def _smoothed(self, k: Any, past: Any, weight: Any, found: State) -> State:
        """Estimate earlier instants along the lines of the particles, from the last backwards."""
        first, end = self.given["lines"][k]
        first = jnp.where(self.given["measured"][k].any(axis=0), first, end)
        rows = jnp.arange(len(weight))[:, None]

        def estimated(back: Any, state: tuple[State, Any]) -> tuple[State, Any]:
            found, line = state
            at = k - back
            *z, parent = past[at, :, rows, line].transpose(2, 0, 1)
            passed = jnp.zeros(weight.shape, bool).at[rows, line].max(weight > 0)
            now = self._estimated(z, weight) | {"lines": passed.sum(axis=1)}
            is_own = (first <= at) & (at < end)
            kept = {name: jnp.where(is_own, each, found[name][at]) for name, each in now.items()}
            found = found | {name: found[name].at[at].set(each) for name, each in kept.items()}
            return found, jnp.int32(parent)

        instants = jnp.where(first < end, k + 1 - first, 0).max()
        found, _ = lax.fori_loop(0, instants, estimated, (found, jnp.int32(self._every)))
        return found


def _where(condition: Any, change: Callable[..., Any], state: Any) -> Any:
    """The changed state if a condition holds, and else the state as it is."""
    return lax.cond(condition, change, lambda state: state, state)


def _variates(kind: str, count: int, key: Any) -> Any:
    if kind == "normal":
        return jax.random.normal(key, (count,), jnp.float32).astype(float)
    # a model may take the logarithm of the distance from 0 of "centred" noise
    uniform = jax.random.uniform(key, (count,), float if kind == "centred" else jnp.float32)
    uniform = (uniform + jnp.finfo(uniform.dtype).eps / 2).astype(float)  # neither 0 nor 1
    return {"uniform": uniform, "centred": uniform - 0.5, "exponential": -jnp.log(uniform)}[kind]


def _sizes(weight: Any) -> Any:
    return weight.sum(axis=1) ** 2 / jnp.sum(weight**2, axis=1)
