"""The relaxation as it is defined, for one set after another: without automaton and programme."""

from collections.abc import Collection, Iterable
from dataclasses import replace
from functools import cache
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.every_set import every_set
from oracles.in_turn import in_turn
from oracles.systems import SYSTEMS
from pfdist import StateSpaceModel
from pfdist.common.measurement_times import Times
from pfdist.filters.kalman import expected_errors
from pfdist.problem.constraints import Constraints
from pfdist.problem.feasible import Feasible
from pfdist.search.first_windows import relaxation_with
from pfdist.search.relaxation import NOTHING, Relaxation, Window

HORIZON, BUDGET = 8, 4
PRICES = (3, 1, 4, 1, 5, 9, 2, 6, 5)
COUNTED: dict[str, dict[str, Any]] = {
    "free": {},
    "forbidden": {"forbidden": (2, 5)},
    "required": {"required": (1, 7)},
    "spaced": {"minimum_spacing": 2},
    "all": {"forbidden": (3,), "required": (6,), "minimum_spacing": 2},
}
MONEY: dict[str, dict[str, Any]] = {
    "money": {"price": PRICES, "total_price": 11},
    "money and all": {"price": PRICES, "total_price": 13, **COUNTED["all"]},
}
FEASIBLE = {name: Feasible(HORIZON, BUDGET, **given) for name, given in COUNTED.items()} | {
    name: Feasible(HORIZON, **given) for name, given in MONEY.items()
}

Array = NDArray[np.float64]


def with_each(names: Collection[str]) -> pytest.MarkDecorator:
    """Each linear system with one of some names, in turn."""
    pairs = zip(SYSTEMS.items(), cycle(names), strict=False)
    return pytest.mark.parametrize(
        ("model", "name"),
        [pytest.param(model, name, id=f"{system}-{name}") for (system, model), name in pairs],
    )


class Case(NamedTuple):
    """Constraints, windows and prices of a relaxation that is like no other."""

    name: str
    seed: int
    unit: int

    def make(self) -> tuple[Relaxation, Array]:
        """A relaxation with windows of any length, and errors that have nothing in common."""
        constraints, rng = FEASIBLE[self.name], np.random.default_rng(self.seed)
        short = relaxation_with(constraints, 1 + self.seed % 2, 1 + self.seed % 4)
        sets, number = satisfying(constraints), 12 * (1 + self.seed)
        relaxation = replace(short, unit=self.unit).grown(ends_of(sets, rng, number))
        far = rng.choice(len(relaxation.windows), 5).tolist()
        relaxation = relaxation.grown((), {relaxation.windows[number] for number in far})
        return relaxation, rng.exponential(size=int(relaxation.offsets[-1]))


_CASES = [
    Case(name, seed, unit)
    for seed in (1, 2)
    for name in FEASIBLE
    for unit in ((1, 2, 3) if name in MONEY else (1,))
]
cases = in_turn("case", _CASES)


@cache
def satisfying(constraints: Constraints) -> list[Times]:
    """All sets that satisfy the constraints, but for their number or their cost."""
    each = (constraints.forbidden, constraints.required, constraints.minimum_spacing)
    instants = constraints.horizon + 1
    return [times for n in range(instants + 1) for times in every_set(instants - 1, n, *each)]


def affordable(relaxation: Relaxation, spent: int) -> list[Times]:
    """The sets of so many measurements, or those that cost at most so many units."""
    prices, sets = relaxation.prices, satisfying(relaxation.constraints)
    if relaxation.constraints.counted:
        return [times for times in sets if len(times) == spent]
    return [times for times in sets if sum(prices[time] for time in times) <= spent]


def longest_end(known: Collection[Window], times: Times) -> Window:
    """The longest known window that the measurements end with."""
    whole = (NOTHING, *times)
    ends = (whole[first:] for first in range(len(whole)))
    return next(end for end in ends if end in known)


def counted_errors(model: StateSpaceModel, relaxation: Relaxation) -> Array:
    """Exact errors of all windows at the instants at which they count, window by window."""
    return counted(relaxation, expected_errors(model, relaxation.horizon, relaxation.sets))


def counted(relaxation: Relaxation, errors: Array) -> Array:
    """The errors (..., E) that count, of all windows at all instants (..., W, T+1)."""
    t = np.arange(relaxation.horizon + 1)
    first, ends = relaxation.first[:, None], relaxation.ends[:, None]
    flat: Array = errors[..., (first <= t) & (t <= ends)]
    return flat


def relaxed_errors(relaxation: Relaxation, errors: Array, times: Times) -> Array:
    """The error at each instant of a set in the relaxation, (..., T+1); inf where none is known.

    Parameters
    ----------
    relaxation : Relaxation
    errors : array of float64, (..., E)
        As `counted` gives them.
    times : tuple of int
    """
    only = relaxation.windows if relaxation.only is None else relaxation.only
    columns, sensors = [], relaxation.constraints.points.ways
    for t in range(relaxation.horizon + 1):
        until = tuple(time for time in times if time // sensors <= t)
        window = longest_end(relaxation.index, until)
        near = t < window[-1] // sensors + relaxation.longest_gap or window in relaxation.far
        counts = window if near else window[-1:]  # nothing was measured for too long
        if window in only and counts in only:
            number = relaxation.index[counts]
            place = relaxation.offsets[number] + t - relaxation.first[number]
            columns.append(errors[..., place])
        else:
            columns.append(np.full(errors.shape[:-1], np.inf))
    return np.stack(columns, axis=-1)


def ends_of(sets: Iterable[Times], rng: np.random.Generator, number: int) -> list[Window]:
    """Random ends of random beginnings of some sets: windows that a relaxation may know."""
    beginnings = [(NOTHING, *times[:size]) for times in sets for size in range(1, len(times) + 1)]
    found = []
    for index in rng.integers(len(beginnings), size=number).tolist():
        beginning = beginnings[index]
        found.append(beginning[int(rng.integers(len(beginning))) :])
    return found
