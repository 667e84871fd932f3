"""Tables that a user brings: measurements and priors, in CSV and Parquet, right and wrong."""

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from oracles.forged import with_sizes_of_nothing
from oracles.in_turn import in_turn
from pfdist import StateSpaceModel, load_model
from pfdist.errors import MeasurementsError, PriorError
from pfdist.filters.user_prior import read_prior
from pfdist.problem.calendar import Calendar
from pfdist.problem.clock import Clock
from pfdist.problem.measurements import Reading, read_measurements
from pfdist.problem.replicates import read_replicates
from pfdist.store import user_tables
from pfdist.store.user_tables import csv_of

NAN = float("nan")


@pytest.fixture(scope="module")
def ship() -> StateSpaceModel:
    return replace(load_model("constant_velocity"), missing_components=True)


def _written(path: Path, rows: dict[str, Any]) -> Path:
    frame = pd.DataFrame(rows)
    if path.suffix.lower() == ".parquet":
        frame.to_parquet(path)
    else:
        frame.to_csv(path, index=False)
    return path


# --- measurements ---------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["csv", "PARQUET"])
def test_rows_in_any_order_are_read_in_the_order_of_time(
    tmp_path: Path, ship: StateSpaceModel, suffix: str
) -> None:
    rows = {"y1": [0.5, NAN, 0.1, NAN], "t": [7, 0, 3, 5], "y0": [2.0, 1.5, 1e-3, NAN]}
    path = _written(tmp_path / f"ship.{suffix}", rows)
    found = read_measurements(path, ship, Clock.counting(10))
    assert found.t == (0, 3, 7)  # nothing was measured at 5
    np.testing.assert_array_equal(found.y, [[1.5, NAN], [1e-3, 0.1], [2.0, 0.5]])


def test_spaces_comments_a_mark_of_byte_order_and_words_for_missing_are_read(
    tmp_path: Path, ship: StateSpaceModel
) -> None:
    (tmp_path / "ship.csv").write_bytes(
        b'\xef\xbb\xbf# ship.csv\r\n#, "by hand\r\n'
        b"t, y0 ,y1\r\n 3 ,NaN, 1e-1\r\n4,NA,\r\n5.0,-2,null\r\n"
    )
    found = read_measurements(tmp_path / "ship.csv", ship, Clock.counting(10))
    assert found.t == (3, 5)
    np.testing.assert_array_equal(found.y, [[NAN, 0.1], [-2.0, NAN]])


@pytest.mark.parametrize(
    "text",
    [
        "t;y0\n0.5;1.25\n2;0.75\n",
        "  t      y0\n  0.5   1.25  \n   2  0.75\n",
        "t;y0\n0,5;1,25\n2;0,75\n",
        "t\ty0\n0,5\t1,25\n2\t0,75\n",
        "# Depth, m\nt|y0\n0.5|1.25\n2|0.75\n",
        "t,y0\r\n+5e-1,1.25\r\n2,7.5E-1\r\n",
        '"t","y0"\n"2","0.75"\n"0.5000000001","1.25"\n',
        ",t,y0\n1,0.5,1.25\n2,2,0.75\n",  # the index of pandas or R
        "t,y0,\n0.5,1.25,\n2,0.75,\n",
        "Time,note,conc\n0.5,a,1.25\n1,,NA\n2,b,0.75\n",
    ],
)
def test_programs_write_tables_in_many_ways(text: str, tmp_path: Path) -> None:
    """Published case: twenty kinds of CSV, of which some are refused with a remedy."""
    (tmp_path / "walk.csv").write_text(text, newline="")
    names = {"t": "Time", "y0": "conc"} if "Time" in text else {}
    clock, model = Clock.regular(12, 0.5, "h"), load_model("random_walk")
    found = read_measurements(tmp_path / "walk.csv", model, clock, reading=Reading(names))
    assert found.t == (1, 4)
    np.testing.assert_array_equal(found.y, [[1.25], [0.75]])


