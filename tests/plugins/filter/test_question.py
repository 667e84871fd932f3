"""Measurements of a user, filtered from the command line: the table, the figure and the words."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Filter, Job
from pfdist.common.component_names import named_components, numbered_components
from pfdist.errors import JobError, MeasurementsError, PfdistWarning, PriorError, StoreError
from pfdist.filters import one_filter
from pfdist.filters.filter_estimate import FilterEstimate
from pfdist.filters.simulation import simulate
from pfdist.plugins.filter.question import IMPROBABLE, FilteredMeasurements
from pfdist.problem.clock import Clock
from pfdist.store import filtered_schema

HORIZON = 12
QUANTILES = {5: 0.05, 25: 0.25, 50: 0.5, 75: 0.75, 95: 0.95}


FEW = ["search.random.evaluations=3", "search.genetic.generations=1", "comparison.draws=20"]


@pytest.fixture
def job(finished: Callable[..., Path]) -> Path:
    """The job of a finished run, in the folder of the run."""
    wrong = ["model.filter.parameters.process_sd=1.5"]
    return finished(*FEW, *wrong) / "job.toml"


@pytest.fixture
def y() -> Any:
    return simulate(pfdist.load_model("ungm"), HORIZON, range(1), 99).y[0, :, 0]


def _written(path: Path, times: Any, y: Any) -> Path:
    frame = pd.DataFrame({"t": list(times), "y0": [float(y[t]) for t in times]})
    frame.to_parquet(path) if path.suffix == ".parquet" else frame.to_csv(path, index=False)
    return path


@pytest.mark.usefixtures("undrawn")
def test_a_job_without_a_run_filters_as_that_of_its_run(job: Path, y: Any, tmp_path: Path) -> None:
    alone = tmp_path / "alone.toml"
    alone.write_text(job.read_text())
    table = _written(tmp_path / "mine.csv", (1, 4, 8), y)
    with_run, without = (
        pfdist.filter_measurements(each, table, out=tmp_path / each.stem) for each in (job, alone)
    )
    pd.testing.assert_frame_equal(without.table, with_run.table)
    assert (without.run, without.name, without.extra) == (None, "", ())
    assert "planned" in repr(with_run._page())
    assert "planned" not in repr(without._page())
    report = (tmp_path / "alone" / "mine.filtered.html").read_text()
    assert "by the filter of the job alone" in report
    with pytest.raises(StoreError, match="there is no run of this job"):
        pfdist.filter_measurements(alone, table, planned="genetic")


@pytest.mark.plugins("online")
@pytest.mark.usefixtures("undrawn")
def test_without_a_run_the_measurements_alone_plan(job: Path, y: Any, tmp_path: Path) -> None:
    alone = tmp_path / "alone.toml"
    alone.write_text(job.read_text())
    table = _written(tmp_path / "mine.csv", (1, 4), y)
    found, planner = pfdist.next_time(alone, table), pfdist.Planner(alone)
    for t in (1, 4):
        planner.update(y[t], t)
    assert found.plan == planner.plan()
    assert len(found.plan) == found.left == 2
    assert (found.run, found.planned_before, found.expected_before) == (None, (), None)
    assert "planned before" not in repr(found._page())
    with pytest.raises(StoreError, match="there is no run of this job"):
        pfdist.next_time(alone, table, rule=True)


@pytest.mark.usefixtures("undrawn")
def test_the_table_is_the_filter_of_the_run_at_every_instant(
    job: Path, y: Any, tmp_path: Path
) -> None:
    times = (1, 4, 8)
    found = pfdist.filter_measurements(job, _written(tmp_path / "mine.csv", times, y), report=False)
    believed = pfdist.load_model("ungm").with_parameters({"process_sd": 1.5})
    filtering = Filter(believed, 40, 1, resampling="multinomial")
    rows = pd.read_csv(tmp_path / "mine.filtered.csv").to_dict("records")
    assert list(found.table.columns) == filtered_schema(named_components(["state"], 1)).names
    assert [row["t"] for row in rows] == list(range(HORIZON + 1))
    for t, row in enumerate(rows):
        estimate = filtering.update(t, y[t]) if t in times else filtering.predict(t)
        assert row["measured"] is (t in times)
        assert row["mean_state"] == estimate.mean[0]
        assert row["sd_state"] == estimate.standard_deviation[0]
        for percent, level in QUANTILES.items():
            assert row[f"q{percent:02d}_state"] == estimate.quantiles(level)[0, 0]
        assert row["effective_sample_size"] == estimate.effective_sample_size
        surprise = None if math.isnan(row["surprise"]) else row["surprise"]
        assert surprise == estimate.surprise
    smoothed = filtering.smoothed(HORIZON)
    for row, estimate in zip(rows, smoothed, strict=True):
        _check_smoothed(row, estimate)
    is_later = np.abs(found.table["smoothed_mean_state"] - found.table["mean_state"]) > 1e-9
    assert is_later.tolist() == [True] * 8 + [False] * 5


def _check_smoothed(row: Any, estimate: FilterEstimate) -> None:
    assert row["smoothed_mean_state"] == estimate.mean[0]
    assert row["smoothed_sd_state"] == estimate.standard_deviation[0]
    for percent, level in QUANTILES.items():
        assert row[f"smoothed_q{percent:02d}_state"] == estimate.quantiles(level)[0, 0]
    assert row["smoothed_effective_sample_size"] == estimate.effective_sample_size


def test_a_job_with_a_lag_smooths_until_then_and_shows_it(
    finished: Callable[..., Path], y: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, path = finished(*FEW, "problem.lag=2") / "job.toml", tmp_path / "mine.csv"
    found = pfdist.filter_measurements(job, _written(path, (1, 4, 8), y))
    filtering = Filter("ungm", 40, 1, resampling="multinomial", horizon=HORIZON)
    for t in (1, 4, 8):
        filtering.update(t, y[t])
    for row, estimate in zip(
        found.table.to_dict("records"), filtering.smoothed(HORIZON, 2), strict=True
    ):
        _check_smoothed(row, estimate)
    axes = pfdist.pages.plots.belief(found)
    assert "smoothed; band: 90 %" in axes.get_legend_handles_labels()[1]
    monkeypatch.setattr(one_filter, "_MOST_STEPS", 40 * HORIZON**2)
    assert pfdist.filter_measurements(job, path).table["smoothed_mean_state"].isna().all()
    monkeypatch.undo()
    table = found.table.assign(smoothed_effective_sample_size=4.9)
    assert "falls below 5 for the smoothed estimate at t = 0, or" in str(
        replace(found, table=table)
    )


def test_the_same_measurements_give_the_same_bytes_and_the_run_is_not_touched(
    job: Path, y: Any, tmp_path: Path
) -> None:
    before = hashes(job.parent)
    path = _written(tmp_path / "patient 7.csv", (0, 3, 8), y)
    found = pfdist.filter_measurements(job, path)
    names = [f"patient 7.filtered.{ending}" for ending in ("csv", "png", "html")]
    assert [file.name for file in found.files] == names
    once = [file.read_bytes() for file in found.files]
    again = pfdist.filter_measurements(job, path)  # earlier results are replaced
    assert [file.read_bytes() for file in again.files] == once
    assert hashes(job.parent) == before
    assert {file.name for file in tmp_path.iterdir()} == {path.name, *names}
    assert matplotlib.image.imread(found.files[1]).shape[:2] == (825, 1050)
    report = " ".join(found.files[2].read_text().split())  # names files and no folder
    assert "3 measurements of patient 7.csv, by the filter of the run run" in report
    made = "Made by pfdist from the measurements patient 7.csv by the filter of the run run."
    assert made in report
    assert "from tables alone" not in report
    assert str(tmp_path) not in report


def test_parquet_gives_parquet_in_another_folder(job: Path, y: Any, tmp_path: Path) -> None:
    path = _written(tmp_path / "mine.parquet", (8, 0, 3), y)
    found = pfdist.filter_measurements(job, path, out=tmp_path / "new" / "folder", report=False)
    table, *_ = found.files
    assert table == tmp_path / "new" / "folder" / "mine.filtered.parquet"
    schema = pq.read_schema(table)
    assert schema.names == filtered_schema(named_components(["state"], 1)).names
    assert all(schema.field(name).metadata[b"description"] for name in schema.names)
    pd.testing.assert_frame_equal(pd.read_parquet(table), found.table)
    assert found.table["surprise"].notna().tolist() == found.table["measured"].tolist()


def test_a_prior_is_where_the_filter_starts(job: Path, y: Any, tmp_path: Path) -> None:
    path, prior = _written(tmp_path / "mine.csv", (5, 8), y), tmp_path / "prior.parquet"
    pd.DataFrame({"x0": [6.5, 7.5], "t": [4, 4]}).to_parquet(prior)
    found = pfdist.filter_measurements(job, path, planned="regular", prior=prior, report=False)
    assert found.table["t"].tolist() == list(range(4, HORIZON + 1))
    assert (found.table["mean_state"][0], found.table["sd_state"][0]) == (7.0, 0.5)
    assert (found.missing, found.extra, found.to_come) == ((4,), (5,), (12,))
    _written(path, (3, 8), y)
    with pytest.raises(MeasurementsError, match=r"mine\.csv: t must lie in 4\.\.12, got 3"):
        pfdist.filter_measurements(job, path, prior=prior)
    pd.DataFrame({"x0": [6.5], "t": [13]}).to_parquet(prior)
    with pytest.raises(PriorError, match=r"0\.\.12, got 13"):
        pfdist.filter_measurements(job, path, prior=prior)


def test_the_command_prints_what_is_missing_and_how_surprising_it_is(
    job: Path, y: Any, tmp_path: Path, said: Callable[..., str]
) -> None:
    path = _written(tmp_path / "mine.csv", (0, 5, 8), y)
    words = ["filter", str(job), str(path), "--planned", "regular"]
    text = said(*words)
    assert re.match(r"At t = 8: state = [\d.-]+ \(90 % band [\d.-]+ to [\d.-]+\)\. The 3\n?", text)
    assert "The 3 measurements fit the model." in " ".join(text.split())
    for line in (
        "  planned, missing      4\n",
        "  planned, to come      12\n",
        "  measured, not planned 5\n",
        "  log evidence          none: the model ungm does not declare normalised=True,\n",
        "  most surprising       t = ",
        "".join(f"\n{tmp_path / f'mine.filtered.{ending}'}" for ending in ("csv", "png", "html")),
    ):
        assert line in text
    assert "may be wrong" not in text
    words.append("--no-report")
    answer = json.loads(said(*words, "--json"))
    assert {key: answer[key] for key in ("measured", "missing", "extra", "to_come")} == {
        "measured": [0, 5, 8], "missing": [4], "extra": [5], "to_come": [12],
    }  # fmt: skip
    assert answer["log_evidence"] is None
    assert (answer["is_improbable"], answer["collapsed"]) == (False, None)
    assert answer["most_surprising"]["t"] in (0, 5, 8)
    y[5] = 1e3
    _written(path, (0, 5, 8), y)
    text = said(*words)
    few = "The estimate is that of a few particles, not the model's: the effective sample size "
    assert " ".join(text.split()).startswith(f"{few}falls below 5 at t = 5, or fewer")
    assert "most surprising       t = 5, p at most " in text
    note = r"The measurement at t = 5 is improbable, p at most [\de.-]+ \(at most [\de.-]+ "
    note += r"among all\): the model may be wrong about this system"
    assert re.search(note, " ".join(text.split()))


def test_an_improbable_measurement_is_a_warning_and_shows_itself(
    job: Path, y: Any, tmp_path: Path
) -> None:
    """Where nobody receives lines; the command line prints a note."""
    y[5] = 1e3
    path = _written(tmp_path / "mine.csv", (0, 5, 8), y)
    options: Any = {"planned": "regular", "report": False}
    with pytest.warns(PfdistWarning) as said:
        found = pfdist.filter_measurements(job, path, **options)
    few, line = (str(each.message) for each in said)
    assert few.startswith("The estimate is that of a few particles, not the model's: ")
    assert line.startswith("The measurement at t = 5 is improbable, p at most 1.0e-05 (")
    assert repr(found).startswith(f"<{few} | {line} | At t = 8: ")
    assert f"<p>{escape(few)}</p>" in found._repr_html_()
    assert f"<p>{line}</p>" in found._repr_html_()
    assert found.as_json()["collapsed"] == 5
    lines = list[str]()
    pfdist.filter_measurements(job, path, **options, say=lines.append)  # raises no warning


@pytest.mark.slow
def test_a_right_model_is_seldom_suspected_and_a_wrong_model_often() -> None:
    """Bonferroni's bound: the number of wrong suspicions is at most binomial with 1 %."""
    model, systems = pfdist.load_model("ungm").with_parameters({"process_sd": 1.5}), 40
    noisier = model.with_parameters({"measurement_sd": 6.0})
    suspected = {}
    for name, truth in (("right", model), ("wrong", noisier)):
        draws = simulate(truth, HORIZON, range(systems), 5).y[:, :, 0]
        found = [_suspected(model, draws[d], range(0, HORIZON + 1, 2), d) for d in range(systems)]
        suspected[name] = sum(found)
    assert suspected["right"] <= 3  # 1 in 1,000 of binomials with 40 draws of 1 %
    assert suspected["wrong"] > systems / 2


