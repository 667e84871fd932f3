"""The filter that moves its particles, in plain NumPy: the reference of the compiled one.

It computes on arrays (draws, particles). Draws that need fewer exponents wait for the others.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times, first_smoothed
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws
from pfdist.filters.plain import finished, flat, mean_error, moments, of_cloud, states
from pfdist.filters.work import Estimation
from pfdist.kernels.ancestors import ancestors_of, weights_of
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, variates
from pfdist.models import StateSpaceModel
from pfdist.plugins.moving import kernel, moves
from pfdist.plugins.moving.arrays import Moved, moved_extension
from pfdist.plugins.moving.gains import Gains
from pfdist.plugins.moving.moves import GAP, INDEPENDENT, SUM, WALK, Move, derived

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
States = tuple[Array, ...]


def _derived(key: int, number: int) -> int:
    with np.errstate(over="ignore"):
        return int(derived.py_func(key, number))


@dataclass
class _Lines:
    """The lines of all particles, (D, P) each: noise and states behind each step."""

    model: StateSpaceModel
    draws: Draws
    settings: Estimation
    moved: Moved
    noise: list[States] = field(default_factory=list)
    path: list[States] = field(default_factory=list)
    # measurements: instant, sensor, in which draws they count, (D,), and log-likelihoods
    events: list[tuple[int, int, Flags, Array]] = field(default_factory=list)
    likelihood: Array = field(default_factory=lambda: np.empty(0))  # of the present measurement

    def states(self, number: int, before: States, noise: States) -> States:
        """The states behind a step."""
        cloud = len(self.draws.index), self.settings.particles
        w, p = flat(noise), self.model.p
        if number == 0:
            return states(self.model.initial(w, p), cloud)
        t = self.draws.instants[number - 1]
        return states(self.model.transition(flat(before), t, w, p), cloud)

    def likelihoods(self, k: int, sensor: int, x: States) -> Array:
        """Log-likelihoods of a sensor's measurement."""
        way, particles = self.model.ways[sensor], self.settings.particles
        y = tuple(np.repeat(values, particles) for values in self.draws.y[:, k, way.y].T)
        found = way.model.log_likelihood(y, flat(x), self.draws.instants[k], self.model.p)
        return of_cloud(found, x[0].shape)

    def variates(self, kind: str, stream: int, t: int, role: Any, component: int) -> Array:
        """A variate for each particle."""
        index, particles = np.array(self.draws.index), self.settings.particles
        return variates(kind, particles, stream, index, t, role, component)

    def taken(self, ancestors: NDArray[np.intp]) -> None:
        """Let all lines be those of ancestors."""

        def parents(values: Array) -> Array:
            return np.take_along_axis(values, ancestors, axis=1)

        self.noise = [tuple(map(parents, each)) for each in self.noise]
        self.path = [tuple(map(parents, each)) for each in self.path]
        self.events = [(k, n, counts, parents(known)) for k, n, counts, known in self.events]
        self.likelihood = parents(self.likelihood)