def test_a_table_without_rows_has_no_measurements(tmp_path: Path, ship: StateSpaceModel) -> None:
    for name in ("none.csv", "none.parquet"):
        found = read_measurements(
            _written(tmp_path / name, {"t": [], "y0": [], "y1": []}), ship, Clock.counting(9)
        )
        assert (found.t, found.y.shape) == ((), (0, 2))


@in_turn(
    ("content", "words"),
    [
        ("time,y0,y1\n1,2,3", "the columns must be t, y0, y1 or t, y_range, y_bearing"),
        ("t y0 y1\n1 2 3 4", "columns must be separated by commas, semicolons, tabs, | or spaces;"),
        ("t\ty0\ty1\n5s\t14n\t10n\n1\t2\t3", "must hold values, got '5s 14n 10n': remove a row"),
        ("t,y0,y1\nUTC,m,rad\n1,2,3", "the row below the names must hold values, got 'UTC m rad'"),
        ("1,2,3\n2,3,4", "the first line must name the columns"),
        ("", "must have a line that names the columns, got none"),
        ("t,y0,y1" + "\n1,2,3" * 9, "each time must have at most 8 rows, got more at t = 1"),
        ("t;y0;y1\n1;1.5;2,5", "must all have a comma or all a point"),
        ("t;y0;y1\n1;1,500;2,250", "one number must show that it is not thousands, got '1,500, 2"),
        ("t;y0;y1\n1;1.500,5;2", "column 'y0' in row 1 must be a number, got '1.500,5'"),
        ("t,y0,y1\n2,2,3\n3,high,3", "in row 2 must be a number, got 'high'; an empty cell is a"),
        ('t,y0,y1\n3,"1,000",3', "number, got '1,000'; thousands have no mark"),
        ("date,time,y0,y1\n3,1,2,3", "; join the date and the time to one column t"),
        ("t,y0,y1\n1792821600,1,2", "(row 1); stamps since 1970 need a start, problem.clock"),
        ("t,y0,y1\n3,.,3", "a number, got '.'; an empty cell is a missing number"),
        ("t,y0,y1\n3,<1.0,3", "a number, got '<1.0'; problem.sensor.limit reads it"),
        ("t,y0,y1\n3,1,2,3", "as many values as the first: Expected 3 fields in line 2, saw 4"),
        (b"t,y0,y1\n3,\xff,1", "must be UTF-8 text, got other bytes: save the sheet as CSV"),
        ("t,y0,y1\n3," + "x" * 3_000_000 + ",1", "column 'y0' in row 1 must be a number, got 'xxx"),
        (",".join(map(str, range(1001))) + "\n", "at most 1,000 columns, got 1,001"),
    ],
)  # fmt: skip
def test_a_wrong_csv_table_is_explained_in_one_line(
    content: str | bytes, words: str, tmp_path: Path, ship: StateSpaceModel
) -> None:
    path = tmp_path / "ship.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(MeasurementsError, match=re.escape(words)) as raised:
        read_measurements(path, ship, Clock.counting(10), start=1)
    message = str(raised.value)
    assert message.startswith(f"{path}: ")
    assert len(message) < len(str(path)) + 700
    assert "\n" not in message


def test_a_number_that_begins_with_nought_is_no_number_of_thousands(
    tmp_path: Path, ship: StateSpaceModel
) -> None:
    (tmp_path / "ship.csv").write_text("t;y0;y1\n1;0,125;0,250\n2;-1,500;2,250\n")
    found = read_measurements(tmp_path / "ship.csv", ship, Clock.counting(10))
    np.testing.assert_array_equal(found.y, [[0.125, 0.25], [-1.5, 2.25]])


