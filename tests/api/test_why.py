"""Why times are what they are: against the exact recursion, and against filters one by one."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.analysis.sampling_windows import sentences, windows_of
from pfdist.api.why import why
from pfdist.cli.main import main
from pfdist.common.rounding import with_error
from pfdist.common.streams import stream_of
from pfdist.errors import ArgumentError, PfdistError, RunMismatchError, StoreError
from pfdist.evaluation.work import Estimation, Work
from pfdist.filters import kalman
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.runner.build import build
from pfdist.runner.worth import CHANGES
from pfdist.store.repair import verify_run

RANDOM = "search.random.evaluations=3"


@pytest.fixture
def quick(small_job: Job) -> Job:
    return small_job.with_changes([RANDOM, "search.genetic.generations=1", "comparison.draws=20"])


def _walk(job: Job, engine: str) -> Job:
    return job.with_changes(["model.name=random_walk", f"filter.engine={engine}"])


def _by_riccati(times: tuple[int, ...], horizon: int) -> dict[tuple[int, str], float]:
    """Give the rise of the exact expected MSE with every change there is."""
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


@pytest.mark.slow
def test_what_a_measurement_is_worth_is_what_the_riccati_recursion_says(
    quick: Job, tmp_path: Path
) -> None:
    particles = 200
    job = _walk(quick, "compiled").with_changes([f"filter.particles={particles}"])
    run = pfdist.run(job, tmp_path / "run", figures=False)
    found = why(run, draws=3000, figures=False)
    for name, result in run.summary()["results"].items():
        exact = _by_riccati(tuple(result["measurement_times"]), 12)
        rises = _rises(found, name)
        assert rises.keys() == exact.keys()
        for key, (rise, error) in rises.items():
            # beside the draws' error, the filter's of order 1/particles
            assert abs(rise - exact[key]) < 4 * error + 2 * abs(exact[key]) / particles, (name, key)
            assert 0 < error < 0.1 * max(abs(exact[key]), 1.0)


def test_where_everything_is_known_no_draws_are_taken(quick: Job, tmp_path: Path) -> None:
    run = pfdist.run(_walk(quick, "kalman"), tmp_path / "run", figures=False)
    found = why(run, figures=False)
    assert found.draws == 0
    for name, result in run.summary()["results"].items():
        exact = _by_riccati(tuple(result["measurement_times"]), 12)
        for key, (rise, error) in _rises(found, name).items():
            assert (rise, error) == (pytest.approx(exact[key]), 0.0)
    means = found.profile.groupby("name")["error"].mean()
    np.testing.assert_allclose(means[found.sets["name"]], found.sets["expected_mse"])


def test_a_measurement_is_moved_only_to_where_the_job_allows_it(quick: Job, tmp_path: Path) -> None:
    bound = ["problem.forbidden=[7, 9]", "problem.required=[4]", "problem.minimum_spacing=3"]
    job = _walk(quick, "kalman").with_changes(bound)
    run = pfdist.run(job, tmp_path / "run", figures=False)
    found, allowed = why(run, figures=False), set(job.problem.feasible.every())
    for name, result in run.summary()["results"].items():
        times = set(result["measurement_times"])
        moves = {(t, "earlier"): t - 1 for t in times} | {(t, "later"): t + 1 for t in times}
        possible = {
            key for key, to in moves.items() if tuple(sorted(times - {key[0]} | {to})) in allowed
        }
        assert 0 < len(possible) < len(moves)
        assert _rises(found, name).keys() == possible | {(t, "removed") for t in times}


@pytest.mark.parametrize("estimator", ESTIMATORS)  # of the searches: nothing to the profile
def test_the_profile_is_the_squared_error_over_time_and_its_mean_the_expected_mse(
    quick: Job, tmp_path: Path, estimator: str
) -> None:
    quick = quick.with_changes([f"evaluation.estimator={estimator}"])
    run, draws = pfdist.run(quick, tmp_path / "run", figures=False), 60
    found, built = why(run, draws, figures=False), build(quick)
    for row in found.sets.to_dict("records"):
        alone = Work(
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


@pytest.mark.slow
def test_the_command_answers_in_json_draws_a_figure_a_search_and_leaves_the_run_as_it_was(
    quick: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = pfdist.run(quick, tmp_path / "run", figures=False)
    before = hashes(run.path)
    assert main(["why", str(run.path / "job.toml"), "--draws", "30", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert set(answer) == {"run", "draws", "sets", "figures"}
    assert answer["draws"] == 30
    assert list(answer["sets"]) == ["regular", "genetic", "random"]
    regular = answer["sets"]["regular"]
    assert [row["t"] for row in regular["worth"]] == [0, 4, 8, 12]
    assert regular["worth"][0]["earlier"] is None
    assert [row["t"] for row in regular["profile"] if row["measured"]] == [0, 4, 8, 12]
    windows, jitter = regular["sampling_windows"], regular["jitter"]
    assert {row["t"] for row in windows} == {0, 4, 8, 12}
    assert [row["loss"] for row in windows if row["moved_to"] == row["t"]] == [0.0] * 4
    assert [row["percent"] for row in jitter] == [1, 5]
    assert all(row["low"] <= row["loss"] <= row["high"] for row in jitter)
    names = [
        f"{name}.{kind}"
        for name in (
            "why-genetic",
            "why-random",
            "sampling_windows-genetic",
            "sampling_windows-random",
            "filters",
        )
        for kind in ("png", "svg")
    ]
    assert [Path(file).name for file in answer["figures"]] == names
    assert all(Path(file).stat().st_size > 5000 for file in answer["figures"])
    after = {
        file: content
        for file, content in hashes(run.path).items()
        if not re.search("why|windows|filters", file)
    }
    assert after == before
    assert run.state == "finished"
    assert run.profile()["error"].tolist()[:13] == [row["error"] for row in regular["profile"]]
    assert run.worth()["removed"].tolist()[:4] == [row["removed"] for row in regular["worth"]]
    stored = run.sampling_windows()
    assert stored["loss"].tolist()[: len(windows)] == [row["loss"] for row in windows]
    assert run.jitter()["loss"].tolist()[:2] == [row["loss"] for row in jitter]
    assert not list(verify_run(run.path))
    again = hashes(run.path)
    assert main(["why", str(run.path / "job.toml"), "--draws", "30"]) == 0
    assert hashes(run.path) == again
    text = capsys.readouterr().out
    assert (
        f"regular: expected MSE {with_error(regular['expected_mse'], regular['standard_error'])} "
        in text
    )
    worth = regular["worth"][1]
    assert with_error(worth["removed"], worth["removed_error"], sign=True) in text
    strict, wide = (windows_of(windows, percent)[1].text for percent in (1, 5))
    assert f"  t = 4: 1 %: {strict}; 5 %: {wide}\n" in text
    unwrapped = " ".join(text.split())
    assert all(said in unwrapped for said in sentences(windows, jitter, is_found=False))
    assert all(len(line) <= 80 for line in text.splitlines() if str(run.path) not in line)


def test_the_effective_sample_size_is_that_of_the_draws_with_trajectories(
    quick: Job, tmp_path: Path
) -> None:
    run = pfdist.run(_walk(quick, "compiled"), tmp_path / "run", figures=False)
    profile = why(run, draws=2, figures=False).profile
    at = profile["effective_sample_size"]
    assert at.notna().tolist() == profile["measured"].tolist()
    assert at[profile["measured"]].between(1, quick.filter.particles).all()
    again = why(run, draws=2, figures=False).profile  # from the same noise
    assert again.equals(profile)


@pytest.mark.slow
def test_degenerate_draws_are_counted_up_to_each_instant(quick: Job, tmp_path: Path) -> None:
    (quick.path.parent / "cut.py").write_text(
        "from dataclasses import replace\n"
        "import numpy as np\n"
        "from pfdist import load_model, where\n"
        "walk = load_model('random_walk')\n"
        "model = replace(walk, log_likelihood=lambda y, x, t, p:\n"
        "    where(abs(y[0] - x[0]) > 3.5, -np.inf, -0.5 * (y[0] - x[0]) ** 2))\n"
    )
    changes = ["model.name=random_walk", "model.filter.name=cut.py:model", "filter.particles=5"]
    job = quick.with_changes([*changes, "evaluation.degenerate_draws=leave_out"])
    run = pfdist.run(job, tmp_path / "run", figures=False)
    found = why(run, draws=50, figures=False)
    known = found.sets.set_index("name")["degenerate_draws"]
    for name, rows in found.profile.groupby("name"):
        counts = rows["degenerate_draws"].to_numpy()
        assert np.all(np.diff(counts) >= 0), name
        assert 0 < counts[-1] == known[name]


@pytest.mark.slow
def test_the_model_file_of_a_kept_job_is_found_from_anywhere_and_must_mean_the_same(
    quick: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = quick.path.parent / "mine.py"
    file.write_text("from pfdist.models.ungm import model\n")
    monkeypatch.chdir(tmp_path)
    run = pfdist.run(
        quick.with_changes(["model.name=mine.py:model"]), tmp_path / "run", figures=False
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    said: list[str] = []
    kept = run.path / "job.toml"
    why(kept, draws=2, say=said.append, figures=False)
    assert said == [f"runs the model file {file}, which your job names"]
    file.write_text('"""Another word."""\nfrom pfdist.models.ungm import model\n# another\n')
    why(kept, draws=2, figures=False)
    file.write_text("from pfdist.models.ungm_gordon import model\n")
    words = r"model\.formulas: \w{8} -> \w{8}.*model\.parameters\.initial_sd: 5\.0 -> 1\.41"
    with pytest.raises(RunMismatchError, match=words):
        why(kept, draws=2, figures=False)


def test_what_is_impossible_is_said(quick: Job, tmp_path: Path) -> None:
    def stop(progress: Any) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(quick, tmp_path / "run", progress=stop, figures=False)
    wrong: list[tuple[type[PfdistError], str, Path, int]] = [
        (
            StoreError,
            r"run is not finished \(comparing\): run its job on first",
            tmp_path / "run",
            2,
        ),
        (StoreError, "there is no run of this job in .*nowhere: ", tmp_path / "nowhere", 2),
        (ArgumentError, r"draws must be at least 2, got 1$", tmp_path / "run", 1),
    ]
    for error, words, path, draws in wrong:
        with pytest.raises(error, match=words):
            why(quick, draws, results=path, figures=False)
