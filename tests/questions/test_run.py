"""A run: what it computes, that it goes on, and that it is the same however it was computed."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.counted import A_DRAW, count_draws
from oracles.in_turn import in_turn
from oracles.results_of import results_of
from pfdist import Job, load_job
from pfdist.errors import PfdistError, SearchError, TaskError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import FilterWork
from pfdist.pools.base import Outcome, SerialPool
from pfdist.questions.run_page import searches_section
from pfdist.questions.subject import Subject
from pfdist.results.stored_run import killed_of
from pfdist.runner import door
from pfdist.runner.build import build
from pfdist.runner.pace import Pace
from pfdist.runner.progress import Progress
from pfdist.store import parquet

ROOT = Path(__file__).parents[2]
GENETIC = '{method="genetic", population=6, generations=4, mutation_probability=0.05}'
RANDOM = '{method="random", evaluations=10}'


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many draws each task of the serial pool filters, from now on."""
    return count_draws(monkeypatch)


# --- Its tables ---------------------------------------------------------------------------------


def test_the_tables_hold_every_evaluation_and_every_draw(small_run: pfdist.Run) -> None:
    evaluations, draws = small_run.table("evaluations"), small_run.table("draws")
    populations = evaluations.groupby(["phase", "generation"])["copies"].sum()
    assert populations["genetic"].tolist() == [6, 6, 6, 6]
    assert populations["random"].tolist() == [10]
    # each evaluation's figures are those of its draws
    per_draw = draws.groupby("evaluation")["mse"]
    evaluations = evaluations.set_index("evaluation")
    np.testing.assert_allclose(evaluations["expected_mse"], per_draw.mean()[evaluations.index])
    np.testing.assert_allclose(evaluations["standard_error"], per_draw.sem()[evaluations.index])
    assert (per_draw.size() == 30).all()
    comparison = small_run.table("comparison")
    assert comparison.columns.tolist() == [
        "draw",
        *(f"mse_{name}" for name in ("regular", "genetic", "random")),
        *(f"degenerate_{name}" for name in ("regular", "genetic", "random")),
    ]
    assert comparison["draw"].tolist() == list(range(250))
    gains = small_run.table("gains")
    expected = 1 - comparison["mse_genetic"] / comparison["mse_regular"]
    np.testing.assert_allclose(gains["gain_genetic"], expected)
    assert not list((small_run.path / "parts").rglob("*.parquet"))
    # and pandas alone reads them
    read = pd.read_parquet(small_run.path / "tables" / "comparison")
    pd.testing.assert_frame_equal(read, comparison)


def test_a_search_reports_what_its_own_evaluation_got(small_run: pfdist.Run) -> None:
    evaluations, results = small_run.table("evaluations"), results_of(small_run)
    last = evaluations[(evaluations["phase"] == "genetic") & (evaluations["generation"] == 3)]
    best = last.loc[last["expected_mse"].idxmin()]
    assert results["genetic"].search_mse == best["expected_mse"]
    assert results["genetic"].measurement_times == best["measurement_times"].tolist()
    assert results["regular"].measurement_times == [0, 4, 8, 12]
    assert results["regular"].search_mse is None


def test_the_first_trajectories_belong_to_the_comparison(small_run: pfdist.Run) -> None:
    rows, comparison = (
        small_run.table("trajectories"),
        small_run.table("comparison").set_index("draw"),
    )
    assert rows["draw"].nunique() == 100
    for name in small_run.names:
        error = (rows["z_state"] - rows[f"estimate_{name}_state"]) ** 2
        mse = error.groupby(rows["draw"]).mean()
        np.testing.assert_allclose(mse, comparison.loc[mse.index, f"mse_{name}"])


