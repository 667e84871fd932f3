"""Evenly spaced sets by a fine lattice of first and last targets, as a reader looks for them."""

from collections.abc import Iterator, Sequence

import numpy as np

_STEP = 0.0731  # of the lattice, in mean steps of the clock; no multiple of it is a tie


def even_instants(times: Sequence[float], number: int) -> list[tuple[int, ...]]:
    """The different instants nearest to a, a + d, ..., within half a step of the clock."""
    clock = np.array(times, float)
    low, high = clock[0] - (clock[1] - clock[0]) / 2, clock[-1] + (clock[-1] - clock[-2]) / 2
    ends = np.arange(low + 1e-6, high, _STEP * (clock[-1] - clock[0]) / (clock.size - 1))
    if number == 1:
        return [(t,) for t in range(clock.size)]
    first, last = (each.ravel() for each in np.meshgrid(ends, ends, indexing="ij"))
    share = np.arange(number) / (number - 1)
    targets = first[:, None] + (last - first)[:, None] * share
    targets = targets[first < last]
    nearest = np.searchsorted((clock[1:] + clock[:-1]) / 2, targets)
    rows = np.unique(nearest[(np.diff(nearest, axis=1) > 0).all(axis=1)], axis=0)
    return [tuple(row) for row in rows.tolist()]


def spaced_around(
    times: Sequence[float], number: int, allowed: set[int], required: Sequence[int] = ()
) -> Iterator[tuple[int, ...]]:
    """Sets with the required ones among them: targets in gaps are left out, or gaps are cut out."""
    most = min(len(times), number + len(times) - len(allowed))  # others would measure more
    free = sorted(allowed)
    for targets in range(number, most + 1):
        for each in even_instants(times, targets):
            kept = [t for t in each if t in allowed]
            if len(kept) == number and {*kept} >= {*required}:
                yield tuple(kept)
    for each in even_instants(range(len(free)), number) if number <= len(free) else ():
        kept = [free[t] for t in each]
        if {*kept} >= {*required}:
            yield tuple(kept)
