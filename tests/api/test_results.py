"""The results of a summary: the same questions to a run of one problem and to a budget study."""

from pathlib import Path

import pytest

import pfdist
from pfdist import Job
from pfdist.errors import StoreError

EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=50"]


@pytest.fixture
def times(small_job: Job, tmp_path: Path) -> pfdist.Run:
    return pfdist.run(small_job.with_changes(EXACT), tmp_path / "times", figures=False)


@pytest.fixture
def budget(small_job: Job, tmp_path: Path) -> pfdist.Run:
    return pfdist.budget(
        small_job.with_changes(EXACT), (2, 4), tmp_path / "budget", draws=50, figures=False
    )


def test_a_run_of_one_problem_has_its_sets_and_no_budget_curve(times: pfdist.Run) -> None:
    sets = times.sets_of_one_number()
    assert list(sets) == times.names == list(times.summary()["results"])
    assert all(len(measurement_times) == 4 for measurement_times in sets.values())
    for curve in (times.budget, lambda: times.reaching(1.0)):
        with pytest.raises(StoreError, match=r"times of one number of measurements alone$"):
            curve()


def test_a_budget_study_has_a_result_for_each_row_of_its_curve(budget: pfdist.Run) -> None:
    results, table = budget.summary()["results"], budget.budget().set_index("name")
    assert list(results) == budget.names == table.index.tolist()
    for name, result in results.items():
        assert result["expected_mse"] == table.loc[name, "expected_mse"]
        assert ("search_cause" in result) == (result["kind"] == "found")
    with pytest.raises(StoreError, match="times of several numbers of measurements"):
        budget.sets_of_one_number()
