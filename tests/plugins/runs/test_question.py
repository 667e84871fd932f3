"""Many runs as one table: its numbers are those of each run's own summary."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.listed import rewrite
from oracles.results_of import results_of
from pfdist import Job
from pfdist.errors import PfdistError, PfdistWarning, StoreError

SHORT = ["comparison.draws=60", "search.genetic.generations=1", "filter.particles=10"]
KALMAN = ["model.name=random_walk", "filter.engine=kalman"]
GAINS = ("gain_of_means", "mean_relative_gain", "positive_fraction")


@pytest.fixture
def folder(finished: Callable[..., Path], tmp_path: Path) -> Path:
    """A folder as of a sweep over two keys, and another run beside it."""
    folder = tmp_path / "folder"
    shutil.copytree(finished(*SHORT), folder / "sweep" / "n-4")
    more = ["seed=2", "problem.measurement_budget=10"]
    shutil.copytree(finished(*SHORT, *more), folder / "sweep" / "n-10")
    shutil.copytree(finished(*SHORT, *KALMAN), folder / "kalman")
    return folder


def test_each_row_has_the_numbers_of_the_summary(folder: Path) -> None:
    frame = pfdist.table(folder / "sweep")
    assert frame["run"].tolist() == ["n-4"] * 2 + ["n-10"] * 2  # numbers as numbers
    for row in frame.to_dict("records"):
        run = pfdist.open_run(row["path"])
        result, regular = (results_of(run)[row[name]] for name in ("set", "reference"))
        assert row["reference"] == "regular"
        for key in ("expected_mse", "standard_error", *GAINS):
            assert row[key] == getattr(result, key)
        for gain in GAINS:
            for end in (f"{gain}_low", f"{gain}_high"):
                assert row[end] == getattr(result, end)
        assert row["reference_mse"] == regular.expected_mse
        assert row["reference_standard_error"] == regular.standard_error
        assert row["measurement_times"] == tuple(result.measurement_times)
        assert row["measurements"] == len(result.measurement_times)
        for key in ("state", "evaluations"):
            assert row[key] == run.as_json()[key]
        assert row["draws"] == run.draws_compared == 60
        assert row["worker_seconds"] == run.table("timings")["seconds"].sum()
        assert np.isnan([row["bound"], row["bound_gap"], row["bound_gap_at_most"]]).all()


def test_the_keys_that_differ_are_columns_and_no_others(folder: Path) -> None:
    frame = pfdist.table(folder / "sweep")
    columns = frame.columns.tolist()
    assert columns[: columns.index("set")] == ["run", "seed", "problem.measurement_budget"]
    assert frame["seed"].tolist() == [1, 1, 2, 2]
    assert frame["problem.measurement_budget"].dtype == np.int64
    alone = pfdist.table(folder / "kalman")
    assert alone.columns.tolist()[:2] == ["run", "set"]
    # and so are versions
    other = shutil.copytree(folder / "kalman", folder / "other")
    about = json.loads((other / "run.json").read_text())
    rewrite(other / "run.json", json.dumps({**about, "pfdist": "0.3.1"}))
    assert {"0.3.1"} < {*pfdist.table(folder / "kalman", other)["pfdist"]}


def test_an_exact_engine_has_exact_errors_and_a_proof_has_its_gap(
    small_job: Job, tmp_path: Path
) -> None:
    job = small_job.with_changes([*SHORT, *KALMAN])
    run = pfdist.run(job, tmp_path / "proved", bound_draws=480, figures=False)
    summary = results_of(run)
    for row in pfdist.table(run).to_dict("records"):
        result = summary[row["set"]]
        exact = pfdist.evaluate(job, {"set": result.measurement_times, "regular": "regular"})
        errors = [each.expected_mse for each in exact.values()]
        assert (row["expected_mse"], row["standard_error"]) == (errors[0], 0.0)
        assert row["gain_of_means"] == 1 - errors[0] / errors[1]
        assert row["gain_of_means_low"] == row["gain_of_means_high"] == row["gain_of_means"]
        assert row["reference_mse"] == errors[1]
        assert row["bound"] == result.bound <= row["expected_mse"] * (1 + 1e-9)
        assert row["bound_gap"] == result.bound_gap


def test_runs_lists_and_folders_are_the_same_and_count_once(folder: Path) -> None:
    paths = [folder / "sweep" / "n-4", folder / "sweep" / "n-10"]
    frame = pfdist.table(folder / "sweep")
    for runs in (paths, [paths], [pfdist.open_run(paths[0]), str(paths[1]), paths[0] / "."]):
        pd.testing.assert_frame_equal(pfdist.table(*runs), frame)


def test_a_folder_with_sweeps_stands_for_their_points(folder: Path) -> None:
    assert set(pfdist.table(folder)["run"]) == {"kalman", "n-4", "n-10"}
    assert set(pfdist.table(folder / "sweep")["run"]) == {"n-4", "n-10"}


def test_names_that_clash_are_told_apart_by_their_paths(folder: Path) -> None:
    for name in ("a/run", "b/run", "b/other"):
        shutil.copytree(folder / "kalman", folder / name)
    names = pfdist.table(*(folder / name for name in ("a/run", "b/run", "b/other")))["run"]
    assert names.unique().tolist() == ["a/run", "b/run", "other"]


def test_a_run_without_results_has_a_row_with_its_state(folder: Path, small_job: Job) -> None:
    def stop(progress: Any) -> None:
        raise KeyboardInterrupt

    job = small_job.with_changes([*SHORT, "seed=7"])
    with pytest.raises(KeyboardInterrupt):
        pfdist.run(job, folder / "stopped", progress=stop, figures=False)
    row, *others = pfdist.table(folder / "stopped", folder / "sweep" / "n-4").to_dict("records")
    assert [other["seed"] for other in others] == [1, 1]
    assert (row["run"], row["seed"], row["state"]) == ("stopped", 7, "searching")
    assert pd.isna([row["set"], row["expected_mse"], row["gain_of_means"]]).all()
    assert row["measurement_times"] is None


@pytest.mark.plugins("budget")
def test_found_times_of_several_numbers_are_compared_with_regular_times_of_the_same(
    small_job: Job, tmp_path: Path
) -> None:
    job = small_job.with_changes(["filter.particles=10"])
    run = pfdist.budget(job, (3, 4), tmp_path / "curve", 50, bound_draws=0, figures=False)
    frame, mse = pfdist.table(run), run.table("comparison")
    assert frame["measurements"].tolist() == [3, 4]
    for row in frame.to_dict("records"):
        found, regular = (mse[f"mse_{row[name]}"] for name in ("set", "reference"))
        assert row["reference"].startswith("regular")
        means = [
            (mse[f"mse_{row[name]}"] - mse[f"control_{row[name]}"]).mean()
            for name in ("set", "reference")
        ]
        assert row["reference_mse"] == pytest.approx(means[1])
        assert row["gain_of_means"] == pytest.approx(1 - means[0] / means[1])
        assert row["mean_relative_gain"] == pytest.approx((1 - found / regular).mean())


# --- As a file ----------------------------------------------------------------------------------


def test_a_csv_file_and_a_parquet_file_hold_the_table(
    folder: Path, finished: Callable[..., Path]
) -> None:
    """Values of different types are text."""
    given = finished(*SHORT, "comparison.reference=[0, 3]")
    frame = pfdist.table(folder, given, out=folder / "t.parquet")
    assert {(0, 3), "regular"} == {*frame["comparison.reference"]}
    read = pd.read_parquet(folder / "t.parquet")
    assert read.columns.tolist() == frame.columns.tolist()
    times = frame["measurement_times"].tolist()
    assert [tuple(each) for each in read["measurement_times"]] == times
    pfdist.table(folder, given, out=folder / "t.csv")
    text = pd.read_csv(folder / "t.csv")
    assert text["measurement_times"].tolist() == [" ".join(map(str, each)) for each in times]
    for column in frame.columns:
        if pd.api.types.is_numeric_dtype(frame[column]):
            assert pd.api.types.is_numeric_dtype(read[column])
            for file in (read, text):
                np.testing.assert_array_equal(
                    file[column].to_numpy(float, na_value=np.nan),
                    frame[column].to_numpy(float, na_value=np.nan),
                )
    for file in (read, text):
        assert {"0 3", "regular"} == {*file["comparison.reference"]}


def test_earlier_tables_are_replaced_and_no_other_file(folder: Path) -> None:
    for ending in ("csv", "parquet"):
        out = folder / f"again.{ending}"
        pfdist.table(folder / "kalman", out=out)
        pfdist.table(folder / "sweep", out=out)  # with other columns
        out.write_text("run,mine\n")
        with pytest.raises(PfdistError, match="exists and is not an earlier result"):
            pfdist.table(folder / "kalman", out=out)
        assert out.read_text() == "run,mine\n"


@pytest.mark.parametrize("name", ["a,b\nc", "\x1b[2J", "a\udcffb", "x" * 200])
def test_any_name_of_a_folder_is_written(name: str, folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "kalman", tmp_path / name)
    for ending in ("csv", "parquet"):
        pfdist.table(tmp_path / name, out=tmp_path / f"t.{ending}")
    with (tmp_path / "t.csv").open(newline="", errors="surrogateescape") as file:
        assert [row["run"] for row in csv.DictReader(file)] == [name] * 2
    assert len(pd.read_parquet(tmp_path / "t.parquet")) == 2


def test_what_is_no_run_or_no_table_is_one_line(folder: Path) -> None:
    kalman, empty, linked = folder / "kalman", folder / "empty", folder / "linked"
    empty.mkdir()
    shutil.copytree(kalman, linked)
    (linked / "tables" / "online").symlink_to("/etc")
    for runs, out, words in (
        ([kalman, empty], None, "empty holds no run"),
        ([kalman], "t.xlsx", r"must end in one of \.csv, \.parquet, got"),
        ([[]], None, "at least one run"),
        ([linked], None, "got a link"),
    ):
        with pytest.raises(PfdistError, match=words):
            pfdist.table(*runs, out=out)


def test_a_run_in_a_folder_that_cannot_be_read_is_left_out(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    for name in ("good", "strange"):
        shutil.copytree(finished(), tmp_path / name)
    job = tmp_path / "strange" / "job.toml"
    rewrite(job, '"a.b" = 1\n' + job.read_text())
    with pytest.warns(PfdistWarning, match="strange is left out: .*unknown key 'a.b'"):
        frame = pfdist.table(tmp_path)
    assert set(frame["run"]) == {"good"}
    assert set(pfdist.list_runs(tmp_path)["run"]) == {"good", "strange"}
    with pytest.raises(StoreError, match="unknown key"):
        pfdist.table(tmp_path / "good", tmp_path / "strange")
