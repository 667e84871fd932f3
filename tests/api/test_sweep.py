"""A sweep is the same as its runs, started one by one."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.analysis.judged import times_by_search
from pfdist.api.foreseen import foreseen
from pfdist.cli.main import main
from pfdist.errors import ArgumentError, JobError, PfdistError, RunMismatchError, SweepError
from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Result, Work
from pfdist.job.judging import judged_sets
from pfdist.runner.progress import Progress
from pfdist.store import held

SWEEP = """
job = "small.toml"
[change]
comparison.draws = 60
[over]
seed = [1, 2]
problem.measurement_budget = "4:5"
[[parallel]]
model.parameters.process_sd = [1.0]
model.filter.parameters.process_sd = [2.0]
[[point]]
seed = 7
"""


@pytest.fixture
def sweep_file(small_job: Job) -> Path:
    path = small_job.path.with_name("study.toml")
    path.write_text(SWEEP)
    return path


def alone(small_job: Job, path: Path, changes: list[str]) -> dict[str, str]:
    pfdist.run(small_job.path, path, changes=changes, figures=False)
    return hashes(path)


def test_every_point_has_the_bytes_of_its_own_run(
    sweep_file: Path, small_job: Job, tmp_path: Path
) -> None:
    sweep = pfdist.sweep(sweep_file, results=tmp_path / "sweep", report=False)
    assert sweep.path == tmp_path / "sweep"
    assert len(sweep.runs) == 5
    for name, run in sweep.runs.items():
        assert run.path == tmp_path / "sweep" / name
        assert run.state == "finished"
    changes = [
        "seed=2",
        "problem.measurement_budget=5",
        "comparison.draws=60",
        "model.parameters.process_sd=1.0",
        "model.filter.parameters.process_sd=2.0",
    ]
    name = (
        "seed=2,measurement_budget=5,model.parameters.process_sd=1.0,"
        "filter.parameters.process_sd=2.0"
    )
    assert hashes(sweep.path / name) == alone(small_job, tmp_path / "one", changes)
    last = alone(small_job, tmp_path / "last", ["seed=7", "comparison.draws=60"])
    assert hashes(sweep.path / "seed=7") == last


ALIKE = {"comparison.draws": [60, 100, 80]}
"""Points with the same searches."""


@pytest.fixture
def filtered(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of filters that searches have run: sets times draws of each task."""
    numbers: list[int] = []
    filtered = Evaluator.filtered

    def counting(evaluator: Evaluator, work: Work) -> Result:
        if all(len(id_.partition(":")[0]) == 16 for id_ in work.ids):  # no set of a comparison
            numbers.append((work.draws[1] - work.draws[0]) * len(work.measurement_times))
        return filtered(evaluator, work)

    monkeypatch.setattr(Evaluator, "filtered", counting)
    return numbers


