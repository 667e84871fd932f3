"""Longer windows where they matter: along the sets that are best in the relaxation.

A set that is best in a relaxation, but not in truth, has windows that are too short: they add
measurements that the set does not contain. So each of its windows grows by a measurement, and the
next programme sees more of the set's own error. A set whose windows are all whole beginnings has
its own error. If it is still the best, it is proved to be optimal.

References
----------
Righini, Salani, "New dynamic programming algorithms for the resource constrained elementary
shortest path problem", Networks 51, 2008 (decremental state-space relaxation).
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from pfdist.bounds.programme import Programme
from pfdist.bounds.relaxation import NOTHING, Relaxation, Window
from pfdist.times.measurement_times import Times


class Longer(NamedTuple):
    """Windows that a relaxation does not know yet, and windows that are to reach farther.

    Parameters
    ----------
    windows : frozenset of tuples of int
    far : frozenset of tuples of int
        Windows whose errors are to count up to T.
    """

    windows: frozenset[Window]
    far: frozenset[Window]


def near_optimal(programme: Programme, spent: int, most: int, below: float) -> list[Times]:
    """Give different sets that are nearly the best of a relaxation, the best first.

    Each but the first is the best of all sets that pass a window which no set before it passes.

    Parameters
    ----------
    programme : Programme
    spent : int
        The sum that each set spends.
    most : int
        Largest number of sets.
    below : float
        The relaxed expected MSE of each but the first is less than this.
    """
    relaxation, through = programme.relaxation, programme.through(spent)
    found, passed = dict[Times, None](), set[int]()
    for window in np.argsort(through, kind="stable").tolist():
        if len(found) == most or not np.isfinite(through[window]):
            break
        if found and through[window] >= below:
            break
        if window not in passed:
            times = programme.path_through(window, spent)
            found[times] = None
            passed.update(relaxation.windows_of(times))
    return list(found)


def longer(relaxation: Relaxation, sets: Iterable[Times]) -> Longer:
    """Give the windows of some sets with a measurement more each, as far as they are unknown."""
    windows, far = set[Window](), set[Window]()
    for times in sets:
        whole = (NOTHING, *times)
        known = [relaxation.windows[number] for number in relaxation.windows_of(times)]
        for number, window in enumerate(known):
            if len(window) <= number:
                windows.add(whole[number - len(window) : number + 1])
        far.update(relaxation.overreached(times))
    return Longer(frozenset(windows), frozenset(far))
