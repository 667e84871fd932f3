"""Outputs of commands, as text and as JSON, and their exit codes."""

import functools
import json
import pkgutil
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.results_of import results_of
from oracles.undrawn import EMPTY, undraw
from pfdist import Job
from pfdist.errors import PoolError, StoreError
from pfdist.questions.evaluate import evaluated

Call = Callable[..., Any]  # exit code, output and errors of a line


@pytest.fixture(scope="module")
def run(finished: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the small job with figures."""
    folder = Path(shutil.copytree(finished(), tmp_path_factory.mktemp("cli") / "run"))
    with pytest.MonkeyPatch.context() as patch:
        undraw(patch)
        pfdist.run(folder / "job.toml", folder, report=False)
    return folder


def test_run_and_status_print_the_same_json_and_nothing_else(run: Path, call: Call) -> None:
    again = call(f"run {run}/job.toml --results {run} --json")
    assert again == call(f"status {run} --json") == (0, again.out, "")
    answer = json.loads(again.out)
    assert answer == pfdist.open_run(run).as_json()
    told = (answer["state"], answer["evaluations"], answer["draws_compared"])
    assert told == ("finished", 34, 250)
    regular, genetic = answer["sets"][:2]
    assert (regular["name"], genetic["name"]) == ("regular", "genetic")
    of_draws = {"mean_relative_gain", "positive_fraction", "gain_of_means", "mean_log10_ratio"}
    assert None not in {genetic[key] for key in (*of_draws, "search_excess")}
    assert {regular[key] for key in (*of_draws, "search_excess", "search_mse")} == {None}
    low, high = (genetic[f"mean_relative_gain_{end}"] for end in ("low", "high"))
    assert low < genetic["mean_relative_gain"] < high < 1
    assert 0 <= genetic["positive_fraction_low"] <= genetic["positive_fraction"] <= 1


def test_the_summary_says_what_a_person_wants_to_know(run: Path, call: Call) -> None:
    answer = " ".join(call(f"status {run}").out.split())
    for words in (
        "finished, 34 evaluations, 250 draws compared",
        "The typical error is ",
        " with regular times (t = 0, 4, 8, 12): the expected MSE is ",
        "Measure at t = ",
        "Expected MSE on 250 draws that took no part in the search",
        f"tables: {run}/tables",
        f"figures: {run}/figures",
    ):
        assert words in answer
    details = " ".join(call(f"status {run} --verbose").out.split())
    assert "All sets of times" in details
    assert "All sets of times" not in answer
    assert "relative gain" not in details


def test_evaluate_prints_json(run: Path, call: Call) -> None:
    job = run / "job.toml"
    line = f"evaluate {job} --times 8,0,4 --draws 50 --particles 30 --seed 9 --json"
    answer = json.loads(call(line).out)
    assert answer.pop("seconds") >= 0
    expected = pfdist.evaluate(job, (0, 4, 8), draws=50, particles=30, seed=9)
    both = evaluated(str(job), times={"": "0,4,8"}, draws=50, particles=30, seed=9)
    ((other,),) = (each.values() for each in both.beside.values())
    assert answer == {
        "expected_mse": expected.expected_mse,
        "standard_error": expected.standard_error,
        "draws": 50,
        "degenerate_draws": 0,
        "largest_share": None,  # it takes more draws
        "smoothed_mse": other.expected_mse,
        "smoothed_error": other.standard_error,
        "broken_constraints": [],
        "criterion": "expected MSE",
        "criterion_unit": "",
    }


def test_evaluate_names_the_constraints_that_are_broken_and_evaluates_all_the_same(
    run: Path, call: Call
) -> None:
    changes = "--set problem.forbidden=[3] problem.required=[6] problem.minimum_spacing=2"
    line = f"evaluate {run}/job.toml --draws 20 {changes} --times"
    broken = call(line, "0,2,3,9")
    assert re.match(r"Expected MSE [\d.]+ ± [\d.]+ \(4 measurements, 20 draws\)", broken.out)
    note = "Note: these times break a constraint: problem"
    assert [each for each in broken.out.splitlines() if each.startswith("Note")] == [
        f"{note}.forbidden: 3 is measured",
        f"{note}.required: 6 is not measured",
        f"{note}.minimum_spacing is 2, got 2 and 3",
    ]
    assert "Note" not in call(line, "0,2,6,9").out


@pytest.mark.usefixtures("no_figures")
def test_what_is_known_exactly_is_said_to_be(small_job: Job, tmp_path: Path, call: Call) -> None:
    exact = "--set model.name=random_walk filter.engine=kalman"
    told = call(f"evaluate {small_job.path} --times 0,4 {exact}").out
    assert re.match(r"Expected MSE \d\.\d{4} \(exact\) \(2 measurements\)", told)
    told = call(f"plan {small_job.path} --results {tmp_path}/run {exact}").out
    assert " % lower (exact)" in " ".join(told.split())


def test_what_is_infinite_is_null_in_json(tmp_path: Path, small_job: Job, call: Call) -> None:
    (tmp_path / "mine.py").write_text(
        "import dataclasses\nfrom pfdist.models.library.ungm import model\n"
        "model = dataclasses.replace(\n"
        "    model, error=lambda z, estimate, t, p: z[0] - z[0] + float('inf'))\n"
    )
    mine = "--set model.name=mine.py:model filter.engine=numpy"
    answer = json.loads(call(f"evaluate {small_job.path} --times 3 --json {mine}").out)
    assert answer["expected_mse"] is answer["standard_error"] is None
    assert (answer["degenerate_draws"], answer["draws"]) == (0, 30)


def test_evaluate_says_how_many_draws_are_degenerate(
    tmp_path: Path, small_job: Job, call: Call
) -> None:
    (tmp_path / "mine.py").write_text(
        "import dataclasses\nfrom pfdist.models.library.ungm import model\n"
        "model = dataclasses.replace(\n"
        "    model, log_likelihood=lambda y, x, t, p: x[0] - x[0] - float('inf'))\n"
    )
    mine = "--set model.name=mine.py:model filter.engine=numpy"
    told = call(f"evaluate {small_job.path} --times 3 {mine}").out
    assert told.startswith("30 of 30 draws are degenerate: ")  # the error is in doubt
    assert re.search(r"\nExpected MSE [\d.]+ ± [\d.]+ \(1 measurement, 30 draws\)", told)
    answer = json.loads(call(f"evaluate {small_job.path} --times 3 --json {mine}").out)
    assert answer["degenerate_draws"] == answer["draws"] == 30


@pytest.mark.usefixtures("undrawn")
def test_plot_draws_every_figure_as_png_svg_and_pdf(run: Path, call: Call) -> None:
    """That there are three files of a figure, with content, is tested with the figures."""
    files = [Path(line) for line in call(f"plot {run}").out.splitlines()]
    names = {"searches", "draw-genetic", "gain-genetic", "draw-random", "gain-random"}
    names |= {"system", "times"}
    wanted = {f"{name}.{kind}" for name in names for kind in ("png", "svg", "pdf")}
    assert {file.name for file in files} == wanted
    assert {file.read_text() for file in files} == {EMPTY}


def test_models_lists_every_model_with_a_line(call: Call) -> None:
    lines = call("models").out.splitlines()
    assert any(line.startswith("ungm ") and "growth model" in line for line in lines)


@pytest.mark.usefixtures("no_figures")
def test_a_damaged_file_is_named_and_the_remedy_is_true(small_run: pfdist.Run, call: Call) -> None:
    run = small_run.path
    (damaged,) = (run / "tables" / "comparison").iterdir()
    damaged.write_bytes(b"damaged")
    found = call(f"verify {run}")
    assert found.code == 1
    assert found.out == (
        f"{damaged} is damaged: its name has another hash; remove it, and run the same command "
        "again\n"
    )
    assert found.err == f"pfdist: {run}: problems found: 1\n"
    damaged.unlink()
    found = call(f"verify {run}")
    assert "is missing: run the same command again to compute its rows" in found.out
    assert call(f"run {run}/job.toml --results {run}").code == 0
    assert call(f"verify {run}").code == 0


@pytest.mark.parametrize(
    ("line", "function", "goes_on"),
    [
        ("run {run}/job.toml", "pfdist.questions.run.run", True),
        ("plan {run}/job.toml", "pfdist.questions.plan.plan", True),
        ("budget {run}/job.toml --measurements 2:3", "pfdist.plugins.budget.question.budget", True),
        ("status {run}", "pfdist.results.open_run", False),
        ("sweep {run}/job.toml --over seed=1:2", "pfdist.plugins.sweep.question.sweep", True),
        (
            "sweep {run}/job.toml --over seed=1:2 --dry-run",
            "pfdist.plugins.sweep.question.foreseen",
            False,
        ),
    ],
)
def test_an_interrupted_command_says_whether_the_same_command_goes_on(
    line: str, function: str, goes_on: bool, run: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    @functools.wraps(pkgutil.resolve_name(function))
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(function, interrupted)
    code, _, error = call(line.format(run=run))
    assert code == 130
    saved = " Finished work is saved; run the same command to resume." if goes_on else ""
    assert error == f"pfdist: Stopped.{saved}\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (None, "Stopped."),
        (PoolError("no worker is left"), "Stopped."),  # the signal has ended the workers, too
        (StoreError("the disk is full"), "the disk is full"),
    ],
)
def test_whatever_ends_a_command_after_a_signal_has_the_exit_code_of_the_signal(
    error: Exception | None,
    line: str,
    stop: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
    call: Call,
) -> None:
    def interrupted(*_: object) -> None:
        stop(signal.SIGTERM)
        if error is not None:
            raise error

    monkeypatch.setattr("pfdist.cli.shown.show", interrupted)
    monkeypatch.setattr("pfdist.results.open_run", lambda path: path)
    code, _, said = call("status nowhere")
    assert (code, said) == (75, f"pfdist: {line}\n")


def test_python_m_pfdist_is_the_same_and_a_finished_run_answers_at_once(run: Path) -> None:
    command = [sys.executable, "-m", "pfdist", "status", str(run), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(done.stdout)["state"] == "finished"
    assert done.stderr == ""


@pytest.mark.usefixtures("no_figures")
def test_without_a_terminal_progress_is_plain_lines(
    small_job: Job, tmp_path: Path, call: Call
) -> None:
    lines = call(f"run {small_job.path} --verbose --results {tmp_path}/run").err.splitlines()
    assert lines[0].startswith("  0.0 %  genetic  generation 1/4")
    assert lines[1].startswith("Serial pool is ready: 1 worker")  # it starts with the first task
    assert lines[-1].startswith("100.0 %  comparison  250 draws")
    assert "\x1b" not in "".join(lines)  # no escape codes
    found = results_of(pfdist.open_run(tmp_path / "run"))["genetic"]
    told = re.search(r"genetic plan: error ([\d.]+) ± ([\d.]+) % (lower|higher)", lines[-1])
    assert told is not None
    sign = 1 if told[3] == "lower" else -1
    assert sign * float(told[1]) == pytest.approx(100 * found.gain_of_means, rel=0.01)
    low, high = (
        found.gain_of_means_low,
        found.gain_of_means_high,
    )
    assert float(told[2]) == pytest.approx(100 * (high - low) / 2 / 1.97, rel=0.05)


@pytest.mark.slow
def test_a_finished_run_holds_no_code(small_job: Job, tmp_path: Path, call: Call) -> None:
    model, flag, run = tmp_path / "mine.py", tmp_path / "flag", tmp_path / "run"
    model.write_text(
        f"open({str(flag)!r}, 'w').close()\nfrom pfdist.models.library.ungm import model\n"
    )
    few = "filter.engine=numpy evaluation.draws=3 comparison.draws=20"
    line = f"run {small_job.path} --results {run} --set model.name=mine.py:model {few}"
    told = f"Running the model file {model}, which your job names\n"
    assert told in call(f"{line} --verbose").err
    assert told not in call(line).err
    assert flag.exists()  # to compute, the model's file was run
    files = [path for path in run.rglob("*") if path.is_file() and path.name != ".lock"]
    kinds = {path.suffix or path.name for path in files if path.stat().st_size}
    assert kinds == {".toml", ".json", ".parquet", ".svg", ".html"}