@in_turn("suffix", ["csv", "parquet"])
@in_turn("has_dates", [False, True])
def test_a_missing_time_is_named_as_missing(
    tmp_path: Path, ship: StateSpaceModel, suffix: str, has_dates: bool
) -> None:
    start = Calendar.starting("2026-10-23", "h", "", by_days=False)
    clock = replace(Clock.regular(10, 1), calendar=start) if has_dates else Clock.counting(10)
    path = _written(tmp_path / f"ship.{suffix}", {"t": [1.0, NAN], "y0": 1.0, "y1": 2.0})
    with pytest.raises(MeasurementsError, match=r"t must not be empty, got nothing \(row 2\)"):
        read_measurements(path, ship, clock)


HOURLY = replace(Clock.regular(24, 1, "h"), calendar=Calendar.starting("2026-04-13", "h"))
CHICAGO = Calendar.starting("2026-04-13", "h", "America/Chicago")
FIRST = 1_776_038_400  # seconds from 1970 to the start, in UTC


@in_turn(
    ("cells", "said"),
    [
        (["0", "2026-04-13 02:00"], ""),
        ([FIRST, FIRST + 7200], "seconds since 1970"),
        ([FIRST * 1000, (FIRST + 7200) * 1000], "milliseconds since 1970"),
        ([FIRST * 10**6, (FIRST + 7200) * 10**6], "microseconds since 1970"),
        ([FIRST * 10**9, (FIRST + 7200) * 10**9], "nanoseconds since 1970"),
        ([2461143.5, 2461143.5 + 1 / 12], "Julian dates"),
        ([61143, 61143 + 1 / 12], "modified Julian dates"),
        (["20260413", "2026041302"], "year month day"),
        (["20260413", "20260413T020000"], "year month day"),
        (["13.04.2026", "13.04.2026 02:00"], "day.month.year"),
        (["13/4/2026 0:00", "13/4/2026 2:00"], "day/month/year"),
        (["04/13/2026", "04/13/2026 02:00:00"], "month/day/year"),
        (["2026/04/13", "2026/04/13 02:00"], "year/month/day"),
        ([103, 103 + 1 / 12], "days of the year"),
    ],
)
@in_turn("suffix", ["csv", "parquet"])
def test_times_are_read_in_the_one_way_in_which_they_lie_in_the_horizon(
    tmp_path: Path, ship: StateSpaceModel, cells: list[Any], said: str, suffix: str
) -> None:
    """The instants by hand: midnight, and two hours later; a line says how t was read."""
    path, notes = tmp_path / f"ship.{suffix}", list[str]()
    _written(path, {"t": cells, "y0": 1.0, "y1": 2.0})
    assert read_measurements(path, ship, HOURLY, reading=Reading(note=notes.append)).t == (0, 2)
    notes = [note for note in notes if "nearest instants" not in note]
    assert [f"read as {said}: " in note for note in notes] == [True] * bool(said)


def test_days_since_the_start_that_could_be_days_of_the_year_are_told(
    tmp_path: Path, ship: StateSpaceModel
) -> None:
    """100 days after 1 April is 10 July; day 100 of the year is 10 April."""
    line = (
        "t of the table is read as time since the start: '100' is 2026-07-10T00:00; as a day of "
        "the year it would be 2026-04-10T00:00"
    )
    clock = replace(Clock.regular(213, 1, "d"), calendar=Calendar.starting("2026-04-01", "d"))
    for cells, said in (([100, 150], line), ([10, 150], ""), ([0, 99], "")):
        path, notes = _written(tmp_path / "ship.csv", {"t": cells, "y0": 1.0, "y1": 2.0}), [""]
        assert read_measurements(path, ship, clock, reading=Reading(note=notes.append)).t == (
            *cells,
        )
        assert said in notes[-1]
        assert bool(notes[1:]) == bool(said)


@in_turn(
    ("start", "zone"),
    [("2026-01-01", ""), ("2026-01-01", "Europe/Brussels"), ("2026-01-01T08:00", "")],
)
def test_days_counted_from_0_or_1_in_january_are_not_told(
    tmp_path: Path, ship: StateSpaceModel, start: str, zone: str
) -> None:
    calendar = Calendar.starting(start, "d", zone)
    clock, notes = replace(Clock.regular(300, 1, "d"), calendar=calendar), list[str]()
    path = _written(tmp_path / "ship.csv", {"t": [100, 150], "y0": 1.0, "y1": 2.0})
    assert read_measurements(path, ship, clock, reading=Reading(note=notes.append)).t == (100, 150)
    assert notes == []


