"""How far apart the measurement times of a set must be, counted in instants."""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise

from pfdist.common.measurement_times import Times


@dataclass(frozen=True)
class Spacing:
    """The rule for which instants are far enough apart for both to be measured.

    >>> spacing = Spacing.constant(3, horizon=5)
    >>> spacing.successors
    (3, 4, 5, 6, 7, 8)
    >>> spacing.before(4)
    1
    """

    # (T+1,): for each instant t, the first later instant that is far enough apart, at least t + 1;
    # an instant after T stands for none. The instants never decrease with t.
    successors: tuple[int, ...]

    @classmethod
    def constant(cls, difference: int, horizon: int) -> "Spacing":
        """The spacing in which measurement times differ by at least so many instants."""
        return cls(tuple(t + difference for t in range(horizon + 1)))

    @cached_property
    def is_free(self) -> bool:
        """Whether all instants are far enough apart, so that spacing does not constrain."""
        return all(later == t + 1 for t, later in enumerate(self.successors))

    def since(self, first: int) -> "Spacing":
        """The same from an instant on; instants count from there."""
        return Spacing(tuple(later - first for later in self.successors[first:]))

    def after(self, time: int) -> int:
        """The first instant that is far enough after a time.

        The time -1 is the start, from which every instant is far enough.
        """
        if time < 0:
            return 0
        return self.successors[time] if time < len(self.successors) else time + 1

    def before(self, time: int) -> int:
        """The last instant that is far enough before a time; -1 if there is none.

        The time T + 1 is the end, from which every instant is far enough.
        """
        return self._predecessors[time] if time < len(self.successors) else time - 1

    def allows(self, times: Iterable[int]) -> bool:
        """Whether all times, in ascending order, are far enough apart."""
        return all(later >= self.after(time) for time, later in pairwise(times))

    def near(self, times: Iterable[int]) -> set[int]:
        """The instants that are too close to one of some times, and these times."""
        last = len(self.successors)
        ranges = (range(self.before(time) + 1, min(self.after(time), last)) for time in times)
        return set(chain.from_iterable(ranges))

    def packed(self, first: int, last: int, among: Times) -> Times:
        """As many of some sorted times as fit between two times, each as early as possible."""
        chosen: list[int] = []
        index, latest = bisect_left(among, self.after(first)), self.before(last)
        while index < len(among) and among[index] <= latest:
            chosen.append(among[index])
            index = bisect_left(among, self.after(among[index]))
        return tuple(chosen)

    def fitting(self, times: Times, among: Times) -> Times:
        """As many of some sorted times as fit beside these, each as early as possible."""
        gaps = pairwise((-1, *times, len(self.successors)))
        return tuple(chain.from_iterable(self.packed(*gap, among) for gap in gaps))

    @cached_property
    def _predecessors(self) -> tuple[int, ...]:
        predecessors, last = list[int](), -1
        for time in range(len(self.successors)):
            while last + 1 < time and self.successors[last + 1] <= time:
                last += 1
            predecessors.append(last)
        return tuple(predecessors)
