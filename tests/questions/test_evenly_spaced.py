"""How many evenly spaced measurements do as well as the plan, against every number."""

from pathlib import Path

import numpy as np
import pytest

import pfdist
from pfdist import Job
from pfdist.common.estimate import CLEAR_ERRORS
from pfdist.questions.run_page import answer_in_a_line
from pfdist.results.columns import Row, rows_of
from pfdist.results.moments import controlled_mse

EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=2"]
DRAWS = "comparison.draws=300"
SHORT = ["model.name=random_walk", "problem.horizon=8"]


def _plan(run: pfdist.Run) -> Row:
    return next(row for row in rows_of(run.table("sets")) if row.label == "plan")


def _on_its_own(job: Job, number: int) -> tuple[int, ...]:
    return job.feasible(number).regular()


def test_exact_errors_lie_between_those_of_two_numbers(small_job: Job, tmp_path: Path) -> None:
    run = pfdist.plan(small_job, tmp_path / "run", changes=EXACT, figures=False)
    job, plan = pfdist.load_job(run.path), _plan(run)
    error = {
        number: pfdist.evaluate(job, _on_its_own(job, number)).expected_mse
        for number in range(1, job.problem.feasible.horizon + 2)
    }
    assert plan.evenly_spaced_between
    worse, better = plan.evenly_spaced
    assert better == worse + 1
    assert error[worse] > plan.expected_mse > error[better]
    said = f"{worse} evenly spaced measurements do worse, and {better} do better (exact)."
    assert said in answer_in_a_line(run)


def test_differences_are_those_of_the_same_draws(small_job: Job, tmp_path: Path) -> None:
    run = pfdist.plan(small_job, tmp_path / "run", changes=[DRAWS], figures=False)
    job, table = pfdist.load_job(run.path), run.table("evenly_spaced").set_index("measurements")
    plan = run.table("comparison")[f"mse_{run.names[-1]}"].to_numpy()
    assert (table["draws"] == len(plan)).all()
    sets = {f"of_{number}": _on_its_own(job, number) for number in table.index}
    again = pfdist.compare(job, times=sets, results=tmp_path / "again", figures=False)
    for number, row in table.iterrows():
        assert tuple(row["measurement_times"]) == sets[f"of_{number}"]
        apart = again.table("comparison")[f"mse_of_{number}"].to_numpy() - plan
        error = np.hypot(row["difference_error"], apart.std(ddof=1) / np.sqrt(len(apart)))
        # Only the noise of the filters differs, so the paired errors are far too large.
        assert abs(row["difference"] - apart.mean()) < CLEAR_ERRORS * error


def test_a_budget_compares_all_numbers(small_job: Job, tmp_path: Path) -> None:
    job = small_job.with_changes(SHORT)
    run = pfdist.budget(job, (2, 5), tmp_path / "run", draws=400, bound_draws=0, figures=False)
    rows, draws = rows_of(run.table("sets")), run.table("comparison")
    for row in rows:
        if row.kind != "found":
            assert row.evenly_spaced is None
            continue
        close = []
        for other in (each for each in rows if each.kind == "regular"):
            apart = controlled_mse(draws, other.name) - controlled_mse(draws, row.name)
            limit = 1.966 * apart.std(ddof=1) / np.sqrt(len(apart))  # Student's t
            if other.measurements >= row.measurements and abs(apart.mean()) < limit:
                close.append(other.measurements)
        assert row.evenly_spaced_between or row.evenly_spaced == close


def test_nothing_is_said_where_not_all_numbers_can_be_evenly_spaced(
    small_job: Job, tmp_path: Path
) -> None:
    changes = [*EXACT, "problem.forbidden=[1]"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=changes, figures=False)
    assert "evenly_spaced" not in run.tables
    assert "evenly spaced measurements" not in answer_in_a_line(run)


def test_nothing_is_said_where_measurements_tell_nothing(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All numbers have the same error, so the search for one that differs ends."""
    monkeypatch.setattr("pfdist.runner.evenly_spaced._MOST", 5)
    # Chance may tell numbers apart; with this seed it does not.
    blind = ["model.name=random_walk", "model.parameters.measurement_sd=1e6", DRAWS, "seed=2"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=blind, figures=False)
    assert "evenly_spaced" not in run.tables
    assert "evenly spaced measurements" not in answer_in_a_line(run)
