"""The linearized error of a set of times: along simulated draws, without a filter.

Around the states of a draw, formulas are replaced by their derivatives, and a measurement by the
information that it has about x there: the expected outer product of the score, the derivative of
its log-likelihood, over simulated y. So readings whose error depends on x, counts and limits count
in full. The error of z then follows as in `pfdist.filters.kalman`. Its mean over draws is that of
the *inverse* information (Bayesian A-optimality for z); for constants alone this is the kind of
design that PopED and PFIM compute. It may mislead where a posterior has several modes.

Sources: Tichavsky, Muravchik, Nehorai, "Posterior Cramer-Rao bounds for discrete-time nonlinear
filtering", IEEE Transactions on Signal Processing 46, 1998 (with process noise; the form with
covariances also holds where x has constants). Chaloner, Verdinelli, "Bayesian experimental design:
a review", Statistical Science 10, 1995 (the mean over draws).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Lag, Times, last_used
from pfdist.common.points import PointNumbers
from pfdist.common.stopping import check
from pfdist.errors import ModelError
from pfdist.filters.draws import noise_of
from pfdist.filters.interface import weighed
from pfdist.filters.kalman import later, measured_points
from pfdist.kernels.variates import TRUTH_INITIAL, TRUTH_PROCESS
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.program import MASKS, Program
from pfdist.models.recorded import declared
from pfdist.models.twin import traced, twin_of

DRAWS: Final = 60
"""Draws suffice whose mean ranks sets within .1 % of their errors."""
_STEP = 1e-6  # of a difference, in standard deviations of a component over draws
_HALVINGS, _JUMPED = 30, 1e-3  # of an interval; what is then left of a jump, relative
_LOOKED_AT = 8  # instants, for jumps
_NODES = 32  # simulated measurements of each draw and instant
_LEAST = 1e-9  # of an information's eigenvalue, relative to the largest
_MOST = 4_000_000  # numbers in an array of all instants
_JUMPS = MASKS | {"floor", "ceil", "trunc", "rint", "sign", "floor_divide", "remainder", "fmod"}
_VARIANCES = {"normal": 1.0, "uniform": 1.0, "centred": 1 / 12}  # uniform: see `_noise`
_NORMAL = NormalDist()
_quantile = np.vectorize(_NORMAL.inv_cdf, otypes=[np.float64])  # workers wait for no SciPy
_probability = np.vectorize(_NORMAL.cdf, otypes=[np.float64])
_FORMULAS = "initial", "transition", "quantity_of_interest"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Linearized:
    """Derivatives along D draws with n components of x; called with sets, it gives their errors."""

    points: PointNumbers
    begin: Array  # (D, n, n): the covariance of x(0)
    steps: Array  # (T, D, n, n): derivatives of x(t+1) by x(t)
    noise: Array  # (T, D, n, n): covariances of what process noise adds
    rows: tuple[Array, ...]  # (R, D, n) for each point: their outer products are its information
    quantities: Array  # (T+1, D, q, n): derivatives of z
    lag: Lag = 0
    weights: Array | None = None  # (T+1,): of instants, with mean 1

    def __call__(self, sets: Sequence[Times]) -> Array:
        """The mean linearized error of each set, (S,); infinite if it is not finite."""
        together = max(1, _MOST // self.quantities[..., 0, :].size // self.begin.shape[-1])
        with np.errstate(all="ignore"):  # then an error is not finite, which counts as infinite
            found = [
                self._errors(sets[first : first + together]).mean(axis=0)
                for first in range(0, len(sets), together)
            ]
        errors = np.concatenate(found)
        return np.where(np.isfinite(errors), errors, np.inf)

    def _errors(self, sets: Sequence[Times]) -> Array:
        """The linearized errors with each set, (D, S)."""
        instants, size = len(self.quantities), self.begin.shape[-1]
        measured = measured_points(self.points, instants - 1, sets, 0)
        covariance = np.repeat(self.begin[:, None], len(sets), axis=1)
        errors = np.empty((len(self.begin), len(sets), instants))
        kept = list[tuple[Array, Array, Array]]()
        for t in range(instants):
            check()
            step = self.steps[t - 1] if t else np.broadcast_to(np.eye(size), self.begin.shape)
            through = np.repeat(step[:, None], len(sets), axis=1)
            information = np.zeros_like(covariance)
            if t:
                covariance = step[:, None] @ covariance @ step[:, None].swapaxes(-1, -2)
                covariance += self.noise[t - 1][:, None]
            for place in self.points.at(t):
                here = measured[:, place]
                for row in self.rows[place] if here.any() else ():
                    prior, to = covariance[:, here], through[:, here]
                    along = np.einsum("dsij,dj->dsi", prior, row)
                    spread = 1.0 + np.einsum("dsi,di->ds", along, row)[..., None, None]
                    seen = np.einsum("di,dsij->dsj", row, to)[..., None, :]
                    gain = along[..., None] / spread
                    covariance[:, here] = prior - gain * along[..., None, :]
                    information[:, here] += seen.swapaxes(-1, -2) * seen / spread
                    through[:, here] = to - gain * seen
            if self.lag:
                kept.append((covariance, through, information))
            else:
                errors[..., t] = self._of_quantity(t, covariance)
        if self.lag:
            covariances, maps, gained = (np.array(each) for each in zip(*kept, strict=True))
            used = last_used(self.lag, range(instants))
            covariances -= covariances @ later(maps, gained, used, both=True) @ covariances
            for t, each in enumerate(covariances):
                errors[..., t] = self._of_quantity(t, each)
        counted = errors if self.weights is None else weighed(errors, self.weights)
        mse: Array = counted.mean(axis=-1)
        return mse

    def _of_quantity(self, t: int, covariance: Array) -> Array:
        h = self.quantities[t]
        found: Array = np.einsum("dqi,dsij,dqj->ds", h, covariance, h, optimize=True)
        return found


def linearized(
    model: StateSpaceModel,
    horizon: int,
    stream: int,
    lag: Lag = 0,
    weights: Array | None = None,
    draws: int = DRAWS,
) -> Linearized:
    """The derivatives of a model along simulated draws of a stream.

    Raises `ModelError` if a formula cannot be recorded, or jumps: then its derivatives say nothing.
    """
    if functions := declared(model):
        raise ModelError(f"model {model.name}: {', '.join(functions)} has no derivatives")
    if model.error is not squared_error or any(model.is_angle):
        raise ModelError(f"model {model.name}: only a squared error of numbers can be linearized")
    instants = range(horizon + 1)
    _check_smooth(model, instants)
    twin, index, (n, *_, q) = twin_of(model, instants), range(draws), model.components
    with np.errstate(all="ignore"):
        w = _noise(model.initial_noise, stream, index, 0, TRUTH_INITIAL)
        begun = partial(_initial, twin)
        states, noises = [_components(begun(w), (draws,))], list[Array]()
        begin = _covariance(begun, w, model.initial_noise, n)
        for t in instants[:-1]:
            noises.append(_noise(model.process_noise, stream, index, t, TRUTH_PROCESS))
            states.append(_components(_following(twin, t, states[-1], noises[-1]), (draws,)))
        spreads = _spreads(np.array(states))
        steps, added = np.empty((2, horizon, draws, n, n))
        for t, (state, w) in enumerate(zip(states[:-1], noises, strict=True)):
            check()
            steps[t] = _slopes(partial(_following, twin, t, noise=w), state, spreads[t], n)
            by_noise = partial(_following, twin, t, state)
            added[t] = _covariance(by_noise, w, model.process_noise, n)
        quantities = np.array(
            [_slopes(partial(_quantity, twin, t), states[t], spreads[t], q) for t in instants]
        )
        rows = [*_information_rows(model.name, twin, states, spreads)]
    for name, values in (("transition", steps), ("process noise", added), ("z", quantities)):
        if not np.isfinite(values).all():
            raise ModelError(f"model {model.name}: the derivative of {name} is not finite")
    return Linearized(model.points, begin, steps, added, tuple(rows), quantities, lag, weights)


def _information_rows(
    name: str, twin: StateSpaceModel, states: Sequence[Array], spreads: Array
) -> Iterator[Array]:
    """The rows of each point; raises `ModelError` if they say nothing."""
    every, is_any = max(1, (len(states) - 1) // _LOOKED_AT), False
    for t, (x, spread) in enumerate(zip(states, spreads, strict=True)):
        check()
        for way in twin.ways:
            if t % every == 0 and _jumps(way.model, x, t, spread):
                raise ModelError(f"model {name}: log_likelihood jumps where x changes")
            rows = _rows(_information(way.model, x, t, spread), spread)
            is_any |= rows.size > 0
            yield rows
    if not is_any:
        raise ModelError(f"model {name}: measurements have no smooth information about x")


def _check_smooth(model: StateSpaceModel, instants: range) -> None:
    """Raise `ModelError` if a formula has a step by x or by noise."""
    for name in _FORMULAS:
        for program in traced(model, name, instants).programs:
            if jump := _jump(program):
                raise ModelError(
                    f"model {model.name}: {name} has {jump!r} of x or of noise, whose derivative "
                    "says nothing"
                )


def _jump(program: Program) -> str:
    """The name of an operation of x or noise that has a jump; empty if there is none."""
    fed = set[int]()  # loops whose values depend on x or noise from the second step on
    for _ in range(2):
        depends = list[bool]()
        for name, arguments, _ in program.operations:
            is_fed = name == "state" and arguments[0] in fed
            depends.append(is_fed or name in ("x", "w") or any(depends[each] for each in arguments))
            if depends[-1] and name in _JUMPS:
                return name
            if depends[-1] and name == "again":
                fed.add(arguments[0])
    return ""


def _spreads(x: Array) -> Array:
    """The standard deviation of each component at each instant, (T+1, n), for steps.

    Where it is 0, nothing depends on the step: that of all instants, or 1, will do.
    """
    own, usual = x.std(axis=2), x.std(axis=(0, 2))
    usual = np.where(usual > 0.0, usual, np.maximum(1.0, np.abs(x).max(axis=(0, 2))))
    found: Array = np.where(own > 1e-9 * usual, own, usual)
    return found


def _noise(kinds: tuple[str, ...], stream: int, index: range, t: int, role: Any) -> Array:
    """Noise of each component and draw, (k, D); of uniform noise the normal number behind it.

    Uniform noise mostly enters by a quantile function, so its variance says little.
    """
    found = [w[:, 0] for w in noise_of(kinds, 1, stream, index, t, role)]
    normal = [_quantile(w) if k == "uniform" else w for k, w in zip(kinds, found, strict=True)]
    return np.array(normal).reshape(len(kinds), len(index))


def _as_drawn(kinds: tuple[str, ...], noise: Array) -> Array:
    """The noise of formulas."""
    is_uniform = np.array([kind == "uniform" for kind in kinds], np.bool_)
    drawn = noise.copy()
    drawn[is_uniform] = _probability(noise[is_uniform])
    return drawn


def _components(values: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Components that a formula gives, as one array; some may be single numbers."""
    found = [np.broadcast_to(np.asarray(each, np.float64), shape) for each in values]
    return np.array(found).reshape(len(found), *shape)