def test_numbers_since_an_epoch_are_in_utc(tmp_path: Path, ship: StateSpaceModel) -> None:
    """In April, midnight in Chicago is 5:00 in UTC; dates without an offset are local."""
    clock = replace(HOURLY, calendar=CHICAGO)
    for cell in (FIRST + 5 * 3600, 2461143.5 + 5 / 24, 61143 + 5 / 24, "13.04.2026", 103):
        path = _written(tmp_path / "ship.csv", {"t": [cell], "y0": 1.0, "y1": 2.0})
        assert read_measurements(path, ship, clock).t == (0,)


@in_turn(
    ("start", "cells", "words"),
    [
        ("2026-01-02", ["01/02/2026"], "got '01/02/2026', which is 2026-02-01T00:00 (day/month"),
        ("2026-04-13", ["2461200.5"], "got '2461200.5' (row 1); the nearest are Julian dates: 2"),
        ("2026-04-13", ["13.04.2026", "31.04.2026"], "exist, got 2026-04-31T00:00:00: day"),
        ("2026-04-13", ["13.04.2026", "soon"], "t must be written as in the other rows, got 'so"),
        ("2026-04-13", ["2025-04-13", "2025-04-14"], ": give --set problem.clock.start=2025-04-13"),
        ("2025-11-01", ["2024-11-02", "2024-11-03"], "write t in h since the start, as 24"),
        ("2026-04-13", ["2025-04-13", "2025-07-14"], "t must lie in 2026-04-13T00:00..2026-05-"),
        ("2026-04-13", ["noon"], "t must be a date, as 2026-04-01 or 2026-04-01T08:00, got 'noon'"),
    ],
)  # fmt: skip
def test_times_with_two_readings_or_none_are_explained(
    tmp_path: Path, ship: StateSpaceModel, start: str, cells: list[str], words: str
) -> None:
    clock = replace(Clock.regular(1000, 1, "h"), calendar=Calendar.starting(start, "h"))
    path = _written(tmp_path / "ship.csv", {"t": cells, "y0": 1.0, "y1": 2.0})
    with pytest.raises(MeasurementsError, match=re.escape(words)):
        read_measurements(path, ship, clock)


def test_a_file_of_too_many_rows_is_not_counted(tmp_path: Path, ship: StateSpaceModel) -> None:
    """The number of rows that were read is not that of the file."""
    path = tmp_path / "ship.csv"
    path.write_text("t,y0,y1\n" + "1,2,3\n" * 400_000)
    with pytest.raises(MeasurementsError, match=r"must have at most [\d,]+ rows, got more$"):
        read_measurements(path, ship, Clock.counting(10))


def test_a_wrong_parquet_table_is_explained_in_one_line(
    tmp_path: Path, ship: StateSpaceModel
) -> None:
    path = tmp_path / "ship.parquet"
    path.write_bytes(b"PAR1" + b"\xff" * 500 + b"PAR1")
    words = r"must be a Parquet table, got an error: \"Parquet file size"
    with pytest.raises(MeasurementsError, match=words):
        read_measurements(path, ship, Clock.counting(10))
    for wrong, must in (("high", "in row 1 must be a number"), (True, "must hold .* bool")):
        _written(path, {"t": [1], "y0": [wrong], "y1": [1.0]})
        with pytest.raises(MeasurementsError, match=f"'y0' {must}"):
            read_measurements(path, ship, Clock.counting(10))
    _written(path, {"t": [1, 2], "y0": [1, 2], "y1": [None, None]})
    assert read_measurements(path, ship, Clock.counting(10)).t == (1, 2)


