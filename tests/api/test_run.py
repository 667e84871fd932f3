"""A run: what it computes, that it goes on, and that it is the same however it was computed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.counted import A_DRAW, count_draws
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.errors import (
    JobError,
    PfdistError,
    RunMismatchError,
    SearchError,
    StoreError,
    TaskError,
)
from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Work
from pfdist.pools.base import Outcome, SerialPool
from pfdist.runner import door
from pfdist.runner.pace import Pace
from pfdist.runner.progress import Progress
from pfdist.store import parquet

ROOT = Path(__file__).parents[2]
# For models of a test, in which the engine makes no difference: nothing is compiled.
IN_NUMPY = ["filter.engine=numpy", "evaluation.draws=3", "comparison.draws=5"]


@pytest.fixture(name="count_draws")
def _count_draws(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many draws each task of the serial pool filtered."""
    return count_draws(monkeypatch)


def test_the_tables_hold_every_evaluation_and_every_draw(small_run: pfdist.Run) -> None:
    evaluations, draws = small_run.evaluations(), small_run.draws()
    populations = evaluations.groupby(["phase", "generation"])["copies"].sum()
    assert populations["genetic"].tolist() == [6, 6, 6, 6]
    assert populations["random"].tolist() == [10]
    # each evaluation's figures are those of its draws
    per_draw = draws.groupby("evaluation")["mse"]
    evaluations = evaluations.set_index("evaluation")
    np.testing.assert_allclose(evaluations["expected_mse"], per_draw.mean()[evaluations.index])
    np.testing.assert_allclose(evaluations["standard_error"], per_draw.sem()[evaluations.index])
    assert (per_draw.size() == 30).all()
    comparison = small_run.comparison()
    assert comparison.columns.tolist() == ["draw", "mse_regular", "mse_genetic", "mse_random"]
    assert comparison["draw"].tolist() == list(range(250))
    gains = small_run.gains()
    expected = 1 - comparison["mse_genetic"] / comparison["mse_regular"]
    np.testing.assert_allclose(gains["gain_genetic"], expected)
    assert not list((small_run.path / "parts").rglob("*.parquet"))


def test_a_search_reports_what_its_own_evaluation_got(small_run: pfdist.Run) -> None:
    evaluations, results = small_run.evaluations(), small_run.summary()["results"]
    last = evaluations[(evaluations["phase"] == "genetic") & (evaluations["generation"] == 3)]
    best = last.loc[last["expected_mse"].idxmin()]
    assert results["genetic"]["search_cost"] == best["expected_mse"]
    assert results["genetic"]["measurement_times"] == best["measurement_times"].tolist()
    assert results["regular"]["measurement_times"] == [0, 4, 8, 12]
    assert results["regular"]["search_cost"] is None


def test_the_first_trajectories_belong_to_the_comparison(small_run: pfdist.Run) -> None:
    rows, comparison = small_run.trajectories(), small_run.comparison().set_index("draw")
    assert rows["draw"].nunique() == 100
    for name in small_run.names:
        error = (rows["z_0"] - rows[f"estimate_{name}_0"]) ** 2
        mse = error.groupby(rows["draw"]).mean()
        np.testing.assert_allclose(mse, comparison.loc[mse.index, f"mse_{name}"])


@pytest.mark.parametrize(
    "file", ["tests/small.toml", pytest.param("jobs/quick.toml", marks=pytest.mark.slow)]
)
def test_pools_and_numbers_of_workers_give_the_same_bytes(
    file: str, tmp_path: Path, ray_cluster: None
) -> None:
    job = load_job(ROOT / file)
    runs = {
        "serial": ("serial", 0),
        "threads": ("threads", 3),
        "one": ("ray", 1),
        "two": ("ray", 2),
    }
    for name, (pool, workers) in runs.items():
        pfdist.run(job, tmp_path / name, pool=pool, workers=workers, figures=False)
    serial, *others = (hashes(tmp_path / name) for name in runs)
    assert len(serial) > 6
    assert others == [serial] * len(others)


