"""What commands print, as text and as JSON, and their exit codes."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import pfdist
from pfdist import Job
from pfdist.cli.main import main
from pfdist.common.rounding import with_error
from pfdist.runner.build import Built, build


@pytest.fixture(scope="module")
def run(finished: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the small job with its figures."""
    folder = Path(shutil.copytree(finished(), tmp_path_factory.mktemp("cli") / "run"))
    assert main(["run", str(folder / "job.toml"), "--results", str(folder)]) == 0
    return folder


def test_run_and_status_print_the_same_json_and_nothing_else(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = str(run / "job.toml")
    outputs = []
    for command in (["run", job, "--results", str(run)], ["status", str(run)]):
        assert main([*command, "--json"]) == 0
        captured = capsys.readouterr()
        outputs.append(json.loads(captured.out))
        assert captured.err == ""
    answer, status = outputs
    assert answer == status
    facts = {"is_exact", "is_constrained", "has_budget"}
    assert set(answer) == {"state", "run", "evaluations", "draws_compared", "results", *facts}
    told = (answer["state"], answer["evaluations"], answer["draws_compared"])
    assert told == ("finished", 34, 250)
    regular, genetic = answer["results"]["regular"], answer["results"]["genetic"]
    of_draws = {"mean_relative_gain", "positive_fraction", "gain_of_means", "mean_log10_ratio"}
    gains = {*of_draws, *(f"{gain}_interval" for gain in of_draws)}
    gains |= {"quantiles", "search_excess", "gains_disagree"}
    both = {"measurement_times", "expected_mse", "standard_error", "search_cost"}
    assert both <= set(regular)
    assert both | gains <= set(genetic)
    assert not gains & set(regular)
    low, high = genetic["mean_relative_gain_interval"]
    assert low < genetic["mean_relative_gain"] < high < 1
    assert 0 <= genetic["positive_fraction_interval"][0] <= genetic["positive_fraction"] <= 1


def test_the_summary_says_what_a_person_wants_to_know(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", str(run)]) == 0
    text = capsys.readouterr().out
    for words in (
        "finished, 34 evaluations, 250 draws compared",
        "regular: measure at t = 0, 4, 8, 12",
        "what it is            regular times (N = 4)",
        "expected MSE",
        "±",
        "against regular",
        "mean relative gain",
        "positive gains",
        "gain of means",
        "quartiles",
        "mean log10 of ratio",
        "the fresh cost (its draws chose the set)",
        "gain over itself",
        "95 %",
        f"tables: {run}/tables",
        f"figures: {run}/figures",
    ):
        assert words in text


def test_evaluate_prints_json(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = f"evaluate {run}/job.toml --times 8,0,4 --draws 50 --particles 30 --seed 9 --json"
    assert main(shlex.split(command)) == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer) == {
        "expected_mse", "standard_error", "draws", "degenerate_draws", "top_percent_share",
        "broken_constraints",
        "seconds",
    }  # fmt: skip
    expected = pfdist.evaluate(run / "job.toml", (0, 4, 8), draws=50, particles=30, seed=9)
    assert answer["expected_mse"] == expected.expected_mse
    assert answer["standard_error"] == expected.standard_error
    assert (answer["draws"], answer["degenerate_draws"]) == (50, 0)
    assert answer["broken_constraints"] == ["problem.measurement_budget is 4, got 3 times"]


def test_evaluate_names_the_constraints_that_are_broken_and_evaluates_all_the_same(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = "--set problem.forbidden=[3] problem.required=[6] problem.minimum_spacing=2"
    command = f"evaluate {run}/job.toml --draws 20 {changes} --times"
    assert main(shlex.split(f"{command} 0,2,3,9")) == 0
    captured = capsys.readouterr()
    assert re.match(r"expected MSE [\d.]+ ± [\d.]+\n20 draws", captured.out)
    note = "pfdist: note: these times break a constraint: problem"
    assert captured.err.splitlines() == [
        f"{note}.forbidden: 3 is measured",
        f"{note}.required: 6 is not measured",
        f"{note}.minimum_spacing is 2, got 2 and 3",
    ]
    assert main(shlex.split(f"{command} 0,2,6,9")) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("no_figures")
def test_what_is_known_exactly_is_said_to_be(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exact = "--set model.name=random_walk filter.engine=kalman"
    job, run = (shlex.quote(str(path)) for path in (small_job.path, tmp_path / "run"))
    assert main(shlex.split(f"evaluate {job} --times 0,4 {exact}")) == 0
    assert re.fullmatch(r"expected MSE \d\.\d{4} \(exact\)\n", capsys.readouterr().out)
    assert main(shlex.split(f"plan {job} --results {run} {exact}")) == 0
    assert re.search(r"\n  exactly +\d\.\d{4}, as the search knew\n", capsys.readouterr().out)


def test_what_is_infinite_is_null_in_json(
    tmp_path: Path, small_job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(
        "import dataclasses\nfrom pfdist.models.ungm import model\n"
        "model = dataclasses.replace(\n"
        "    model, log_likelihood=lambda y, x, t, p: x[0] - x[0] - float('inf'))\n"
    )
    command = ["evaluate", str(small_job.path), "--times", "3", "--json"]
    assert main([*command, "--set", "model.name=mine.py:model", "filter.engine=numpy"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["expected_mse"] is answer["standard_error"] is None
    assert answer["degenerate_draws"] == answer["draws"] == 30


def test_plot_draws_every_figure_as_png_and_svg(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", str(run)]) == 0
    files = [Path(line) for line in capsys.readouterr().out.splitlines()]
    names = {"cost", "draw-genetic", "gain-genetic", "draw-random", "gain-random", "times"}
    assert {file.name for file in files} == {
        f"{n}.{kind}" for n in names for kind in ("png", "svg")
    }
    assert all(file.stat().st_size > 5000 for file in files)


def test_models_lists_every_model_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("ungm ") and "growth model" in line for line in lines)


@pytest.mark.slow
def test_the_seconds_of_evaluate_are_those_of_the_draws(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def slowly(job: Job) -> Built:  # as where all must be compiled
        time.sleep(1.5)
        return build(job)

    monkeypatch.setattr("pfdist.api.evaluate.build", slowly)
    seconds = []
    for _ in range(3):
        assert main(["evaluate", str(run / "job.toml"), "--times", "0,3", "--json"]) == 0
        seconds.append(json.loads(capsys.readouterr().out)["seconds"])
    assert min(seconds) < 1.0


@pytest.mark.usefixtures("no_figures")
def test_a_missing_file_is_told_as_what_the_job_makes_again(
    small_run: pfdist.Run, capsys: pytest.CaptureFixture[str]
) -> None:
    run = small_run.path
    damaged = run / "tables" / "comparison" / "comparison-00000.parquet"
    damaged.write_bytes(b"damaged")
    assert main(["verify", str(run)]) == 1
    assert "`pfdist repair " in capsys.readouterr().err
    for command in ("repair", "repair"):  # the second time there is nothing to move
        assert main([command, str(run)]) == 0
        said = capsys.readouterr().out
        assert f"run `pfdist run {run}/job.toml` to compute what is missing" in said
    assert main(["verify", str(run)]) == 1
    error = capsys.readouterr().err
    assert f"missing files: 1. To recompute them, run `pfdist run {run}/job.toml`" in error
    assert "repair" not in error
    assert main(["run", str(run / "job.toml"), "--results", str(run)]) == 0
    assert main(["verify", str(run)]) == 0


@pytest.mark.parametrize(
    ("command", "function", "goes_on"),
    [
        ("run {job}", "pfdist.api.run.run", True),
        ("plan {job}", "pfdist.api.plan.plan", True),
        ("budget {job} --measurements 2:3", "pfdist.api.budget.budget", True),
        ("status {run}", "pfdist.analysis.open_run", False),
    ],
)
def test_an_interrupted_command_says_whether_the_same_command_goes_on(
    command: str,
    function: str,
    goes_on: bool,
    run: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(function, interrupted)
    filled = command.format(job=run / "job.toml", run=run)
    assert main(shlex.split(filled)) == 130
    error = capsys.readouterr().err
    assert error.startswith("pfdist: interrupted")
    assert error.endswith("the same command goes on from there\n") is goes_on


def test_python_m_pfdist_is_the_same_and_a_finished_run_answers_at_once(run: Path) -> None:
    command = [sys.executable, "-m", "pfdist", "status", str(run), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(done.stdout)["state"] == "finished"
    assert done.stderr == ""


def test_without_a_terminal_progress_is_plain_lines(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(small_job.path), "--results", str(tmp_path / "run")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("  0.0 %  genetic  generation 1/4")
    assert lines[1].startswith("Serial pool is ready: 1 worker")  # it starts with the first task
    assert lines[-1].startswith("100.0 %  comparison  250 draws")
    assert "\x1b" not in "".join(lines)  # no escape codes
    found = pfdist.open_run(tmp_path / "run").summary()["results"]["genetic"]
    (low, high), (least, most) = (
        found[f"{gain}_interval"] for gain in ("gain_of_means", "mean_relative_gain")
    )
    of_means = with_error(100 * found["gain_of_means"], 50 * (high - low))
    relative = with_error(100 * found["mean_relative_gain"], 50 * (most - least))
    assert f"genetic: MSE {of_means} % lower, relative gain {relative} %" in lines[-1]


@pytest.mark.slow
def test_a_finished_run_holds_no_code(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, flag, run = tmp_path / "mine.py", tmp_path / "flag", tmp_path / "run"
    model.write_text(f"open({str(flag)!r}, 'w').close()\nfrom pfdist.models.ungm import model\n")
    command = ["run", str(small_job.path), "--results", str(run)]
    few = ["filter.engine=numpy", "evaluation.draws=3", "comparison.draws=20"]
    assert main([*command, "--set", 'model.name="mine.py:model"', *few]) == 0
    assert f"runs the model file {model}, which your job names\n" in capsys.readouterr().err
    assert flag.exists()  # to compute, the model's file was run
    files = [path for path in run.rglob("*") if path.is_file() and path.name != ".lock"]
    kinds = {path.suffix or path.name for path in files if path.stat().st_size}
    assert kinds == {".toml", ".json", ".parquet", ".png", ".svg", ".html", "manifest"}