def test_a_file_that_is_none_or_too_large_is_not_read(
    tmp_path: Path, ship: StateSpaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(MeasurementsError, match=r"^cannot read .*none\.csv: No such file"):
        read_measurements(tmp_path / "none.csv", ship, Clock.counting(10))
    with pytest.raises(MeasurementsError, match="a table must be a file, got a folder"):
        read_measurements(tmp_path, ship, Clock.counting(10))
    rows = {"t": [1, 2], "y0": [1.0, 2.0], "y1": [1.0, 2.0]}
    for name in ("ship.csv", "ship.parquet"):
        path = _written(tmp_path / name, rows)
        with monkeypatch.context() as less:
            less.setattr(user_tables, "MOST_NUMBERS", 5)
            with pytest.raises(
                MeasurementsError, match=r"of 3 columns must have at most 1 rows, got (more|2)"
            ):
                read_measurements(path, ship, Clock.counting(10))
        with monkeypatch.context() as less:
            less.setattr(user_tables, "MOST_BYTES", 15)
            with pytest.raises(MeasurementsError, match="must have at most 15 bytes, got"):
                read_measurements(path, ship, Clock.counting(10))
        assert read_measurements(path, ship, Clock.counting(10)).t == (1, 2)


def test_a_table_in_memory_may_have_an_index_missing_values_and_numbers_as_texts(
    ship: StateSpaceModel,
) -> None:
    table = pd.DataFrame(
        {"y0": pd.array([1, None], "Int64"), "y1": [" 0.1", None]}, index=pd.Index([3, 7], name="t")
    )
    found = read_measurements(table, ship, Clock.counting(10))
    assert found.t == (3,)  # nothing was measured at 7
    np.testing.assert_array_equal(found.y, [[1.0, 0.1]])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ([True], "must hold numbers, got bool"),
        ([1j], "must hold numbers, got complex128"),
        (pd.to_datetime(["2020-01-01"]), "must hold numbers, got datetime64"),
        ([[1.0, 2.0]], "in row 1 must be a number, got '[1.0, 2.0]'"),
        (["high"], "in row 1 must be a number, got 'high'"),
    ],
)
def test_a_column_in_memory_that_holds_no_numbers_is_named(
    wrong: Any, words: str, ship: StateSpaceModel
) -> None:
    table = pd.DataFrame({"t": [1], "y0": wrong, "y1": [1.0]})
    must = re.escape(f"measurements: column 'y0' {words}")
    with pytest.raises(MeasurementsError, match=must):
        read_measurements(table, ship, Clock.counting(10))


# --- large tables ---------------------------------------------------------------------------------


def _in_file(path: Path, **columns: Any) -> Path:
    pq.write_table(pa.table(columns), path, compression="zstd")
    return path


def _repeated(text: str, rows: int) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), pa.array([text]))


ZEROS = np.zeros(12_000)
LISTS = pa.ListArray.from_arrays(pa.array([0, 400_000]), pa.array(np.zeros(400_000, np.int8)))
OF_MARS = pa.array([0], pa.timestamp("ns", "Mars/Base"))
UNREAD: list[tuple[dict[str, Any], str]] = [
    (
        {"t": [1.0], "y0": [1.0], "y2": [1.0], "note": LISTS},
        "the columns must be t, y0, y1 or t, y_range, y_bearing, got",
    ),
    ({"t": [1.0], "y0": LISTS, "y1": [1.0]}, "column 'y0' must hold numbers, texts or dates, got"),
    ({"t": [1.0], "y0": [b"x"], "y1": [1.0]}, "column 'y0' must hold numbers, .* got binary"),
    ({"t": ZEROS, "y0": ZEROS, "y1": ZEROS}, "3 columns must have at most 10,088 rows, got 12,000"),
    (
        {"t": [1], "y0": OF_MARS, "y1": [1.0]},
        "must have a time zone that .* knows, got .*Mars/Base",
    ),
]


