"""The plan of a run as a CSV table or an iCalendar file (RFC 5545)."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from pfdist.common.arguments import path_argument
from pfdist.common.measurement_times import Times
from pfdist.common.rounding import unrounded
from pfdist.errors import ArgumentError, one_line, shown
from pfdist.problem.clock import Clock
from pfdist.results.sampling_windows import STRICT, WIDE, runs_of, windows_of
from pfdist.results.stored_run import StoredRun, measured_of, problem_of, provenance_of
from pfdist.store import run_key
from pfdist.store.files import begins_with, check_replaceable, write_file

_KINDS = {".csv": b"measurement,t", ".ics": b"PRODID:-//pfdist//"}  # and the beginnings of files
_START = 100  # bytes that hold these
_LINE = 75  # octets of a line of iCalendar
_Rows = list[dict[str, Any]]


def checked_export(path: str | Path, clock: Clock) -> Path:
    """The path of an export of a plan on a clock, after a check.

    Raises ArgumentError if its name has another ending, or if the clock has no dates for a diary.
    Raises StoreError if another file has this name.
    """
    file = path_argument("export", path)
    kind = file.suffix.lower()
    if kind not in _KINDS or (kind == ".ics" and not clock.calendar):
        raise ArgumentError(
            "export must end in .csv, or in .ics if the job has problem.clock.start, got "
            f"{shown(str(path))}",
            argument="export",
        )
    check_replaceable(file, partial(begins_with, mark=_KINDS[kind], most=_START))
    return file


def export_plan(run: StoredRun, name: str, path: str | Path) -> Path:
    """Write a set of a run, its plan, with its sampling windows where `pfdist.why` was asked."""
    # A run is opened without pandas.
    import pandas as pd  # noqa: PLC0415

    from pfdist.store.user_tables import csv_of  # noqa: PLC0415

    points = problem_of(run).points
    clock, measured = points.clock, measured_of(run)[name]
    file, rows = checked_export(path, clock), _rows(run, name, measured)
    if file.suffix.lower() == ".ics" and clock.calendar:
        dates = [clock.dates[points.made_at(each)] for each in measured]
        content = _in_icalendar(run, rows, dates, clock.calendar.by_days).encode()
    else:
        columns = None if rows else ["measurement", "t"]
        content = csv_of(pd.DataFrame(rows, columns=columns))
    write_file(file, lambda temporary: temporary.write_bytes(content))
    return file


def _rows(run: StoredRun, name: str, measured: Times) -> _Rows:
    """A row for each measurement of the plan, in order of time."""
    rows, problem = _Rows(), problem_of(run)
    points, clock = problem.points, problem.clock
    windows = dict[int, dict[str, Any]]()
    if "sampling_windows" in run.tables:
        moved = run.table("sampling_windows")
        of_plan = moved[moved["name"] == name].to_dict("records")
        allowed = points.made(problem.feasible.allowed)
        order = {instant: place for place, instant in enumerate(allowed)}
        for percent in (STRICT, WIDE):
            for window in windows_of(of_plan, percent, clock):
                [at] = points.read([window.measurement])
                # Instants that are not allowed, such as weekends, end no window.
                inside = {t: order.get(instant, -2) for t, instant in window.inside.items()}
                [stretch] = [each for each in runs_of(inside) if window.t in each]
                ends = map(clock.text, (stretch[0], stretch[-1]))
                keys = f"earliest_{percent}", f"latest_{percent}"
                windows.setdefault(at, {}).update(zip(keys, ends, strict=True))
    for place, point in enumerate(measured, 1):
        instant = points.made_at(point)
        row: dict[str, Any] = {"measurement": place, "t": unrounded(clock.times[instant])}
        row |= {"date": clock.time(instant)} if clock.has_dates else {}
        rows.append(row | points.columns(point) | windows.get(point, {}))
    return rows


# --- iCalendar ------------------------------------------------------------------------------------


def _in_icalendar(run: StoredRun, rows: _Rows, dates: Sequence[datetime], by_days: bool) -> str:
    started = datetime.fromisoformat(provenance_of(run)["started"])
    lines = ["BEGIN:VCALENDAR", "VERSION:2.0", "PRODID:-//pfdist//plan//EN"]
    for row, moment in zip(rows, dates, strict=True):
        key, sensor = f"{run_key(run.path)}-{row['t']}", row.get("sensor", "")
        summary = f"Measurement {row['measurement']} of {len(rows)}"
        start = f":{moment:%Y%m%dT%H%M%S}"  # local, if the clock has no time zone
        if by_days:
            start = f";VALUE=DATE:{moment:%Y%m%d}"
        elif moment.tzinfo:
            start = f":{moment.astimezone(UTC):%Y%m%dT%H%M%SZ}"
        lines += [
            "BEGIN:VEVENT",
            f"UID:{key}{f'-{sensor}' * bool(sensor)}@pfdist",
            f"DTSTAMP:{started.astimezone(UTC):%Y%m%dT%H%M%SZ}",
            f"DTSTART{start}",
            f"SUMMARY:{_escaped(summary + f': {sensor}' * bool(sensor))}",
            f"DESCRIPTION:{_escaped(_description(run, row))}",
            "END:VEVENT",
        ]
    lines.append("END:VCALENDAR")
    return "".join(f"{_folded(line)}\r\n" for line in lines)


def _description(run: StoredRun, row: Mapping[str, Any]) -> str:
    ends = {
        percent: (row[f"earliest_{percent}"], row[f"latest_{percent}"])
        for percent in (STRICT, WIDE)
        if f"earliest_{percent}" in row
    }
    windows = [
        f"Alone it may move from {first} to {last} at a loss of at most {percent} %."
        for percent, (first, last) in ends.items()
        if first != last
    ]
    if ends and not windows:
        windows = [f"No other time is known to lose at most {WIDE} %."]
    return " ".join([f"Run {one_line(run.path.name)}, planned by pfdist.", *windows])


def _escaped(text: str) -> str:
    for mark in ("\\", ";", ","):
        text = text.replace(mark, f"\\{mark}")
    return text


def _folded(line: str) -> str:
    """A line in pieces of at most 75 octets; all but the first begin with a space."""
    pieces, size = [""], 0
    for letter in line:
        octets = len(letter.encode())
        if size + octets > _LINE:
            pieces.append(" ")
            size = 1
        pieces[-1] += letter
        size += octets
    return "\r\n".join(pieces)
