"""Long tables of many systems: what is read, and one line for each mistake."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.lake import lake
from oracles.two_platforms import two_platforms
from pfdist.errors import MeasurementsError
from pfdist.problem.clock import Clock
from pfdist.problem.measurements import Reading
from pfdist.problem.points import Points
from pfdist.problem.replicates import Replicate, read_replicates
from pfdist.store import user_tables

MODEL = lake()
COUNTS = Clock.counting(4)
HOURS = Clock.regular(24, 6, "h")


def read(
    text: str | pd.DataFrame, folder: Path, clock: Clock = COUNTS, model: Any = MODEL, column="",
) -> list[Replicate]:  # fmt: skip
    """The replicates of a CSV table, whose header may be left out."""
    reading = Reading(any_time=lambda: True)
    if isinstance(text, pd.DataFrame):
        return read_replicates(text, column, model, clock, [*model.parameters], reading)
    path = folder / "days.csv"
    path.write_text(text, encoding="utf-8")
    return read_replicates(path, column, model, clock, [*model.parameters], reading)


def test_a_table_has_the_replicates_in_their_order(tmp_path: Path) -> None:
    text = "day,t,y0\ntue,2,0.5\ntue,0,0.25\nmon,1,\nmon,3,1.5\n"
    tuesday, monday = read(text, tmp_path)
    assert (tuesday.name, monday.name) == ("tue", "mon")
    np.testing.assert_array_equal(tuesday.y[:, 0], [0.25, np.nan, 0.5, np.nan, np.nan])
    np.testing.assert_array_equal(monday.y[:, 0], [np.nan, np.nan, np.nan, 1.5, np.nan])
    assert monday.measured(MODEL) == (3,)
    assert monday.z is None
    assert (monday.is_training, monday.has_own_clock, monday.parameters) == (False, False, {})
    assert monday.clock is COUNTS


def test_parquet_and_a_table_in_memory_are_read_alike(tmp_path: Path) -> None:
    table = pd.DataFrame({"year": [1990, 1990, 1991], "t": [0, 1, 0], "y0": [1.0, 2.0, 3.0]})
    table.to_parquet(tmp_path / "years.parquet")
    for source in (
        table,
        table.set_index("year"),
        table.assign(year=table["year"].astype("category")),
        tmp_path / "years.parquet",
    ):
        first, second = read_replicates(source, "", MODEL, COUNTS, [])
        assert (first.name, second.name) == ("1990", "1991")
        assert first.y[:2, 0].tolist() == [1.0, 2.0]


def test_any_column_may_name_the_replicate_also_with_the_letter_y(tmp_path: Path) -> None:
    text = "t,y_turbidity,yard\n0,1,a\n1,2,a\n"
    (found,) = read(text, tmp_path, column="yard")
    assert found.name == "a"
    assert found.y[:2, 0].tolist() == [1.0, 2.0]


def test_covariates_are_numbers_or_values_at_each_instant(tmp_path: Path) -> None:
    rows = [f"{day},{t},1,{0.1 if day == 'a' else 0.1 * (t + 1):.1f}" for day in "ab"
            for t in range(1, 5)]  # fmt: skip
    a, b = read("\n".join(["day,t,y0,noise", *rows]), tmp_path)
    assert a.parameters == {"noise": 0.1}
    assert b.parameters == {"noise": (0.2, 0.2, 0.3, 0.4, 0.5)}  # the first instant has no row
    assert a.key != b.key


def test_known_quantities_and_training_replicates(tmp_path: Path) -> None:
    text = "day,t,y0,z_turbidity,train\na,0,1,1.5,0\na,1,2,,0\nb,0,1,2.5,1\n"
    a, b = read(text, tmp_path)
    np.testing.assert_array_equal(a.z[:, 0], [1.5, np.nan, np.nan, np.nan, np.nan])
    assert (a.is_training, b.is_training) == (False, True)


def test_times_beside_the_clock_make_a_clock_of_the_replicate(tmp_path: Path) -> None:
    on, own = read("day,t,y0\na,6,1\na,0,1\nb,7.5,1\nb,23,2\n", tmp_path, HOURS)
    assert (on.has_own_clock, on.clock) == (False, HOURS)
    assert own.has_own_clock
    assert own.clock.times == (0.0, 7.5, 23.0)  # the first instant is that of the job
    assert (own.clock.unit, own.y.shape) == ("h", (3, 1))
    assert own.measured(MODEL) == (1, 2)


def test_a_clock_of_the_replicate_may_have_more_instants_than_covariates_of_the_job(
    tmp_path: Path,
) -> None:
    """As a rate of infusion at each time of a patient, where the job has a few instants."""
    model = replace(MODEL, parameters={**MODEL.parameters, "rate": (1.0, 0.0)})
    text = "t,y0,rate,day\n0,1,5,a\n1,2,4,a\n2,2,3,a\n5,2,1,a\n6,1,1,a\n"
    (only,) = read(text, tmp_path, Clock.regular(6, 6, "h"), model, "day")
    assert only.clock.times == (0, 1, 2, 5, 6)
    assert only.parameters == {"rate": (5.0, 4.0, 3.0, 1.0, 1.0)}


def test_sensors_have_a_row_each(tmp_path: Path) -> None:
    text = "day,t,sensor,y0\na,6,still,1\na,6,moving,2\na,0,still,3\nb,1.5,moving,4\n"
    a, b = read(text, tmp_path, HOURS, two_platforms())
    assert a.measured(two_platforms()) == (1, 2, 3)  # t * 2 + sensor
    assert a.y[1].tolist() == [2.0, 1.0]
    assert b.measured(two_platforms()) == (2,)
    assert b.clock.times == (0.0, 1.5)


def test_the_nearest_measurement_is_used_once_and_by_its_sensor(tmp_path: Path) -> None:
    (found,) = read("day,t,y0\n" + "".join(f"a,{t},1\n" for t in (1, 7, 13, 23)), tmp_path, HOURS)
    points = Points(found.clock)
    assert found.nearest([(0.0, 0), (12.0, 0)], points, MODEL, 1.0) == (1, 3)
    assert found.nearest([(6.9, 0), (7.1, 0)], points, MODEL, 6.0) == (2, 3)  # the next nearest
    late = Points(found.clock, delays=(1,))
    assert found.nearest([(7.0, 0)], late, MODEL, 0.5) == (3,)  # arrives at 13, made at 7
    with pytest.raises(MeasurementsError, match=r"no measurement within 30 min of t = 12"):
        found.nearest([(1.0, 0), (12.0, 0)], points, MODEL, 0.5)
    with pytest.raises(MeasurementsError, match=r"of t = 2, but one that an earlier time uses$"):
        found.nearest([(2.0, 0)] * 5, points, MODEL, 100.0)
    text = "day,t,sensor,y0\na,0,still,1\na,6,moving,2\n"
    (seen,) = read(text, tmp_path, HOURS, two_platforms())
    points = Points(seen.clock, ("moving", "still"))
    assert seen.nearest([(5.0, 1)], points, two_platforms(), 5.0) == (1,)
    with pytest.raises(MeasurementsError, match="no measurement by still within 3 h of t = 5"):
        seen.nearest([(5.0, 1)], points, two_platforms(), 3.0)


HEAD = "day,t,y0"
COLUMNS = r"day, t, y0, y_turbidity, y, z0, z_turbidity, z, train, a, sd, noise"


@in_turn(
    ("text", "said"),
    [
        ("", "a table must have a line that names the columns, got none"),
        (HEAD, "the table must have rows, got none"),
        ("day:t:y0\na:0:1", "the column t is missing, got day:t:y0; columns must be separated by "
                            "commas, semicolons, tabs, | or spaces; decimals have a point"),
        (f"{HEAD}\n,0,1", "column 'day' must not be empty, got nothing in row 1"),
        ("day,y0\na,1", "the column t is missing, got day, y0"),
        (f"{HEAD},y1\na,0,1,1", f"unknown column 'y1'. Columns: {COLUMNS}"),
        ("t,y0\n0,1", "replicate must be a column with names of systems: the table has none, got "
                      "'t'"),
        (f"{HEAD},z0,z_turbidity\na,0,1,1,1", "columns of z must be z0 or z_turbidity or z, got "
                                              "z0, z_turbidity"),
        (f"{HEAD},z0\na,0,1,inf", "replicate 'a': z0 must have one finite value at each time, got "
                                  "inf at t = 0"),
        (f"{HEAD}\na,0,1" + 9 * "\nb,1,1", "replicate 'b': each time must have at most 8 rows, got "
                                         "more at t = 1"),
        (f"{HEAD}\na,0,inf", "replicate 'a': a measurement must be finite, or NaN where a "
                             "component is missing, got y0 = inf at t = 0"),
        (f"{HEAD}\na,-1,1", "replicate 'a': t must lie in 0..4, got -1"),
        (f"{HEAD}\na,0,1\na,5,1", "replicate 'a': t must lie in 0..4, got 5"),
        (f"{HEAD},train\na,0,1,0\na,1,1,1", "train must be 0 or 1 in all rows, got [0.0, 1.0]"),
        (f"{HEAD},noise\na,0,1,\na,1,1,1", "replicate 'a': noise must be a finite number in all "
                                           "rows, got nan"),
        (f"{HEAD},noise\na,0,1,.1\na,2,1,.2", "replicate 'a': noise varies, so it must have a "
                                              "value at each instant, got none at t = 1"),
    ],
)  # fmt: skip
def test_a_wrong_table_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(MeasurementsError) as error:
        read(text, tmp_path)
    line = str(error.value)
    assert line.startswith(f"{tmp_path / 'days.csv'}: ")
    assert "\n" not in line
    assert said in line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("day,t,y0\na,0,1", "the column sensor is missing, got day, t, y0"),
        ("day,t,sensor,y0\na,0,stil,1", "column 'sensor' in row 1: got 'stil'; did you mean "
                                        "'still'?"),
        ("day,t,sensor,y0" + 9 * "\na,0,still,1", "time must have at most 8 rows of still, got "
                                                 "more at t = 0"),
        ("day,t,sensor,y0,z0,z1\na,0,still,1,1,1\na,0,moving,1,1,2",
         "replicate 'a': z1 must have one finite value at each time, got 1.0 and 2.0 at t = 0"),
        ("day,t,sensor,y0,range_sd\na,0,still,1,1\na,0,moving,1,2", "range_sd must have one finite "
                                                                    "value at each time"),
    ],
)  # fmt: skip
def test_a_wrong_table_of_sensors_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(MeasurementsError) as error:
        read(text, tmp_path, HOURS, two_platforms())
    assert said in str(error.value), str(error.value)
    assert "\n" not in str(error.value)


def test_times_outside_are_named_and_rows_of_one_time_follow_each_other(
    tmp_path: Path,
) -> None:
    for time, said in (("-1", "0..24"), ("24.5", "0..24"), ("inf", "inf")):
        with pytest.raises(MeasurementsError, match=said) as error:
            read(f"day,t,y0\na,{time},1\n", tmp_path, HOURS)
        assert "replicate 'a': t must " in str(error.value)
    with pytest.raises(MeasurementsError, match=r"t must not be empty, got nothing \(row 2\)"):
        read("day,t,y0\na,1,1\na,nan,1\n", tmp_path, HOURS)
    (found,) = read("day,t,y0\na,1.5,1\na,1.5,2\n", tmp_path, HOURS)
    assert found.y.tolist()[1] == [1.0, 2.0]


def test_files_that_are_no_tables_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def said(path: Path, match: str) -> None:
        with pytest.raises(MeasurementsError, match=match):
            read_replicates(path, "", MODEL, COUNTS, [])

    said(tmp_path / "none.csv", r"cannot read .*none\.csv: No such file")
    said(tmp_path, "a table must be a file, got a folder, a pipe or a device")
    os.mkfifo(tmp_path / "pipe.csv")
    said(tmp_path / "pipe.csv", "a table must be a file, got a folder, a pipe or a device")
    (tmp_path / "wrong.parquet").write_text("day,t,y0\n")
    said(tmp_path / "wrong.parquet", "must be a Parquet table")
    (tmp_path / "latin.csv").write_bytes("day,t,y0\né,0,1\n".encode("latin-1"))
    said(tmp_path / "latin.csv", "must be UTF-8 text")
    large = pd.DataFrame({"day": ["a"] * 4, "t": range(4), "y0": 1.0})
    monkeypatch.setattr(user_tables, "MOST_NUMBERS", 11)
    with pytest.raises(
        MeasurementsError, match="data: a table of 3 columns must have at most 3 rows"
    ):
        read_replicates(large, "", MODEL, COUNTS, [])


@pytest.mark.parametrize("column", ["t", "y0", "noise", "nobody", "dya"])
def test_a_column_of_replicates_must_have_names(column: str, tmp_path: Path) -> None:
    with pytest.raises(MeasurementsError, match="column with names of systems: day") as error:
        read("day,t,y0,noise\na,0,1,1\n", tmp_path, column=column)
    assert ("did you mean 'day'" in str(error.value)) is (column == "dya")


def test_missing_components_are_for_models_that_declare_them(tmp_path: Path) -> None:
    ship, text = pfdist.load_model("constant_velocity"), "ship,t,y0,y1\na,0,1,\n"
    with pytest.raises(MeasurementsError, match=r"replicate 'a': all components of y must be"):
        read(text, tmp_path, model=ship)
    (found,) = read(text, tmp_path, model=replace(ship, missing_components=True))
    np.testing.assert_array_equal(found.y[0], [1.0, np.nan])
