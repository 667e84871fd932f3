"""In which order to filter sets of times, and what to go on from.

Under the same noise, sets that agree up to t have the same cloud up to t. In the order of words in
a dictionary each set comes soon after that with which it shares most; it goes on from the cloud
that that one kept, bit for bit as if it had begun at 0.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Plan(NamedTuple):
    """What the filter of several sets does, U different ones in their order.

    Parameters
    ----------
    measured : array of bool, (U, T+1)
    begins, ends : array of int64, (U,)
        The first instant that a set does not share, and the one after its last.
    sources : array of int64, (U,)
        Which kept cloud it goes on from, unless it begins at 0.
    stops, slots : array of int64, (U, T+2)
        From each instant, the next one at which the cloud, as it comes there, is kept, or the end;
        and where it is kept, or -1.
    """

    measured: NDArray[np.bool_]
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    sources: NDArray[np.int64]
    stops: NDArray[np.int64]
    slots: NDArray[np.int64]

    @property
    def clouds(self) -> int:
        """How many are kept at most at a time."""
        return int(self.slots.max(initial=0)) + 1


class Saved(NamedTuple):
    """Clouds that later sets resume from.

    Parameters
    ----------
    clouds : array of float64 or float32, (slots, n, width(P))
    errors : array of float64, (slots,)
        The sum of errors up to each cloud.
    """

    clouds: NDArray[Any]
    errors: NDArray[np.float64]


@lru_cache(maxsize=64)
def plan(
    sets: tuple[tuple[int, ...], ...], instants: int, ends: tuple[int, ...] | None = None
) -> tuple[Plan, NDArray[np.int64]]:
    """Plan the filter of several sets.

    Parameters
    ----------
    sets : tuple of tuples of int
        S sets of times in 0..T.
    instants : int
        T + 1.
    ends : tuple of int, (S,), optional
        The instant after the last one that is wanted of each set, and after all its times; by
        default T + 1.

    Returns
    -------
    Plan
    place : array of int64, (S,)
        Of each set in the plan.

    Examples
    --------
    >>> found, place = plan(((0, 2), (1, 2), (0, 1)), 3)
    >>> place, found.begins  # (1, 2) comes first; (0, 1) shares (0,) with (0, 2)
    (array([1, 0, 2]), array([0, 0, 1]))
    """
    wanted = [instants] * len(sets) if ends is None else list(ends)
    # Of sets that differ in their ends alone, the longest first: the others end on its way.
    order = sorted(set(zip(sets, wanted, strict=True)), key=_word)
    place = {key: position for position, key in enumerate(order)}
    measured = np.zeros((len(order), instants), np.bool_)
    for row, (times, _) in zip(measured, order, strict=True):
        row[list(times)] = True
    ends_ = np.array([end for _, end in order])
    begins, givers = _shared(measured, ends_)
    stops, slots, sources = _kept(begins, givers, ends_, instants)
    found = Plan(measured, begins, ends_, sources, stops, slots)
    return found, np.array([place[key] for key in zip(sets, wanted, strict=True)])


def _word(key: tuple[tuple[int, ...], int]) -> tuple[tuple[int, ...], int]:
    """Sort sets as a dictionary sorts their rows of zeros and ones."""
    times, end = key
    return tuple(-time for time in times), -end


def _shared(
    measured: NDArray[np.bool_], ends: NDArray[np.int64]
) -> tuple[NDArray[np.int64], list[int]]:
    """From which instant on each set is new, and which one before it came there first."""
    begins, givers = np.zeros(len(ends), np.int64), [-1] * len(ends)
    for index in range(1, len(ends)):
        differ = measured[:index] != measured[index]
        alike = np.where(differ.any(axis=1), differ.argmax(axis=1), measured.shape[1])
        upto = np.minimum(np.minimum(alike, ends[:index]), ends[index])
        giver = int(np.flatnonzero(upto == upto.max())[-1])
        begins[index] = upto[giver]
        while begins[giver] > begins[index]:  # it did not come there itself
            giver = givers[giver]
        givers[index] = giver
    return begins, givers


def _kept(
    begins: NDArray[np.int64], givers: Sequence[int], ends: NDArray[np.int64], instants: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """What each set keeps, where, and which each goes on from; places are used again."""
    last_use: dict[tuple[int, int], int] = {}
    origins: list[tuple[int, int]] = []
    for index, (giver, begin) in enumerate(zip(givers, begins.tolist(), strict=True)):
        as_its_giver = begin > 0 and begins[giver] == begin
        origins.append(origins[giver] if as_its_giver else (giver, begin))
        if begin > 0:
            last_use[origins[index]] = index
    stops = np.repeat(ends[:, None], instants + 1, axis=1)
    slots, sources = np.full_like(stops, -1), np.zeros_like(ends)
    held: dict[tuple[int, int], int] = {}
    for index in range(len(ends)):
        if begins[index] > 0:
            sources[index] = held[origins[index]]
        held = {what: slot for what, slot in held.items() if last_use[what] > index}
        for what in sorted((what for what in last_use if what[0] == index), reverse=True):
            held[what] = min(set(range(len(held) + 1)) - set(held.values()))
            stops[index, : what[1]] = what[1]
            slots[index, what[1]] = held[what]
    return stops, slots, sources
