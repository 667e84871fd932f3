"""`pfdist budget`: what it finds, that it goes on, and what it says."""

import json
import re
import shlex
from pathlib import Path

import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import JobError, StoreError
from pfdist.filters.kalman import expected_mse
from pfdist.runner.progress import Progress
from pfdist.times.feasible import Feasible

EXACT = ["model.name=random_walk", "filter.engine=kalman"]


@pytest.fixture
def exact_job(small_job: Job) -> Job:
    """T = 12, and every cost known."""
    return small_job.with_changes(EXACT)


def test_times_of_every_number_are_those_of_brute_force_and_beside_them_the_regular_ones(
    exact_job: Job, tmp_path: Path
) -> None:
    run = pfdist.budget(exact_job, (2, 5), tmp_path / "run", draws=300, target=3.0)
    table = run.budget()
    assert table["name"].tolist() == [
        f"{name}_{number:02}" for name in ("regular", "survivors") for number in range(2, 6)
    ]
    model = pfdist.load_model("random_walk")
    for row in table.to_dict("records"):
        feasible = Feasible(12, row["measurements"])
        if row["kind"] == "regular":
            assert tuple(row["measurement_times"]) == feasible.regular()
        else:
            sets = list(feasible.every())
            costs = expected_mse(model, 12, sets)
            assert row["search_cost"] == pytest.approx(costs.min(), rel=1e-9)
            assert tuple(row["measurement_times"]) == sets[int(costs.argmin())]
        exact = expected_mse(model, 12, [tuple(row["measurement_times"])])[0]
        assert abs(row["expected_mse"] - exact) < 4 * row["standard_error"]
        assert row["low"] < row["expected_mse"] < row["high"]
    assert not (run.path / "tables" / "trajectories").exists()
    assert {file.name for file in (run.path / "figures").iterdir()} == {
        f"{name}.{kind}" for name in ("budget", "budget-target-3") for kind in ("png", "svg")
    }


def test_however_it_is_cut_it_ends_with_the_same_bytes_and_grows(
    small_job: Job, tmp_path: Path
) -> None:
    few = small_job.with_changes(["problem.horizon=8", "filter.particles=10"])
    whole = pfdist.budget(few, (2, 4), tmp_path / "whole", draws=60, figures=False)
    for phase in ("survivors", "comparison"):

        def stop(progress: Progress, phase: str = phase) -> None:
            if progress.phase == phase and progress.evaluations > 20:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            pfdist.budget(few, (2, 4), tmp_path / phase, draws=40, report=stop, figures=False)
        assert pfdist.open_run(tmp_path / phase).state != "finished"
        other = few.with_changes(["problem.measurement_budget=3"])  # is left aside
        pfdist.budget(other, (2, 4), tmp_path / phase, draws=60, figures=False)
        assert hashes(tmp_path / phase) == hashes(tmp_path / "whole")
    assert whole.state == "finished"
    assert whole.names[0] == "regular_2"


def test_the_command_says_how_many_are_enough(
    exact_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pfdist.budget(exact_job, (2, 5), tmp_path / "run", draws=300, figures=False).budget()
    costs = table[table["kind"] == "found"].set_index("measurements")["expected_mse"]
    target = (costs[3] + costs[4]) / 2
    command = (
        f"budget {shlex.quote(str(exact_job.path))} --measurements 2:5 --draws 300 "
        f"--set {' '.join(EXACT)} --results {shlex.quote(str(tmp_path / 'run'))} --target {target}"
    )
    assert main([*shlex.split(command), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["results"]["survivors_05"]["expected_mse"] == costs[5]
    assert answer["target"] == target
    assert answer["reached"]["found"]["measurements"] == 4
    assert main(shlex.split(command)) == 0
    text = capsys.readouterr().out
    assert f"found times reach {target:g} with N = 4 (95 %: " in text
    assert re.search(rf"^    5  .*\(.* to .*\) +{costs[5]:.3f} \(.* to .*\)$", text, re.MULTILINE)
    assert main(["status", str(tmp_path / "run")]) == 0
    assert "\n    2  " in capsys.readouterr().out
    with pytest.raises(StoreError, match="several numbers of measurements"):
        main(["why", str(tmp_path / "run"), "--debug"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--measurements 5", "must be two numbers A:B .* got '5'"),
        ("--measurements 7:5", "2 <= A <= B, .* got '7:5'"),
        ("--measurements 1:5", "got '1:5'"),
        ("--measurements 2:x", "got '2:x'"),
        ("--measurements 2:14", "budget of 14 measurements: .* at most horizon . 1 = 13, got 14"),
        ("--measurements 2:3 --set search.survivors.survivors=0", "survivors .* got 0"),
        ("--measurements 2:3 --set comparison.draws=9", "as measurements and draws say, got c"),
        ("--measurements 2:3 --set search.survivors.polish=true", "polish = false, got true"),
        ("--measurements 2:3 --draws 1", r"draws must be at least 2, got 1 \(--draws\)"),
        ("--measurements 2:3 --set problem.required=[1,2,3]", "budget of 2 .* at least 3"),
    ],
)
def test_a_mistake_is_one_line(
    options: str, words: str, small_job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["budget", str(small_job.path), *options.split(), "--results", "nowhere"]
    assert main(command) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(words, error)


def test_money_and_other_searches_are_refused(small_job: Job) -> None:
    text = small_job.path.read_text()
    money = text.replace("measurement_budget = 4", f"cost = {[1] * 13}\ntotal_cost = 4")
    small_job.path.write_text(money)
    with pytest.raises(JobError, match=r"needs problem.measurement_budget, got problem.total_cost"):
        pfdist.budget(small_job.path, (2, 3))
    small_job.path.write_text(f"{text}\n[budget]\nleast = 2\nmost = 3\n")
    with pytest.raises(JobError, match="one search of method 'survivors', got genetic, random"):
        pfdist.load_job(small_job.path)
    with pytest.raises(JobError, match=r"unknown key 'lest' in \[budget\], allowed: least, most"):
        pfdist.load_job(small_job.path, ["budget.lest=2"])
