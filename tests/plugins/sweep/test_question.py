"""A sweep is the same as its runs, started one by one."""

import contextlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.in_turn import in_turn
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import PfdistError, RunMismatchError, SweepError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import FilterWork, Result
from pfdist.plugins.sweep.question import foreseen
from pfdist.plugins.sweep.sweep_file import START_SECONDS, parts_that_pay
from pfdist.questions.at_work import release_the_lock
from pfdist.runner.progress import Progress
from pfdist.store import held

SWEEP = """
job = "small.toml"
[change]
comparison.draws = 60
search.genetic.generations = 1
[over]
problem.measurement_budget = "4:5"
model.parameters.process_sd = [1.0]
model.filter.parameters.process_sd = [2.0]
[[point]]
seed = 7
"""
FIRST = {"comparison.draws": [60]}
ALIKE = {"comparison.draws": [60, 80]}  # points with the same searches
SEEDS = {"seed": [1, 2]}
EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=30"]

Sweeping = Callable[..., pfdist.Sweep]
Finished = Callable[..., Path]


@pytest.fixture
def swept(small_job: Job, tmp_path: Path) -> Sweeping:
    """A function that sweeps the small job in the folder "sweep"."""
    return partial(pfdist.sweep, small_job, results=tmp_path / "sweep", figures=False)


@pytest.fixture
def sweep_file(small_job: Job) -> Path:
    path = small_job.path.with_name("study.toml")
    path.write_text(SWEEP)
    return path


def alone(finished: Finished) -> dict[str, dict[str, str]]:
    """Bytes of the runs that are alike, each started alone."""
    names = [f"comparison.draws={draws}" for draws in ALIKE["comparison.draws"]]
    return {name: hashes(finished(name)) for name in names}


def bytes_of(sweep: pfdist.Sweep) -> dict[str, dict[str, str]]:
    return {name: hashes(run.path) for name, run in sweep.runs.items()}


