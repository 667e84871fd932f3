"""Sampling windows as readers want them: instants, which measurements matter, and how flat it is.

The functions take rows of the tables ``sampling_windows`` and ``jitter``, also those of a JSON
answer.
"""

import math
from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pfdist.common.clock import Time
from pfdist.common.formatted_times import formatted_time, formatted_times, measurement_of
from pfdist.common.percent import percent_with_interval
from pfdist.results.relative_loss import INSIDE, OPEN
from pfdist.store import WINDOW_PERCENTS

Rows = Iterable[Mapping[Hashable, Any]]
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
        told by its time.
    open : mapping of int or float to int
        Instants that the draws leave open.
    can_be_tried : bool
        Whether there is another instant between the neighbours that the job allows.
    sensor : str
        Name of the sensor that measures; empty without sensors. Its measurement moves in time.
    """

    t: Time
    inside: Mapping[Time, int]
    open: Mapping[Time, int]
    can_be_tried: bool
    sensor: str = ""

    @property
    def measurement(self) -> Time | str:
        """The measurement as users read it."""
        return measurement_of({"t": self.t, "sensor": self.sensor})

    @property
    def is_wide(self) -> bool:
        """Whether another instant is inside."""
        return len(self.inside) > 1

    @property
    def is_single(self) -> bool:
        """Whether every other instant that was tried is known to lose more."""
        return self.can_be_tried and not self.is_wide and not self.open

    @property
    def text(self) -> str:
        """The window in words.

        Examples
        --------
        >>> SamplingWindow(6.0, {5.5: 11, 6.0: 12, 6.5: 13}, {7.0: 14}, True).text
        '5.5 to 6.5 (open: 7)'
        >>> SamplingWindow(12, {12: 12}, {}, True).text
        'only 12'
        """
        inside = spelled(self.inside) if self.is_wide else f"only {formatted_time(self.t)}"
        return f"{inside} (open: {spelled(self.open)})" if self.open else inside


def windows_of(rows: Rows, percent: int) -> list[SamplingWindow]:
    """The sampling windows of a set's measurements, in order of time.

    Parameters
    ----------
    rows : iterable of mappings
        Rows of the table ``sampling_windows`` of one set.
    percent : int
        The level: the largest loss, in per cent.
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
        windows.append(SamplingWindow(t, inside, left_open, len(rows_at_t) > 1, sensor))
    return windows


def runs_of(instants: Mapping[Time, int]) -> list[list[Time]]:
    """The stretches of successive instants, where the number of each instant is given."""
    runs, last = list[list[Time]](), -2
    for instant, place in instants.items():
        if place != last + 1:
            runs.append([])
        runs[-1].append(instant)
        last = place
    return runs


def spelled(instants: Mapping[Time, int]) -> str:
    """Instants in words, three and more successive instants as a range.

    Examples
    --------
    >>> spelled({3: 3, 4: 4, 9: 9, 10: 10, 11: 11, 12: 12})
    '3, 4, 9 to 12'
    """
    return ", ".join(
        formatted_times(run)
        if len(run) <= _LONGEST_LIST
        else f"{formatted_time(run[0])} to {formatted_time(run[-1])}"
        for run in runs_of(instants)
    )


def is_flat(windows: Sequence[SamplingWindow], jitter: Mapping[Hashable, Any]) -> bool:
    """Whether all measurements together can move within their windows at a loss of at most a level.

    All measurements that the job and their neighbours do not fix have another instant inside, and
    the 95 % interval of the loss when all are jittered ends at or below the level.

    Parameters
    ----------
    windows : sequence of SamplingWindow
        For one level.
    jitter : mapping
        The row of the table ``jitter`` of this level.
    """
    movable = [window for window in windows if window.can_be_tried]
    high = math.nan if jitter["high"] is None else jitter["high"]
    is_small = bool(high <= jitter["percent"] / 100)
    return bool(movable) and all(window.is_wide for window in movable) and is_small


def sentences(rows: Rows, jitter: Rows, *, is_found: bool = True) -> list[str]:
    """Say which measurements must be kept exactly, which need not, and whether the optimum is flat.

    Parameters
    ----------
    rows, jitter : iterable of mappings
        Rows of the tables ``sampling_windows`` and ``jitter`` of one set.
    is_found : bool
        Whether a search has found the set; other sets are no optimum.
    """
    rows, jitter = list(rows), list(jitter)
    windows = {int(row["percent"]): windows_of(rows, int(row["percent"])) for row in jitter}
    flat = [row for row in jitter if is_flat(windows[int(row["percent"])], row)]
    flat = flat[:1] if is_found else []
    said = [_flat_sentence(row, windows[int(row["percent"])]) for row in flat]
    said += _measurements(windows.get(STRICT, []))
    return said + [
        f"If all measurements move at random within their windows of {row['percent']} %, the loss "
        f"is {loss_text(row)}."
        for row in jitter
        if row["draws"] and row not in flat
    ]


def loss_text(row: Mapping[Hashable, Any]) -> str:
    """The loss of a row of the table ``jitter`` with its 95 % interval, in per cent."""
    values = [None if row[key] is None else float(row[key]) for key in ("loss", "low", "high")]
    loss, *interval = [None if x is None or math.isnan(x) else x for x in values]
    return percent_with_interval(loss, interval).replace("  (", " (")


def _flat_sentence(row: Mapping[Hashable, Any], windows: Sequence[SamplingWindow]) -> str:
    movable = sum(window.can_be_tried for window in windows)
    return (
        f"The optimum is flat: {movable} of {len(windows)} measurements can move"
        f"{', each' * (movable > 1)} within a window of {row['percent']} %. If all of these move "
        f"at random within their windows, the loss is {loss_text(row)}."
    )


def _measurements(windows: Sequence[SamplingWindow]) -> list[str]:
    """Name the measurements that must be kept exactly, that can move, and that are undecided."""
    movable = [window for window in windows if window.can_be_tried]
    wide = [window for window in movable if window.is_wide]
    single = [window for window in movable if window.is_single]
    undecided = [window for window in movable if not window.is_wide and window.open]
    parts = (
        (single, "Keep exactly (every other instant that was tried loses more than {} %): t = {}."),
        (wide, "Can move at a loss of at most {} %: t = {}."),
        (undecided, "The draws leave open whether these can move within {} %: t = {}."),
    )
    return [said.format(STRICT, _listed(group)) for group, said in parts if group]


def _listed(windows: Sequence[SamplingWindow]) -> str:
    """The measurements of some windows in words."""
    if windows[0].sensor:
        return formatted_times(window.measurement for window in windows)
    return spelled({window.t: window.inside[window.t] for window in windows})