# The survivors are polished on more and more draws, of which a session before did the first.
SURVIVORS = [
    "search=[{method='survivors', evaluation={draws=20, particles=100, resampling='multinomial'}}]",
    "comparison.draws=20",
]


@pytest.mark.parametrize(
    ("changes", "stop_after"),
    [
        pytest.param([], 3, marks=pytest.mark.slow),
        ([], 25),
        pytest.param([], 40, marks=pytest.mark.slow),
        pytest.param(SURVIVORS, 250, marks=pytest.mark.crash),
        pytest.param(SURVIVORS, 330, marks=pytest.mark.crash),
    ],
)
def test_a_run_that_failed_goes_on_with_what_is_committed_and_ends_with_the_same_bytes(
    changes: list[str],
    stop_after: int,
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    count_draws: list[int],
) -> None:
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 60 * A_DRAW)
    monkeypatch.setattr(door, "COMMIT_SECONDS", 0.0)  # each task is committed
    small_job = small_job.with_changes(["execution.failures=0", *changes])
    whole = pfdist.run(small_job, tmp_path / "whole", figures=False)
    needed = sum(count_draws)
    count_draws.clear()
    calls, do = 0, Evaluator.filtered

    def failing(self: Evaluator, work: Work) -> Any:
        nonlocal calls
        calls += 1
        if calls > stop_after:
            raise ArithmeticError("the cluster is on fire")
        return do(self, work)

    with monkeypatch.context() as patch:
        patch.setattr(Evaluator, "filtered", failing)
        with pytest.raises(TaskError, match="the cluster is on fire") as failure:
            pfdist.run(small_job, tmp_path / "again", figures=False)
    assert "Traceback" in failure.value.traceback
    timings = pfdist.open_run(tmp_path / "again").timings()
    assert timings["failures"].sum() == 1
    assert timings.loc[timings["failures"] == 1, "error"].str.contains("on fire").all()
    failed = count_draws.pop()  # counted, and not done
    again = pfdist.run(small_job, tmp_path / "again", figures=False)
    assert sum(count_draws) == needed  # nothing is computed twice
    assert failed > 0
    assert hashes(again.path) == hashes(whole.path)


def test_a_finished_run_computes_nothing(
    small_job: Job, count_draws: list[int], small_run: pfdist.Run
) -> None:
    count_draws.clear()
    assert pfdist.run(small_job, small_run.path, figures=False).summary() == small_run.summary()
    assert count_draws == []


def test_more_draws_of_comparison_compute_only_the_new_and_give_the_same_bytes(
    small_job: Job, tmp_path: Path, count_draws: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "comparison", 100)
    larger = small_job.with_changes(["comparison.draws=430"])
    at_once = pfdist.run(larger, tmp_path / "at once", figures=False)
    pfdist.run(small_job, tmp_path / "grown", figures=False)
    count_draws.clear()
    grown = pfdist.run(larger, tmp_path / "grown", figures=False)
    assert sum(count_draws) == (430 - 250) * (3 + 1 + 3 + 4)  # all sets three times
    assert hashes(grown.path) == hashes(at_once.path)
    assert grown.summary()["draws_compared"] == 430


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ("seed=2", "seed: 1 -> 2"),
        ("problem.measurement_budget=5", "problem.measurement_budget: 4 -> 5"),
        ("search.genetic.generations=5", "search.genetic.generations: 4 -> 5"),
        ("model.parameters.process_sd=2.0", "model.parameters.process_sd: nothing -> 2.0"),
    ],
)
def test_another_job_is_refused_with_the_difference(
    small_job: Job, change: str, difference: str, small_run: pfdist.Run
) -> None:
    with pytest.raises(RunMismatchError, match=difference):
        pfdist.run(small_job.with_changes([change]), small_run.path, figures=False)


