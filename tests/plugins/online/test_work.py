"""Times that are chosen one after another: their table, their draws, and what they are worth."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import pfdist
from oracles.bytes_of import hashes
from oracles.listed import forget
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.common.streams import stream_of
from pfdist.errors import JobError
from pfdist.filters.work import Estimation, FilterWork
from pfdist.plugins.online.draws import online_draws
from pfdist.results import Run
from pfdist.runner.build import build
from pfdist.runner.pace import Pace

ASSETS = Path(__file__).parents[2] / "assets"
HORIZON, PARTICLES = 12, 50
JOB = f"""
seed = 1
[problem]
horizon = {HORIZON}
measurement_budget = 4
[filter]
particles = {PARTICLES}
[[search]]
method = "survivors"
polish = false
evaluation.draws = 40
[comparison]
draws = 30
[online]
draws = 6
judging_draws = 40
search.method = "corridor"
search.rounds = 1
search.evaluation.draws = 20
search.evaluation.particles = 20
[execution]
pool = "serial"
"""
PRICES = f"problem={{horizon={HORIZON}, total_price=7, price={[1, 2] * 6 + [1]}}}"
CONSTRAINTS = {
    "times": ["problem.minimum_spacing=2", "problem.forbidden=[3, 7]", "problem.required=[0, 12]"],
    "costs": [PRICES],
}


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    path = tmp_path_factory.mktemp("job") / "online.toml"
    path.write_text(JOB)
    return load_job(path)


@pytest.fixture(scope="module")
def run(finished: Callable[..., Path]) -> Run:
    return pfdist.open_run(finished(job=JOB))


@pytest.fixture
def draw_by_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    """A task for each draw."""
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 1)


def _work(times: tuple[int, ...], draw: int) -> FilterWork:
    """The work of the filter with some times, spelt out."""
    return FilterWork(
        measurement_times=(times,),
        ends=(HORIZON,),
        filter_streams=(stream_of("comparison", 1, "filter", "survivors"),),
        draws_stream=stream_of("comparison", 1, "draws"),
        draws=(draw, draw + 1),
        estimation=Estimation(PARTICLES),
    )


def test_a_row_has_the_error_of_the_filter_with_these_times_and_keys(job: Job, run: Run) -> None:
    evaluator, rows = build(job).evaluator, run.table("online")
    assert rows.columns.tolist() == [
        *("draw", "mse", "degenerate", "measurement_times", "estimate")
    ]
    assert rows["draw"].tolist() == list(range(6))
    trajectories = run.table("trajectories").set_index("draw")
    for row in rows.to_dict("records"):
        times = tuple(row["measurement_times"])
        assert evaluator(_work(times, row["draw"])).mse.item() == row["mse"]
        z = trajectories.loc[row["draw"], "z_state"].to_numpy()
        assert np.mean((z - row["estimate"]) ** 2) == pytest.approx(row["mse"], rel=1e-12)


def test_times_depend_on_the_draw_and_the_first_is_that_of_the_plan(run: Run) -> None:
    chosen = [tuple(times) for times in run.table("online")["measurement_times"]]
    plan = run.sets["survivors"]
    assert {times[0] for times in chosen} == {plan[0]}
    assert len(set(chosen)) > 1


@pytest.mark.parametrize("constraint", ["times", pytest.param("costs", marks=pytest.mark.slow)])
def test_the_times_of_each_draw_keep_to_the_constraints(
    constraint: str, job: Job, tmp_path: Path
) -> None:
    """With costs, they spend as much as they may."""
    constrained = job.with_changes([*CONSTRAINTS[constraint], "online.draws=3"])
    rows = pfdist.run(constrained, tmp_path / "run", figures=False).table("online")
    feasible = constrained.problem.feasible
    assert all(feasible.accepts(tuple(times)) for times in rows["measurement_times"])
    if constraint == "costs":
        assert max(feasible.price_of(tuple(times)) for times in rows["measurement_times"]) <= 7


def test_the_plan_is_the_first_search_also_beside_sets_that_the_job_names(
    job: Job, tmp_path: Path
) -> None:
    """Draws that keep the plan keep its error; a set that the job names is no plan."""
    named = job.with_changes(["comparison.sets.mine=[0, 1, 2, 3]"])
    run = pfdist.run(named, tmp_path / "run", figures=False)
    assert {*run.names[:2]} == {"evenly_spaced", "mine"}  # the better one is the reference
    assert run.names[2:] == ["survivors"]
    summary, draws = run.as_json()["online"], online_draws(run)
    assert [summary[key]["name"] for key in ("reference", "plan")] == [run.names[0], "survivors"]
    assert draws.planned_times == run.sets["survivors"] != run.sets["mine"]
    kept = draws.rows[~draws.differ]
    assert 0 < len(kept) < len(draws.rows)
    assert (kept["mse_online"] == kept["mse_survivors"]).all()


@pytest.mark.slow
@pytest.mark.usefixtures("draw_by_draw")
def test_a_run_that_is_stopped_goes_on_with_the_draws_that_it_lacks(
    job: Job, run: Run, tmp_path: Path, stopped: Callable[..., None], handed: list[FilterWork]
) -> None:
    stopped(job, tmp_path / "run", "online", 2)
    part = pfdist.open_run(tmp_path / "run")
    assert (part.state, len(part.table("online"))) == ("comparing", 2)
    assert part.as_json()["online"]["draws"] == 2
    handed.clear()
    assert pfdist.run(job, tmp_path / "run", figures=False).state == "finished"
    computed = [work.draws for work in handed if work.ids == ("online",)]
    assert computed == [(2, 3), (3, 4), (4, 5), (5, 6)]
    assert hashes(tmp_path / "run") == hashes(run.path)


def test_a_table_that_is_lost_is_made_again(job: Job, run: Run, tmp_path: Path) -> None:
    folder = shutil.copytree(run.path, tmp_path / "run")
    forget(folder, "online")
    assert pfdist.open_run(folder).state == "comparing"
    assert pfdist.open_run(folder).as_json()["online"] is None
    pfdist.run(job, folder, figures=False)
    assert hashes(folder) == hashes(run.path)


RARE = """
from dataclasses import replace
import numpy as np
from pfdist import load_model, where
ungm = load_model("ungm")
model = replace(ungm, log_likelihood=lambda y, x, t, p:
    where(y[0] > 14.0, -np.inf, -0.5 * (y[0] - x[0] ** 2 / 20) ** 2))