def _suspected(model: Any, y: Any, times: Any, draw: int) -> bool:
    filtering = Filter(model, 400, draw=draw)
    surprises = [filtering.update(t, y[t], warn=False).surprise for t in times]
    table = pd.DataFrame({"t": list(times), "surprise": surprises})
    clock = Clock.counting(HORIZON)
    found = FilteredMeasurements(
        Path(), "", Path(), "", tuple(times), (), (), (), table, None, "", (Path(), Path()), clock
    )
    assert found.is_improbable is (min(surprises) * len(surprises) < IMPROBABLE)
    return found.is_improbable


def test_the_exact_filter_gives_its_evidence(
    finished: Callable[..., Path], tmp_path: Path, said: Callable[..., str]
) -> None:
    job = finished(*FEW, "model.name=random_walk", "filter.engine=kalman") / "job.toml"
    path = tmp_path / "mine.csv"
    path.write_text("t,y0\n0,3.0\n4,1.0\n")
    found = pfdist.filter_measurements(job, path, report=False)
    exact = Filter("random_walk", engine="kalman")
    exact.update(0, 3.0)
    exact.update(4, 1.0)
    assert found.log_evidence == exact.log_evidence
    path.write_text("t,y0\n0,3.0\n4,1e6\n")
    with pytest.warns(PfdistWarning, match="improbable, p = ") as warned:
        assert pfdist.filter_measurements(job, path, report=False).collapsed is None
    assert len(warned) == 1
    path.write_text("t,y0\n0,3.0\n4,1.0\n")
    assert found.table["effective_sample_size"].isna().all()
    np.testing.assert_array_equal(found.table["mean_level"][4:], exact.now.mean[0])
    assert f"  log evidence          {exact.log_evidence:.4f}\n" in said(
        "filter", job, path, "--no-report"
    )


