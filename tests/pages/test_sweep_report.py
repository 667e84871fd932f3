"""The report of a sweep: it says what the table says, links to the points, and trusts no name."""

import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pandas as pd
import pytest
from matplotlib.axes import Axes
from scipy import stats

import pfdist
from oracles.results_of import results_of
from pfdist import Job
from pfdist.cli.main import main
from pfdist.common.rounding import rounded, with_interval
from pfdist.errors import ArgumentError, StoreError, SweepError
from pfdist.pages.plots import against
from pfdist.results.judged import judged_table, least_regret
from pfdist.results.runs_table import formatted_gain, formatted_mse

EXACT = ("model.name=random_walk", "filter.engine=kalman", "comparison.draws=30")
BUDGET = "problem.measurement_budget"
HOSTILE = ("<b>\"x\" & 'y'#?%41=é", "javascript:alert(1)", "<img src=x onerror=alert(1)>", "a\nb")


See = Callable[[Path], Any]  # the page of a sweep


@pytest.fixture
def exact(small_job: Job) -> Job:
    return small_job.with_changes([*EXACT, "search=[{method='random', evaluations=4}]"])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep over a budget, a text and seeds, with the reports of all points."""
    folder = tmp_path_factory.mktemp("sweeps")
    job = folder / "small.toml"
    job.write_text((Path(__file__).parents[1] / "small.toml").read_text())
    over = {BUDGET: [3, 5], "model.name": ["linear_gaussian", "random_walk"], "seed": [1, 2]}
    changes = [*EXACT[1:], "search=[{method='random', evaluations=4}]"]  # the models are swept
    sweep = pfdist.sweep(job, over, results=folder / "mine", changes=changes, report=False)
    first, *others = sweep.runs.values()
    report = pfdist.report(first)
    for run in others:  # whose own would take as long again
        shutil.copy(report, run.path)
    return sweep.path


@pytest.fixture(scope="module")
def page(made: Path, see: See) -> Any:
    return see(made)


@pytest.fixture
def sweep(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "mine"))


def test_every_point_has_a_row_that_leads_to_its_report(made: Path, page: Any) -> None:
    folders = sorted(path.name for path in made.iterdir() if path.is_dir())
    assert len(folders) == 8
    assert sorted(unquote(link.removesuffix("/report.html")) for link in page.links) == folders
    assert all((made / unquote(link)).is_file() for link in page.links)
    head, *rows = page.rows
    assert head[:3] == ["model.name", "measurement_budget", "seed"]
    assert [row[:3] for row in rows[:3]] == [
        ["linear_gaussian", "3", "1"],
        ["linear_gaussian", "3", "2"],
        ["linear_gaussian", "5", "1"],
    ]


def test_it_says_which_point_is_best(made: Path, page: Any) -> None:
    """The mean over the seeds is the lowest, and its interval is Student's."""
    errors = pfdist.table(made).groupby(["model.name", BUDGET])["expected_mse"]
    (model, budget), mean = errors.mean().idxmin(), errors.mean().min()
    half = stats.t.ppf(0.975, 1) * errors.std()[model, budget] / math.sqrt(2)
    value, low, high = with_interval(mean, mean - half, mean + half)
    told = f"The lowest expected MSE is {value} (95 % CI {low} to {high}), the mean of 2 seeds: "
    assert f"{told}model.name {model}, measurement_budget {budget}." in page.text
    assert "Small points are the runs of single seeds." in page.text


def test_it_has_one_figure_and_one_table_of_its_points(made: Path, page: Any) -> None:
    assert page.tags.count("figure") == 1
    assert len(page.rows) == 1 + 8
    for row in pfdist.table(made).to_dict("records"):
        named = [str(row[key]) for key in ("model.name", BUDGET, "seed")]
        [shown] = [cells for cells in page.rows if cells[:3] == named]
        assert shown[3:] == [row["set"], formatted_mse(row), formatted_gain(row)]
    ids = re.findall(r'\bid="([^"]+)"', page.html)
    assert len(ids) == len(set(ids)) > 50


def test_it_loads_nothing_and_is_small(made: Path, page: Any) -> None:
    assert page.tags.count("script") == 1
    assert [each for each in page.loaded if not each.startswith(("#", "data:"))] == []
    assert all(not urlsplit(link).scheme and not urlsplit(link).netloc for link in page.links)
    assert len(page.html.encode()) < 400_000
    assert str(made.parent) not in page.html


def test_a_sweep_of_one_point_without_keys_has_a_report(
    exact: Job, tmp_path: Path, see: See
) -> None:
    run = pfdist.run(exact, tmp_path / "sweep" / "alone", figures=False)
    page = see(tmp_path / "sweep")
    result = results_of(run)["random"]
    assert page.rows[1][0] == "alone"
    assert f"The expected MSE is {rounded(result.expected_mse)} (exact)." in page.text
    assert page.tags.count("figure") == 0


