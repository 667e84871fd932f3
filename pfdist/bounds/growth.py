"""Longer windows where they matter: along the sets that are best in the relaxation.

A set that is best in a relaxation, but not in truth, has windows that are too short: they add
measurements that the set does not contain. So each of its windows grows by a measurement, and the
next programme sees more of the set's own error. A set whose windows are all whole beginnings has
its own error. If it is still the best, it is proved to be optimal.

Source: Righini, Salani, "New dynamic programming algorithms for the resource constrained elementary
shortest path problem", Networks 51, 2008 (decremental state-space relaxation).
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from pfdist.bounds.programme import Programme
from pfdist.bounds.relaxation import NOTHING, Relaxation, Window
from pfdist.times.measurement_times import Times


class Longer(NamedTuple):
    """Windows by which a relaxation can grow."""

    windows: frozenset[Window]  # windows that the relaxation does not know yet
    far: frozenset[Window]  # known windows whose errors are to count up to T


def near_optimal(programme: Programme, spent: int, most: int, below: float) -> list[Times]:
    """At most `most` different sets that are nearly the best of a relaxation, the best first.

    Each set spends the sum `spent`. Each but the first is the best of all sets that pass a window
    which no set before it passes, and its relaxed expected MSE is less than `below`.
    """
    relaxation, through = programme.relaxation, programme.through(spent)
    sets, passed = dict[Times, None](), set[int]()
    for window in np.argsort(through, kind="stable").tolist():
        if len(sets) == most or not np.isfinite(through[window]):
            break
        if sets and through[window] >= below:
            break
        if window not in passed:
            times = programme.path_through(window, spent)
            sets[times] = None
            passed.update(relaxation.windows_of(times))
    return list(sets)


def longer(relaxation: Relaxation, sets: Iterable[Times]) -> Longer:
    """The windows of some sets with one more measurement each, unless the relaxation knows them."""
    # Only windows that are not whole beginnings grow, each backwards by one measurement. In each
    # round the windows of a best set therefore become longer, until the set has its own error.
    windows, far = set[Window](), set[Window]()
    for times in sets:
        whole = (NOTHING, *times)
        passed = [relaxation.windows[number] for number in relaxation.windows_of(times)]
        for number, window in enumerate(passed):
            if len(window) <= number:
                windows.add(whole[number - len(window) : number + 1])
        far.update(relaxation.overreached(times))
    return Longer(frozenset(windows), frozenset(far))
