"""Times that users write: numbers, ranges such as ``20:30``, and lists of these."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pfdist.common.parsing import as_text, finite_number, ranges, whole_numbers
from pfdist.errors import MeasurementTimesError, shown
from pfdist.problem.calendar import names_dates
from pfdist.problem.clock import Clock, joined_times

RANGES = "'20:30', '0:60:3' or '20-30'"
"""Examples of ranges, for errors and help."""
SEPARATOR = re.compile(r"[\s,]+")
_WITH_HYPHEN = re.compile(r"(\d{1,6}(?:\.\d+)?)-(\d{1,6}(?:\.\d+)?)")
_WHOLE_FLOAT = re.compile(r"(?<=\d)\.0+(?=[\s,:]|$)")  # 2.0 is the instant 2
_NUMBER = (int, float, np.integer, np.floating)


def instants_written(written: Any, clock: Clock, name: str = "measurement_times") -> list[int]:
    """The instants of a number, a text, or several of these, in the order written.

    A text has times and ranges, with commas or spaces between them. ``FIRST:LAST`` and
    ``FIRST-LAST`` mean all instants from FIRST to LAST, and ``FIRST:LAST:STEP`` the times FIRST,
    FIRST + STEP, ... If the clock counts instants, only whole numbers are times, and they may lie
    outside 0..T. If the clock has a start, a text has dates, as `Clock.dated` reads them. Raises
    `MeasurementTimesError`, which begins with `name`, for any other text, or for a time that is not
    on the clock.

    >>> instants_written([1, "2.5:4"], Clock.regular(6, 0.5, "h"))
    [2, 5, 6, 7, 8]
    """
    written = as_text(written)
    if isinstance(written, str):
        return clock.dated(written, name) if clock.has_dates else [
            *_instants_of_text(written, clock, name)
        ]  # fmt: skip
    if isinstance(written, Iterable):
        return joined_times(name, (instants_written(entry, clock, name) for entry in written))
    is_number = isinstance(written, _NUMBER) and not isinstance(written, bool)
    if not is_number or (clock.counts and not float(written).is_integer()):
        raise MeasurementTimesError(
            f"{name} must name times, as 20, and ranges, as {RANGES}, got {shown(written)}"
        )
    return [int(written) if clock.counts else clock.instant(float(written), name)]


def by_instant(name: str, given: Any, clock: Clock) -> list[Any]:
    """The value of each instant, from a number, a list, or a mapping of times and ranges.

    Raises `MeasurementTimesError`, which begins with `name`, unless each instant has one value.
    """
    instants, values = len(clock.times), dict[int, Any]()
    if isinstance(given, int | float):
        return [given] * instants
    if not isinstance(given, Mapping):
        if len(given) != instants:
            raise MeasurementTimesError(
                f"{name} needs {instants} values, one for each instant, got {len(given)}"
            )
        return [*given]
    first, last = map(clock.text, (clock.times[0], clock.times[-1]))
    must = f"{name} must name every time in {first}..{last} once, got"
    for key, value in given.items():
        for t in instants_written(key, clock, name):
            is_instant = 0 <= t <= clock.horizon
            if t in values or not is_instant:
                what = "twice" if t in values else f"for a horizon of {clock.horizon}"
                time = clock.text(clock.times[t]) if is_instant else t
                raise MeasurementTimesError(f"{must} {time} {what}")
            values[t] = value
    for t in range(instants):
        if t not in values:
            raise MeasurementTimesError(f"{must} none for {clock.text(clock.times[t])}")
    return [values[t] for t in range(instants)]


def clock_of(text: str) -> Clock:
    """The clock whose instants a text lists, as times and ranges in ascending order.

    ``FIRST:LAST`` has an instant at each unit of time, and ``FIRST:LAST:STEP`` at each step. Raises
    `MeasurementTimesError` for any other text, for fewer than two times, for another order, or if
    the steps of a range do not lead to its end.

    >>> clock_of("0 0.25 0.5 1:3").times
    (0.0, 0.25, 0.5, 1.0, 2.0, 3.0)
    """
    try:
        entries = ranges(text, finite_number, by_ones=True)
    except ValueError as error:
        raise MeasurementTimesError(f"times {error}") from error
    times = [time for entry in entries for time in _stepped(*entry, text)]
    if len(times) < 2:
        raise MeasurementTimesError(f"times must have at least two times, got {shown(text)}")
    return Clock(tuple(times))


def _stepped(first: float, last: float, step: float, text: str) -> list[float]:
    """The times of a range; a step of 0 means 1."""
    step = step or 1.0
    steps = round((last - first) / step)
    if not math.isclose(first + steps * step, last, rel_tol=1e-12, abs_tol=1e-9 * step):
        raise MeasurementTimesError(
            f"times must have ranges FIRST:LAST:STEP (STEP is 1 if there is none) whose steps lead "
            f"from FIRST to LAST, got {first:.10g} to {last:.10g} in steps of {step:.10g}: "
            f"{shown(text)}"
        )
    return [float(f"{first + k * step:.12g}") for k in range(steps + 1)]  # 3 * 0.1 is 0.3


def _instants_of_text(text: str, clock: Clock, name: str) -> Sequence[int]:
    with_hyphen = _WITH_HYPHEN.fullmatch(text)
    spelt = f"{with_hyphen[1]}:{with_hyphen[2]}" if with_hyphen else text
    try:
        if clock.counts:
            return whole_numbers(_WHOLE_FLOAT.sub("", spelt))
        entries = ranges(spelt, finite_number)
        return [t for entry in entries for t in _instants_between(entry, clock, name)]
    except MeasurementTimesError:
        raise
    except ValueError as error:
        if names_dates(text):
            raise MeasurementTimesError(
                f"{name} must name times, because clock.start is not given; got {shown(text)}"
            ) from error
        if ":" in text:
            raise MeasurementTimesError(f"{name} {error}") from error
        what = f"name times, as 20, and ranges, as {RANGES}"
        if with_hyphen:
            what = "have ranges from a time to a later one"
        raise MeasurementTimesError(f"{name} must {what}, got {shown(text)}") from error


def _instants_between(entry: tuple[float, float, float], clock: Clock, name: str) -> Sequence[int]:
    """The instants of a range of times; a step of 0 means all instants."""
    first, last, step = entry
    if first == last:
        return [clock.instant(first, name)]
    if not step:
        for end in (first, last):
            clock.check_is_within(end, name)
        return clock.between(first, last)
    steps = int((last - first + clock.slack) / step)
    return [clock.instant(first + k * step, name) for k in range(steps + 1)]