def test_fewer_draws_than_are_there_are_refused_by_saying_so(
    small_job: Job, small_run: pfdist.Run
) -> None:
    with pytest.raises(StoreError, match=r"must be at least the 250 draws .* got 100") as refused:
        pfdist.run(small_job, small_run.path, changes=["comparison.draws=100"], figures=False)
    assert "another run" not in str(refused.value)


def test_between_search_and_comparison_the_found_times_are_told(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(progress: Progress) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(small_job, tmp_path / "run", progress=stop, figures=False)
    summary = pfdist.open_run(tmp_path / "run").summary()
    assert (summary["state"], summary["draws_compared"]) == ("comparing", 0)
    assert set(summary["results"]) == {"regular", "genetic", "random"}
    assert len(summary["results"]["genetic"]["measurement_times"]) == 4
    assert main(["status", str(tmp_path / "run")]) == 0
    text = capsys.readouterr().out
    assert "genetic: measure at t = " in text
    assert "the search believed" in text
    assert f"tables: {tmp_path / 'run' / 'tables'}" in text
    assert "figures" not in text  # there is no such folder yet


def test_an_edited_model_is_refused(tmp_path: Path, small_job: Job) -> None:
    source = (ROOT / "pfdist" / "models" / "ungm.py").read_text()
    model = small_job.path.with_name("mine.py")
    model.write_text(source)
    job = small_job.with_changes(['model.name="mine.py:model"', *IN_NUMPY])
    pfdist.run(job, tmp_path / "run", figures=False)
    model.write_text(source.replace("x[0] / 2", "x[0] / 3"))
    with pytest.raises(RunMismatchError, match=r"one's: model\.formulas: \w{8} -> \w{8}$"):
        pfdist.run(job, tmp_path / "run", figures=False)


def test_where_nearly_all_differs_a_few_differences_are_named(
    small_job: Job, small_run: pfdist.Run
) -> None:
    with pytest.raises(RunMismatchError, match=r"; and \d+ more$") as error:
        pfdist.plan(small_job, small_run.path, figures=False)
    assert str(error.value).count(" -> ") == 1 + 8
    assert len(error.value.differences) > 8


def test_common_noise_evaluates_a_set_once_in_a_whole_search(
    small_job: Job, tmp_path: Path, count_draws: list[int]
) -> None:
    job = small_job.with_changes(["evaluation.noise=common", "search.genetic.generations=12"])
    run = pfdist.run(job, tmp_path / "run", figures=False)
    genetic = run.evaluations().query("phase == 'genetic'")
    times = genetic["measurement_times"].map(tuple)
    assert times.nunique() < len(times)  # some sets came back in a later generation
    assert genetic["evaluation"].nunique() == times.nunique()
    assert len(run.draws()) == 30 * run.evaluations()["evaluation"].nunique()


def test_a_search_that_kills_everything_says_so(small_job: Job, tmp_path: Path) -> None:
    small_job.path.with_name("hopeless.py").write_text(
        "from pfdist.models.ungm import model\n"
        "import dataclasses\n"
        "hopeless = dataclasses.replace(\n"
        "    model, log_likelihood=lambda y, x, t, p: x[0] - x[0] - float('inf'))\n"
    )
    job = small_job.with_changes(['model.name="hopeless.py:hopeless"', *IN_NUMPY])
    with pytest.raises(SearchError, match=r"genetic: every set of times .* degenerate"):
        pfdist.run(job, tmp_path / "run", figures=False)
    rows = pfdist.open_run(tmp_path / "run").evaluations()
    assert (rows["degenerate_draws"] == rows["draws"]).all()
    assert np.isinf(rows["expected_mse"]).all()


def test_the_serial_pool_has_one_worker(small_job: Job, tmp_path: Path) -> None:
    with pytest.raises(
        JobError, match="in this process, takes no workers, got 4; pools that do: 'ray', 'threads'"
    ):
        pfdist.run(small_job, tmp_path / "run", workers=4, figures=False)


def test_progress_counts_all_work_once(small_job: Job, tmp_path: Path) -> None:
    seen: list[Any] = []
    pfdist.run(small_job, tmp_path / "run", progress=seen.append, figures=False)
    done = [state.done for state in seen]
    assert done == sorted(done)
    assert seen[-1].done == seen[-1].total == ((6 * 4 + 10) * 30 + 250 * 3) * A_DRAW
    assert {state.phase for state in seen} == {"genetic", "random", "comparison"}


def test_the_order_of_the_searches_is_part_of_what_a_run_is(
    small_job: Job, small_run: pfdist.Run
) -> None:
    swapped = small_job.model_copy(update={"search": small_job.search[::-1]})
    with pytest.raises(
        RunMismatchError, match=r"search\.order: genetic, random -> random, genetic"
    ):
        pfdist.run(swapped, small_run.path, figures=False)


def test_tables_without_what_says_whose_they_are_are_left_alone(
    small_job: Job, small_run: pfdist.Run
) -> None:
    (small_run.path / "run.json").unlink()
    (small_run.path / "manifest").unlink()
    with pytest.raises(PfdistError, match=r"must be a new folder, .* or a run's, got .* with"):
        pfdist.run(small_job, small_run.path, figures=False)


def test_a_wish_for_too_many_draws_can_be_taken_back(small_job: Job, small_run: pfdist.Run) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Evaluator, "filtered", lambda self, work: 1 / 0)
        with pytest.raises(TaskError, match="ZeroDivisionError"):
            pfdist.run(
                small_job.with_changes(["comparison.draws=90000000"]), small_run.path, figures=False
            )
    again = pfdist.run(small_job, small_run.path, figures=False)
    assert again.state == "finished"
    assert again.draws_compared == 250


