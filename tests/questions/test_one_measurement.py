"""When to measure once: a measurement budget of 1, from end to end."""

from pathlib import Path

import pytest

import pfdist
from pfdist import Job
from pfdist.cli.main import main

ONE = ["problem.measurement_budget=1", "comparison.draws=40"]


@pytest.mark.slow
def test_one_measurement_is_planned_explained_and_chosen_online(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, run = small_job.path, str(tmp_path / "run")
    quick = ["--set", *ONE]
    path.write_text(path.read_text().partition("[[search]]")[0] + '[execution]\npool = "serial"\n')
    assert main(["plan", str(path), "--results", run, *quick]) == 0
    assert "Proved: no other time lowers the expected MSE" in " ".join(
        capsys.readouterr().out.split()
    )
    text = (tmp_path / "run" / "report.html").read_text()
    assert " than with evenly spaced times" in text
    assert main(["why", str(path), "--results", run, "--draws", "20", *quick]) == 0
    online = ["online", str(path), "--results", str(tmp_path / "online"), "--draws", "3", *quick]
    assert main(online) == 0
    online_times = pfdist.open_run(tmp_path / "online").table("online")["measurement_times"]
    assert [len(times) for times in online_times] == [1, 1, 1]
