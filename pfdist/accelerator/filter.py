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

import numpy as np
from numpy.typing import NDArray

from pfdist.accelerator.formulas import CompiledFormula
from pfdist.common.measurement_times import Times
from pfdist.errors import PfdistError
from pfdist.filters import particle_filter, plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws
from pfdist.filters.interface import SUMS, all_or_none, checking, errors_of_filters, weighed
from pfdist.filters.work import Estimation, filter_streams, sum_of_draws
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.left import ROUNDING
from pfdist.kernels.rules import Applied
from pfdist.kernels.schemes import ALL_SCHEMES, STRATIFIED, SYSTEMATIC
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, RESAMPLING
from pfdist.models import StateSpaceModel
from pfdist.models.base import squared_error
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
_WITH_PAST = 2**28
"""Particles of all rows that are filtered together; with a lag, those of all instants."""

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
    has_rule: bool


def filter_checked_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    stream: int,
    settings: Estimation,
    trajectories: bool = False,
) -> FilterArrays:
    """The results of `pfdist.filters.particle_filter.filter_checked_draws`."""
    wants_ranks = trajectories and ALL_SCHEMES[settings.resampling].holds_truth
    if wants_ranks or not _computes(draws, settings):
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
        total = np.cumsum(weighted, axis=2)
    before = np.pad(total[..., :-1], ((0, 0), (0, 0), (1, 0))) < np.inf
    degenerate = np.any(np.any(fails, axis=0).reshape(shape) & counts & before, axis=2).T
    mse = np.where(total[..., -1] < np.inf, total[..., -1] / shape[2], np.inf).T
    mse[degenerate & ALL_SCHEMES[settings.resampling].holds_truth] = np.nan
    if errors == SUMS:
        sums = sum_of_draws(weighted.swapaxes(0, 1))
        sums[~np.isfinite(mse).all(axis=0)] = np.nan
        return FilterArrays(mse, degenerate, errors=sums)
    each = all_or_none(each.swapaxes(0, 1), mse)[..., : shape[2] if errors else 0]
    return FilterArrays(mse, degenerate, errors=each, measured=filters[0].measured)


def _computes(draws: Draws, settings: Estimation) -> bool:
    """Whether this module computes a filter: no log evidence, nor what few jobs need."""
    estimator, rule, model = ESTIMATORS[settings.estimator], settings.rule, draws.model
    has_more = settings.penalty or np.any(settings.lag) or len(model.parts) > 1
    if rule is not None and (has_more or rule != Applied(rule.rule)):
        return False
    has_own_error = estimator.by_error and model.error is not squared_error
    return not (estimator.weights.evidence or has_own_error)


def _request(model: StateSpaceModel, draws: Draws, settings: Estimation) -> _Filter:
    def made(name: str, owner: StateSpaceModel = model) -> CompiledFormula:
        formula, instants = owner.formulas[name], range(draws.instants[-1] + 1)
        known = formula.traced if isinstance(formula, Programs) else traced(owner, name, instants)
        return CompiledFormula(known, known.hash)

    return _Filter(
        made("initial"),
        made("transition"),
        made("quantity_of_interest"),
        tuple(
            (made("log_likelihood", each.model), each.y.start, each.y.stop) for each in model.parts
        ),
        (model.initial_noise, model.process_noise),
        tuple(draws.model.is_angle),
        settings.particles,
        settings.resampling,
        settings.threshold,
        bool(np.max(settings.lag)),
        settings.rule is not None,
    )


