"""Work is counted by what it is for, once, and foreseen before it is done."""

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.unknown import level_and_slope
from pfdist import Job
from pfdist.cli.main import main
from pfdist.filters import variants
from pfdist.filters.evaluator import Evaluator
from pfdist.questions.foreseen import foreseen_work
from pfdist.questions.run_of_job import searched_by
from pfdist.results.stored_run import steps_by_part
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import build
from pfdist.runner.driver import core_steps, foreseen_by_part, prover_of
from pfdist.runner.likelihood import VALUES
from pfdist.runner.parts import PARTS


def test_the_steps_of_all_tasks_are_counted_and_a_resumed_run_adds_what_it_computes(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps, results = list[int](), variants.results

    def counting(evaluator: Evaluator, works: Any) -> Any:
        steps.extend(work.steps for work in works)
        return results(evaluator, works)

    monkeypatch.setattr(variants, "results", counting)
    small_job = small_job.with_changes(["problem.horizon=8"])
    run = pfdist.run(small_job, tmp_path / "run", bound_draws=480, figures=False)
    before = steps_by_part(run)
    assert (
        sum(before.values()) == sum(steps) + VALUES
    )  # of formulas, in the check of the likelihood
    assert before.keys() <= PARTS.keys()
    assert before["comparison"] == 3 * 250 * 9 * 40  # sets, draws, instants, particles
    assert 0 < before["other estimate"] <= before["comparison"]
    more = small_job.with_changes(["comparison.draws=300"])
    after = steps_by_part(pfdist.run(more, tmp_path / "run", figures=False))
    assert after["comparison"] == 3 * 300 * 9 * 40
    assert after["search"] == before["search"]
    assert sum(after.values()) == sum(steps) + VALUES


@pytest.mark.plugins("moving")
def test_steps_of_moved_particles_are_those_that_filters_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever was foreseen, and however draws were cut; the controls are plain filters."""
    problem = pfdist.Problem(
        level_and_slope(0.1, 0.05), horizon=8, measurement_budget=2, proposal="moving",
        moved_particles=20,
    )  # fmt: skip
    counted, done, filtered = list[float](), set[int](), Evaluator.filtered

    def counting(evaluator: Evaluator, work: Any) -> Any:
        result = filtered(evaluator, work)
        counted.extend(result.work.tolist() if work.controlled else ())
        return result

    monkeypatch.setattr(Evaluator, "filtered", counting)
    for guess in (5.0, 50.0):
        monkeypatch.setattr("pfdist.runner.build.steps_a_particle", lambda *_, own=guess: own)
        counted.clear()
        run = pfdist.compare(
            problem, times={"one": [2, 6], "two": [3, 8]}, draws=200, pool="serial",
            results=tmp_path / f"{guess:g}", figures=False,
        )  # fmt: skip
        controls = 2 * 200 * 9 * 100  # sets, draws, instants, particles
        moved = steps_by_part(run)["comparison"] - controls
        assert moved == sum(counted)
        done.add(moved)
    assert len(done) == 1
    assert done.pop() > 2 * 200 * 9 * 20


def test_an_exact_engine_counts_instants_of_sets(
    finished: Callable[..., Path],
) -> None:
    changes = ["model.name=linear_gaussian", "filter.engine=kalman", "filter.proposal=auto"]
    done = steps_by_part(pfdist.open_run(finished(*changes)))
    # each set on each draw, whose errors are shown, and its exact error
    assert done["comparison"] == 3 * (250 + 1) * 13
    assert done["search"] % 13 == 0
    assert done["other estimate"] == 3 * 13


@pytest.mark.plugins("rule")
@pytest.mark.parametrize("search", [True, False])
def test_the_other_estimate_takes_at_most_a_tenth_and_checks_and_a_rule_a_twentieth(
    search: bool, small_job: Job
) -> None:
    alone = {"search": [], "comparison": {"draws": 250, "sets": {"a": (0, 5), "b": (3, 8)}}}
    for horizon in (8, 100):
        changes = [f"problem.horizon={horizon}", f"comparison.draws={200 * horizon}"]
        job = small_job.with_changes(changes, sections=searched_by("genetic") if search else alone)
        built = build(job, Path("none"))
        prover = prover_of(built, BoundSettings(draws=480))
        foreseen = foreseen_by_part(built, prover)
        assert 0 < foreseen["other estimate"] <= 0.1 * core_steps(built)
        assert 0 < foreseen["likelihood"] - VALUES <= 0.05 * foreseen["proof"]
        assert foreseen.get("rule", 0) <= 0.05 * core_steps(built, prover)
        assert search == ("rule" in foreseen)


def test_a_plan_is_foreseen_about_as_it_is_done(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = ["problem.horizon=8", "filter.particles=20"]
    words = ["plan", str(small_job.path), *(f"--set={each}" for each in few)]
    assert main([*words, "--dry-run"]) == 0
    text = capsys.readouterr().out
    whole = foreseen_work(small_job.path, "relaxation", few, None)
    rows = whole.work
    foreseen = dict(zip(rows["part"], rows["steps"], strict=True))
    shown = dict(re.findall(r"^(.*?)  +(\S+e\+\d+|\d+) ", text, re.MULTILINE))
    assert shown.pop("all") == f"{sum(foreseen.values()):.3g}"
    assert shown == {PARTS[part]: f"{steps:.3g}" for part, steps in foreseen.items()}
    assert (rows["minutes"] > 0).all()
    run = tmp_path / "run"
    assert main([*words, "--results", str(run), "--no-report", "--pool", "serial"]) == 0
    capsys.readouterr()
    done = Counter(steps_by_part(pfdist.open_run(run)))
    for part in ("comparison", "other estimate"):
        assert done[part] == foreseen[part]
    for part in ("search", "proof", "likelihood", "statistics"):
        assert foreseen[part] / 4 < done[part] < 2 * foreseen[part], part
    assert 0 < done["scan"] <= foreseen["scan"]
    size = sum(file.stat().st_size for file in run.rglob("*") if file.is_file())
    pictures = 0.7e6  # which --no-report leaves out
    assert whole.bytes / 2 < size + pictures < 2 * whole.bytes
    assert main(["status", str(run)]) == 0
    assert f"particle-steps: {done.total():.3g} (" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "particles"),
    [
        ("random_walk", 50),
        pytest.param("lorenz63", 50, marks=pytest.mark.slow),
        pytest.param("pharmacokinetics", 50, marks=pytest.mark.slow),
        pytest.param("plan", 30, marks=pytest.mark.slow),
    ],
)
def test_a_search_is_foreseen_within_a_factor_of_two_and_shares_are_parts_of_less(
    name: str, particles: int, tmp_path: Path
) -> None:
    """Two and a half to four times as much is done as the number of which answers have shares."""
    file = Path(__file__).parents[2] / "jobs" / f"{name}.toml"
    changes = [f"filter.particles={particles}", "comparison.draws=200"]
    job = pfdist.load_job(file).with_changes(changes, sections=searched_by("relaxation"))
    built = build(job, Path("none"))
    usual = foreseen_by_part(built)["search"]
    done = steps_by_part(pfdist.run(job, tmp_path / "run", figures=False))["search"]
    assert usual / 2 < done < 2 * usual
    assert core_steps(built) < done


def test_a_proof_that_a_plan_leaves_to_a_question_of_its_own_is_not_foreseen(
    small_job: Job,
) -> None:
    """Five minutes of a core are the most that a proof takes where nobody asked for it alone."""
    many = ["filter.particles=500", "comparison.draws=8000", "problem.measurement_budget=10"]
    for horizon, is_foreseen in ((20, True), (200, False)):
        changes = [f"problem.horizon={horizon}", *many]
        rows = foreseen_work(small_job.path, "relaxation", changes, None).work
        assert ("proof" in set(rows["part"])) is is_foreseen