def test_a_sweep_over_seeds_alone_gives_their_mean_and_chooses_none(
    exact: Job, tmp_path: Path, see: See
) -> None:
    sweep = pfdist.sweep(exact, {"seed": [1, 2, 3]}, results=tmp_path / "sweep", report=False)
    errors = sweep.table()["expected_mse"]
    low, high = stats.t.interval(0.95, 2, errors.mean(), errors.std() / math.sqrt(3))
    value, low, high = with_interval(errors.mean(), low, high)
    page = see(sweep.path)
    told = f"The expected MSE is {value} (95 % CI {low} to {high})"
    assert f"{told}, the mean of 3 seeds." in page.text
    assert page.tags.count("figure") == 1
    assert "lowest" not in page.text
    assert "best of several" not in page.text
    assert "Its links lead" not in page.text


@pytest.mark.slow
def test_a_run_without_replicates_has_the_interval_of_its_draws(
    small_job: Job, tmp_path: Path, see: See
) -> None:
    job = small_job.with_changes(["search=[{method='random', evaluations=2}]"])
    sweep = pfdist.sweep(job, {BUDGET: [3, 4]}, results=tmp_path / "sweep")
    best = sweep.table().sort_values("expected_mse").iloc[0]
    mse, half = best["expected_mse"], 1.96 * best["standard_error"]
    value, low, high = with_interval(mse, mse - half, mse + half)
    told = f"The lowest expected MSE is {value} (95 % CI {low} to {high}): "
    assert f"{told}measurement_budget {best[BUDGET]}." in see(sweep.path).text


def test_no_name_of_a_folder_becomes_markup_or_another_address(sweep: Path, see: See) -> None:
    folders = sorted(path for path in sweep.iterdir() if path.is_dir())
    for folder, name in zip(folders, HOSTILE, strict=False):
        folder.rename(sweep / name)
    other = sweep.rename(sweep.parent / "<script>alert(1)<b>")
    page = see(other)
    assert page.tags.count("script") == 1
    assert not {"img", "b"} & set(page.tags)
    assert len(page.links) == 8
    for link in page.links:
        parts = urlsplit(link)
        assert (parts.scheme, parts.netloc, parts.query, parts.fragment) == ("", "", "", "")
        assert (other / unquote(link)).is_file()
    assert {unquote(link).removesuffix("/report.html") for link in page.links} >= {*HOSTILE}


def test_a_damaged_run_is_a_warning_that_says_so_and_the_others_stay(sweep: Path, see: See) -> None:
    first, second, third, *_ = sorted(path for path in sweep.iterdir() if path.is_dir())
    (first / "run.json").write_text("{")
    for file in (second / "tables" / "timings").glob("*.parquet"):
        file.write_bytes(b"no table")
    hostile = third.rename(sweep / "<i>hostile")
    (hostile / "job.toml").write_text("[[[")
    page = see(sweep)
    for name in (first.name, second.name, "<i>hostile"):
        assert f"{name} cannot be read: " in page.text
    assert "i" not in page.tags
    assert page.text.count("cannot be read") == 3
    assert len(page.rows) == 1 + 5


def test_a_folder_with_damaged_runs_alone_has_a_report(tmp_path: Path, see: See) -> None:
    (tmp_path / "point").mkdir()
    (tmp_path / "point" / "run.json").write_text("{")
    page = see(tmp_path)
    assert "point cannot be read: " in page.text
    assert page.tags.count("figure") == 0


def test_an_unfinished_point_says_so_and_has_no_link(exact: Job, sweep: Path, see: See) -> None:
    def stop(progress: Any) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    path = sweep / "unfinished"
    with pytest.raises(KeyboardInterrupt):
        pfdist.run(exact.with_changes(["seed=9"]), path, progress=stop, figures=False)
    page = see(sweep)
    assert "Not finished: 1 of 9 points." in page.text
    assert any("unfinished" in row for row in page.rows)
    assert not any("unfinished" in link for link in page.links)
    assert len(page.links) == 8


@pytest.mark.slow
def test_a_users_own_file_is_not_replaced_and_the_sweep_stands(exact: Job, tmp_path: Path) -> None:
    own = tmp_path / "sweep" / "report.html"
    own.parent.mkdir()
    own.write_text("mine")
    said = list[str]()
    sweep = pfdist.sweep(exact, {"seed": [1, 2]}, results=own.parent, say=said.append)
    assert own.read_text() == "mine"
    assert len(sweep.runs) == 2
    assert sum("there is no report" in line for line in said) == 1
    with pytest.raises(StoreError, match="move it away"):
        pfdist.report(own.parent)