def test_copies_of_a_set_are_evaluated_afresh_unless_they_share(
    finished: Callable[..., Path],
) -> None:
    """Paper, section 2.4: the cost of each of the 50 individuals of a generation is estimated."""

    def rows(*changes: str) -> pd.DataFrame:
        parents_survive = [
            f"search.genetic.{how}_probability=0.0" for how in ("crossover", "mutation")
        ]
        run = pfdist.open_run(finished(*parents_survive, *changes))
        found = run.table("evaluations")
        assert len(run.table("draws")) == 30 * found["evaluation"].nunique()
        found = found[found["phase"] == "genetic"]
        return found.assign(times=found["measurement_times"].map(tuple))

    fresh, keys = rows(), ["generation", "times"]
    assert fresh.groupby("generation").size().tolist() == [6] * 4
    assert (fresh["copies"] == 1).all()
    repeated = fresh[fresh.duplicated(keys, keep=False)]
    assert len(repeated) > 0
    assert not fresh["evaluation"].duplicated().any()
    assert not repeated.duplicated([*keys, "expected_mse"]).any()
    shared, common = rows("search.genetic.share_copies=true"), rows("evaluation.noise=common")
    for merged in (shared, common):
        assert not merged.duplicated(keys).any()
        assert merged.groupby("generation")["copies"].sum().tolist() == [6] * 4
        assert merged["copies"].max() > 1
    # Common noise evaluates a set once in a whole search.
    assert common["evaluation"].nunique() == common["times"].nunique() < len(common)


def test_a_search_that_kills_everything_says_so(small_job: Job, tmp_path: Path) -> None:
    small_job.path.with_name("hopeless.py").write_text(
        "from pfdist.models.library.ungm import model\n"
        "import dataclasses\n"
        "hopeless = dataclasses.replace(\n"
        "    model, log_likelihood=lambda y, x, t, p: x[0] - x[0] - float('inf'))\n"
    )
    changes = ['model.name="hopeless.py:hopeless"', "filter.engine=numpy", "evaluation.draws=3"]
    says = r"genetic: every set of times .* check-model .* 'continue'"
    with pytest.raises(SearchError, match=says):
        pfdist.run(small_job.with_changes(changes), tmp_path / "run", figures=False)
    rows = pfdist.open_run(tmp_path / "run").table("evaluations")
    assert (rows["degenerate_draws"] == rows["draws"]).all()
    assert np.isinf(rows["expected_mse"]).all()
    assert killed_of(pfdist.open_run(tmp_path / "run")) == {"genetic": 24, "random": 10}


def test_the_answer_says_how_many_sets_were_killed(small_job: Job, tmp_path: Path) -> None:
    small_job.path.with_name("rare.py").write_text(
        "from pfdist import where\n"
        "from pfdist.models.library.ungm import model\n"
        "import dataclasses\n"
        "rare = dataclasses.replace(model, log_likelihood=lambda y, x, t, p: where(\n"
        "    y[0] > 15.0, -float('inf'), -0.5 * (y[0] - x[0] ** 2 / 20) ** 2))\n"
    )
    changes = ['model.name="rare.py:rare"', "filter.engine=numpy", "evaluation.draws=3"]
    changes.append("comparison.draws=30")
    run = pfdist.run(small_job.with_changes(changes), tmp_path / "run", figures=False)
    rows = run.table("evaluations")
    killed = rows["copies"][np.isinf(rows["expected_mse"])].groupby(rows["phase"]).sum()
    assert 0 < killed["genetic"] < 24
    texts = [
        block.text for block in searches_section(Subject(run)).blocks if hasattr(block, "text")
    ]
    said = (
        f"genetic: {killed['genetic']} evaluated sets had an infinite error, by degenerate draws."
    )
    assert said in texts


# --- The same, however it was computed ----------------------------------------------------------


