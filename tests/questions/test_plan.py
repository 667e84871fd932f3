"""`pfdist plan`: one search in the place of a job's own, with all that `run` allows."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.systems import one_state
from pfdist import Job
from pfdist.errors import JobError
from pfdist.questions.run_page import page_of

EXACT = ["model.name=random_walk", "filter.engine=kalman"]


@pytest.fixture
def unnamed(small_job: Job) -> Path:
    """A job that names no search."""
    text = small_job.path.read_text()
    head, _, rest = text.partition("[[search]]")
    path = small_job.path.with_name("unnamed.toml")
    path.write_text(head + rest[rest.index("[comparison]") :])
    return path


def test_it_is_the_run_of_a_job_without_searches_and_its_bound_that_of_the_command_bound(
    unnamed: Path, tmp_path: Path
) -> None:
    run, plan = tmp_path / "run", tmp_path / "plan"
    pfdist.run(unnamed, run, changes=EXACT, figures=False)
    pfdist.plan(unnamed, plan, changes=EXACT, bound_draws=0, figures=False)
    without = hashes(run)
    assert hashes(plan) == without
    pfdist.bound(run / "job.toml", pool="serial", figures=False)
    pfdist.plan(unnamed, plan, changes=EXACT, figures=False)
    planned = {file: each for file, each in hashes(plan).items() if "evenly_spaced" not in file}
    assert planned == hashes(run) != without


def test_another_method_may_search_and_the_jobs_own_are_left_aside(
    small_job: Job, tmp_path: Path
) -> None:
    method, changes = "exchange", [*EXACT, "comparison.draws=2"]
    run = pfdist.plan(
        small_job, tmp_path / "run", method, changes=changes, figures=False, bound_draws=0
    )
    assert run.names == ["regular", method]
    phases = set(run.table("evaluations")["phase"])
    assert method in phases <= {method, f"{method}.polish", f"{method}.shortlist"}


def test_its_own_folder_unless_the_job_is_the_same(
    small_job: Job, unnamed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    changes = [*EXACT, "comparison.draws=2"]
    job = pfdist.load_job(unnamed).with_changes(changes)
    quiet = {"figures": False, "bound_draws": 0}
    own, other = (Path(f"results/{name}").absolute() for name in ("unnamed", "small-plan"))
    assert pfdist.plan(unnamed, changes=changes, **quiet).path == own
    assert pfdist.plan(job, **quiet).path == own
    assert pfdist.plan(small_job, changes=changes, **quiet).path == other


@pytest.mark.usefixtures("no_figures")
def test_the_command_takes_what_run_takes_and_answers_in_the_same_json(
    small_job: Job, tmp_path: Path, said: Callable[..., str]
) -> None:
    job = shlex.quote(str(small_job.path))
    a, b = (shlex.quote(str(path)) for path in (tmp_path / "a", tmp_path / "b"))
    changes = f"{' '.join(EXACT)} comparison.draws=3 search.relaxation.paths=3"
    command = f"plan {job} --pool serial --json --bound-draws 0 --no-report --set {changes}"
    answer = json.loads(said(*shlex.split(f"{command} --results {a}")))
    assert answer == json.loads(said("status", tmp_path / "a", "--json"))
    assert pfdist.open_run(tmp_path / "a").job["search"][0]["paths"] == 3
    assert (
        json.loads(said(*shlex.split(f"{command} comparison.draws=4 --results {b} --reuse {a}")))[
            "draws_compared"
        ]
        == 4
    )


def test_a_job_has_only_the_search_that_it_is_planned_with(small_job: Job, tmp_path: Path) -> None:
    words = "no search 'random', allowed: genetic"
    with pytest.raises(JobError, match=words):
        pfdist.plan(small_job, tmp_path / "no", "genetic", ["search.random.evaluations=3"])


def test_few_particles_find_the_optimum_where_the_likelihood_has_bounded_support(
    tmp_path: Path,
) -> None:
    """The best t is 3, by brute force: the noise before it is large. Then many draws degenerate.

    If these draws killed a set, or did not count, a search would measure where it is of no use.
    """
    model = one_state(
        "bounded",
        initial=lambda w, p: (0.1 * w[0],),
        transition=lambda x, t, w, p: (x[0] + pfdist.where(t == 2, 1.6, 0.3) * w[0],),
        log_likelihood=lambda y, x, t, p: pfdist.where(abs(y[0] - x[0]) <= 0.5, 0.0, -np.inf),
        measurement_noise=("centred",),
    )
    problem = pfdist.Problem(model, horizon=5, measurement_budget=1, particles=500)
    exact = pfdist.evaluate(problem, {f"t{t}": [t] for t in range(6)}, draws=400, particles=5000)
    best = min(exact, key=lambda name: exact[name].expected_mse)
    changes = ["seed=0", "comparison.draws=400"]
    run = pfdist.plan(problem, tmp_path / "run", bound_draws=0, figures=False, changes=changes)
    assert f"t{run.best.measurement_times[0]}" == best == "t3"
    rows = run.table("evaluations")
    assert rows["degenerate_draws"].any()
    assert np.isfinite(rows["expected_mse"]).all()


def test_a_plan_that_leaves_measurements_over_says_so(tmp_path: Path) -> None:
    """A visit of two instants has room for two of six; an exact number is always used."""
    for visits, said in (({"within": 2, "most": 1}, True), (None, False)):
        problem = pfdist.Problem(
            "random_walk", horizon=9, measurement_budget=6, engine="kalman",
            visits=visits,
        )  # fmt: skip
        folder = tmp_path / str(said)
        pfdist.plan(problem, folder, changes=["comparison.draws=2"], bound_draws=0, figures=False)
        text = str(page_of(pfdist.open_run(folder)))
        assert ("This uses 2 of 6 measurements." in text) is said


@pytest.mark.plugins("why")
@pytest.mark.parametrize("written", ["@last.csv", ["last=@last.csv"], {"last": [2, 5, 6, 11]}])
def test_last_years_times_are_compared_with_the_best_of_as_many(
    unnamed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: Any
) -> None:
    """The job asks for another number; its exact errors are those of `evaluate`."""
    monkeypatch.chdir(tmp_path)
    Path("last.csv").write_text("t,y0\n2,1\n5,2\n6,1\n11,0\n")
    changes = [*EXACT, "problem.measurement_budget=6"]
    run = pfdist.plan(unnamed, changes=changes, bound_draws=0, against=written, figures=False)
    assert run.path == tmp_path / "results" / "unnamed-against"
    assert {len(times) for times in run.sets.values()} == {4}
    sets = {"last": run.sets["last"], "plan": run.best.measurement_times}
    errors = pfdist.evaluate(pfdist.load_job(unnamed, changes), sets)
    lower = 100 * (1 - errors["plan"].expected_mse / errors["last"].expected_mse)
    said = f"Instead of the set last (4 measurements), the expected MSE is {lower:.2f}"
    assert said in " ".join(str(run).split())
    assert pfdist.why(unnamed, changes=changes, figures=False).run == run.path


def test_a_wrong_set_to_plan_against_names_the_option(
    unnamed: Path, call: Callable[..., Any]
) -> None:
    for written, words in (
        ("3,99", "measurement_times must lie in 0..12, got 99"),
        ("=3", "a name"),
    ):
        code, _, error = call("plan", str(unnamed), "--against", written)
        assert code == 1
        assert error.startswith("pfdist: --against: ")
        assert words in error
    for none in ([], {}, {"last": []}):
        with pytest.raises(JobError, match="against must name at least one time, as last=0,6,12"):
            pfdist.plan(unnamed, against=none)