def _initial(model: StateSpaceModel, noise: Array) -> Any:
    return model.initial(_as_drawn(model.initial_noise, noise), model.p)


def _following(model: StateSpaceModel, t: int, x: Array, noise: Array) -> Any:
    w = _as_drawn(model.process_noise, _wide(noise, x))
    return model.transition(_wide(x, noise), t, w, model.p)


def _quantity(model: StateSpaceModel, t: int, x: Array) -> Any:
    return model.quantity_of_interest(x, t, model.p)


def _wide(values: Array, like: Array) -> Array:
    """The values of D draws, (k, D), as often as another argument has columns."""
    return np.tile(values, max(1, like.shape[1] // values.shape[1]))


def _slopes(formula: Callable[[Any], Any], at: Array, spread: Array, count: int) -> Array:
    """The derivatives of a formula by its argument (k, D), (D, count, k): central differences."""
    size, columns = at.shape
    steps = _STEP * spread
    moved = at[:, None, None] + np.zeros((size, 2, size, columns))
    for c in range(size):
        moved[c, 0, c] += steps[c]
        moved[c, 1, c] -= steps[c]
    if not size:
        return np.empty((columns, count, 0))
    values = _components(formula(moved.reshape(size, -1)), (moved[0].size,))
    high, low = values.reshape(count, 2, size, columns).swapaxes(0, 1)
    made = np.array([moved[c, 0, c] - moved[c, 1, c] for c in range(size)])  # rounded
    slopes: Array = ((high - low) / made).transpose(2, 0, 1)
    return slopes


def _covariance(
    formula: Callable[[Any], Any], noise: Array, kinds: tuple[str, ...], count: int
) -> Array:
    """The covariance of what a formula gives, (D, count, count), where noise (k, D) varies."""
    root = _slopes(formula, noise, np.ones(len(noise)), count)
    own = np.array([_VARIANCES[kind] for kind in kinds], np.float64)
    covariance: Array = np.einsum("dik,k,djk->dij", root, own, root)
    return covariance


def _jumps(model: StateSpaceModel, x: Array, t: int, spread: Array) -> bool:
    """Whether a log-likelihood jumps between two states near to each of some, (n, D).

    The half of an interval in which it changes more is halved again: only a jump is left.
    """
    nodes, _ = _nodes(model.measurement_noise)
    noise = nodes[:, np.arange(x.shape[1]) % nodes.shape[1]]
    y = _components(model.measurement(x, t, noise, model.p), x.shape[1:])

    def likely(x: Array) -> Array:
        found: Array = _components([model.log_likelihood(y, x, t, model.p)], x.shape[1:])[0]
        return found

    for step in np.diag(spread):
        ends = [x - step[:, None], x + step[:, None]]
        values = [likely(each) for each in ends]
        for _ in range(_HALVINGS):
            middle = 0.5 * (ends[0] + ends[1])
            value = likely(middle)
            first, second = (np.nan_to_num(np.abs(value - each), nan=-1.0) for each in values)
            is_first = first > second
            ends = [np.where(is_first, ends[0], middle), np.where(is_first, middle, ends[1])]
            values = [np.where(is_first, values[0], value), np.where(is_first, value, values[1])]
        change = np.abs(values[1] - values[0])
        size = 1.0 + np.minimum(*np.abs(values))
        if np.any(change > _JUMPED * np.where(np.isfinite(size), size, 1.0)):
            return True
    return False


def _information(model: StateSpaceModel, x: Array, t: int, spread: Array) -> Array:
    """A measurement's information about x, (n, D), for x in standard deviations, (D, n, n)."""
    (size, draws), p = x.shape, model.p
    nodes, share = _nodes(model.measurement_noise)  # (k, K) and (K,)
    states, noise = np.repeat(x, len(share), axis=1), np.tile(nodes, draws)
    y = _components(model.measurement(states, t, noise, p), states.shape[1:])
    score = _slopes(lambda x: [model.log_likelihood(_wide(y, x), x, t, p)], states, spread, 1)
    score = score.reshape(draws, len(share), size)
    score = np.where(np.isfinite(score), score * spread, 0.0)
    information = score.swapaxes(1, 2) @ (share[:, None] * score)
    finite: Array = np.where(np.isfinite(information), information, 0.0)
    return finite


def _rows(information: Array, spread: Array) -> Array:
    """Rows, (R, D, n), whose outer products are an information, (D, n, n)."""
    sizes, vectors = np.linalg.eigh(information)
    kept = np.where(sizes > _LEAST * np.maximum(sizes[:, -1:], 1e-300), sizes, 0.0)
    rows = (vectors * np.sqrt(kept)[:, None]).transpose(2, 0, 1) / spread
    return rows[np.any(rows != 0.0, axis=(1, 2))]


def _nodes(kinds: tuple[str, ...]) -> tuple[Array, Array]:
    """Noise of simulated measurements, (k, K), and their shares: one normal component is exact."""
    if kinds == ("normal",):
        nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES // 2)
        return nodes[None], weights / weights.sum()
    if not kinds:
        return np.zeros((0, 1)), np.ones(1)
    if len(kinds) == 1:  # in cells, which are smaller towards the ends: for rare counts
        ends = 4.0 ** -np.arange(3.0, 14.0)
        edges = np.unique([0.0, *ends, *np.linspace(0.0, 1.0, _NODES + 1), *(1.0 - ends), 1.0])
        places, share = (edges[:-1] + edges[1:])[:, None] / 2, np.diff(edges)
    else:
        from scipy.stats import qmc  # noqa: PLC0415

        sobol = qmc.Sobol(len(kinds), scramble=False).random(4 * _NODES)
        places = np.clip(sobol + 0.5 / len(sobol), 1e-9, 1 - 1e-9)
        share = np.full(len(places), 1 / len(places))
    nodes = np.empty(places.T.shape)
    for c, kind in enumerate(kinds):
        if kind == "normal":
            nodes[c] = _quantile(places[:, c])
            nodes[c] = (nodes[c] - nodes[c].mean()) / nodes[c].std()
        else:
            nodes[c] = places[:, c] - 0.5 * (kind == "centred")
    return nodes, share