def test_no_file_of_others_is_overwritten(job: Path, y: Any, tmp_path: Path) -> None:
    def refused(path: Path, name: str) -> None:
        with pytest.raises(StoreError, match=rf"{name} exists and is not an earlier result"):
            pfdist.filter_measurements(job, path)

    path = _written(tmp_path / "mine.csv", (0, 3), y)
    contents = {"csv": b"t,measured\n", "png": b"\x89PNG" + b"x" * 9000, "html": b""}
    for end, content in contents.items():
        other = tmp_path / f"mine.filtered.{end}"
        other.write_bytes(content)
        refused(path, other.name)
        assert other.read_bytes() == content
        other.unlink()
    other.symlink_to(tmp_path / "elsewhere")
    refused(path, other.name)
    other.unlink()
    _written(tmp_path / "mine.filtered.parquet", (0, 3), y)
    refused(_written(tmp_path / "mine.parquet", (0, 3), y), "mine.filtered.parquet")


def test_a_set_or_a_folder_that_there_is_not_is_one_line(
    job: Path, y: Any, tmp_path: Path, said: Callable[..., str]
) -> None:
    path = _written(tmp_path / "mine.csv", (0, 3), y)
    for words, message in (
        (["--planned", "none"], ", genetic, random, got 'none'\n"),
        (["--out", str(path)], "cannot "),
    ):
        error = said("filter", job, path, *words, code=1)
        assert error.count("\n") == 1
        assert message in error
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.plugins("budget")
@pytest.mark.usefixtures("undrawn")
def test_a_run_of_several_budgets_must_be_told_which_times_were_planned(
    small_job: Job, y: Any, tmp_path: Path
) -> None:
    few = small_job.with_changes(["model.name=random_walk", "filter.engine=kalman"])
    curve = pfdist.budget(few, (3, 4), tmp_path / "budget", draws=20, bound_draws=0, figures=False)
    path, name = _written(tmp_path / "mine.csv", (0, 3), y), curve.names[-1]
    with pytest.raises(JobError, match="several numbers of measurements: planned must say which"):
        pfdist.filter_measurements(curve, path)
    assert pfdist.filter_measurements(curve, path, planned=name, report=False).name == name