def filter_block(
    model: StateSpaceModel,
    draws: Draws,
    times: Times,
    stream: int,
    settings: Estimation,
    keeps_lines: bool,
) -> FilterArrays:
    """Filter some draws with a set."""
    (count, instants, _), particles = draws.z.shape, settings.particles
    cloud, kept = (count, particles), particles if keeps_lines else 0
    mean, variance = np.full((2, *draws.z.shape), np.nan)
    sizes, behind = np.full((2, count, instants), np.nan)
    log_likelihoods = np.zeros((2, count, instants))
    line_weight, line_z = np.ones((count, instants, kept)), np.empty((*draws.z.shape, kept))
    fails, share = np.zeros((count, instants), np.bool_), np.full(cloud, 1 / particles)
    lines = _Lines(model, draws, settings, moved_extension(model, draws, settings))
    first, until = first_smoothed(settings.lag, draws.instants), _continue(lines, stream)
    for k, t in enumerate(draws.instants):
        if k > until:
            _propagate(lines, k, stream)
        elif k < until:
            continue
        sensors = [n for n, point in enumerate(model.points.at(t)) if point in times]
        for sensor in sensors:
            weighs = _measure(lines, k, sensor, stream, log_likelihoods[0, :, k])
            sizes[:, k] = np.where(weighs, particles, np.nan)
            fails[:, k] |= ~weighs
        for at in range(first[k] if sensors else k, k + 1):
            z = states(
                model.quantity_of_interest(flat(lines.path[at]), draws.instants[at], model.p), cloud
            )
            line_z[:, at] = np.stack(z, axis=1)[..., :kept]
            if settings.lag:
                behind[:, at] = particles if sensors else np.nan
            for c, values in enumerate(z):
                is_angle = draws.model.is_angle[c]
                mean[:, at, c], variance[:, at, c] = moments(values, share, is_angle)
            if ESTIMATORS[settings.estimator].by_error:
                variance[:, at] = mean_error(draws, at, flat(z), mean[:, at], share)
    found = FilterArrays(
        np.empty(0), np.empty(0, np.bool_), mean, variance, sizes, np.empty((0, 0)),
        np.full((2, *draws.z.shape), np.nan), np.stack(lines.path[-1], axis=1), np.ones(cloud),
        behind, line_z, line_weight, log_likelihoods, np.empty((count, 0), np.uint8),
        **({} if draws.x.size else _written(lines)),
    )  # fmt: skip
    return finished(draws, settings, fails, found)


def _written(lines: _Lines) -> dict[str, Any]:
    """The lines, for another filter to continue."""
    most = max(1, len(lines.model.initial_noise), len(lines.model.process_noise))
    (count, particles), steps = lines.path[0][0].shape, len(lines.noise)
    noise = np.zeros((count, steps, most, particles), np.float32)
    for k, of_step in enumerate(lines.noise):
        for c, values in enumerate(of_step):
            noise[:, k, c] = values
    counts = np.zeros((count, steps, len(lines.model.ways)), np.uint8)
    for k, sensor, weighs, _ in lines.events:
        counts[:, k, sensor] = weighs
    return {"noise": noise, "first_states": np.stack(lines.path[0], axis=1), "counts": counts}


def _continue(lines: _Lines, stream: int) -> int:
    """Take the lines, or the states, of a prior; the last instant with lines, or -1."""
    prior, draws, particles = lines.settings.prior, lines.draws, lines.settings.particles
    if not isinstance(prior, Cloud):
        return -1
    chosen = prior.chosen_for_filters(particles, draws.index, stream)
    carried = lines.moved.carried
    x = prior.x if carried is None else carried.states
    lines.path.append(tuple(values[chosen] for values in x))
    lines.noise.append(())
    if carried is None:
        return 0
    for k, noise in enumerate(carried.noise):
        kinds = lines.model.process_noise if k else lines.model.initial_noise
        taken = tuple(noise[c, chosen].astype(np.float64) for c in range(len(kinds)))
        if k:
            lines.path.append(lines.states(k, lines.path[-1], taken))
            lines.noise.append(taken)
        elif carried.begins:
            lines.noise[0] = taken
        for sensor in np.flatnonzero(carried.counts[k]):
            known = lines.likelihoods(k, int(sensor), lines.path[k])
            lines.events.append((k, int(sensor), np.ones(len(chosen), np.bool_), known))
    return len(carried.noise) - 1


def _propagate(lines: _Lines, k: int, stream: int) -> None:
    """Begin the lines, or let them reach the next instant."""
    model = lines.model
    kinds, t, role = model.initial_noise, 0, FILTER_INITIAL
    if k > 0:
        kinds, t, role = model.process_noise, lines.draws.instants[k - 1], FILTER_PROCESS
    noise = tuple(lines.variates(kind, stream, t, role, c) for c, kind in enumerate(kinds))
    lines.path.append(lines.states(k, lines.path[-1] if k else (), noise))
    lines.noise.append(noise)


