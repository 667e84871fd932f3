"""A threshold for each possible measurement: sweeps of exchanges, two evaluations an instant.

A draw depends on the threshold of a point only through whether it is measured there. So two
evaluations, as the rule decides and with the opposite at this point, give the errors of all
thresholds at this point: sorted by the deviation with which the draws come to it, the changes add
up, and the best threshold stands where their sum is least. A price of a measurement, the Lagrange
multiplier of the budget, weighs errors against measurements; after a sweep, each price gives a
rule, and one of them keeps the budget. Points far apart hardly depend on each other, so they change
together. Errors count only until a change has little effect: what follows is mostly noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.rules import ALWAYS, NEVER, Thresholds

Array = NDArray[np.float64]
Points = tuple[int, ...]

TURNS = 8
"""Of a sweep: every eighth group changes in one."""


class Trial(NamedTuple):
    """A rule to evaluate, and the point at which it decides the opposite; None for the rule."""

    rule: Thresholds
    flipped: int | None = None
    ends: Points = ()  # last instants whose errors and measurements count; by default the horizon


class Tried(NamedTuple):
    """Results of a trial with E ends for each of D draws."""

    mse: Array  # (E, D)
    spent: Array  # (E, D)
    # (D,): with which the draw comes to the flipped point; NaN if it cannot be measured
    deviation: Array


class Changes(NamedTuple):
    """The changes by a measurement at a point in each draw, with the deviation there, (D,)."""

    deviation: Array
    mse: Array
    spent: Array


def best_threshold(changes: Changes, price: float) -> float:
    """The threshold with the least sum of errors and prices.

    >>> changes = Changes(*map(np.array, ([1.0, 2.0, 4.0], [1.0, -2.0, -3.0], [1.0, 1.0, 1.0])))
    >>> best_threshold(changes, 0.0), best_threshold(changes, 2.5), best_threshold(changes, 9.0)
    (1.5, 3.0, inf)
    """
    order = np.argsort(-changes.deviation, kind="stable")
    deviation, sums = (
        changes.deviation[order],
        np.cumsum((changes.mse + price * changes.spent)[order]),
    )
    ends = np.append(deviation[1:] < deviation[:-1], True)  # equal deviations are not told apart
    sums = np.where(ends, sums, np.inf)
    if not sums.size or not sums.min() < 0.0:
        return NEVER
    last = int(np.argmin(sums))
    return ALWAYS if last + 1 == sums.size else float(deviation[last : last + 2].mean())


@dataclass(frozen=True)
class SweepState:
    """Progress of a sweep."""

    rule: Thresholds
    left: tuple[tuple[Points, ...], ...]  # groups that are still to come, those together first
    changes: Mapping[Points, tuple[Changes, ...]]
    trials: tuple[Trial, ...] = ()  # those that were asked for


@dataclass(frozen=True)
class ThresholdSweep:
    """A sweep over all points: groups of points get their best thresholds.

    Parameters
    ----------
    rule : Thresholds
        Where the sweep starts, with a threshold for each point.
    groups : tuple of tuple of int
        Points that share a threshold, in order; one, drawn at random, stands for all of a group.
    price : float
        The price of a unit of the budget, in errors.
    ends : sequence of int
        For each point, the last instant whose error counts.
    pooled : int
        How many sweeps decide together: this one, and the last ones before it.
    changes : mapping
        Those of the sweeps before.
    """

    rule: Thresholds
    groups: tuple[Points, ...]
    price: float
    ends: Sequence[int]
    pooled: int = 1
    changes: Mapping[Points, tuple[Changes, ...]] = field(default_factory=dict)

    def init(self) -> SweepState:
        """The state before the first point."""
        turns = tuple(self.groups[first::TURNS] for first in range(TURNS))
        return SweepState(self.rule, tuple(filter(None, turns)), self.changes)

    def ask(self, state: SweepState, rng: np.random.Generator) -> SweepState:
        """The state with the next trials: the rule, and the rule flipped in groups far apart."""
        left = [state.left[place] for place in rng.permutation(len(state.left))]
        points = [group[int(rng.integers(len(group)))] for group in left[0]]
        flipped = [Trial(state.rule, point, (self.ends[point],)) for point in points]
        base = Trial(state.rule, None, tuple(sorted({*chain(*(each.ends for each in flipped))})))
        return replace(state, left=tuple(left), trials=(base, *flipped))

    def tell(self, state: SweepState, results: Sequence[Tried]) -> SweepState:
        """Take the best threshold of each group that was tried."""
        (base, *flipped), (groups, *left) = results, state.left
        changes = {**state.changes}
        for group, trial, tried in zip(groups, state.trials[1:], flipped, strict=True):
            was = tried.deviation > state.rule.thresholds[trial.flipped or 0]
            sign, is_open = np.where(was, -1.0, 1.0), np.isfinite(tried.deviation)
            end = state.trials[0].ends.index(*trial.ends)
            mse, spent = tried.mse[0] - base.mse[end], tried.spent[0] - base.spent[end]
            each = tried.deviation, sign * mse, sign * spent
            own = Changes(*(values[is_open] for values in each))
            changes[group] = (*changes.get(group, ()), own)[-self.pooled :]
        rule = at_price(state.rule, {group: changes[group] for group in groups}, self.price)
        return SweepState(rule, tuple(left), changes)

    def done(self, state: SweepState) -> bool:
        """Whether every group has a new threshold."""
        return not state.left


def at_price(
    rule: Thresholds, changes: Mapping[Points, tuple[Changes, ...]], price: float
) -> Thresholds:
    """The rule with the best thresholds of some groups for a price."""
    thresholds = [*rule.thresholds]
    for group, each in changes.items():
        pooled = Changes(*map(np.concatenate, zip(*each, strict=True)))
        for point in group:
            thresholds[point] = best_threshold(pooled, price)
    return rule._replace(thresholds=tuple(thresholds))


def point_groups(allowed: Points, ways: int, most: int) -> tuple[Points, ...]:
    """At most about `most` groups of successive points of a sensor.

    >>> point_groups((0, 1, 2, 3, 4, 5), 2, 4)
    ((0, 2), (4,), (1, 3), (5,))
    """
    groups = list[Points]()
    for way in range(ways):
        own = [point for point in allowed if point % ways == way]
        size = -(-len(own) * ways // most)
        groups += [tuple(own[first : first + size]) for first in range(0, len(own), size)]
    return tuple(groups)
