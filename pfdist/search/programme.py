"""The dynamic programme over known windows and sums spent: the least relaxed expected MSE.

A set spends its number of measurements, or their prices in units. One programme gives the results
for all sums up to the largest.

If a set is best in a relaxation but not in truth, its windows are too short: they add measurements
that the set does not contain. So each of its windows grows by a measurement, and the next relaxed
error is closer to the set's own error. If all windows of a set are whole beginnings, its relaxed
error is its own error. If it is still the best, it is proved to be optimal.

Largest numbers, as those of visits, are relaxed by Lagrange multipliers.

Sources: Bellman, "Dynamic programming", 1957. Christofides, Mingozzi, Toth, "State-space relaxation
procedures for the computation of bounds to routing problems", Networks 11, 1981.
Righini, Salani, "New dynamic programming algorithms for the resource constrained elementary
shortest path problem", Networks 51, 2008 (decremental state-space relaxation). Geoffrion,
"Lagrangean relaxation for integer programming", Mathematical Programming Study 2, 1974.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.stopping import check
from pfdist.search.relaxation import NOTHING, START, Moves, Relaxation, Window
from pfdist.search.setups import Indices

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Programme:
    """The programme for all sums that may be spent, up to `most`.

    `errors` (E,) are expected errors of all windows at all instants that are known, window by
    window; see `Relaxation.offsets`.

    If measurements are counted, a set makes exactly the number of the sum. Money may be left over.

    A measurement adds the multipliers of all that it begins to the sum of errors, and multipliers
    times the largest numbers are subtracted at the end. With multipliers of at least 0, the relaxed
    error of a set that keeps these numbers is at most its own error, so the minimum is still a
    lower bound.
    """

    relaxation: Relaxation
    errors: Array
    most: int
    multipliers: tuple[float, ...] = ()  # of each setup, 0 without a largest number; or empty

    @property
    def mse(self) -> Array:
        """The least relaxed expected MSE of each sum, (most+1,)."""
        return self._mean(self._from[self._start])

    def path(self, spent: int) -> Times:
        """The times with the least error for a sum; empty if no set has this price."""
        is_known = np.isfinite(self._from[self._start, spent])
        return self._path_from(self._start, spent) if is_known else ()

    def of_set(self, times: Times) -> float:
        """The relaxed expected MSE of a set, without multipliers."""
        return float(self.of_sets([times])[0])

    def of_sets(self, sets: Sequence[Times]) -> Array:
        """The relaxed expected MSE of each set, (S,), without multipliers; inf if it is no path."""
        relaxation, sizes = self.relaxation, np.array([len(times) for times in sets])
        errors = np.empty(len(sets))
        for size in np.unique(sizes).tolist():
            places = np.flatnonzero(sizes == size)
            following = np.full((places.size, size + 1), relaxation.end)
            following[:, :size] = [sets[place] for place in places.tolist()]
            windows, is_path = (
                np.full(following.shape, relaxation.index[START]),
                np.full(places.size, True),
            )
            for k in range(size):
                after = relaxation.after[windows[:, k], following[:, k]]
                is_path &= after >= 0
                windows[:, k + 1] = np.maximum(after, 0)
            sums = self._between(windows.ravel(), following.ravel()).reshape(following.shape)
            errors[places] = np.where(is_path, sums.sum(axis=1), np.inf)
        mean: Array = errors / (relaxation.horizon + 1)
        return mean

    def through(self, spent: int) -> Array:
        """The least relaxed expected MSE of all sets of a sum through each window, (W,)."""
        least = (self._to[:, : spent + 1] + self._from[:, spent::-1]).min(axis=1)
        return self._mean(least.reshape(-1, self.relaxation.states).min(axis=1))

    def path_through(self, window: int, spent: int) -> Times:
        """The times with the least error among the sets of a sum that pass through a window."""
        states = window * self.relaxation.states + np.arange(self.relaxation.states)
        sums = self._to[states, : spent + 1] + self._from[states, spent::-1]
        state, before = divmod(int(np.argmin(sums)), spent + 1)
        state += int(states[0])
        return (*self._path_to(state, before), *self._path_from(state, spent - before))

    @property
    def _start(self) -> int:
        """The state before the first measurement."""
        return self.relaxation.index[START] * self.relaxation.states

    @property
    def _states(self) -> int:
        return len(self.relaxation.windows) * self.relaxation.states

    @cached_property
    def _to(self) -> Array:
        """The least sum of errors before the last measurement of each state, (S, most+1)."""
        error = np.full((self._states, self.most + 1), np.inf)
        error[self._start, 0] = 0.0
        for moves in self._moves(self.relaxation.constraints.allowed):
            check()
            between = self._until(moves)
            reached = np.full((moves.before.size, self.most + 1), np.inf)
            for price, some in self._priced(moves):
                before = error[moves.before[some], : self.most + 1 - price]
                reached[some, price:] = between[some, None] + before
            error[moves.after] = np.minimum.reduceat(reached, moves.starts, axis=0)
        return error

    @property
    def _from(self) -> Array:
        """The least sum of errors from the last measurement of each state on, (S, most+1)."""
        return self._onward[0]

    @cached_property
    def _onward(self) -> tuple[Array, Indices]:
        """`_from`, and the next time that reaches it, (S, most+1); -1 if nothing is measured."""
        error = np.full((self._states, self.most + 1), np.inf)
        following = np.full(error.shape, NOTHING)
        left_over = 0 if self.relaxation.constraints.counted else self.most
        error[:, : left_over + 1] = np.repeat(self._at_the_end, self.relaxation.states)[:, None]
        for moves in self._moves(reversed(self.relaxation.constraints.allowed)):
            check()
            between = self._until(moves)
            for price, some in self._priced(moves):
                before = moves.before[some]
                onward = between[some, None] + error[moves.to[some], : self.most + 1 - price]
                known, times = error[before, price:], following[before, price:]
                # Between equal sums, the end wins, then the earliest time.
                least = (onward < known) | ((onward == known) & (times != NOTHING))
                error[before, price:] = np.where(least, onward, known)
                following[before, price:] = np.where(least, moves.time, times)
        return error, following

    def _moves(self, times: Iterable[int]) -> Iterator[Moves]:
        """The moves by these times, if any."""
        return (moves for moves in map(self.relaxation.moves, times) if moves.before.size)

    def _priced(self, moves: Moves) -> Iterator[tuple[int, NDArray[np.bool_]]]:
        """Each price of some moves that can be paid, and the moves that have it."""
        prices = self.relaxation.priced(moves)
        for price in np.unique(prices).tolist():
            if price <= self.most:
                yield price, prices == price

    @cached_property
    def _at_the_end(self) -> Array:
        """The sum of errors from the last measurement of each window to T, (W,)."""
        every = np.arange(len(self.relaxation.windows))
        rest = self._between(every, self.relaxation.end)
        last_required = max(self.relaxation.constraints.required, default=NOTHING)
        return np.where(self.relaxation.last >= last_required, rest, np.inf)

    def _until(self, moves: Moves) -> Array:
        """Sums of errors from the last measurement of each state up to and with a measurement."""
        windows = (moves.before // self.relaxation.states).astype(np.int64)
        between = self._between(windows, moves.time)
        return between + np.array(self.multipliers) @ moves.begun if self.multipliers else between

    def _mean(self, sums: Array) -> Array:
        """Expected MSEs, or their bounds, from sums of errors and multipliers."""
        most = self.relaxation.constraints.most if self.multipliers else {}
        left: Array = sums - sum(self.multipliers[place] * most[place] for place in most)
        return left / (self.relaxation.horizon + 1)

    def _between(self, windows: Indices, time: Indices | int) -> Array:
        """Sums of errors from the last measurement of each window to just before the next."""
        return self._sums(windows, np.broadcast_to(time, windows.shape))

    @cached_property
    def _sums(self) -> Callable[[Indices, Indices], Array]:
        return self.relaxation.sums(self.errors)

    def _path_to(self, state: int, spent: int) -> Times:
        """The times before and up to a state's last, by following the programme back."""
        relaxation, times = self.relaxation, list[int]()
        while state != self._start:
            time = int(relaxation.last[state // relaxation.states])
            moves = relaxation.moves(time)
            left = spent - relaxation.priced(moves)
            is_possible = (moves.to == state) & (left >= 0)
            reached = self._until(moves) + self._to[moves.before, np.maximum(left, 0)]
            least = int(np.argmin(np.where(is_possible, reached, np.inf)))
            state, spent = int(moves.before[least]), int(left[least])
            times.append(time)
        return tuple(reversed(times))

    def _path_from(self, state: int, spent: int) -> Times:
        """The times after a state's last, by following the programme to the end of the horizon."""
        relaxation, following, times = self.relaxation, self._onward[1], list[int]()
        while (time := int(following[state, spent])) != NOTHING:
            moves = relaxation.moves(time)
            (place,) = np.flatnonzero(moves.before == state)
            spent -= int(relaxation.priced(moves)[place])
            state = int(moves.to[place])
            times.append(time)
        return tuple(times)


def with_multipliers(
    relaxation: Relaxation, errors: Array, spent: int, known_mse: float
) -> Programme:
    """The programme of a sum, with the multipliers that maximise its least error.

    Any multipliers give a lower bound. Each is limited to the sum of errors of a feasible set of
    this sum, whose expected MSE is `known_mse`.
    """
    most, setups = relaxation.constraints.most, range(len(relaxation.constraints.setups))
    unlimited = Programme(relaxation, errors, spent)
    if not (most and 0 < known_mse < np.inf):
        return unlimited
    largest = known_mse * (relaxation.horizon + 1)

    def programme(shares: Array) -> Programme:
        limited = dict(zip(most, (largest * shares).tolist(), strict=True))
        return replace(unlimited, multipliers=tuple(limited.get(each, 0.0) for each in setups))

    def lowest(shares: Array) -> tuple[float, Array]:
        path = programme(shares).path(spent)
        own = relaxation.begun(path)[[*most]]
        return unlimited.of_set(path) / known_mse, own - [*most.values()]

    return programme(highest(lowest, np.zeros(len(most))))


_ROUNDS = 100  # at most
_DIGITS = 6  # of an argument; those of the solver may end otherwise elsewhere, and all are valid
_SETTLED = 1e-4  # relative distance of the value from the largest that the planes allow


def highest(
    lowest: Callable[[Array], tuple[float, Array]], start: Array, total: float | None = None
) -> Array:
    """The n arguments in 0..1 that maximise the minimum of many planes.

    `lowest` gives the plane that is the lowest at some arguments: its value at 0 and its slopes
    (n,). Source: Kelley, "The cutting-plane method for solving convex programs", Journal of the
    Society for Industrial and Applied Mathematics 8, 1960.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  it loads only where planes are cut

    # Unknowns: the arguments, and the value of the lowest plane, which is maximised.
    objective, bounds = [0.0] * len(start) + [-1.0], [(0.0, 1.0)] * len(start) + [(None, None)]
    sums = None if total is None else [[1.0] * len(start) + [0.0]]
    totals = None if total is None else [total]
    best, largest, at = start, -np.inf, start
    values, planes = list[float](), list[list[float]]()
    for _ in range(_ROUNDS):
        value, slopes = lowest(at)
        values.append(value)
        planes.append([*(-slopes).tolist(), 1.0])
        value += float(np.sum(slopes * at))
        if value > largest:
            best, largest = at, value
        found = linprog(objective, planes, values, sums, totals, bounds)
        if found.x is None or found.x[-1] <= largest * (1 + _SETTLED):
            break
        at = np.asarray(np.round(np.clip(found.x[:-1], 0.0, None), _DIGITS), np.float64)
        at = at if total is None else total * at / at.sum()
    return best


def near_optimal(programme: Programme, spent: int, most: int, below: float) -> list[Times]:
    """At most `most` different near-optimal sets of a relaxation, best first.

    Each set spends the sum `spent`. Each but the first is the best set through a window through
    which no earlier set passes, and its relaxed expected MSE is less than `below`.
    """
    relaxation, through = programme.relaxation, programme.through(spent)
    sets, passed = dict[Times, None](), set[int]()
    for window in np.argsort(through, kind="stable").tolist():
        if len(sets) == most or not np.isfinite(through[window]):
            break
        if sets and through[window] >= below:
            break
        check()
        if window not in passed:
            times = programme.path_through(window, spent)
            sets[times] = None
            passed.update(relaxation.windows_of(times))
    return list(sets)


def longer(
    relaxation: Relaxation, sets: Iterable[Times]
) -> tuple[frozenset[Window], frozenset[Window]]:
    """The windows of some sets, each with one more measurement, that the relaxation lacks."""
    # Only windows that are not whole beginnings grow, each backwards by one measurement. In each
    # round the windows of a best set therefore become longer, until the set has its own error.
    windows, far = set[Window](), set[Window]()
    for times in sets:
        whole = (NOTHING, *times, relaxation.end)
        passed = [relaxation.windows[number] for number in relaxation.windows_of(times)]
        for number, window in enumerate(passed):
            if len(window) <= number:
                windows.add(whole[number - len(window) : number + 1])
        far.update(relaxation.overreached(times))
    return frozenset(windows), frozenset(far)