def test_trajectories_committed_out_of_order_are_completed(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = pfdist.run(small_job, tmp_path / "whole", figures=False)
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 30 * A_DRAW)
    do = SerialPool.run

    def backwards_and_killed(self: SerialPool, tasks: Any) -> Iterator[Outcome]:
        tasks = list(tasks)[::-1]
        for outcome in do(self, tasks):
            yield outcome
            if "trajectories" in outcome.task.key:
                raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(SerialPool, "run", backwards_and_killed)
        with pytest.raises(KeyboardInterrupt):
            pfdist.run(small_job, tmp_path / "run", figures=False)
    again = pfdist.run(small_job, tmp_path / "run", figures=False)
    assert again.trajectories()["draw"].nunique() == 100
    assert hashes(again.path) == hashes(whole.path)


def test_copies_of_a_set_are_evaluated_afresh_unless_they_share(
    small_job: Job, tmp_path: Path
) -> None:
    """Paper, section 2.4: the cost of each of the 50 individuals of a generation is estimated."""

    def rows(name: str, *changes: str) -> pd.DataFrame:
        parents_survive = [
            f"search.genetic.{how}_probability=0.0" for how in ("crossover", "mutation")
        ]
        job = small_job.with_changes([*parents_survive, *changes])
        found = pfdist.run(job, tmp_path / name, figures=False).evaluations()
        found = found[found["phase"] == "genetic"]
        return found.assign(times=found["measurement_times"].map(tuple))

    fresh, keys = rows("fresh"), ["generation", "times"]
    assert fresh.groupby("generation").size().tolist() == [6] * 4
    assert (fresh["copies"] == 1).all()
    repeated = fresh[fresh.duplicated(keys, keep=False)]
    assert len(repeated) > 0
    assert not fresh["evaluation"].duplicated().any()
    assert not repeated.duplicated([*keys, "expected_mse"]).any()
    for name, change in (
        ("shared", "search.genetic.share_copies=true"),
        ("common", "evaluation.noise=common"),
    ):
        merged = rows(name, change)
        assert not merged.duplicated(keys).any()
        assert merged.groupby("generation")["copies"].sum().tolist() == [6] * 4
        assert merged["copies"].max() > 1
