"""Covariates: parameters of a job's models from columns of tables, a value for each instant.

Prices and what else varies with time may be columns, too, and tables of events are read alike. The
job then holds the values, and so does its identity. A run no longer needs the table.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pfdist.common.arguments import address_fault
from pfdist.common.nearest import did_you_mean, did_you_mean_path
from pfdist.common.parsing import MOST_NUMBERS
from pfdist.errors import JobError, MeasurementTimesError, shown
from pfdist.problem.points import Points

_KEYS = {"file", "column"}
_BY_TIME = {"price", "fails", "income", "instant_weights"}
_EVENT = ("time", "amount", "state")


def with_columns(section: Any, folder: Path, key: str = "model") -> Any:
    """A section [model] or [model.filter] of a job, with values instead of names of columns.

    Paths are relative to the folder. `key` names the section in the job. Raises `JobError` if a
    table cannot be read or lacks the column, or if a value is not a finite number.
    """
    if not isinstance(section, dict):
        return section
    read = dict(section)
    for part, read_table in (("parameters", _column), ("events", _events)):
        if isinstance(read.get(part), dict):
            read[part] = {
                name: read_table(value, folder, f"{key}.{part}.{name}")
                if isinstance(value, dict)
                else value
                for name, value in read[part].items()
            }
    if "filter" in read:
        read["filter"] = with_columns(read["filter"], folder, f"{key}.filter")
    return read


def with_columns_by_time(section: Any, folder: Path, key: str = "problem") -> Any:
    """A section [problem] of a job, with values instead of columns of what varies with time.

    Paths and errors are those of `with_columns`.
    """
    if not isinstance(section, dict):
        return section
    read = dict(section)
    for name, value in section.items():
        if name in _BY_TIME and isinstance(value, dict) and value.keys() & _KEYS:
            read[name] = _column(value, folder, f"{key}.{name}")
        else:
            read[name] = with_columns_by_time(value, folder, f"{key}.{name}")
    return read


def times_of_file(
    text: str, points: Points, folder: Path, note: Callable[[str], Any], key: str
) -> list[Any]:
    """The times of a table as a job writes them, given a text such as ``@last.csv``.

    They are those of the column t, or of another as in ``@last.csv:date``, with their sensors, in
    any year. Each counts at the nearest instant, two at one instant once; `note` receives a line if
    one moves.
    Raises `JobError`, which begins with `key`.
    """
    from pfdist.store.user_tables import read_user_table  # noqa: PLC0415  as below

    clock, names = points.clock, ["t", *["sensor"] * bool(points.sensors)]
    file, _, column = text.removeprefix("@").partition(":")
    if fault := address_fault(file):
        raise JobError(f"{key} {fault}")
    path, renamed = folder / file, {"t": column} if column else {}

    def check_header(header: list[str]) -> None:
        for name in names:
            if name not in header:
                other = f"; another is named {text}:COLUMN" * (name == "t")
                got = ", ".join(header)
                raise ValueError(f"a table of times needs a column {name}, got {got}{other}")

    try:
        table = read_user_table(
            path, check_header, names, {"sensor": points.sensors}, clock.readers(between=True),
            renamed=renamed,
        )  # fmt: skip
        times = clock.of_table(table["t"].tolist(), note, any_year=True)
        for time in times:
            clock.check_is_within(time, "t")
    except OSError as error:
        raise JobError(f"{key}: cannot read {path}: {error.strerror}") from error
    except (ValueError, MeasurementTimesError) as error:
        raise JobError(f"{key}: {error} ({path})") from error
    instants = clock.nearest(times)
    distances = [abs(clock.times[t] - time) for t, time in zip(instants, times, strict=True)]
    if (most := max(distances, default=0.0)) > clock.slack:
        note(f"times of {path} count at the nearest instants, at most {clock.duration(most)} away")
    if not points.sensors:
        return [*dict.fromkeys(map(clock.time, instants))]
    ways = table["sensor"].astype(int).tolist()
    texts = [clock.text(clock.times[t]) for t in instants]
    return [
        *dict.fromkeys(
            f"{text} {points.sensors[way]}" for text, way in zip(texts, ways, strict=True)
        )
    ]


def _events(given: dict[str, Any], folder: Path, key: str) -> list[list[Any]]:
    """The rows of a table of events."""
    if given.keys() != {"file"} or not isinstance(given["file"], str):
        raise JobError(
            f"{key} must be rows [time, amount, state], or a table with these columns, as "
            f'{{file = "doses.csv"}}, got {shown(given)}'
        )
    columns = _read(given["file"], _EVENT, folder, key)
    for row, state in enumerate(columns[2], 1):
        if state < 0 or state % 1:
            raise JobError(f"{key}: state must be the number of a component of x, got {state} in "
                           f"row {row} ({folder / given['file']})")  # fmt: skip
    return [[time, amount, int(state)] for time, amount, state in zip(*columns, strict=True)]


def _column(given: dict[str, Any], folder: Path, key: str) -> list[float]:
    """The values of a column; by default it has the name of the parameter, the end of the key."""
    file, column = given.get("file"), given.get("column", key.rpartition(".")[2])
    if given.keys() - _KEYS or not (isinstance(file, str) and isinstance(column, str)):
        raise JobError(
            f"{key} must be numbers, or a column of a table, as "
            f'{{file = "weather.csv", column = "rain"}}, got {shown(given)}'
        )

    return _read(file, (column,), folder, key)[0]


def _read(file: str, names: Sequence[str], folder: Path, key: str) -> list[list[float]]:
    """The finite numbers of some columns of a table."""
    # Imported here, because most jobs need no tables.
    from pfdist.store.user_tables import read_user_table  # noqa: PLC0415

    def check_header(header: list[str]) -> None:
        for column in names:
            if column not in header:
                meant, columns = did_you_mean(column, header) or ".", ", ".join(header)
                raise ValueError(
                    f"the table has no column {shown(column)}{meant} Columns: {columns}"
                )

    if fault := address_fault(file):
        raise JobError(f"{key}.file {fault}")
    path = folder / file
    try:
        table = read_user_table(path, check_header, names, most_rows=MOST_NUMBERS)
    except OSError as error:
        meant = did_you_mean_path(path, (path.parent,), lambda other: other.suffix == path.suffix)
        raise JobError(f"{key}: cannot read {path}: {error.strerror}{meant}") from error
    except ValueError as error:
        raise JobError(f"{key}: {error} ({path})") from error
    for column in names:
        for row in np.flatnonzero(~np.isfinite(table[column]))[:1]:
            raise JobError(
                f"{key}: column {shown(column)} must hold finite numbers, got "
                f"{table[column][row]} in row {row + 1} ({path})"
            )
    return [table[column].tolist() for column in names]