@pytest.mark.parametrize(("columns", "words"), UNREAD)
def test_names_types_and_sizes_are_refused_before_a_row_is_unpacked(
    columns: dict[str, Any], words: str, tmp_path: Path, ship: StateSpaceModel,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    path = _in_file(tmp_path / "bomb.parquet", **columns)
    monkeypatch.setattr(user_tables.pq, "ParquetFile", None)  # it reads rows
    with pytest.raises(MeasurementsError, match=words):
        read_measurements(path, ship, Clock.counting(10))


def test_the_unpacked_size_of_a_file_is_limited(
    tmp_path: Path, ship: StateSpaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = [f"{row:0200}" for row in range(100)]  # a kilobyte in the file, 20 when unpacked
    path = _in_file(tmp_path / "texts.parquet", t=texts, y0=texts, y1=texts)
    assert path.stat().st_size < 6000
    path.write_bytes(with_sizes_of_nothing(path.read_bytes()))
    monkeypatch.setattr(user_tables, "MOST_NUMBERS", 1000)
    with pytest.raises(MeasurementsError, match="must have at most 8,000 bytes unpacked, got 6"):
        read_measurements(path, ship, Clock.counting(10))


def test_a_text_that_many_rows_share_is_measured_before_it_is_repeated(tmp_path: Path) -> None:
    rows = 20_000
    path = _in_file(tmp_path / "days.parquet", day=_repeated("x" * 100_000, rows), t=np.zeros(rows))
    before = pa.default_memory_pool().max_memory()
    with pytest.raises(MeasurementsError, match="at most 250 bytes, got 100,000 in column 'day'"):
        read_replicates(path, "day", load_model("ungm"), Clock.counting(10), [])
    assert pa.default_memory_pool().max_memory() - before < 20_000_000  # repeated: 2 GB


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (",".join(f"c{k}" for k in range(100_000)), "at most 1,000 columns, got 100,000"),
        ("t," + "y" * 2_000_000, "the first line must be shorter than 1,000,000 letters"),
        ("#" + "x" * 2_000_000, "the first line must be shorter than 1,000,000 letters"),
        (
            't,"' + "y\n" * 200_000 + '"',
            "lines must have as many values as the first: field larger",
        ),
    ],
)
def test_a_line_of_names_is_refused_before_pandas_reads_it(
    line: str, words: str, tmp_path: Path, ship: StateSpaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wide.csv").write_text(f"{line}\n1,2\n")
    monkeypatch.setattr(user_tables.pd, "read_csv", None)
    with pytest.raises(MeasurementsError, match=words):
        read_measurements(tmp_path / "wide.csv", ship, Clock.counting(10))


@pytest.mark.parametrize("name", ["days.csv", "days.parquet"])
def test_a_table_is_the_same_however_many_parts_it_is_read_in(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(1)
    written = {"day": ["a", "b b"] * 15, "t": np.arange(30), "y0": rng.normal(size=30)}
    written["y1"] = np.where(written["t"] % 4 == 0, NAN, rng.normal(size=30))
    path = _written(tmp_path / name, written)
    for cells in (4, 16, 1000):
        monkeypatch.setattr(user_tables, "_CELLS", cells)
        found = user_tables.read_user_table(path, lambda header: ["day"])
        assert found["day"].tolist() == written["day"]
        for column in ("t", "y0", "y1"):
            np.testing.assert_allclose(found[column], written[column], rtol=1e-14)  # pandas 2
        (only,) = user_tables.read_user_table(path, lambda header: None, only=["y1"]).values()
        np.testing.assert_array_equal(only, found["y1"])
    monkeypatch.setattr(user_tables, "_CELLS", 8)
    wrong = [str(value) for value in written["y0"]]
    wrong[20] = "high"
    path = _written(tmp_path / name, written | {"y0": wrong})
    with pytest.raises(ValueError, match="column 'y0' in row 21 must be a number, got 'high'"):
        user_tables.read_user_table(path, lambda header: ["day"])


def test_lines_of_other_lengths_are_found_in_every_part(
    tmp_path: Path, ship: StateSpaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_tables, "_CELLS", 6)
    rows = "".join(f"{t},1,2\n" for t in range(8))
    (tmp_path / "ship.csv").write_text(f"# a\n\n#b\nt,y0,y1\n{rows}8,1,2,3\n")
    with pytest.raises(MeasurementsError, match="Expected 3 fields in line 10, saw 4"):
        read_measurements(tmp_path / "ship.csv", ship, Clock.counting(10))
    (tmp_path / "ship.csv").write_text(f"# a\n\n#b\nt,y0,y1\n{rows}8,1\n9,1,2\n")
    found = read_measurements(tmp_path / "ship.csv", ship, Clock.counting(10))
    assert found.t == tuple(range(10))
    assert np.isnan(found.y[8, 1])


# --- priors ---------------------------------------------------------------------------------------


def test_a_prior_is_read_with_its_weights_and_its_instant(tmp_path: Path) -> None:
    model = load_model("linear_gaussian")
    columns = {"x1": [1.0, 2.0, 3.0], "x0": [4.0, 5.0, 6.0]}
    for name in ("prior.parquet", "prior.csv"):
        cloud = read_prior(_written(tmp_path / name, columns), model)
        assert (cloud.t, cloud.weight) == (0, None)
        np.testing.assert_array_equal(cloud.x, [columns["x0"], columns["x1"]])
        more = columns | {"weight": [1.0, 0.0, 3.0], "t": [5, 5, 5]}
        cloud = read_prior(_written(tmp_path / name, more), model)
        assert cloud.t == 5
        np.testing.assert_array_equal(cloud.share, [0.25, 0.0, 0.75])


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"x0": [1.0], "x1": [1.0], "w": [1.0]}, "may be weight and t, got 'x0, x1, w'"),
        ({"x0": [1.0, NAN], "x1": [1.0, 2.0]}, "finite states, got x[0] = nan of particle 1"),
        ({"x0": [1.0, 1.0], "x1": [1.0, 1.0], "t": [3, 4]}, "for all particles, got 4"),
    ],
)  # fmt: skip
def test_a_wrong_prior_is_explained_in_one_line(
    columns: dict[str, Any], words: str, tmp_path: Path
) -> None:
    path = _written(tmp_path / "prior.parquet", columns)
    with pytest.raises(PriorError, match=re.escape(words)) as raised:
        read_prior(path, load_model("linear_gaussian"))
    assert str(raised.value).startswith(f"{path}: ")


