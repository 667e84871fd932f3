"""Why times are what they are: against the exact recursion, and against filters one by one."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.results_of import results_of
from pfdist import Job, Run
from pfdist.cli.main import main
from pfdist.common.rounding import with_error
from pfdist.common.streams import stream_of
from pfdist.filters import kalman
from pfdist.filters.work import Estimation, FilterWork
from pfdist.plugins.why.measured_worth import CHANGES
from pfdist.plugins.why.question import Why
from pfdist.problem.clock import Clock
from pfdist.results.sampling_windows import windows_of
from pfdist.runner.build import build
from pfdist.store.verify import verify_run

QUICK = [
    "search.random.evaluations=3",
    "search.genetic.generations=1",
    "comparison.draws=20",
]
WALK = [*QUICK, "model.name=random_walk"]
KALMAN = [*WALK, "filter.engine=kalman"]


@pytest.fixture
def run_of(finished: Callable[..., Path], tmp_path: Path) -> Callable[..., Run]:
    """A function that gives a finished run of the small job with changes."""
    return lambda *changes: pfdist.open_run(shutil.copytree(finished(*changes), tmp_path / "run"))


def why(run: Run, draws: int = 1000) -> Why:
    return pfdist.why(run.path / "job.toml", draws, figures=False)


def _by_riccati(times: tuple[int, ...], horizon: int) -> dict[tuple[int, str], float]:
    """The rise of the exact expected MSE with every change there is."""
    others: dict[tuple[int, str], set[int]] = {}
    for t in times:
        rest = set(times) - {t}
        others[t, "removed"] = rest
        others[t, "earlier"], others[t, "later"] = rest | {t - 1}, rest | {t + 1}
    possible = {
        key: tuple(sorted(other))
        for key, other in others.items()
        if key[1] == "removed"
        or (len(other) == len(times) and 0 <= min(other) <= max(other) <= horizon)
    }
    model = pfdist.load_model("random_walk")
    whole, *changed = kalman.expected_mse(model, horizon, [times, *possible.values()])
    return {key: mse - whole for key, mse in zip(possible, changed, strict=True)}


def _rises(found: Any, name: str) -> dict[tuple[int, str], tuple[float, float]]:
    rows = found.worth[found.worth["name"] == name]
    return {
        (row["t"], change): (row[change], row[f"{change}_error"])
        for row in rows.to_dict("records")
        for change in CHANGES
        if not np.isnan(row[change])
    }


def test_where_everything_is_known_no_draws_are_taken(run_of: Callable[..., Run]) -> None:
    run = run_of(*KALMAN)
    found = why(run)
    assert found.draws == 0
    for name, result in results_of(run).items():
        exact = _by_riccati(tuple(result.measurement_times), 12)
        for key, (rise, error) in _rises(found, name).items():
            assert (rise, error) == (pytest.approx(exact[key]), 0.0)
    means = found.profile.groupby("name")["error"].mean()
    np.testing.assert_allclose(means[found.sets["name"]], found.sets["expected_mse"])


def test_a_measurement_is_moved_only_to_where_the_job_allows_it(
    run_of: Callable[..., Run], small_job: Job
) -> None:
    bound = ["problem.forbidden=[7, 9]", "problem.required=[4]", "problem.minimum_spacing=3"]
    allowed = set(small_job.with_changes(bound).problem.feasible.every())
    run = run_of(*KALMAN, *bound)
    found = why(run)
    for name, result in results_of(run).items():
        times = set(result.measurement_times)
        moves = {(t, "earlier"): t - 1 for t in times} | {(t, "later"): t + 1 for t in times}
        possible = {
            key for key, to in moves.items() if tuple(sorted(times - {key[0]} | {to})) in allowed
        }
        assert 0 < len(possible) < len(moves)
        assert _rises(found, name).keys() == possible | {(t, "removed") for t in times}


def test_the_profile_is_the_squared_error_over_time_and_its_mean_the_expected_mse(
    run_of: Callable[..., Run], small_job: Job
) -> None:
    changes, draws = [*QUICK, "comparison.control=false"], 60
    quick = small_job.with_changes(changes)
    found, built = why(run_of(*changes), draws), build(quick)
    for row in found.sets.to_dict("records"):
        alone = FilterWork(
            measurement_times=(tuple(row["measurement_times"]),),
            ends=(12,),
            filter_streams=(stream_of("why", quick.seed, "filter", row["name"]),),
            draws_stream=stream_of("why", quick.seed, "draws"),
            draws=(0, draws),
            estimation=Estimation(quick.filter.particles, quick.filter.resampling),
            trajectories=True,
        )
        result = built.evaluator(alone)
        error = (result.z - result.estimates[0])[:, :, 0] ** 2
        profile = found.profile[found.profile["name"] == row["name"]]
        np.testing.assert_allclose(profile["error"], error.mean(axis=0))
        standard_error = error.std(axis=0, ddof=1) / np.sqrt(draws)
        np.testing.assert_allclose(profile["standard_error"], standard_error)
        assert profile["error"].mean() == pytest.approx(row["expected_mse"])
        assert profile["t"][profile["measured"]].tolist() == row["measurement_times"]


@pytest.mark.usefixtures("no_figures")
def test_the_command_answers_in_json_and_words_and_leaves_the_run_as_it_was(
    run_of: Callable[..., Run], capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_of(*QUICK)
    before, words = hashes(run.path), ["why", str(run.path / "job.toml"), "--draws", "30"]
    assert main([*words, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer) == {"run", "draws", "sets", "figures"}
    assert answer["draws"] == 30
    assert list(answer["sets"]) == ["regular", "genetic", "random"]
    regular = answer["sets"]["regular"]
    windows = regular["sampling_windows"]
    assert [row["t"] for row in regular["profile"] if row["measured"]] == [0, 4, 8, 12]
    assert [row["loss"] for row in windows if row["moved_to"] == row["t"]] == [0.0] * 4
    after = {
        file: content
        for file, content in hashes(run.path).items()
        if not re.search("why|windows|system", file)
    }
    assert after == before
    assert run.state == "finished"
    for table, column in (("profile", "error"), ("worth", "removed"), ("sampling_windows", "loss")):
        rows = regular[table]
        assert run.table(table)[column].tolist()[: len(rows)] == [row[column] for row in rows]
    assert not list(verify_run(run.path))
    again = hashes(run.path)
    assert main([*words, "--verbose"]) == 0
    assert hashes(run.path) == again
    text = " ".join(capsys.readouterr().out.split())
    best = min(("genetic", "random"), key=lambda name: results_of(run)[name].expected_mse)
    rises = {row["t"]: row["removed"] for row in answer["sets"][best]["worth"]}
    most, least = (each(rises, key=lambda t: rises[t]) for each in (max, min))
    assert text.startswith(f"Most important measurement of the {best} plan: t = {most} (")
    assert f" Least important: t = {least} (" in text
    assert re.findall(r"Measurements of (.*?), on 30 fresh draws", text)[0] == f"the {best} plan"
    assert text.count("Measurements of ") == 3
    worth, mse = regular["worth"][1], regular["expected_mse"]
    rise, error = (100 * worth[part] / mse for part in ("removed", "removed_error"))
    assert f" 4 {with_error(rise, error)} " in text
    for percent in (1, 5):  # cells are cut into lines
        window = windows_of(windows, percent, Clock.counting(12))[1].text
        assert window.partition(" (")[0] in text


def test_the_effective_sample_size_is_that_of_the_draws_with_trajectories(
    run_of: Callable[..., Run], small_job: Job
) -> None:
    run = run_of(*WALK)
    profile = why(run, draws=2).profile
    at = profile["effective_sample_size"]
    assert at.notna().tolist() == profile["measured"].tolist()
    assert at[profile["measured"]].between(1, small_job.filter.particles).all()
    assert why(run, draws=2).profile.equals(profile)  # from the same noise


def test_a_lost_answer_is_computed_when_it_is_asked_for(
    run_of: Callable[..., Run],
) -> None:
    run = run_of(*KALMAN)
    why(run)
    (worth,) = (run.path / "tables" / "worth").iterdir()
    (ranks, *_) = (run.path / "tables" / "comparison").iterdir()
    for file in (worth, ranks):
        file.unlink()
    again = pfdist.run(run.path / "job.toml", figures=False)
    assert again.state == "finished"
    assert "worth" not in again.tables
    assert not list(verify_run(run.path))
    why(again)
    assert [worth] == list((run.path / "tables" / "worth").iterdir())
    assert not list(verify_run(run.path))