def test_a_report_that_fails_is_told_in_a_line_and_the_sweep_stands(
    exact: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path) -> Path:
        raise ZeroDivisionError("a\nmistake")

    monkeypatch.setattr("pfdist.questions.report.write_sweep_report", fail)
    said = list[str]()
    sweep = pfdist.sweep(exact, {"seed": [1]}, results=tmp_path / "sweep", say=said.append)
    assert len(sweep.runs) == 1
    [line] = [line for line in said if "there is no report" in line]
    assert "ZeroDivisionError: a mistake" in line


@pytest.mark.slow
def test_points_that_fail_leave_a_report_of_the_others(exact: Job, tmp_path: Path) -> None:
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "seed=2").write_text("a file in the way")
    with pytest.raises(SweepError):
        pfdist.sweep(exact, {"seed": [1, 2]}, results=tmp_path / "sweep")
    html = (tmp_path / "sweep" / "report.html").read_text()
    assert re.findall(r'<a href="([^"]+)"', html) == ["seed=1/report.html"]


def test_the_command_line_writes_it_and_no_report_means_none(
    exact: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str], see: See
) -> None:
    folder = tmp_path / "sweep"
    pfdist.sweep(exact, {"seed": [1]}, results=folder, report=False)
    assert not (folder / "report.html").exists()
    assert main(["report", str(folder)]) == 0
    assert capsys.readouterr().out.strip() == str(folder / "report.html")
    assert see(folder).links == []
    with pytest.raises(ArgumentError, match="watch needs the folder of a run"):
        pfdist.report(folder, watch=True)


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep over two process noises that judges."""
    folder = tmp_path_factory.mktemp("judged")
    job = folder / "small.toml"
    job.write_text((Path(__file__).parents[1] / "small.toml").read_text())
    over = {"model.parameters.process_sd": [0.5, 5.0]}
    changes = ["search=[{method='exchange'}]"]
    return pfdist.sweep(job, over, results=folder / "mine", changes=changes, judge=True).path


@pytest.mark.slow
def test_it_names_the_plan_of_least_regret_and_draws_the_regret_of_each(
    judged: Path, see: See, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = ["process_sd=0.5", "process_sd=5.0"]
    runs = {name: pfdist.open_run(judged / name) for name in points}
    judges = {name: pfdist.open_run(next(judged.glob(f"judged/*/{name}"))) for name in points}
    table, drawn = judged_table(runs, judges), list[Any]()
    largest = table.groupby("found_at")["regret"].max()

    def recorded(*given: Any, ax: Axes) -> Axes:
        drawn.append(given)
        return against(*given, ax=ax)

    monkeypatch.setattr("pfdist.questions.sweep_page.against", recorded)
    page = see(judged)
    words = r"found at process_sd ([\d.]+)\. Its regret is at most (\S+) %"
    told = re.search(words, page.text)
    assert told is not None
    assert f"process_sd={float(told[1])}" == largest.idxmin()
    assert float(told[2]) == pytest.approx(100 * largest.min(), rel=0.1, abs=0.05)
    assert page.tags.count("figure") == 1
    [(shown, axis, value)] = drawn
    assert (axis, value) == ("model.parameters.process_sd", "regret")
    for row in shown.to_dict("records"):
        same = (table["found_at"] == f"process_sd={float(row['found at'].split()[-1])}") & (
            table[axis] == row[axis]
        )
        assert row["regret"] == table[same]["regret"].max()
    assert len(shown) == 4


@pytest.mark.slow
def test_judged_times_that_cannot_be_read_leave_the_points(
    judged: Path, tmp_path: Path, see: See
) -> None:
    copy = shutil.copytree(judged, tmp_path / "mine")
    damaged = next(copy.glob("judged/*/process_sd=5.0/tables/comparison/*"))
    damaged.write_text("<b>")
    page = see(copy)
    assert "The judged times cannot be read: " in page.text
    assert "least regret" not in page.text
    assert len(page.rows) == 3


def test_the_plan_of_least_regret_has_the_smallest_largest_regret_at_all_points() -> None:
    """Plan b has the smallest regret of all at one point, and c none at another."""
    regrets = {"a": (0.02, 0.03), "b": (0.0, 0.04), "c": (0.0, math.nan)}
    table = pd.DataFrame(
        [
            {"run": run, "found_at": found_at, "set": "random", "regret": regret}
            for found_at, both in regrets.items()
            for run, regret in zip(("first", "second"), both, strict=True)
        ]
    )
    least = least_regret(table)
    assert least is not None
    assert (least["found_at"], least["run"], least["regret"]) == ("a", "second", 0.03)
    assert least_regret(table[table["found_at"] == "c"]) is None