@pytest.fixture
def filtered(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of filters that searches have run: sets times draws of each task."""
    numbers: list[int] = []
    filtered = Evaluator.filtered

    def counting(evaluator: Evaluator, work: FilterWork) -> Result:
        if all(len(id_.partition(":")[0]) == 16 for id_ in work.ids):  # no set of a comparison
            numbers.append((work.draws[1] - work.draws[0]) * len(work.measurement_times))
        return filtered(evaluator, work)

    monkeypatch.setattr(Evaluator, "filtered", counting)
    return numbers


# --- Its points ---------------------------------------------------------------------------------


def test_every_point_has_the_bytes_of_its_own_run(
    sweep_file: Path, finished: Finished, tmp_path: Path
) -> None:
    """Before, its points can be listed with the work that they will be."""
    points = foreseen(sweep_file, results=tmp_path / "sweep").points
    assert points["state"].tolist() == ["none"] * 3
    assert (points["steps"] > 0).all()
    assert (points["seconds"] > 0).all()
    assert not (tmp_path / "sweep").exists()
    sweep = pfdist.sweep(sweep_file, results=tmp_path / "sweep", figures=False)
    assert [sweep.path / point for point in points["point"]] == [
        run.path for run in sweep.runs.values()
    ]
    assert set(foreseen(sweep_file, results=tmp_path / "sweep").points["state"]) == {"finished"}
    few = ["comparison.draws=60", "search.genetic.generations=1"]
    changes = ["problem.measurement_budget=5", "model.parameters.process_sd=1.0"]
    changes.append("model.filter.parameters.process_sd=2.0")
    name = "measurement_budget=5_model.parameters.process_sd=1.0_filter.parameters.process_sd=2.0"
    assert hashes(sweep.path / name) == hashes(finished(*few, *changes))
    last = finished("seed=7", *few)
    assert hashes(sweep.path / "seed=7") == hashes(last)


@pytest.mark.parametrize("processor", ["this", pytest.param("another", marks=pytest.mark.slow)])
def test_points_that_are_added_take_what_another_has_computed_if_its_bytes_are_sure(
    processor: str,
    swept: Sweeping,
    finished: Finished,
    filtered: list[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last digits may differ on another processor."""
    searches = 1
    with monkeypatch.context() as patched:
        if processor == "another":
            other, searches = {"model": "x", "compiled_for": "y"}, 2
            patched.setattr("pfdist.runner.provenance.processor", lambda: other)
        swept(FIRST)
    once = sum(filtered)
    sweep = swept(ALIKE)
    assert 0 < searches * once <= sum(filtered) < (searches + 1) * once
    assert bytes_of(sweep) == alone(finished)


def test_progress_is_that_of_the_whole_and_a_finished_sweep_needs_no_workers(
    swept: Sweeping, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Progress] = []
    first = swept(SEEDS, changes=EXACT, progress=seen.append)
    assert {state.total for state in seen} == {2}
    assert all(0 <= state.done <= 2 for state in seen)
    assert seen[-1].done == 2
    assert seen[-1].doing.startswith("2 of 2 points finished")
    assert any("seed=2: genetic" in state.doing for state in seen)
    before = bytes_of(first)

    def refuse(*_: Any) -> None:
        raise AssertionError("workers were started")

    monkeypatch.setattr("pfdist.pools.base.SerialPool.__enter__", refuse)
    assert bytes_of(swept(SEEDS, changes=EXACT)) == before


def test_results_have_the_name_of_the_sweep_file(
    sweep_file: Path, small_job: Job, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    sweep = partial(pfdist.sweep, changes=EXACT[:2], figures=False)
    sweep_file.write_text('job = "small.toml"\n[over]\nseed = [3]\n')
    assert sweep(sweep_file).path == Path("results/study").absolute()
    assert sweep(small_job, {"seed": [3]}).path == Path("results/small-sweep").absolute()


# --- In parts -----------------------------------------------------------------------------------


def test_parts_look_at_no_other_point_and_together_are_the_sweep(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others hold all points but those of a part; afterwards nothing is left to compute."""
    start = partial(pfdist.sweep, small_job, {"seed": [1, 2, 3]}, changes=EXACT)
    whole = start(results=tmp_path / "whole", figures=False)
    reported = list[object]()
    monkeypatch.setattr(
        "pfdist.plugins.sweep.question.try_report", lambda run, *_: reported.append(run)
    )
    for number in (1, 2):
        with contextlib.ExitStack() as others:
            for name in [*whole.runs][2 - number :: 2]:
                others.enter_context(held(tmp_path / "parts" / name))
            part = start(results=tmp_path / "parts", part=(number, 2))
        assert [*part.runs] == [*whole.runs][number - 1 :: 2]
        assert part.busy == ()
        assert part.files == (part.path,)
    assert len(reported) == 3

    def refuse(*_: Any) -> None:
        raise AssertionError("workers were started")

    monkeypatch.setattr("pfdist.pools.base.SerialPool.__enter__", refuse)
    joined = start(results=tmp_path / "parts")
    assert bytes_of(joined) == bytes_of(whole)
    assert joined.files == (joined.path / "points.csv",)


@in_turn(("part",), [((0, 2),), ((3, 2),), ((1, 3),)])
def test_a_part_that_has_no_point_is_refused(part: tuple[int, int], swept: Sweeping) -> None:
    words = r"part must be K/N with 1 <= K <= N <= 2, the number of points, got "
    with pytest.raises(PfdistError, match=words):
        swept(SEEDS, part=part)


@pytest.mark.parametrize("seconds", [[5.0] * 40, [200.0] * 7, [1000.0, *[10.0] * 20], [0.0, 9e9]])
def test_parts_that_pay_compute_for_half_of_their_time_and_more_do_not(
    seconds: list[float],
) -> None:
    def share(parts: int) -> float:
        longest = max(sum(seconds[part::parts]) for part in range(parts))
        return sum(seconds) / parts / (longest + START_SECONDS)

    pay = [parts for parts in range(2, len(seconds) + 1) if share(parts) >= 0.5]
    assert parts_that_pay(seconds) == max(pay, default=1)


# --- Points that fail ---------------------------------------------------------------------------


def test_a_point_that_fails_is_said_and_the_others_go_on(swept: Sweeping, tmp_path: Path) -> None:
    said: list[str] = []
    over = {"model.parameters.process_sd": [1.0, -1.0, 2.0]}
    with pytest.raises(SweepError) as caught:
        swept(over, changes=["comparison.draws=60"], say=said.append)
    assert list(caught.value.failed) == ["process_sd=-1.0"]
    assert str(caught.value).startswith("1 of 3 points failed, the others are finished in ")
    assert "process_sd must be a finite number" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert sum("process_sd=-1.0: failed: " in line for line in said) == 1
    for name in ("process_sd=1.0", "process_sd=2.0"):
        assert pfdist.open_run(tmp_path / "sweep" / name).state == "finished"


@pytest.mark.slow
def test_a_point_that_is_free_again_is_computed_and_the_others_stay_left_out(
    swept: Sweeping, tmp_path: Path
) -> None:
    with held(tmp_path / "sweep" / "seed=1"), contextlib.ExitStack() as stack:
        stack.enter_context(held(tmp_path / "sweep" / "seed=2"))

        def say(line: str) -> None:
            if line.startswith("seed=3: finished"):
                stack.close()

        sweep = swept({"seed": [1, 2, 3]}, changes=EXACT, say=say)
    assert (list(sweep.runs), sweep.busy) == (["seed=2", "seed=3"], ("seed=1",))


def test_a_point_that_another_process_computes_is_left_out_and_said(
    swept: Sweeping, small_job: Job, tmp_path: Path, said: Callable[..., str]
) -> None:
    folder = tmp_path / "sweep"
    lines: list[str] = []
    with held(folder / "seed=1"):
        sweep = swept(SEEDS, changes=EXACT, say=lines.append)
        assert (list(sweep.runs), sweep.busy) == (["seed=2"], ("seed=1",))
        words = ["sweep", str(small_job.path), "--results", str(folder), "--no-report"]
        words += ["--set", *EXACT, "--over"]
        assert "other processes compute seed=1\n" in said(*words, "seed=1:2")
        assert main([*words, "seed=1"]) == 0
    assert any(line.startswith("seed=1: left out: ") and "by process" in line for line in lines)
    again = swept(SEEDS, changes=EXACT)
    assert (list(again.runs), again.busy) == (["seed=1", "seed=2"], ())


@pytest.mark.slow
def test_the_work_is_foreseen_by_the_measured_speed_of_the_model(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """150 sines in a step take more than 20 ns anywhere; the guess for all models is 2 ns."""
    (small_job.path.parent / "slow.py").write_text(
        "from dataclasses import replace\n"
        "import numpy as np\n"
        "from pfdist import load_model\n"
        "def transition(x, t, w, p):\n"
        "    total = x[0]\n"
        "    for k in range(150):\n"
        "        total = np.sin(total + k)\n"
        "    return (total + w[0],)\n"
        "model = replace(load_model('random_walk'), linear_gaussian=False, transition=transition)\n"
    )
    seen = list[Progress]()
    options: Any = {"results": tmp_path / "sweep", "changes": ["model.name=slow.py:model"]}
    points = foreseen(small_job, SEEDS, **options, progress=seen.append).points
    assert (points["seconds"] / points["steps"]).between(2e-8, 1e-3).all()
    assert [(each.done, each.total) for each in seen] == [(0, 2), (1, 2)]
    assert [each.doing for each in seen] == ["measuring seed=1", "measuring seed=2"]
    words = ["sweep", str(small_job.path), "--over", "seed=1:2", "--dry-run", "--results"]
    assert main([*words, str(tmp_path / "sweep")]) == 0
    assert "measuring seed=1" in capsys.readouterr().err


def test_a_folder_of_another_run_fails_its_point_alone(
    swept: Sweeping, small_job: Job, tmp_path: Path
) -> None:
    folder = tmp_path / "sweep"
    pfdist.run(small_job, folder / "seed=1", changes=EXACT, figures=False)
    few = foreseen(small_job, SEEDS, results=folder, changes=EXACT).points
    assert list(few["state"]) == ["finished", "none"]
    other = [*EXACT, "problem.measurement_budget=3"]
    assert list(foreseen(small_job, SEEDS, results=folder, changes=other).points["state"]) == [
        "other run",
        "none",
    ]
    with pytest.raises(SweepError) as caught:
        swept(SEEDS, changes=other)
    assert RunMismatchError.__name__ not in str(caught.value)
    assert "holds a different run" in caught.value.failed["seed=1"]
    assert pfdist.open_run(folder / "seed=2").state == "finished"


@in_turn("start", [pfdist.sweep, foreseen])
@in_turn(
    ("over", "options", "words"),
    [
        ({"filter.particles": [9, 0]}, {}, "the point particles=0 of the sweep: filter.particles "),
        (SEEDS, {"changes": ["seed = 3"]}, "must not also be changed at all points, got seed"),
        (SEEDS, {"results": "small.toml"}, "results must be a folder for .*, got a file: "),
        (SEEDS, {"results": "run"}, "results must be a folder for .*, got a run: "),
    ],
)
def test_a_wrong_sweep_is_refused_in_one_line_before_anything_is_touched(
    start: Callable[..., object],
    over: dict[str, list[Any]],
    options: dict[str, Any],
    words: str,
    small_job: Job,
    small_run: pfdist.Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = small_run.path.parent
    monkeypatch.chdir(folder)
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    with pytest.raises(PfdistError, match=words) as caught:
        start(small_job, over, **{"results": "sweep"} | options)
    assert "\n" not in str(caught.value)
    assert {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('job = "small.toml"\novr = {seed = [1]}', "unknown key 'ovr'; did you mean 'over'"),
        ('job = "study.toml"\n[over]\nseed = [1]', "is a sweep file, not a job: run it by"),
    ],
)
def test_a_wrong_sweep_file_is_told_in_one_line(text: str, words: str, sweep_file: Path) -> None:
    sweep_file.write_text(text)
    with pytest.raises(PfdistError, match=words) as caught:
        pfdist.sweep(sweep_file)
    assert "\n" not in str(caught.value)


# --- Its table and its figure -------------------------------------------------------------------


def test_a_sweep_has_the_table_of_its_points_and_one_figure(
    small_job: Job, tmp_path: Path, said: Callable[..., str]
) -> None:
    """Its folder is no run: commands about a run name one of its points."""
    over = {"problem.measurement_budget": [3, 4]}
    folder = tmp_path / "sweep"
    sweep = pfdist.sweep(small_job, over, results=folder, changes=EXACT, report=False)
    frame, (file,) = sweep.table(), sweep.files
    assert repr(sweep).startswith("<The lowest expected MSE is ")  # as a run shows its answer
    assert pd.read_csv(file)["expected_mse"].tolist() == frame["expected_mse"].tolist()
    assert sweep.figures == (folder / "figures" / "points.svg",)
    assert not (folder / ".lock").exists()
    drawn = sweep.figures[0].read_bytes()
    sweep.figures[0].unlink()
    names = {f"points.{kind}" for kind in ("png", "svg", "pdf")}
    assert {Path(line).name for line in said("plot", folder).splitlines()} == names
    assert (folder / "figures" / "points.svg").read_bytes() == drawn
    more = partial(
        pfdist.sweep, small_job, {"problem.measurement_budget": [5]}, results=folder, changes=EXACT
    )
    assert len(more(report=False).runs) == 1
    assert len(pd.read_csv(file)) == len(pfdist.table(folder)) > len(frame)
    assert sweep.figures[0].read_bytes() != drawn
    for command in ("report", "status", "verify"):
        line = said(command, folder, code=1)
        assert f"holds several runs, as a sweep does: name one of them, such as {folder}/" in line


def test_an_error_of_the_table_or_the_figure_is_a_line_and_the_sweep_stands(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, said = tmp_path / "sweep" / "points.csv", list[str]()
    own.parent.mkdir()
    own.write_text("mine")
    start = partial(pfdist.sweep, small_job, SEEDS, changes=EXACT, report=False, say=said.append)
    assert len(start(results=own.parent).runs) == 2
    assert own.read_text() == "mine"
    assert "there is no table or figure: " in said[-1]

    def fail(*_: Any) -> None:
        raise ZeroDivisionError("a\nmistake")

    monkeypatch.setattr("pfdist.plugins.runs.figure.draw_points", fail)
    sweep = start(results=tmp_path / "other")
    assert sweep.files == (tmp_path / "other" / "points.csv",)
    assert sweep.figures == ()
    assert "ZeroDivisionError: a mistake (`pfdist plot " in said[-1]


def test_a_single_point_whose_formulas_are_python_wants_processes_for_all() -> None:
    assert release_the_lock(["compiled", "kalman"])
    assert not release_the_lock(["compiled", "numpy"])


@pytest.mark.usefixtures("undrawn")
def test_a_point_has_the_particles_and_the_proposal_that_were_found(
    swept: Sweeping, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report of a point needs them."""
    monkeypatch.setattr("pfdist.runner.particles._DRAWS", (1000,))
    changes = ["filter.particles=auto", "filter.proposal=auto", "model.name=random_walk"]
    changes += ["comparison.draws=30", "search=[{method='random', evaluations=2}]"]
    (run,) = swept({"seed": [1]}, changes=changes, report=True).runs.values()
    assert run.job == pfdist.open_run(run.path).job
    assert isinstance(run.job["filter"]["particles"], int)
    assert (run.path / "report.html").exists()