def test_values_are_drawn_if_y_has_the_name_and_the_unit_of_z() -> None:
    model = replace(
        pfdist.load_model("random_walk"), y_names=("level [m]",), z_names=("level [m]",)
    )
    table = pd.DataFrame({"t": [1, 4, 4], "y0": [0.5, 1.5, 1.25]})

    def drawn(model: pfdist.StateSpaceModel) -> dict[str, list[list[float]]]:
        problem = pfdist.Problem(model, horizon=6, measurement_budget=2, engine="kalman")
        axes = pfdist.pages.plots.belief(
            pfdist.filter_measurements(problem, table, say=lambda line: None)
        )
        return {str(e.get_label()): [*map(list, e.get_data())] for e in axes.get_lines()}

    values = drawn(model)
    assert values["measured values"] == [[1, 4, 4], [0.5, 1.5, 1.25]]
    assert values["measured"][0] == [1, 4]
    assert not any("planned" in label for label in values)
    assert "measured values" not in drawn(replace(model, y_names=("level [cm]",)))


def test_failed_measurements_and_few_ancestors_are_counted() -> None:
    problem = pfdist.Problem(
        "random_walk", horizon=60, measurement_budget=9, particles=30, sensor={"fails": 0.2}
    )
    times = [*range(0, 60, 10)]
    table = pd.DataFrame({"t": times, "y0": [0.1, 0.4, math.nan, 0.2, math.nan, 0.3]})
    found = pfdist.filter_measurements(problem, table)
    assert found.failed == (20, 40)
    text = repr(found._page())
    assert "('failed', '2 of 6, t = 20, 40')" in text
    sizes = found.table["smoothed_effective_sample_size"]
    least = f"{sizes.min():.0f} at t = {sizes.argmin()}"
    assert f"few ancestors: {least}; more particles help, or problem.lag" in text
    better = replace(found, table=found.table.assign(smoothed_effective_sample_size=20.0))
    assert "few ancestors" not in repr(better._page())