def _filtered(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
    wanted: Sequence[str] = ("estimate", "variance"),
) -> tuple[FilterArrays, NDArray[np.bool_]]:
    """Some results of all rows, set by set, and the instants at which no particle explains y."""
    request, device = _request(model, draws, settings), jax.default_backend()
    start, (count, own, _) = draws.start, draws.z.shape
    instants = own if request.has_lag else 1 << (own - 1).bit_length()
    size = _AT_ONCE.get(device, _ON_OTHERS)
    size = min(size, _WITH_PAST // instants) if request.has_lag else size
    size = max(1, size // settings.particles)
    measured = np.zeros((len(sets), instants, len(model.parts)), np.bool_)
    lines = np.tile([instants, 0], (len(sets), instants, 1))
    for place, (times, end) in enumerate(zip(sets, ends, strict=True)):
        measured[place].reshape(-1)[np.array(times, int) - model.points.first(start)] = True
        if request.has_lag:
            known = plain.estimated(model, range(start, end + 1), times, settings.lag)
            lines[place, : len(known)] = [(at.start, at.stop) for at in known]
    unused = (0, 0), (0, instants - own), (0, 0)
    of_draws = {"y": np.pad(draws.y, unused), "truth": np.pad(draws.x, unused)}
    same: State = {"start": start, "p": model.p._asdict()}
    same["stream"] = np.array([stream >> 32, stream & 0xFFFFFFFF], np.uint32)
    if settings.rule is not None:
        rule = settings.rule.rule
        same |= {"levels": rule.thresholds_of(range(start, start + instants)), "instants": own}
        same |= {"limit": rule.limit, "exponent": rule.exponent}
    has_prior = isinstance(settings.prior, Cloud)
    x, weight = plain.first(model, draws, stream, settings) if has_prior else ((), np.empty(0))
    end_of_row, whole = np.repeat(ends, count) + 1 - start, State()
    order = np.argsort(end_of_row, kind="stable")
    wanted = (*wanted, "fails", *["measured"] * request.has_rule)
    with jax.enable_x64(device == "cpu"):
        for begin in range(0, len(order), size):
            rows = order[begin : begin + size]
            number, draw = np.divmod(np.resize(rows, size), count)
            of_rows: State = {name: each[draw] for name, each in of_draws.items()}
            of_rows |= {"measured": measured[number], "lines": lines[number]}
            given = same | {name: np.moveaxis(each, 0, -1) for name, each in of_rows.items()}
            given |= {"end": end_of_row[rows[-1]], "draws": draws.index.start + draw}
            if has_prior:
                given |= {"x": [each[draw] for each in x], "weight": weight[draw]}
            found = _run(request, given)
            for name in wanted:
                each = np.asarray(found[name])[: len(rows)]
                whole.setdefault(name, np.empty((len(order), *each.shape[1:])))[rows] = each
    for name in whole.keys() - {"cloud", "weight"}:
        whole[name] = whole[name][:, :own]
    fails = whole.pop("fails") > 0
    if request.has_rule:
        whole["measured"] = whole["measured"][..., 0] > 0
    return FilterArrays(np.empty(0), np.empty(0, np.bool_), **whole), fails


@partial(jax.jit, static_argnums=0)
def _run(request: _Filter, given: State) -> State:
    """The results of a block, with draws first."""
    block = _Block(request, given)
    cloud, found = lax.fori_loop(0, given["end"], block.instant, block.first())
    found = {name: jnp.moveaxis(found[name], -1, 0) for name in found.keys() - {"past"}}
    return found | {"cloud": jnp.stack(cloud["x"], axis=1), "weight": cloud["weight"]}


@dataclass
class _Block:
    """The filter of R rows: its state is the cloud, (R, P), and what was found, instants first."""

    request: _Filter
    given: State

    def _noise(self, kind: str, count: int, *key: Any) -> Any:
        """Variates of a kind for each row, (R, count), by its draw."""
        root = jax.random.wrap_key_data(self.given["stream"], impl="threefry2x32")
        for part in key:
            root = jax.random.fold_in(root, part)
        keys = jax.vmap(jax.random.fold_in, (None, 0))(root, self.given["draws"])
        return jax.vmap(partial(_variates, kind, count))(keys)

    def _noise_of(self, process: int, *key: Any) -> list[Any]:
        kinds, particles = self.request.noise[process], self.request.particles
        return [self._noise(kind, particles, *key, number) for number, kind in enumerate(kinds)]

    @property
    def _every(self) -> Any:
        """The number of each particle, (R, P)."""
        size = self.given["draws"].size, self.request.particles
        return jnp.broadcast_to(jnp.arange(size[1], dtype=float), size)

    def first(self) -> tuple[State, State]:
        """The state before the first instant."""
        request, given, (instants, *_) = self.request, self.given, self.given["measured"].shape
        size = given["draws"].size, request.particles
        x = given.get("x")
        if x is None:
            x = request.initial(0, given["p"], w=self._noise_of(0, 0, int(FILTER_INITIAL)))
        none, q = jnp.zeros(size[0], bool), len(request.is_angle)
        cloud = {"x": [*x], "weight": given.get("weight", jnp.ones(size)), "weighs": none}
        cloud |= {"fails": none, "spent": jnp.zeros(size[0]), "measured": given["measured"][0]}
        unknown = jnp.full((instants, q, size[0]), jnp.nan)
        found = {"estimate": unknown, "variance": unknown, "sizes": unknown[:, 0]}
        found |= {"lines": unknown[:, 0], "fails": jnp.zeros((instants, size[0]), bool)}
        if request.has_lag:  # z of the particles, and the particle at the instant before
            found["past"], cloud["parent"] = jnp.zeros((instants, q + 1, *size)), self._every
        return cloud, found | {"measured": given["measured"]}

    def instant(self, k: Any, state: tuple[State, State]) -> tuple[State, State]:
        """The state after the measurements at t = start + k, from that after those before."""
        request, given, (cloud, found) = self.request, self.given, state
        sensors, none, t = len(request.sensors), jnp.zeros_like(cloud["fails"]), given["start"] + k
        x = _where(k > 0, partial(self._moved, t - 1), cloud["x"])
        if ALL_SCHEMES[request.resampling].holds_truth:
            x = [each.at[:, 0].set(true) for each, true in zip(x, given["truth"][k], strict=True)]
        cloud = cloud | {"x": x, "weighs": none, "fails": none, "measured": given["measured"][k]}
        if request.has_rule:
            cloud = self._decided(t, k, cloud)
        for number in range(sensors):
            weighed = partial(self._weighed, t, given["y"][k], number)
            cloud = _where(cloud["measured"][number].any(), weighed, cloud)
        z, weight = request.quantity(t, given["p"], x=cloud["x"]), cloud["weight"]
        now = cloud | dict(zip(("estimate", "variance"), self._estimated(z, weight), strict=True))
        now |= {"lines": found["lines"][k]}
        now["sizes"] = jnp.where(cloud["weighs"], _sizes(weight), jnp.nan)
        if request.has_lag:
            now["past"], cloud["parent"] = jnp.stack([*z, cloud["parent"]]), self._every
        found = {name: each.at[k].set(now[name]) for name, each in found.items()}
        if request.has_lag:
            smoothed = partial(self._smoothed, k, found["past"], weight)
            changed = {name: found[name] for name in ("estimate", "variance", "lines")}
            found |= _where(cloud["measured"].any(), smoothed, changed)
        resampled = partial(self._resampled, (t + 1) * sensors - 1, True)
        return _where(cloud["weighs"].any(), resampled, cloud), found

    def _decided(self, t: Any, k: Any, cloud: State) -> State:
        """Let a rule decide at which of the given points of a sensor each row is measured."""
        given = self.given
        z = self.request.quantity(t, given["p"], x=cloud["x"])
        deviation = jnp.sqrt(self._estimated(z, cloud["weight"])[1].sum(axis=0))
        left, limit = given["limit"] - cloud["spent"], given["limit"]
        factor = ((given["instants"] - k) / jnp.where(left > 0, left, 1.0)) ** given["exponent"]
        level = given["levels"][k] * jnp.where(limit > 0, factor, 1.0)
        may = cloud["measured"] & ((left > ROUNDING * limit) | (limit == 0))
        measured = may & (deviation > level)
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
        if request.threshold < np.inf:  # else weights are resampled before they are carried
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
        weight, particles = cloud["weight"], self.request.particles
        uneven = rows & cloud["weighs"] & (_sizes(weight) < self.request.threshold * particles)
        uneven = (uneven & (weight.sum(axis=1) < particles))[:, None]
        found = jnp.where(uneven, self._ancestors(weight, key), jnp.arange(particles))

        def taken(values: Any) -> Any:
            at = jnp.broadcast_to(found, values.shape)
            return jnp.take_along_axis(values, at, axis=-1, mode="promise_in_bounds")

        moved = {name: jax.tree.map(taken, cloud[name]) for name in cloud.keys() & {"x", "parent"}}
        return cloud | moved | {"weight": jnp.where(uneven, 1.0, weight)}

    def _ancestors(self, weight: Any, key: Any) -> Any:
        """Ancestors of each row's particles, (R, P); see `pfdist.kernels.ancestors`."""
        count, scheme = self.request.particles, self.request.resampling
        kept = int(ALL_SCHEMES[scheme].holds_truth)
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
            sums = jnp.cumsum(self._noise("exponential", count + 1 - kept, key, role), axis=1)
            points = sums[:, :-1] / sums[:, -1:]
        found = jax.vmap(partial(jnp.searchsorted, side="right"))(cumulative, points)
        return jnp.pad(jnp.minimum(found, count - 1), ((0, 0), (kept, 0)))

    def _estimated(self, z: Sequence[Any], weight: Any) -> list[Any]:
        """Mean and variance of the particles' z, (q, R) each."""
        share = weight / weight.sum(axis=1, keepdims=True)
        counted = [jnp.where(weight > 0, each, 0.0) for each in z]
        moments = map(partial(_moments, share), counted, self.request.is_angle)
        return [jnp.stack(each) for each in zip(*moments, strict=True)]

    def _smoothed(self, k: Any, past: Any, weight: Any, found: State) -> State:
        """Estimate earlier instants along the lines of the particles, from the last backwards."""
        first, end = self.given["lines"][k]
        rows = jnp.arange(len(weight))[:, None]

        def estimated(back: Any, state: tuple[State, Any]) -> tuple[State, Any]:
            found, line = state
            at = k - back
            *z, parent = past[at, :, rows, line].transpose(2, 0, 1)
            mean, variance = self._estimated(z, weight)
            passed = jnp.zeros(weight.shape, bool).at[rows, line].max(weight > 0)
            now = {"estimate": mean, "variance": variance, "lines": passed.sum(axis=1)}
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
