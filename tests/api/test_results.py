"""The results of a summary: one number of measurements is a budget curve of a single number."""

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


def test_a_run_of_one_number_has_a_curve_of_one_number(times: pfdist.Run) -> None:
    sets, table = times.sets_of_one_number(), times.budget()
    assert list(sets) == times.names
    assert all(len(measurement_times) == 4 for measurement_times in sets.values())
    assert table["kind"].tolist() == ["regular", "found", "found"]
    assert table["measurements"].tolist() == [4, 4, 4]
    least = table[table["kind"] == "found"]["expected_mse"].min()
    assert times.reaching(least)["found"]["measurements"] == 4
    below = times.reaching(least * 0.999)
    assert (below["found"]["measurements"], below["regular"]["measurements"]) == (None, None)


@pytest.mark.parametrize("kind", ["times", "budget"])
def test_a_run_has_a_result_for_each_row_of_its_curve(
    kind: str, request: pytest.FixtureRequest
) -> None:
    run = request.getfixturevalue(kind)
    results, table = run.summary()["results"], run.budget().set_index("name")
    assert list(results) == run.names == table.index.tolist()
    for name, result in results.items():
        assert result["expected_mse"] == table.loc[name, "expected_mse"]
        assert ("search_cause" in result) == (result["kind"] == "found")


def test_each_set_gains_over_the_reference_with_as_many_measurements(budget: pfdist.Run) -> None:
    results, gains = budget.summary()["results"], budget.gains()
    assert len(budget.references) == 3
    assert gains.columns.tolist() == ["draw", *(f"gain_{name}" for name in budget.references)]
    for name, reference in budget.references.items():
        cost, other = (results[each]["expected_mse"] for each in (name, reference))
        assert results[name]["measurements"] == results[reference]["measurements"]
        assert results[name]["gain_of_means"] == pytest.approx(1 - cost / other)


def test_the_sets_of_several_numbers_are_not_those_of_one(budget: pfdist.Run) -> None:
    with pytest.raises(StoreError, match="times of several numbers of measurements"):
        budget.sets_of_one_number()