"""


@pytest.mark.slow
def test_degenerate_draws_count_with_their_errors_and_are_counted(tmp_path: Path) -> None:
    (tmp_path / "rare.py").write_text(RARE)
    (tmp_path / "rare.toml").write_text(JOB)
    changes = ["model.name=rare.py:model", "online.draws=30"]
    run = pfdist.run(tmp_path / "rare.toml", tmp_path / "run", changes=changes, figures=False)
    rows, compared = run.table("online"), run.table("comparison")
    assert rows["degenerate"].any()
    assert not rows["degenerate"].all()
    assert all(len(times) == 4 for times in rows["measurement_times"])
    compared, online = compared[compared["draw"] < 30], run.as_json()["online"]
    either = compared["degenerate_evenly_spaced"] | compared["degenerate_survivors"]
    degenerate = rows["degenerate"].to_numpy() | either.to_numpy()
    assert (online["draws"], online["degenerate_draws"]) == (30, degenerate.sum())
    assert online["expected_mse"] == pytest.approx(rows["mse"].mean())
    assert online["plan"]["expected_mse"] == pytest.approx(compared["mse_survivors"].mean())


def test_the_summary_gives_costs_differences_and_gains_on_the_same_draws(run: Run) -> None:
    online = run.as_json()["online"]
    mse = run.table("online")["mse"].to_numpy()
    for key, name in (("plan", "survivors"), ("reference", "evenly_spaced")):
        told, other = online[key], run.table("comparison")[f"mse_{name}"][:6].to_numpy()
        assert told["name"] == name
        assert told["expected_mse"] == pytest.approx(other.mean())
        assert told["difference"] == pytest.approx(np.mean(mse - other))
        half = stats.sem(mse - other) * stats.t.ppf(0.975, 5)
        low, high = told["difference_low"], told["difference_high"]
        assert (high - low) / 2 == pytest.approx(half)
        assert told["gain_of_means"] == pytest.approx(1 - mse.mean() / other.mean())
        assert told["mean_relative_gain"] == pytest.approx(np.mean(1 - mse / other))
        assert told["positive_fraction"] == pytest.approx(np.mean(mse < other))
    assert online["standard_error"] == pytest.approx(stats.sem(mse))
    plan = run.sets["survivors"]
    differ = [tuple(times) != plan for times in run.table("online")["measurement_times"]]
    assert online["differs_from_plan"] == np.mean(differ)


def test_a_run_without_the_section_has_none() -> None:
    run = pfdist.open_run(ASSETS / "kept")
    assert "online" not in run.tables
    assert run.as_json()["online"] is None


@pytest.mark.usefixtures("no_figures")
def test_the_command_prints_a_block_and_takes_draws(
    job: Job, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["online", str(job.path), "--results", str(tmp_path / "run"), "--draws", "6"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["online"] == run.as_json()["online"]
    assert hashes(tmp_path / "run") == hashes(run.path)
    block = printed[printed.index("Expected MSE on 6 draws") :].splitlines()
    rows = [line.split()[0] for line in block if re.search(r"± \d", line)]
    assert rows == ["online", "plan", "evenly"]
    assert all(len(line) <= 80 for line in block if str(tmp_path) not in line)


def test_a_job_without_the_section_gets_its_defaults_and_a_folder_of_its_own(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "plain.toml"
    head, _, rest = JOB.partition("[online]")
    path.write_text(head + rest[rest.index("[execution]") :])
    run = pfdist.online(path, draws=2, figures=False)
    assert run.path == Path("results/plain-online").absolute()
    assert len(run.table("online")) == 2
    assert run.job["online"]["search"]["method"] == "corridor"
    with pytest.raises(JobError, match=r"comparison\.draws = 30, got 1000"):
        pfdist.online(path, figures=False)
    changes = ["online.draws=2"]
    assert (
        pfdist.online(job, changes=changes, figures=False).path == Path("results/online").absolute()
    )
    given = pfdist.online(load_job(path), changes=changes, figures=False)
    assert given.path == Path("results/plain-online").absolute()