def test_a_run_that_failed_goes_on_with_what_is_committed_and_ends_with_the_same_bytes(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, counted: list[int]
) -> None:
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 60 * A_DRAW)
    monkeypatch.setattr(door, "COMMIT_SECONDS", 0.0)  # each task is committed
    small_job = small_job.with_changes(["execution.failures=0"])
    whole = pfdist.run(small_job, tmp_path / "whole", figures=False)
    needed = sum(counted)
    counted.clear()
    calls, do = 0, Evaluator.filtered

    def failing(self: Evaluator, work: FilterWork) -> Any:
        nonlocal calls
        calls += 1
        if calls > 25:
            raise ArithmeticError("the cluster is on fire")
        return do(self, work)

    with monkeypatch.context() as patch:
        patch.setattr(Evaluator, "filtered", failing)
        with pytest.raises(TaskError, match="the cluster is on fire") as failure:
            pfdist.run(small_job, tmp_path / "again", figures=False)
    assert "Traceback" in failure.value.traceback
    timings = pfdist.open_run(tmp_path / "again").table("timings")
    assert timings["failures"].sum() == 1
    assert timings.loc[timings["failures"] == 1, "error"].str.contains("on fire").all()
    failed = counted.pop()  # counted, and not done
    again = pfdist.run(small_job, tmp_path / "again", figures=False)
    assert sum(counted) == needed  # nothing is computed twice
    assert failed > 0
    assert hashes(again.path) == hashes(whole.path)


def test_more_draws_of_comparison_compute_only_the_new_and_give_the_same_bytes(
    small_job: Job, tmp_path: Path, counted: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "comparison", 100)
    larger = small_job.with_changes(["comparison.draws=430"])
    at_once = pfdist.run(larger, tmp_path / "at once", figures=False)
    small = pfdist.run(small_job, tmp_path / "grown", figures=False)
    others = len(small.table("other_estimate"))
    counted.clear()
    grown = pfdist.run(larger, tmp_path / "grown", figures=False)
    more = (len(grown.table("other_estimate")) - others) * 3  # with the other estimate
    assert more > 0
    assert sum(counted) == (430 - 250) * (3 + 3 + 4) + more  # all sets three times
    assert hashes(grown.path) == hashes(at_once.path)
    assert grown.draws_compared == 430
    counted.clear()
    assert pfdist.run(larger, grown.path, figures=False).as_json() == grown.as_json()
    assert counted == []