def _measure(lines: _Lines, k: int, sensor: int, stream: int, evidence: Array) -> Flags:
    """Let a measurement's likelihood enter; whether it weighs each draw. Adds the log evidence."""
    particles = lines.settings.particles
    lines.likelihood = lines.likelihoods(k, sensor, lines.path[k])
    possible = np.isfinite(lines.likelihood)
    weighs: Flags = np.any(possible, axis=1)
    power, number = np.zeros(len(possible)), 0
    evidence[~weighs] = -np.inf
    drops, active = weighs & ~np.all(possible, axis=1), weighs
    key = _derived(stream, lines.model.points.at(lines.draws.instants[k])[sensor])
    while active.any():
        rest = 1.0 - power
        exponent = rest if number >= kernel.MOST else _exponent(lines.likelihood, rest)
        exponent = np.where(drops, 0.0, exponent)
        weight = _weights(lines.likelihood, exponent)
        highest = np.where(np.isfinite(lines.likelihood), lines.likelihood, -np.inf).max(axis=1)
        added = exponent * highest + np.log(weight.sum(axis=1)) - np.log(particles)
        evidence[active] += added[active]
        power = np.where(~drops & (exponent == rest), 1.0, power + exponent)
        drops = np.zeros_like(drops)
        root, mean = _moments_of_noise(lines, weight)
        own = _derived(key, number)
        chosen = ancestors_of(
            lines.settings.resampling, weight, _derived(own, 0), lines.draws.index, 0
        )
        lines.taken(np.where(active[:, None], chosen, np.arange(particles)))
        for place in range(len(lines.moved.moves)):
            stream_of_move = _derived(own, place + 1)
            proposed = _proposed(lines, k, place, stream_of_move, mean, root)
            if proposed is not None:
                _judge(lines, k, sensor, power, active, stream_of_move, proposed)
        active = active & (power < 1.0)
        number += 1
    lines.events.append((k, sensor, weighs, lines.likelihood))
    return weighs


def _weights(likelihood: Array, exponent: Array) -> Array:
    possible = np.isfinite(likelihood)
    powers = exponent[:, None] * np.where(possible, likelihood, 0.0)
    return weights_of(np.where(possible, powers, -np.inf))


def _exponent(likelihood: Array, most: Array) -> Array:
    """The largest exponents, to three digits, that keep half of the particles effective."""

    def is_effective(exponent: Array) -> Flags:
        weight = _weights(likelihood, exponent)
        total, squares = weight.sum(axis=1), np.sum(weight**2, axis=1)
        found: Flags = total * total >= kernel.EFFECTIVE * likelihood.shape[1] * squares
        return found

    whole, low = is_effective(most), 0.5 * most
    for _ in range(kernel.HALVINGS):
        low = np.where(is_effective(low), low, 0.5 * low)
    high = 2.0 * low
    for _ in range(kernel.BISECTIONS):
        middle = 0.5 * (low + high)
        kept = is_effective(middle)
        low, high = np.where(kept, middle, low), np.where(kept, high, middle)
    return np.where(whole, most, low)


def _moments_of_noise(lines: _Lines, weight: Array) -> tuple[Array, Array]:
    """Root of the covariance of weighted initial noise, and its mean."""
    share = weight / weight.sum(axis=1, keepdims=True)
    noise = np.stack(lines.noise[0], axis=1) if lines.noise[0] else np.empty((len(share), 0, 1))
    mean = np.sum(share[:, None] * noise, axis=2)
    deviation = noise - mean[:, :, None]
    covariance = np.einsum("dp,dap,dbp->dab", share, deviation, deviation)
    kinds = lines.model.initial_noise[: len(lines.noise[0])]
    for a, first in enumerate(kinds):
        for b, second in enumerate(kinds):
            if a != b and (first, second) != ("normal", "normal"):
                covariance[:, a, b] = 0.0
    root = np.zeros_like(covariance)
    for a in range(len(kinds)):
        for b in range(a + 1):
            rest = covariance[:, a, b] - np.sum(root[:, a, :b] * root[:, b, :b], axis=1)
            is_diagonal = np.sqrt(np.maximum(rest, 0.0) + kernel.LEAST) if a == b else None
            root[:, a, b] = rest / root[:, b, b] if is_diagonal is None else is_diagonal
    return root, mean