def test_a_failed_measurement_off_the_clock_is_the_planned_one_nearest_to_it(
    tmp_path: Path,
) -> None:
    walk = pfdist.load_model("random_walk")
    walk = replace(
        walk,
        transition=lambda x, t, w, p: (x[0] + p.step_sd * np.sqrt(p.dt[t]) * w[0],),
    )
    problem = pfdist.Problem(
        walk, horizon=12, measurement_budget=3, particles=30, sensor={"fails": 0.1}, time_step=1
    )
    changes = ["comparison.draws=20", "comparison.sets.mine=[3, 6, 10]"]
    run = pfdist.plan(problem, tmp_path / "run", figures=False, changes=changes)
    table = pd.DataFrame({"t": [0.9, 3.1, 6.2, 7.9, 9.9], "y0": [0.1, math.nan] * 2 + [math.nan]})
    found = pfdist.filter_measurements(run, table, planned="mine")
    assert found.failed == (3.1, 7.9, 9.9)
    assert (found.missing, found.to_come) == ((), ())
    assert found.extra == (0.9, 7.9)


def test_a_panel_is_drawn_for_each_component_up_to_six(tmp_path: Path) -> None:
    from pfdist.plugins.filter.figure import draw_filtered, filtered_plot

    for number, height in ((1, 825), (8, 3000)):
        names = filtered_schema(numbered_components(number)).names
        table = pd.DataFrame({name: np.zeros(5) for name in names})
        table["t"], table["measured"] = range(5), [True, False, True, False, False]
        path = tmp_path / f"{number}.png"
        draw_filtered(path, filtered_plot(table, ((0, 2), (1,), (2,), (4,))))
        assert matplotlib.image.imread(path).shape[0] == height