def test_trajectories_committed_out_of_order_are_completed(
    small_job: Job,
    finished: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
    assert again.table("trajectories")["draw"].nunique() == 100
    assert hashes(again.path) == hashes(finished())


def test_a_wish_for_too_many_draws_can_be_taken_back(small_job: Job, small_run: pfdist.Run) -> None:
    wish = small_job.with_changes(["comparison.draws=90000000"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Evaluator, "filtered", lambda self, work: 1 / 0)
        with pytest.raises(TaskError, match="ZeroDivisionError"):
            pfdist.run(wish, small_run.path, figures=False)
    again = pfdist.run(small_job, small_run.path, figures=False)
    assert again.state == "finished"
    assert again.draws_compared == 250


# --- What it refuses ----------------------------------------------------------------------------


@in_turn(
    ("changes", "words"),
    [
        (["search.genetic.generations=5"], "now: search.genetic.generations: 4 -> 5$"),
        (["model.parameters.process_sd=2.0"], "parameters.process_sd: nothing -> 2.0$"),
        ([f"search=[{RANDOM}, {GENETIC}]"], r"now: search.order: genetic, random -> random, gen"),
        (["comparison.draws=100"], "^comparison.draws must be at least the 250 .*, got 100"),
        (['search=[{method="survivors"}]'], r"now: ([^;]+ -> [^;]+; ){8}and \d+ more$"),
    ],
)
def test_another_job_than_the_folders_is_refused_with_the_difference(
    changes: list[str], words: str, small_job: Job, small_run: pfdist.Run
) -> None:
    with pytest.raises(PfdistError, match=words):
        pfdist.run(small_job.with_changes(changes), small_run.path, figures=False)


def test_a_folder_with_other_things_or_tables_of_nobody_is_left_alone(
    small_job: Job, small_run: pfdist.Run
) -> None:
    (small_run.path / "run.json").unlink()
    (small_run.path / "files.json").unlink()
    for folder, what in ((small_run.path, "model.json"), (small_job.path.parent, "small.toml")):
        with pytest.raises(
            PfdistError, match=f"must be a new folder, .* or a run's, .*{what}.* in"
        ):
            pfdist.run(small_job, folder, figures=False)


def test_the_serial_pool_has_one_worker(small_job: Job, tmp_path: Path) -> None:
    words = "in this process, takes no workers, got 4; pools that do: 'ray', 'processes', 'threads'"
    with pytest.raises(PfdistError, match=words):
        pfdist.run(small_job, tmp_path / "run", workers=4, figures=False)


# --- What is seen meanwhile, and what is left ---------------------------------------------------


def test_progress_counts_all_work_once(small_job: Job, tmp_path: Path) -> None:
    seen: list[Any] = []
    pfdist.run(small_job, tmp_path / "run", progress=seen.append, figures=False)
    done = [state.done for state in seen]
    assert done == sorted(done)
    assert seen[-1].done == seen[-1].total == ((6 * 4 + 10) * 30 + 250 * 3) * A_DRAW
    assert {state.phase for state in seen} == {"genetic", "random", "comparison"}


@pytest.mark.plugins("why")
def test_between_search_and_comparison_the_found_times_are_told(
    small_job: Job, tmp_path: Path, said: Callable[..., str]
) -> None:
    def stop(progress: Progress) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(small_job, tmp_path / "run", progress=stop, figures=False)
    run = pfdist.open_run(tmp_path / "run")
    assert (run.state, run.draws_compared) == ("comparing", 0)
    results = results_of(run)
    assert set(results) == {"regular", "genetic", "random"}
    assert len(results["genetic"].measurement_times) == 4
    assert results["genetic"].expected_mse is None
    text = said("status", tmp_path / "run")
    assert "genetic plan: measure at t = " in text
    assert "The search estimated an error of" in " ".join(text.split())
    assert f"tables: {tmp_path / 'run' / 'tables'}" in text
    assert "figures" not in text  # there is no such folder yet
    with pytest.raises(PfdistError, match=r"run is not finished \(comparing\): resume it fi"):
        pfdist.why(tmp_path / "run" / "job.toml", figures=False)


@pytest.mark.plugins("rule", "why")
def test_a_question_about_an_unfinished_plan_names_the_command_that_resumes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(progress: Progress) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    problem = '[model]\nname = "random_walk"\n[problem]\nhorizon = 6\nmeasurement_budget = 2\n'
    Path("walk.toml").write_text(f'seed = 1\n{problem}[filter]\nengine = "kalman"\n')
    with pytest.raises(KeyboardInterrupt):
        pfdist.plan("walk.toml", progress=stop, pool="serial", figures=False, bound_draws=0)
    with pytest.raises(PfdistError, match=r"resume it first, `pfdist plan walk\.toml`"):
        pfdist.rule("walk.toml")


@pytest.mark.usefixtures("undrawn")
def test_a_finished_run_of_the_papers_job_holds_fewer_than_60_files(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def parts(job: Job) -> dict[str, list[int]]:
        """How many files the rows of a job's large tables are cut into."""
        rows = [
            search.optimiser.evaluations * job.evaluation.draws for search in build(job).searches
        ]
        cut = parquet.ROWS_IN_A_FILE
        return {
            "draws": [math.ceil(count / cut["draws"]) for count in rows],
            "comparison": [math.ceil(job.comparison.draws / cut["comparison"])],
        }

    paper = parts(load_job(ROOT / "jobs" / "paper.toml"))
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "draws", 400)
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "comparison", 100)
    job = small_job.with_changes(["search.random.evaluations=24"])
    run = pfdist.run(job, tmp_path / "run")
    assert [len(small_job.search), sum(paper["comparison"])] == [2, 2]
    for table, files in parts(job).items():
        assert len(list((run.path / "tables" / table).iterdir())) == sum(files)
        assert files >= paper[table]
    # tables, figures and what the run is: all there is
    files = [path for path in run.path.rglob("*") if path.is_file()]
    drawn = [path for path in files if path.suffix == ".svg"]
    assert len(drawn) > 3
    assert len(files) < 60