# --- moves ----------------------------------------------------------------------------------------

_Proposed = tuple[list[States], list[States], Array]
"""Noise, states, and log density of the noise, new less old."""


def _proposed(
    lines: _Lines, k: int, place: int, stream: int, mean: Array, root: Array
) -> _Proposed | None:
    """The proposals of a move; None if it does not apply."""
    move, ratio = lines.moved.moves[place], np.zeros_like(lines.likelihood)
    if move.kind in (WALK, INDEPENDENT):
        if not lines.noise[0]:
            return None
        noise = [_initial(lines, move, stream, mean, root, ratio), *lines.noise[1:]]
        gains = lines.moved.gains
        if place == 0 and gains is not None and k > 0:
            return noise, _path_kept(lines, gains, noise, ratio), ratio
    else:
        process = _process(lines, k, move, stream)
        if process is None:
            return None
        noise = [lines.noise[0], *process]
    path = list[States]()
    for number, each in enumerate(noise):
        is_given = number == 0 and not each
        path.append(
            lines.path[0] if is_given else lines.states(number, path[-1] if number else (), each)
        )
    return noise, path, ratio


def _on_circle(value: Array, kind: str) -> Array:
    if kind == "uniform":
        return np.clip(value - np.floor(value), moves.INSIDE, 1.0 - moves.INSIDE)
    return value - np.rint(value)


def _rounded(value: Array) -> Array:
    return value.astype(np.float32).astype(np.float64)


def _centred(kind: str) -> str:
    return "normal" if kind == "normal" else "centred"


def _initial(
    lines: _Lines, move: Move, stream: int, mean: Array, root: Array, ratio: Array
) -> States:
    """New initial noise; its log density, less that of the old, is added to the ratio."""
    kinds, new = lines.model.initial_noise, list[Array]()
    drawn = [
        lines.variates(_centred(kind), stream, 0, moves.MOVED, c) for c, kind in enumerate(kinds)
    ]
    walked = (move.scale if move.kind == WALK else moves.STEP) * moves.WALKED / len(kinds) ** 0.5
    for a, (kind, old) in enumerate(zip(kinds, lines.noise[0], strict=True)):
        change = sum(root[:, a, b, None] * drawn[b] for b in range(a + 1))
        is_independent = move.kind == INDEPENDENT and kind == "normal"
        factor = move.scale if is_independent else walked
        value = (mean[:, a, None] if is_independent else old) + factor * change
        new.append(_rounded(value if kind == "normal" else _on_circle(value, kind)))
        if kind == "normal":
            ratio += 0.5 * (old * old - new[-1] * new[-1])
    if move.kind == INDEPENDENT:
        for noise, sign in ((lines.noise[0], -0.5), (new, 0.5)):
            solved = list[Array]()
            for a, kind in enumerate(kinds):
                rest = noise[a] - mean[:, a, None]
                rest -= sum(root[:, a, b, None] * solved[b] for b in range(a))
                solved.append(rest / root[:, a, a, None] if kind == "normal" else 0.0 * rest)
                ratio += sign / (move.scale * move.scale) * solved[-1] ** 2
    return tuple(new)


def _path_kept(lines: _Lines, gains: Gains, noise: list[States], ratio: Array) -> list[States]:
    """Change process noise so that the components that it drives stay; the path."""
    path = [lines.states(0, (), noise[0])]
    for number in range(1, len(noise)):
        here = lines.states(number, path[-1], noise[number])
        new = list[Array]()
        for c, old in enumerate(noise[number]):
            change = np.zeros_like(old)
            for j, component in enumerate(gains.driven):
                difference = lines.path[number][component] - here[component]
                change += gains.inverse[number - 1, c, j] * difference
            new.append(_rounded(old + change))
            ratio += 0.5 * (old * old - new[-1] * new[-1])
        noise[number] = tuple(new)
        path.append(lines.states(number, path[-1], noise[number]))
    return path


