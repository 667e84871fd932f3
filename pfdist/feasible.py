"""The sets of measurement times that may be chosen: all, at random, and the neighbours of one."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from heapq import merge
from itertools import chain, combinations, pairwise
from math import comb

import numpy as np

from pfdist.affordable import Affordable
from pfdist.completions import Completions
from pfdist.constraints import Constraints
from pfdist.measurement_times import Times, nearest, random, regular


class Feasible(Constraints):
    """Sets of N times, or sets that a sum of money pays for and to which nothing can be added.

    To a filter that knows the truth a measurement more does no harm in expectation, so with money
    a best set is among these; where the filter is wrong, these are what is searched. The parameters
    are those of `Constraints`; sets are sorted.
    """

    def accepts(self, times: Times) -> bool:
        """Whether a set is one of them."""
        if self.counted and len(times) != self.total:
            return False
        complete = set(self.required).issubset(times) and self.allows(times)
        return complete and (self.counted or not self.affordable(times))

    @cached_property
    def measurements(self) -> int:
        """N; or as many as the regular times are, and about as many as any set has."""
        return len(self.regular())

    @property
    def size(self) -> int:
        """How many sets there are."""
        if self._free:
            return comb(len(self.optional), self.total - len(self.required))
        return sum(completions.size for completions in self._completions)

    def every(self) -> Iterator[Times]:
        """Give all sets, in the order of words in a dictionary."""
        if self._free:
            chosen = combinations(self.optional, self.total - len(self.required))
            return (self.with_required(times) for times in chosen)
        return merge(*(completions.every() for completions in self._completions))

    def random(self, sets: int, rng: np.random.Generator) -> list[Times]:
        """Draw sets, each of the same probability."""
        if self._free:
            number = self.total - len(self.required)
            rows = random(len(self.optional) - 1, number, sets, rng).tolist()
            return [self.with_required(self.optional[place] for place in row) for row in rows]
        return [self._at(_below(self.size, rng)) for _ in range(sets)]

    def regular(self) -> Times:
        """Give the regular times, or what comes nearest to them.

        With N measurements they are those of the paper's equation 13, or if these are not feasible
        the set that is nearest to them (see `pfdist.measurement_times.nearest`). With money, of
        the sets that spend as much as any can, those with the most measurements are looked at, and
        the nearest to regular times is given (see `pfdist.affordable.Affordable.nearest`).
        """
        return self._nearest_regular

    def is_regular(self, times: Times) -> bool:
        """Whether times are the regular ones of their number (equation 13), feasible or not."""
        return times == self._wanted(len(times))

    def additions(self, times: Times) -> list[Times]:
        """Give what one time more makes of a set, as long as one of them can still come of it."""
        if not self.allows(times):
            return []
        lacking = {*self.required} - {*times}
        new = sorted({*lacking, *self.affordable(times)})
        if self.counted and not self._free:
            new = self._with_room_for_others(times, new)
        return [tuple(sorted({*times, time})) for time in new]

    def removals(self, times: Times) -> list[Times]:
        """Give what one time less makes of a set, as long as it still holds one of them."""
        held = self._held(times)
        if held is None:
            return []
        smaller = {out: tuple(time for time in times if time != out) for out in times}
        return [
            smaller_set
            for out, smaller_set in smaller.items()
            if out not in held or self._held(smaller_set)
        ]

    def extensions(self, times: Times) -> Sequence[int]:
        """Give the times that may come next, so that one of them can come of it.

        Parameters
        ----------
        times : tuple of int
            All that is measured up to the last of them.

        Returns
        -------
        sequence of int
            Sorted.
        """
        if not self.counted:
            return sorted(set().union(*(one.extensions(times) for one in self._completions)))
        left, last = self.total - len(times), times[-1] if times else -1
        required = self.required[bisect_right(self.required, last) :]
        if left <= 0 or len(required) > left:
            return ()
        start = bisect_left(self.allowed, last + self.minimum_spacing if times else 0)
        stop = bisect_right(self._room, -left)
        if required:
            place = bisect_left(self.allowed, required[0])
            start, stop = (place if len(required) == left else start), min(stop, place + 1)
        return self.allowed[start:stop]

    def exchanges(self, times: Times, reach: int | None = None) -> list[Times]:
        """Give the sets in which one time is another, at most so far away.

        With money, those nearest to a new time that costs too much, or that stands in their way,
        are taken out; what is saved buys others, each as far from the rest as can be.
        """
        found = [
            one
            for out in times
            if out not in self.required
            for new in self._near(out, reach)
            if new not in times and (one := self._exchanged({*times} - {out}, new)) is not None
        ]
        return found if self.counted else [one for one in dict.fromkeys(found) if one != times]

    def repair(self, times: Iterable[int], rng: np.random.Generator) -> Times:
        """Give one of them that holds what it can of a set of any times in 0..T.

        The times are taken in random order, as long as one of them can come of it, and then others
        at random. If it is one of them, it is given back and nothing is drawn.
        """
        kept, given = Times(), tuple(sorted(times))
        if self.accepts(given):
            return given
        for time in rng.permutation(given).tolist():
            larger = tuple(sorted({*kept, time}))
            kept = larger if self._becomes_one(larger) else kept
        while larger_ones := self.additions(kept):
            kept = larger_ones[rng.integers(len(larger_ones))]
        return kept

    @property
    def _free(self) -> bool:
        """Whether any N allowed times will do, if the required ones are among them."""
        return self.counted and self.minimum_spacing == 1

    @cached_property
    def _room(self) -> list[int]:
        """How many times there is room for from each allowed one on, as negative numbers."""
        room = [0] * (len(self.allowed) + 1)
        for place in reversed(range(len(self.allowed))):
            after = bisect_left(self.allowed, self.allowed[place] + self.minimum_spacing)
            room[place] = room[after] - 1
        return room[:-1]

    @cached_property
    def _completions(self) -> list[Completions]:
        return self._completions_of(self.allowed)

    def _completions_of(self, usable: Times) -> list[Completions]:
        """Sets by what they leave over: for each of these bounds, other times are cheap."""
        prices = sorted({self.price[time] for time in self.optional})
        bounds = [0, 1] if self.counted else [0, *prices, self.total + 1]
        return [
            Completions(
                horizon=self.horizon,
                usable=usable,
                required=self.required,
                cheap=tuple(time for time in self.optional if self.price[time] <= least),
                spacing=self.minimum_spacing,
                cost=self.price,
                total=self.total,
                left_over=range(least, min(more, self.total + 1)),
            )
            for least, more in pairwise(bounds)
            if least <= self.total
        ]

    def _at(self, index: int) -> Times:
        for completions in self._completions:
            if index < completions.size:
                break
            index -= completions.size
        return completions.at(index)

    def _becomes_one(self, times: Times) -> bool:
        if not self.allows(times):
            return False
        return self._free or not self.counted or self.room(times) >= self.total

    def _with_room_for_others(self, times: Times, new: list[int]) -> list[int]:
        """Those of new times beside which there is room for N in all."""
        kept = self.with_required(times)
        ends, spare = self.with_ends(kept), self.room(times) - self.total

        def lost(time: int) -> int:
            if time in kept:
                return 0
            place = bisect_left(kept, time)
            before, after = ends[place], ends[place + 1]
            beside = self.room_between(before, time) + self.room_between(time, after)
            return self.room_between(before, after) - beside - 1

        return [time for time in new if lost(time) <= spare]

    def _held(self, times: Times) -> Times | None:
        """Give one of them that has no other times than these, if there is one."""
        usable = tuple(time for time in self.allowed if time in times)
        if not set(self.required).issubset(usable):
            return None
        if not self.counted:
            every = (completions.every() for completions in self._completions_of(usable))
            return next(chain.from_iterable(every), None)
        gaps = pairwise(self.with_ends(self.required))
        packed = [time for a, b in gaps for time in self.packed(a, b, usable)]
        held = self.with_required(packed[: self.total - len(self.required)])
        return held if len(held) == self.total else None

    def _wanted(self, number: int) -> Times:
        """Give regular times, feasible or not; for N = 1, where the formula fails, the middle."""
        return regular(self.horizon, number) if number > 1 else ((self.horizon + 1) // 2,)[:number]

    @cached_property
    def _nearest_regular(self) -> Times:
        spacing = self.minimum_spacing
        if not self.counted:
            affordable = Affordable(self.allowed, self.required, spacing, self.price, self.total)
            return affordable.nearest(self._wanted)
        wanted = self._wanted(self.total)
        if self.together(wanted) and {*self.required}.issubset(wanted):
            return wanted
        return nearest(wanted, self.allowed, self.required, spacing)

    def _near(self, time: int, reach: int | None) -> Times:
        if reach is None:
            return self.allowed
        first, stop = time - reach, time + reach + 1
        return self.allowed[bisect_left(self.allowed, first) : bisect_left(self.allowed, stop)]

    def _exchanged(self, others: set[int], new: int) -> Times | None:
        if self.counted:
            exchanged = tuple(sorted({*others, new}))
            return exchanged if self._free or self.together(exchanged) else None
        leaving = sorted(others - {*self.required}, key=lambda time: (-abs(time - new), time))
        while leaving and not self.allows({*others, new}):
            others = others - {leaving.pop()}
        return self._filled({*others, new}) if self.allows({*others, new}) else None

    def _filled(self, times: Iterable[int]) -> Times:
        """Add what can be paid for, each time as far from the others as can be."""
        filled = self.with_required(times)
        while more := self.affordable(filled):
            farthest = max(more, key=lambda time: self.distance(time, filled))
            filled = self.with_required({*filled, farthest})
        return filled


def _below(bound: int, rng: np.random.Generator) -> int:
    """Draw an integer in 0..bound-1, however large, each with the same probability."""
    bits = (bound - 1).bit_length()
    while True:
        number = int.from_bytes(rng.bytes(-(-bits // 8)), "little") >> (-bits % 8)
        if number < bound:
            return number
