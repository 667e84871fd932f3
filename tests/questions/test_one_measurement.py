"""When to measure once: a measurement budget of 1, from end to end."""

from pathlib import Path

import pytest

import pfdist
from pfdist import Job
from pfdist.cli.main import main
from pfdist.filters.evaluator import Evaluator
from pfdist.problem.methods import METHODS

ONE = ["problem.measurement_budget=1", "comparison.draws=40"]


@pytest.mark.parametrize("method", METHODS)
def test_every_search_finds_the_best_time_of_all(
    small_job: Job, tmp_path: Path, method: str
) -> None:
    """Brute force: the exact expected MSE of each of the 13 times. Random trials meet them all."""
    sections = {"model": {"name": "random_walk"}, "search": [{"method": method}]}
    job = small_job.with_changes([*ONE, "filter.engine=kalman"], sections=sections)
    run = pfdist.run(job, tmp_path / "run", figures=False)
    evaluator = Evaluator(pfdist.load_model("random_walk"), 12, engine="kalman")
    exact = evaluator.expected_mse([(t,) for t in range(13)])
    assert run.sets["regular"] == (6,)
    (found,) = run.sets[method]
    assert exact[found] <= exact.min()
    assert exact[found] < exact[6]


@pytest.mark.slow
def test_one_measurement_is_planned_explained_and_chosen_online(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, run = small_job.path, str(tmp_path / "run")
    quick = ["--set", *ONE]
    path.write_text(path.read_text().partition("[[search]]")[0] + '[execution]\npool = "serial"\n')
    assert main(["plan", str(path), "--results", run, *quick]) == 0
    assert "Proved: no other time lowers the error" in " ".join(capsys.readouterr().out.split())
    text = (tmp_path / "run" / "report.html").read_text()
    assert "Measuring at this time instead of regular times" in text
    assert main(["why", str(path), "--results", run, "--draws", "20", *quick]) == 0
    online = ["online", str(path), "--results", str(tmp_path / "online"), "--draws", "3", *quick]
    assert main(online) == 0
    online_times = pfdist.open_run(tmp_path / "online").table("online")["measurement_times"]
    assert [len(times) for times in online_times] == [1, 1, 1]


def test_a_budget_curve_begins_at_one_measurement(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["budget", str(small_job.path), "--results", str(tmp_path / "budget")]
    options = ["--measurements", "1:3", "--draws", "40", "--target", "1000"]
    assert main([*command, *options, "--bound-draws", "0"]) == 0
    assert "1 found time reaches it" in capsys.readouterr().out
    table = pfdist.open_run(tmp_path / "budget").table("sets")
    assert sorted(set(table["measurements"])) == [1, 2, 3]