def _process(lines: _Lines, k: int, move: Move, stream: int) -> list[States] | None:
    """New process noise of the steps 1 to k; None if none changes."""
    kinds, steps = lines.model.process_noise, np.arange(1, k + 1)[:, None]
    if not k or not kinds or (move.kind == SUM and k < 2):
        return None
    changes = _stretch(lines, k, move, stream, steps)  # (k, D)
    number = changes.sum(axis=0)[:, None]
    found = list[list[Array]]()
    for c, kind in enumerate(kinds):
        old = np.stack([each[c] for each in lines.noise[1:]])
        drawn = np.stack([
            lines.variates(_centred(kind), stream, t, moves.MOVED, c) for t in range(1, k + 1)
        ])  # fmt: skip
        keeps_sum, counted = move.kind == SUM and kind == "normal", changes[:, :, None]
        old_mean, new_mean = (
            _added(np.where(counted & keeps_sum, each, 0.0)) / number for each in (old, drawn)
        )
        fresh = move.scale * (drawn - new_mean)
        new = old_mean + np.sqrt(1.0 - move.scale * move.scale) * (old - old_mean) + fresh
        if kind != "normal":
            new = _on_circle(old + fresh, kind)
        found.append([*np.where(counted, _rounded(new), old)])
    return [*zip(*found, strict=True)]


def _added(values: Array) -> Array:
    """The sum over the steps, one after another."""
    total: Array = np.cumsum(values, axis=0)[-1]
    return total


def _stretch(lines: _Lines, k: int, move: Move, stream: int, steps: NDArray[np.intp]) -> Flags:
    """Whether each step changes in each draw, (k, D)."""
    instants = np.zeros((k, len(lines.draws.index)), np.bool_)
    for at, _, counts, _ in lines.events:
        if at < k:
            instants[at] |= counts
    before = np.where(instants, np.arange(k)[:, None], 0).max(axis=0)
    if move.kind == GAP:
        changes: Flags = steps > before
        return changes
    length = np.rint(move.span * (k / (instants.sum(axis=0) + 1))).clip(2, k)
    place = lines.variates("uniform", stream, 0, moves.PLACED, 0)[:, 0]
    first = 1 + np.floor(place * (k - length + 1))
    chosen: Flags = (first <= steps) & (steps < first + length)
    return chosen


def _judge(
    lines: _Lines,
    k: int,
    sensor: int,
    power: Array,
    active: Flags,
    stream: int,
    proposed: _Proposed,
) -> None:
    """Accept proposals by all likelihoods so far."""
    noise, path, ratio = proposed
    tried = list[Array]()
    for at, which, counts, known in lines.events:
        tried.append(lines.likelihoods(at, which, path[at]))
        ratio = ratio + np.where(counts[:, None], tried[-1] - known, 0.0)
    likelihood = lines.likelihoods(k, sensor, path[k])
    ratio = ratio + power[:, None] * (likelihood - lines.likelihood)
    bound = -lines.variates("exponential", stream, 0, moves.ACCEPTED, 0)
    takes = (bound < ratio) & (ratio < np.inf) & np.isfinite(likelihood) & active[:, None]

    def either(new: States, old: States) -> States:
        return tuple(np.where(takes, a, b) for a, b in zip(new, old, strict=True))

    lines.noise = [either(*pair) for pair in zip(noise, lines.noise, strict=True)]
    lines.path = [either(*pair) for pair in zip(path, lines.path, strict=True)]
    lines.events = [
        (at, which, counts, np.where(takes, new, known))
        for (at, which, counts, known), new in zip(lines.events, tried, strict=True)
    ]
    lines.likelihood = np.where(takes, likelihood, lines.likelihood)
