"""Sampling windows: the instants to which a measurement alone may move, and its relative loss.

The functions take rows of the table ``sampling_windows``, also those of a JSON answer.
"""

import math
from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pfdist.common.estimate import CONFIDENCE, UNKNOWN, Interval
from pfdist.problem.clock import Clock, Time
from pfdist.results.moments import Array, Pairs
from pfdist.store import WINDOW_PERCENTS

INSIDE, OPEN, OUTSIDE = "inside", "open", "outside"
"""States of a loss against a level: at most the level, undecided, and above the level."""
_Rows = Iterable[Mapping[Hashable, Any]]
TWO_SIDED = 2 * CONFIDENCE - 1  # its ends are one-sided limits of the confidence
_LONGEST_LIST = 2  # successive instants that are listed singly
STRICT, WIDE = min(WINDOW_PERCENTS), max(WINDOW_PERCENTS)


@dataclass(frozen=True)
class SamplingWindow:
    """The instants to which a measurement alone can be moved at a loss of at most a level.

    Parameters
    ----------
    t : int or float
        The measurement.
    inside : mapping of int or float to int
        These instants, sorted, and the number of each; t is among them. On a clock an instant is
        given by its time.
    open : mapping of int or float to int
        Instants that are undecided: they need more draws.
    clock : Clock
    sensor : str
        Name of the sensor that measures; empty without sensors. Its measurement moves in time.
    """

    t: Time
    inside: Mapping[Time, int]
    open: Mapping[Time, int]
    clock: Clock
    sensor: str = ""

    @property
    def measurement(self) -> Time | str:
        """The measurement as users read it."""
        return self.clock.of_row({"t": self.t, "sensor": self.sensor})

    @property
    def is_wide(self) -> bool:
        """Whether another instant is inside."""
        return len(self.inside) > 1

    @property
    def text(self) -> str:
        """The window in words.

        Examples
        --------
        >>> clock = Clock.regular(12, 0.5)
        >>> SamplingWindow(6.0, {5.5: 11, 6.0: 12, 6.5: 13}, {7.0: 14}, clock).text
        '5.5 to 6.5 (undecided: 7)'
        >>> SamplingWindow(12.0, {12.0: 24}, {}, clock).text
        'only 12'
        """
        only = f"only {self.clock.text(self.t)}"
        inside = spelled(self.inside, self.clock) if self.is_wide else only
        return f"{inside} (undecided: {spelled(self.open, self.clock)})" if self.open else inside


def windows_of(rows: _Rows, percent: int, clock: Clock) -> list[SamplingWindow]:
    """The sampling windows of a set's measurements, in order of time.

    Parameters
    ----------
    rows : iterable of mappings
        Rows of the table ``sampling_windows`` of one set.
    percent : int
        The level: the largest loss, in per cent.
    clock : Clock
        That of the times.
    """
    tried = defaultdict[tuple[Time, str], list[Mapping[Hashable, Any]]](list)
    for row in sorted(rows, key=lambda row: row["moved_to"]):
        tried[row["t"], str(row.get("sensor", ""))].append(row)
    windows = []
    for (t, sensor), rows_at_t in sorted(tried.items()):
        places = {
            row["moved_to"]: row.get("moved_to_instant", row["moved_to"]) for row in rows_at_t
        }
        states = {row["moved_to"]: row[f"within_{percent}"] for row in rows_at_t} | {t: INSIDE}
        inside, left_open = (
            {to: int(place) for to, place in places.items() if states[to] == state}
            for state in (INSIDE, OPEN)
        )
        windows.append(SamplingWindow(t, inside, left_open, clock, sensor))
    return windows


def runs_of(instants: Mapping[Time, int]) -> list[list[Time]]:
    """The stretches of successive instants; each instant comes with its number."""
    runs, last = list[list[Time]](), -2
    for instant, place in instants.items():
        if place != last + 1:
            runs.append([])
        runs[-1].append(instant)
        last = place
    return runs


def spelled(instants: Mapping[Time, int], clock: Clock) -> str:
    """Instants in words, three and more successive instants as a range.

    Examples
    --------
    >>> spelled({3: 3, 4: 4, 9: 9, 10: 10, 11: 11, 12: 12}, Clock.counting(12))
    '3, 4, 9 to 12'
    """
    return ", ".join(
        ", ".join(map(clock.text, run))
        if len(run) <= _LONGEST_LIST
        else f"{clock.text(run[0])} to {clock.text(run[-1])}"
        for run in runs_of(instants)
    )


@dataclass
class RelativeLoss:
    """Mean rise of the MSE over the mean MSE of the kept set, on the pairs of errors added so far.

    Parameters
    ----------
    pairs : Pairs
        Moments of the rise of the MSE (x) and the MSE of the kept set (y).
    """

    pairs: Pairs = field(default_factory=Pairs)

    def add(self, changed_mse: Array, kept_mse: Array) -> None:
        """Add a block of draws; the same blocks in the same order give the same bits.

        Parameters
        ----------
        changed_mse, kept_mse : array of float64, (D,)
            Per-draw MSE of both sets on the same draws.
        """
        with np.errstate(invalid="ignore"):  # infinite errors have no difference
            self.pairs.add(changed_mse - kept_mse, kept_mse)

    @property
    def mean(self) -> float:
        """The loss; NaN if an error is infinite, or if the mean error is not above 0."""
        return self.pairs.x.mean / self.pairs.y.mean if self._is_known else math.nan

    @property
    def standard_error(self) -> float:
        """Standard error of the loss, by the delta method."""
        return self.pairs.ratio_error if self._is_known else math.nan

    @property
    def limits(self) -> Interval:
        """One-sided 95 % lower limit and one-sided 95 % upper limit, Fieller's."""
        return self.pairs.ratio_interval(TWO_SIDED) if self._is_known else UNKNOWN

    @property
    def _is_known(self) -> bool:
        rise, kept_mse = self.pairs.x, self.pairs.y
        moments = (rise.mean, rise.squares, kept_mse.mean, kept_mse.squares)
        return all(map(math.isfinite, moments)) and kept_mse.mean > 0.0


def state_of(limits: Interval, level: float) -> str:
    """Whether a loss is at most a level, by its one-sided limits; an unknown loss is open."""
    low, high = limits
    if high <= level:
        return INSIDE
    return OUTSIDE if low > level else OPEN
