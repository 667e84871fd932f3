"""The order of sets in the filter, and the cloud from which each set resumes.

Under the same noise, sets that agree up to t have the same cloud up to t. In lexicographic order,
each set comes soon after the set with which it shares the longest prefix. It resumes from the cloud
that the earlier set saved. The result has the same bits as if it had begun at 0.
"""

from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import ManySets, Times


class Plan(NamedTuple):
    """The order in which the filter computes U different sets, and the clouds that it saves."""

    # (U, T+1, bytes): the sensors with which each set measures at each instant, a bit for each; 1
    # and 0 say whether a set measures, if there is a single sensor
    measured: NDArray[np.uint8]
    # (U,): the first instant that a set does not share with an earlier set
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]  # (U,): the instant after a set's last
    # (U,): slot of the saved cloud from which a set resumes, unless it begins at 0
    sources: NDArray[np.int64]
    # (U+1,): where the stops of each set begin. The filter of a set stops before the instants at
    # which it saves its cloud, and at its end.
    first_stops: NDArray[np.int64]
    stops: NDArray[np.int64]  # (K,): ascending in each set
    slots: NDArray[np.int64]  # (K,): slot in which the cloud is saved at each stop, or -1

    @property
    def clouds(self) -> int:
        """The largest number of clouds that are saved at a time."""
        return int(self.slots.max(initial=0)) + 1

    @property
    def unshared(self) -> "Plan":
        """The plan with which each set begins at 0, and no cloud is saved."""
        numbers = np.arange(len(self.ends) + 1)
        nothing = np.zeros_like(self.ends)
        return self._replace(
            begins=nothing, sources=nothing, first_stops=numbers, stops=self.ends,
            slots=nothing - 1,
        )  # fmt: skip


class Planned(NamedTuple):
    """A plan, and the places of the S requested sets in it."""

    plan: Plan
    places: NDArray[np.int64]  # (S,): index of each wanted set in the plan
    givers: list[int]  # for each of the U sets, the set that filters its shared prefix; -1 for none


def plan_prefixes(
    sets: Sequence[Times],
    instants: int,
    ends: tuple[int, ...] | None = None,
    sensors: int = 1,
) -> Planned:
    """The plan of the filter for S sets of possible measurements.

    `instants` is T + 1. With several sensors, the measurement at t by sensor number k is
    ``t * sensors + k``. `ends` has, for each set, the instant after the last instant whose error
    counts, by default T + 1. All of the set's times must lie before it.

    >>> filter_plan, places, givers = plan_prefixes(((0, 2), (1, 2), (0, 1)), 3)
    >>> places, filter_plan.begins  # the order is (1, 2), (0, 2), (0, 1); (0, 1) shares (0,)
    (array([1, 0, 2]), array([0, 0, 1]))
    >>> givers[2]  # the error of (0, 1) at t = 0 is that of (0, 2)
    1
    """
    wanted = (instants,) * len(sets) if ends is None else ends
    return _plan(ManySets.packed(sets, instants, sensors), wanted)


@lru_cache(maxsize=16)
def _plan(sets: ManySets, wanted: tuple[int, ...]) -> Planned:
    unique = dict[tuple[bytes, int], int]()
    numbers = [
        unique.setdefault((word, -end), place)
        for place, (word, end) in enumerate(zip(map(bytes, sets.bits), wanted, strict=True))
    ]
    # If sets differ only in their ends, the longest comes first, so the others can share it.
    order = [unique[each] for each in sorted(unique)]
    measured, ends = sets.bits[order], np.array(wanted, np.int64)[order]
    begins, givers = _shared(measured, ends)
    filter_plan = Plan(measured, begins, ends, *_slot_plan(begins, givers, ends))
    places = np.zeros(len(sets), np.int64)
    places[order] = np.arange(len(order))
    return Planned(filter_plan, places[numbers], givers)


def _shared(
    measured: NDArray[np.uint8], ends: NDArray[np.int64]
) -> tuple[NDArray[np.int64], list[int]]:
    """For each set: the length of its longest shared prefix, and the set that filters it.

    In lexicographic order, all earlier sets that share a prefix with a set share the prefix with
    the set before it, too.
    """
    begins, givers = np.zeros(len(ends), np.int64), [-1] * len(ends)
    differ = (measured[1:] != measured[:-1]).any(axis=2)
    alike = np.where(differ.any(axis=1), differ.argmax(axis=1), measured.shape[1]).tolist()
    # For each length of a prefix of the present set, the last set before that reaches so far; and
    # the longest such prefix. Lists are faster than arrays here.
    latest, longest = [0] * (measured.shape[1] + 1), int(ends[0])
    starts = [0]
    for index, (shared, end) in enumerate(zip(alike, ends[1:].tolist(), strict=True), start=1):
        begin = min(longest, shared, end)
        giver = latest[begin]
        while starts[giver] > begin:  # it resumed behind this instant: its own giver filtered it
            giver = givers[giver]
        givers[index] = giver
        starts.append(begin)
        latest[: end + 1] = [index] * (end + 1)
        longest = max(min(longest, shared), end)
    begins[:] = starts
    return begins, givers


def _slot_plan(
    begins: NDArray[np.int64], givers: Sequence[int], ends: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """`Plan.sources`, `first_stops`, `stops` and `slots`.

    Slots are reused.
    """
    # A saved cloud is named by the set that saves it and by the instant before which it does. A set
    # that begins where its giver began resumes from the same cloud: the giver did not save another.
    last_use: dict[tuple[int, int], int] = {}
    begins_of_takers: dict[int, set[int]] = defaultdict(set)
    origins: list[tuple[int, int]] = []
    for index, (giver, begin) in enumerate(zip(givers, begins.tolist(), strict=True)):
        as_its_giver = begin > 0 and begins[giver] == begin
        origins.append(origins[giver] if as_its_giver else (giver, begin))
        if begin:
            last_use[origins[index]] = index
            begins_of_takers[origins[index][0]].add(origins[index][1])
    # With a stop for each instant, the memory would grow with the horizon times the sets.
    first_stops, stops, slots = [0], list[int](), list[int]()
    sources = np.zeros_like(ends)
    held: dict[tuple[int, int], int] = {}
    freed = set(last_use.values())
    for index, (begins_later, end) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
        # The set copies its source before it saves anything. So a slot that it is the last to read
        # is free for the clouds that it saves itself.
        if begins_later:
            sources[index] = held[origins[index]]
        if index in freed:
            held = {what: slot for what, slot in held.items() if last_use[what] > index}
        saved = sorted(begins_of_takers.get(index, ()), reverse=True)
        for begin in saved:
            held[index, begin] = min(set(range(len(held) + 1)) - set(held.values()))
        here = {end: -1} | {begin: held[index, begin] for begin in saved}
        stops += sorted(here)
        slots += [here[stop] for stop in sorted(here)]
        first_stops.append(len(stops))
    return sources, np.array(first_stops), np.array(stops), np.array(slots)