def test_a_prior_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(PriorError, match=r"^cannot read .*none\.parquet: No such file"):
        read_prior(tmp_path / "none.parquet", load_model("ungm"))


@pytest.mark.parametrize("row", ["3      2.0", "3 1.0"])
def test_between_spaces_an_empty_cell_is_no_missing_value(
    tmp_path: Path, ship: StateSpaceModel, row: str
) -> None:
    """Nobody can tell which column it is: the values behind it would move to the left."""
    (tmp_path / "ship.txt").write_text(f"t y0 y1\n{row}\n4 1.0 3.0\n")
    with pytest.raises(MeasurementsError, match="each row must have as many values as the first"):
        read_measurements(tmp_path / "ship.txt", ship, Clock.counting(10))


def test_a_spreadsheet_computes_no_text_of_a_table_that_is_written() -> None:
    """Texts come from models and jobs of others; OWASP calls this CSV injection."""
    computed = ["=1+1", "+1 a", "-x", "@SUM(A1)", "\t=1", "=cmd|' /C calc'!A0"]
    plain = ["-1.5", "+2e3", "a=1", "", "2027-03-01", "'x", "9 b"]
    frame = pd.DataFrame({"=name": [*computed, *plain], "number": -1.0})
    read = pd.read_csv(io.BytesIO(csv_of(frame)), keep_default_na=False, dtype=str)
    assert [*read] == ["'=name", "number"]
    assert read["'=name"].tolist() == [*(f"'{text}" for text in computed), *plain]
    assert set(read["number"]) == {"-1.0"}
