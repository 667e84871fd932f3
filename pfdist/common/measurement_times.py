"""Measurement times of a set: their check, regular and random sets; and many sets as bits."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementTimesError, shown

Times = tuple[int, ...]
Lag = int | tuple[int, ...]
"""Instants after t whose measurements the estimate of z(t) uses: of all t, or (T+1,) of each."""
REGULAR: Final = "regular"  # name of the regular times in jobs and tables
LINEARIZED: Final = "linearized"  # written instead of times: the linearized design
EVEN: Final = "evenly_spaced"  # name of the best evenly spaced times in tables
MOST_REGULAR: Final = 2  # so few times are always evenly spaced: their opponent is regular times
CLOCK: Final = ("time", "dt")
"""Parameters that the clock of a job gives: the time of each instant, and the time to the next."""
DATES: Final = ("day_of_year", "hour", "weekday")
"""Parameters that the dates of a job give, unless a model has its own of this name."""


@dataclass(frozen=True, eq=False)
class ManySets(Sequence[Times]):
    """Sets of points as bits: for hundreds of thousands of sets, with hundreds of points each.

    >>> sets = ManySets.packed([(0, 3), (2,)], instants=2, sensors=2)
    >>> sets[0], [*sets], sets.bits[..., 0].tolist(), [*sets.written()]
    ((0, 3), [(0, 3), (2,)], [[1, 2], [0, 1]], ['[0,3]', '[2]'])
    """

    bits: NDArray[np.uint8]  # (S, T+1, bytes): a bit for each sensor that measures at an instant
    sensors: int

    @classmethod
    def packed(cls, sets: Sequence[Times], instants: int, sensors: int) -> "ManySets":
        """Sets of points of the first instants."""
        if isinstance(sets, ManySets):
            has_all = sets.bits.shape[1] == instants
            return sets if has_all else cls(sets.bits[:, :instants], sensors)
        rows = np.zeros((len(sets), instants * sensors), np.bool_)
        for row, times in zip(rows, sets, strict=True):
            row[list(times)] = True
        return cls.from_points(rows, sensors)

    @classmethod
    def from_points(cls, points: NDArray[np.bool_], sensors: int) -> "ManySets":
        """Sets of points, from whether each has each point, (S, points)."""
        instants, size = points.shape[1] // sensors, -(-sensors // 8)
        by_instant = points.reshape(len(points), instants, sensors)
        if sensors == 1:
            return cls(by_instant.view(np.uint8), sensors)
        whole = np.pad(by_instant, ((0, 0), (0, 0), (0, 8 * size - sensors)))
        flat = whole.reshape(len(points), 8 * size * instants)
        bits = np.packbits(flat, axis=1, bitorder="little")
        return cls(bits.reshape(len(points), instants, size), sensors)

    def __len__(self) -> int:
        """S."""
        return len(self.bits)

    def __getitem__(self, number: Any) -> Any:
        """A set, or those of a slice or of an array of numbers."""
        if isinstance(number, slice | np.ndarray):
            return ManySets(self.bits[number], self.sensors)
        return tuple(np.flatnonzero(self.points(number)).tolist())

    def __add__(self, sets: Sequence[Times]) -> "ManySets":
        """These sets, followed by others."""
        others = ManySets.packed(sets, self.bits.shape[1], self.sensors)
        return ManySets(np.concatenate([self.bits, others.bits]), self.sensors)

    def __eq__(self, other: object) -> bool:
        """Whether these are the same bits."""
        return isinstance(other, ManySets) and self._content == other._content

    def __hash__(self) -> int:
        """A hash of the bits."""
        return hash(self._content)

    def points(self, number: Any = ...) -> NDArray[np.bool_]:
        """Whether a set has each point, (points,); of all sets, (S, points)."""
        bits = self.bits[number]
        chosen = np.unpackbits(bits, axis=-1, count=self.sensors, bitorder="little")
        points = bits.shape[-2] * self.sensors
        return chosen.reshape(*bits.shape[:-2], points).view(np.bool_)

    def written(self) -> Iterator[str]:
        """The JSON text of each set."""
        _, instants, size = self.bits.shape
        step = max(1, 8 // self.sensors)  # so many instants have at most 256 texts, or are one
        texts = dict[tuple[int, bytes], str]()  # of the points of instants, each after a comma
        for row in self.bits:
            word, text = row.tobytes(), list[str]()
            for t in range(0, instants, step):
                key = t, word[t * size : (t + step) * size]
                if key not in texts:
                    own = np.unpackbits(row[t : t + step], 1, self.sensors, bitorder="little")
                    points = t * self.sensors + np.flatnonzero(own)
                    texts[key] = "".join(f",{point}" for point in points.tolist())
                text.append(texts[key])
            yield f"[{''.join(text)[1:]}]"

    @cached_property
    def _content(self) -> bytes:
        digest = hashlib.blake2b(self.bits.tobytes(), digest_size=32)
        digest.update(repr((self.bits.shape, self.sensors)).encode())
        return digest.digest()


def validated(measurement_times: Iterable[int], horizon: int, where: str = "") -> Times:
    """A set of measurement times in 0..horizon, sorted, after a check.

    Raises `MeasurementTimesError` if a time is not an integer, lies outside, or is given twice. Its
    message ends with `where` the times came from, for instance the option or the key.

    >>> validated([5, 0, 3], horizon=10)
    (0, 3, 5)
    """
    origin = f" ({where})" if where else ""
    if isinstance(measurement_times, str | bytes) or not isinstance(measurement_times, Iterable):
        raise MeasurementTimesError(
            f"measurement_times must be a list of integers, got {shown(measurement_times)}{origin}"
        )
    times = list(measurement_times)
    for time in times:
        if isinstance(time, bool) or not isinstance(time, (int, np.integer)):
            raise MeasurementTimesError(
                f"measurement_times must be integers, got {shown(time)}{origin}"
            )
        if not 0 <= time <= horizon:
            raise MeasurementTimesError(
                f"measurement_times must lie in 0..{horizon}, got {shown(int(time))}{origin}"
            )
    ordered = tuple(sorted(int(time) for time in times))
    for time, following in pairwise(ordered):
        if time == following:
            raise MeasurementTimesError(
                f"measurement_times must differ from each other, got {time} twice{origin}"
            )
    return ordered


def regular(horizon: int, measurement_budget: int) -> Times:
    """The regular times M_REG (paper, equation 13): Round[k T / (N-1)], halves rounded up.

    For N = 1 the formula divides by zero; the single time is in the middle, Round[T / 2]. Raises
    `MeasurementTimesError` if N does not lie in 1..T+1.

    >>> regular(horizon=60, measurement_budget=5)
    (0, 15, 30, 45, 60)
    >>> regular(horizon=5, measurement_budget=3)  # 2.5 is rounded up
    (0, 3, 5)
    >>> regular(horizon=5, measurement_budget=1)
    (3,)
    """
    if not 1 <= measurement_budget <= horizon + 1:
        raise MeasurementTimesError(
            f"regular times need a measurement_budget in 1..{horizon + 1} (horizon {horizon}), "
            f"got {measurement_budget}"
        )
    if measurement_budget == 1:
        return ((horizon + 1) // 2,)
    intervals = measurement_budget - 1
    # floor(a/b + 1/2) in integers
    return tuple((2 * k * horizon + intervals) // (2 * intervals) for k in range(intervals + 1))


def random(
    horizon: int, measurement_budget: int, sets: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Draw sets of N measurement times with equal probability, (sets, N); each row is sorted."""
    order = rng.permuted(np.tile(np.arange(horizon + 1), (sets, 1)), axis=1)
    return np.sort(order[:, :measurement_budget], axis=1)


def random_below(bound: int, rng: np.random.Generator) -> int:
    """Draw an integer in 0..bound-1; all have the same probability. The bound may be huge."""
    bits = (bound - 1).bit_length()
    while True:
        number = int.from_bytes(rng.bytes(-(-bits // 8)), "little") >> (-bits % 8)
        if number < bound:
            return number


def last_used(lag: Lag, instants: range) -> NDArray[np.int64]:
    """The last measurement that the estimate of each instant uses, (K,); all count from the first.

    With longer steps a lag has fewer instants, but no estimate uses fewer than an earlier one.
    """
    own = lag[instants.start : instants.stop] if isinstance(lag, tuple) else lag
    last: NDArray[np.int64] = np.minimum(np.arange(len(instants)) + own, len(instants) - 1)
    return last


def first_smoothed(lag: Lag, instants: range) -> NDArray[np.int64]:
    """The first instant whose estimate uses the measurement at each instant, (K,)."""
    return np.searchsorted(last_used(lag, instants), np.arange(len(instants)))
