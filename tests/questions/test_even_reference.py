"""The best evenly spaced times as the reference: chosen by a race, judged on fresh draws."""

from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist.filters.exact import exact_mse
from pfdist.problem.even_sets import EvenSets
from pfdist.problem.feasible import Feasible
from pfdist.problem.job import Job
from pfdist.questions.run_page import answer_of
from pfdist.runner.build import build

EVEN = 'comparison.reference="evenly spaced"'
EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=2", EVEN]


def _grids(feasible: Feasible) -> list[tuple[int, ...]]:
    even = EvenSets(feasible)
    return [*even.sets_of(even.lines(10_000))]


def test_of_exact_errors_the_least_is_taken(small_job: Job, tmp_path: Path) -> None:
    changes = [*EXACT, "problem.horizon=11"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=changes, figures=False, bound_draws=0)
    job = pfdist.load_job(run.path)
    grids = _grids(job.problem.feasible)
    errors = np.array(exact_mse(build(job).evaluator, grids))
    assert tuple(run.sets["evenly_spaced"]) == grids[int(errors.argmin())] == (0, 3, 6, 9)
    row = run.table("sets").set_index("name").loc["evenly_spaced"]
    assert row["label"] == "evenly spaced"
    assert row["expected_mse"] == pytest.approx(errors.min())
    assert "These are evenly spaced times" in str(answer_of(run))
    assert "evenly spaced measurements" not in str(answer_of(run))  # nothing to add


def test_a_race_finds_it_and_a_run_goes_on_with_the_same_bytes(
    small_job: Job, tmp_path: Path
) -> None:
    changes = [EVEN, "problem.horizon=30"]
    run = pfdist.run(small_job, tmp_path / "run", changes=changes, figures=False)
    raced = run.table("evaluations").query("phase == 'evenly_spaced.shortlist'")
    grids = _grids(pfdist.load_job(run.path).problem.feasible)
    assert {tuple(times) for times in raced["measurement_times"]} <= {*grids}
    # the best of the ranking, and those from coarse to fine, of which some may be the same
    assert 48 < len(raced.query("generation == 0")) <= 96 < len(grids)
    last = raced[raced["generation"] == raced["generation"].max()]
    best = last.loc[last["expected_mse"].idxmin(), "measurement_times"]
    assert tuple(best) == tuple(run.sets["evenly_spaced"])
    assert list(run.references.values()) == ["evenly_spaced"] * 2
    fewer = [*changes, "comparison.draws=40"]
    short = pfdist.run(small_job, tmp_path / "short", changes=fewer, figures=False)
    longer = pfdist.run(small_job, short.path, changes=changes, figures=False)
    assert hashes(longer.path) == hashes(run.path)


@pytest.mark.plugins("budget")
def test_a_budget_has_the_best_of_each_number(small_job: Job, tmp_path: Path) -> None:
    run = pfdist.budget(
        small_job,
        (2, 4),
        tmp_path / "run",
        changes=[*EXACT[:2], EVEN],
        draws=2,
        bound_draws=0,
        figures=False,
    )
    job = pfdist.load_job(run.path)
    evaluator = build(job).evaluator
    for number in (2, 3, 4):
        grids = _grids(job.feasible(number))
        least = grids[int(np.argmin(exact_mse(evaluator, grids)))]
        assert tuple(run.sets[f"evenly_spaced_{number:02}"]) == least


def test_its_name_belongs_to_it(small_job: Job) -> None:
    for changes in (['search=[{method="random", name="evenly_spaced"}]'],
                    ["comparison.sets={evenly_spaced=[1, 2, 3, 4]}"]):  # fmt: skip
        with pytest.raises(pfdist.PfdistError, match="evenly_spaced"):
            small_job.with_changes(changes)


def test_a_comparison_keeps_the_name_that_a_set_has(small_job: Job, tmp_path: Path) -> None:
    job = small_job.with_changes(["comparison.sets={mine='regular', other=[1, 2, 3, 4]}", EVEN])
    run = pfdist.compare(job, results=tmp_path / "run", draws=20, figures=False)
    assert [*run.sets] == ["mine", "other"]
    with pytest.raises(pfdist.PfdistError, match="'evenly_spaced'"):
        pfdist.compare(job, times={"evenly_spaced": [0, 1, 2, 3]}, results=tmp_path / "no")