@pytest.mark.parametrize(
    "changes",
    [
        [],
        pytest.param(["search.genetic.share_copies=true"], marks=pytest.mark.slow),
        pytest.param(['search=[{method="relaxation"}]'], marks=pytest.mark.slow),
        pytest.param(
            ['search=[{method="greedy_forward"}, {method="relaxation", name="again"}]'],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_evaluation_that_several_points_need_is_computed_once(
    changes: list[str], small_job: Job, tmp_path: Path, filtered: list[int]
) -> None:
    """Three points that differ in their comparison alone cost one search."""
    whole = {}
    for draws in ALIKE["comparison.draws"]:
        filtered.clear()
        all_changes = [*changes, f"comparison.draws={draws}"]
        whole[f"comparison.draws={draws}"] = alone(small_job, tmp_path / f"{draws}", all_changes)
    once = sum(filtered)
    assert once > 0
    filtered.clear()
    sweep = pfdist.sweep(
        small_job, ALIKE, changes=changes, results=tmp_path / "sweep", report=False
    )
    assert sum(filtered) == once
    assert {name: hashes(run.path) for name, run in sweep.runs.items()} == whole


def test_a_finished_point_saves_points_that_are_added_its_search(
    small_job: Job, tmp_path: Path, filtered: list[int]
) -> None:
    few, path = {"comparison.draws": [60]}, tmp_path / "sweep"
    first = pfdist.sweep(small_job, few, results=path, report=False)
    before = hashes(first.runs["comparison.draws=60"].path)
    filtered.clear()
    sweep = pfdist.sweep(small_job, ALIKE, results=path, report=False)
    assert sum(filtered) == 0
    for draws in ALIKE["comparison.draws"][1:]:
        whole = alone(small_job, tmp_path / f"{draws}", [f"comparison.draws={draws}"])
        assert hashes(sweep.path / f"comparison.draws={draws}") == whole
    assert hashes(sweep.path / "comparison.draws=60") == before


@pytest.mark.parametrize("method", [pytest.param("genetic", marks=pytest.mark.slow), "relaxation"])
def test_an_unfinished_point_saves_the_others_what_it_has_computed(
    method: str,
    small_job: Job,
    tmp_path: Path,
    filtered: list[int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    changes = [f'search=[{{method="{method}"}}]']
    alone(small_job, tmp_path / "whole", [*changes, "comparison.draws=60"])
    once = sum(filtered)
    filtered.clear()

    def stop(*_: Any) -> None:
        raise PfdistError("the search is over")

    with monkeypatch.context() as patched:
        patched.setattr("pfdist.runner.driver.run_comparison", stop)
        with pytest.raises(SweepError):
            pfdist.sweep(
                small_job, {"comparison.draws": [60]}, changes=changes,
                results=tmp_path / "sweep", report=False,
            )  # fmt: skip
    assert sum(filtered) == once
    sweep = pfdist.sweep(
        small_job, ALIKE, changes=changes, results=tmp_path / "sweep", report=False
    )
    assert sum(filtered) == once
    first = sweep.path / "comparison.draws=60"
    assert hashes(first) == hashes(tmp_path / "whole")


def test_a_point_of_another_processor_gives_other_points_nothing(
    small_job: Job, tmp_path: Path, filtered: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last digits of its evaluations may differ."""
    path = tmp_path / "sweep"
    with monkeypatch.context() as patched:
        patched.setattr(
            "pfdist.runner.provenance.processor", lambda: {"model": "x", "compiled_for": "y"}
        )
        pfdist.sweep(small_job, {"comparison.draws": [60]}, results=path, report=False)
    once = sum(filtered)
    pfdist.sweep(small_job, ALIKE, results=path, report=False)
    assert sum(filtered) == 2 * once


@pytest.mark.slow
def test_a_damaged_point_gives_other_points_nothing(
    small_job: Job, tmp_path: Path, filtered: list[int]
) -> None:
    path = tmp_path / "sweep"
    pfdist.sweep(small_job, {"comparison.draws": [60]}, results=path, report=False)
    once = sum(filtered)
    damaged = next((path / "comparison.draws=60" / "tables" / "draws").glob("*.parquet"))
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"?")
    filtered.clear()
    sweep = pfdist.sweep(small_job, ALIKE, results=path, report=False)
    assert sum(filtered) == once
    for draws in ALIKE["comparison.draws"]:
        whole = alone(small_job, tmp_path / f"{draws}", [f"comparison.draws={draws}"])
        assert hashes(sweep.path / f"comparison.draws={draws}") == whole


@pytest.mark.slow
def test_points_on_ray_have_the_same_bytes(
    small_job: Job, tmp_path: Path, ray_cluster: None
) -> None:
    sweep = pfdist.sweep(small_job, ALIKE, pool="ray", results=tmp_path / "sweep", report=False)
    for draws in ALIKE["comparison.draws"]:
        whole = alone(small_job, tmp_path / f"{draws}", [f"comparison.draws={draws}"])
        assert hashes(sweep.path / f"comparison.draws={draws}") == whole


def test_a_sweep_that_is_finished_needs_no_workers(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = pfdist.sweep(small_job, {"seed": [1, 2]}, results=tmp_path / "sweep", report=False)
    before = {name: hashes(run.path) for name, run in first.runs.items()}

    def refuse(*_: Any) -> None:
        raise AssertionError("workers were started")

    monkeypatch.setattr("pfdist.pools.base.SerialPool.__enter__", refuse)
    again = pfdist.sweep(small_job, {"seed": [1, 2]}, results=tmp_path / "sweep", report=False)
    assert {name: hashes(run.path) for name, run in again.runs.items()} == before


def test_a_point_that_fails_is_said_and_the_others_go_on(small_job: Job, tmp_path: Path) -> None:
    said: list[str] = []
    over = {"model.parameters.process_sd": [1.0, -1.0, 2.0]}
    with pytest.raises(SweepError) as caught:
        pfdist.sweep(small_job, over, results=tmp_path / "sweep", report=False, say=said.append)
    assert list(caught.value.failed) == ["process_sd=-1.0"]
    assert str(caught.value).startswith("1 of 3 points failed, the others are finished in ")
    assert "process_sd must be a finite number" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert sum("process_sd=-1.0: failed: " in line for line in said) == 1
    for name in ("process_sd=1.0", "process_sd=2.0"):
        assert pfdist.open_run(tmp_path / "sweep" / name).state == "finished"


def test_a_point_that_another_process_computes_is_left_out_and_said(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, over = tmp_path / "sweep", {"seed": [1, 2]}
    said: list[str] = []
    with held(folder / "seed=1"):
        sweep = pfdist.sweep(small_job, over, results=folder, report=False, say=said.append)
        assert (list(sweep.runs), sweep.busy) == (["seed=2"], ("seed=1",))
        words = ["sweep", str(small_job.path), "--results", str(folder), "--no-report", "--over"]
        assert main([*words, "seed=1:2"]) == 0
        assert "other processes compute seed=1\n" in capsys.readouterr().out
        assert main([*words, "seed=1"]) == 0
    assert any(line.startswith("seed=1: left out: ") and "by process" in line for line in said)
    again = pfdist.sweep(small_job, over, results=folder, report=False)
    assert (list(again.runs), again.busy) == (["seed=1", "seed=2"], ())


def test_a_folder_of_another_run_fails_its_point_alone(small_job: Job, tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    pfdist.run(small_job, folder / "seed=1", changes=["filter.particles=20"], figures=False)
    with pytest.raises(SweepError) as caught:
        pfdist.sweep(small_job, {"seed": [1, 2]}, results=folder, report=False)
    assert RunMismatchError.__name__ not in str(caught.value)
    assert "holds another run" in caught.value.failed["seed=1"]
    assert pfdist.open_run(folder / "seed=2").state == "finished"


def test_a_wrong_point_is_told_before_anything_is_computed(small_job: Job, tmp_path: Path) -> None:
    with pytest.raises(JobError) as caught:
        pfdist.sweep(small_job, {"filter.particles": [10, 0]}, results=tmp_path / "sweep")
    assert str(caught.value).startswith("the point particles=0 of the sweep: filter.particles must")
    assert not (tmp_path / "sweep").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("job = 3", "job must be a string, got 3"),
        ('job = "small.toml"\novr = {seed = [1]}', "unknown key 'ovr', allowed: job, change, over"),
        ('job = "small.toml"\nover = 3', "over must be a section, got 3"),
        ('job = "nothing.toml"\n[over]\nseed = [1]', "nothing.toml"),
        (
            'job = "study.toml"\n[over]\nseed = [1]',
            "is a sweep file, not a job: run it by",
        ),
        ('job = "small.toml"', "a sweep must have 1..10000 points, got 0"),
        ('job = "small.toml"\n[over]\nsede = [1]', "unknown key 'sede'"),
    ],
)
def test_a_wrong_sweep_file_is_told_in_one_line(
    text: str, words: str, sweep_file: Path, tmp_path: Path
) -> None:
    sweep_file.write_text(text)
    with pytest.raises(JobError) as caught:
        pfdist.sweep(sweep_file, results=tmp_path / "sweep")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "sweep").exists()


def test_progress_is_that_of_the_whole(small_job: Job, tmp_path: Path) -> None:
    seen: list[Progress] = []
    pfdist.sweep(
        small_job,
        {"seed": [1, 2, 3]},
        results=tmp_path / "sweep",
        report=False,
        progress=seen.append,
    )
    assert {state.total for state in seen} == {3}
    shares = [state.done for state in seen]
    assert all(0 <= share <= 3 for share in shares)
    assert seen[-1].done == 3
    assert seen[-1].doing.startswith("3 of 3 points finished")
    assert any("seed=2: genetic" in state.doing for state in seen)


def test_points_can_be_listed_without_computing(
    sweep_file: Path, small_job: Job, tmp_path: Path
) -> None:
    points = foreseen(sweep_file, results=tmp_path / "sweep")
    assert list(points["state"]) == ["none"] * 5
    assert (points["steps"] > 0).all()
    assert "judging_steps" not in points
    judging = foreseen(sweep_file, results=tmp_path / "sweep", judge=True)["judging_steps"]
    job = pfdist.load_job(small_job.path, ["comparison.draws=60"])
    filtered = 60 * job.filter.particles * (job.problem.feasible.horizon + 1)
    assert set(judging) == {filtered * (1 + 5 * len(job.search))}  # the reference and all found
    assert not (tmp_path / "sweep").exists()
    pfdist.sweep(sweep_file, results=tmp_path / "sweep", report=False)
    assert set(foreseen(sweep_file, results=tmp_path / "sweep")["state"]) == {"finished"}


@pytest.mark.slow
def test_a_problem_with_an_object_is_swept(tmp_path: Path) -> None:
    mine = dataclasses.replace(
        pfdist.load_model("random_walk"), transition=lambda x, t, w, p: (0.9 * x[0] + w[0],)
    )
    problem = pfdist.Problem(mine, horizon=12, measurement_budget=4, engine="kalman")
    sweep = pfdist.sweep(
        problem,
        {"seed": [1, 2]},
        pool="serial",
        results=tmp_path / "sweep",
        changes=["comparison.draws=60"],
    )
    assert all((run.path / "report.html").exists() for run in sweep.runs.values())


def test_results_have_the_name_of_the_sweep_file(
    sweep_file: Path, small_job: Job, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    few: Callable[..., pfdist.Sweep] = pfdist.sweep
    assert few(sweep_file, report=False).path == Path("results/study")
    assert few(small_job, {"seed": [3]}, report=False).path == Path("results/small-sweep")


@pytest.mark.slow
def test_times_found_at_each_point_are_judged_at_every_point(
    small_job: Job, tmp_path: Path
) -> None:
    """As `pfdist.compare` judges them: the same draws, filters and figures."""
    over = {"model.parameters.process_sd": [1.0, 2.0], "seed": [1, 2]}
    changes = ['search=[{method="greedy_forward"}]']
    sweep = pfdist.sweep(
        small_job, over, changes=changes, results=tmp_path / "sweep", judge=True, report=False
    )
    judged = sweep.judged()
    assert len(judged) == 16
    assert set(judged["found_at"]) == set(sweep.runs)
    assert judged["run"].nunique() == 4
    assert set(judged["set"]) == {"greedy_forward"}
    point = "process_sd=2.0,seed=1"
    sets = judged_sets(times_by_search(sweep.runs))
    compared = pfdist.compare(
        small_job,
        times=sets,
        changes=["model.parameters.process_sd=2.0", "seed=1"],
        results=tmp_path / "compared",
        figures=False,
    )
    expected = {sets[name]: compared.comparison()[f"mse_{name}"].mean() for name in sets}
    own = expected[sweep.runs[point].sets()["greedy_forward"]]
    for row in judged[judged["run"] == point].itertuples():
        assert row.measurement_times == sweep.runs[row.found_at].sets()["greedy_forward"]
        mse = expected[row.measurement_times]
        assert row.expected_mse == pytest.approx(mse, rel=1e-12)
        assert row.loss == pytest.approx(mse / own - 1, rel=1e-9, abs=1e-12)
        assert row.loss_low <= row.loss <= row.loss_high
    assert (judged.loc[judged["found_at"] == judged["run"], "loss"] == 0).all()


def test_times_found_at_several_points_are_judged_once(small_job: Job, tmp_path: Path) -> None:
    """Points that differ in their comparison alone find the same times."""
    sweep = pfdist.sweep(small_job, ALIKE, results=tmp_path / "sweep", judge=True, report=False)
    for name, judge in sweep.judges.items():
        assert list(judge.sets()) == ["regular", "point_1_genetic", "point_1_random"]
        assert judge.sets()["point_1_genetic"] == sweep.runs[name].sets()["genetic"]
    judged = sweep.judged()
    assert len(judged) == 18
    best, other = sorted(judged.groupby("set")["loss"].min())
    assert best == 0 < other


EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=30"]


def test_losses_of_an_exact_engine_are_exact(small_job: Job, tmp_path: Path) -> None:
    """Times of another number of measurements have no loss."""
    changes = [*EXACT, 'search=[{method="exhaustive"}]']
    over = {"model.parameters.step_sd": [0.2, 3.0], "problem.measurement_budget": [2, 3]}
    sweep = pfdist.sweep(
        small_job, over, changes=changes, results=tmp_path / "sweep", judge=True, report=False
    )
    judged = sweep.judged()
    assert len(judged) == 16
    assert judged["loss"].notna().sum() == 8
    for row in judged.itertuples():
        own = sweep.runs[row.run]
        if len(row.measurement_times) != own.problem.measurement_budget:
            assert math.isnan(row.loss)
            continue
        exact = own.summary()["results"]["exhaustive"]["exact_mse"]
        assert row.loss == pytest.approx(row.expected_mse / exact - 1, abs=1e-12)
        assert row.loss_low == row.loss == row.loss_high


def test_times_of_other_methods_have_losses_too(small_job: Job, tmp_path: Path) -> None:
    """The best times that any search has found at a point are those that count there."""
    over = {"search.exhaustive.method": ["exhaustive", "greedy_forward"]}
    changes = [*EXACT, 'search=[{method="exhaustive"}]']
    sweep = pfdist.sweep(
        small_job, over, changes=changes, results=tmp_path / "sweep", judge=True, report=False
    )
    losses = sweep.judged().set_index(["found_at", "run"])["loss"].unstack()
    best, other = sweep.runs
    assert losses.loc[best, other] <= 0 <= losses.loc[other, best]


def test_affordable_times_have_losses_where_a_filter_is_wrong(
    small_job: Job, tmp_path: Path
) -> None:
    """A filter that trusts its sensor too much needs few times; the right filter needs more."""
    problem = {"horizon": 5, "cost": [1, 2] * 3, "total_cost": 5}
    model = {"name": "random_walk", "parameters": {"measurement_sd": 6.0, "initial_sd": 2.0}}
    search = [{"method": "exhaustive", "evaluation": {"estimator": "squared_error"}}]
    job = small_job.with_changes(sections={"problem": problem, "model": model, "search": search})
    over = {"model.filter.parameters.measurement_sd": [6.0, 0.2]}
    sweep = pfdist.sweep(job, over, results=tmp_path / "sweep", judge=True, report=False)
    losses = sweep.judged().set_index(["found_at", "run"])["loss"].unstack()
    assert losses.notna().all(axis=None)
    right, wrong = sweep.runs
    assert losses.loc[right, wrong] > 0 < losses.loc[wrong, right]


@pytest.mark.slow
def test_points_that_are_added_are_judged_too(small_job: Job, tmp_path: Path) -> None:
    """The report shows the newest comparisons, which know the times of all points."""
    changes = [*EXACT, 'search=[{method="greedy_forward"}]']
    for noises in ([0.2, 3.0], [0.2, 1.0, 3.0]):
        sweep = pfdist.sweep(
            small_job, {"model.parameters.step_sd": noises}, changes=changes, judge=True,
            results=tmp_path / "sweep", report=False,
        )  # fmt: skip
        assert len(sweep.judged()) == len(noises) ** 2
    assert "were judged at" not in pfdist.report(sweep.path).read_text()
    pfdist.sweep(
        small_job, {"model.parameters.step_sd": [5.0]}, changes=changes,
        results=tmp_path / "sweep", report=False,
    )  # fmt: skip
    assert "judged at 3 of 4 points" in pfdist.report(sweep.path).read_text()


@pytest.mark.parametrize("start", [pfdist.sweep, foreseen])
def test_points_with_other_clocks_are_not_judged(
    start: Callable[..., object], small_job: Job, tmp_path: Path
) -> None:
    with pytest.raises(JobError, match="must have the same horizon and clock at all points"):
        start(small_job, {"problem.horizon": [12, 13]}, results=tmp_path / "x", judge=True)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("start", [pfdist.sweep, foreseen])
def test_a_sweep_spoils_neither_a_run_nor_a_file(
    start: Callable[..., object], small_job: Job, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.touch()
    run = pfdist.run(small_job, tmp_path / "run", changes=EXACT)
    report = (run.path / "report.html").read_bytes()
    for path, what in ((file, "a file"), (run.path, "a run")):
        with pytest.raises(ArgumentError, match=f"results must be a folder for .*, got {what}: "):
            start(small_job, {"seed": [1, 2]}, results=path)
    assert (run.path / "report.html").read_bytes() == report


def test_a_point_whose_folder_has_another_run_is_listed_so(small_job: Job, tmp_path: Path) -> None:
    pfdist.sweep(small_job, {"seed": [1]}, results=tmp_path, changes=EXACT, report=False)
    few = foreseen(small_job, {"seed": [1, 2]}, results=tmp_path, changes=EXACT)
    assert list(few["state"]) == ["finished", "none"]
    other = [*EXACT, "problem.measurement_budget=3"]
    listed = foreseen(small_job, {"seed": [1, 2]}, results=tmp_path, changes=other)
    assert list(listed["state"]) == ["other run", "none"]


def test_a_swept_key_is_not_changed_too(small_job: Job, tmp_path: Path) -> None:
    with pytest.raises(JobError, match="must not be changed at all points, too, got seed"):
        pfdist.sweep(small_job, {"seed": [1]}, changes=["seed = 3"], results=tmp_path / "x")


def test_failed_points_are_said_to_prevent_the_judging(small_job: Job, tmp_path: Path) -> None:
    said = list[str]()
    over = {"model.parameters.process_sd": [1.0, -1.0]}
    with pytest.raises(SweepError):
        pfdist.sweep(
            small_job, over, results=tmp_path / "x", judge=True, report=False, say=said.append
        )
    assert "the found times are not judged, because not all points are finished" in said


def test_a_sweep_that_does_not_judge_says_so(small_job: Job, tmp_path: Path) -> None:
    sweep = pfdist.sweep(small_job, {"seed": [1]}, results=tmp_path / "sweep", report=False)
    with pytest.raises(pfdist.PfdistError, match="judged needs a sweep that judges"):
        sweep.judged()
