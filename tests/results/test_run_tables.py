"""The public names of a run, its tables by one door, and the run as a tree of labelled arrays."""

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfdist import Run, open_run
from pfdist.errors import ArgumentError, StoreError
from pfdist.results.run import COMPUTED, TABLES
from pfdist.store.schema import KEYS

EXAMPLE = Path(__file__).parents[2] / "results" / "example"
MOST_NAMES = 14


@pytest.fixture(scope="module")
def run() -> Run:
    return open_run(EXAMPLE)


def test_a_run_has_few_public_names(run: Run) -> None:
    names = [name for name in dir(run) if not name.startswith("_")]
    assert len(names) <= MOST_NAMES
    for name in set(names) - {"job", "path"}:  # described by the class
        assert inspect.getdoc(inspect.getattr_static(Run, name))


def test_every_table_that_a_run_has_is_read_by_its_name_and_no_other(run: Run) -> None:
    assert set(run.tables) <= set(TABLES)
    for name in TABLES:
        if name in run.tables:
            assert len(run.table(name)) > 0
        else:
            with pytest.raises(StoreError, match=f"no table '{name}'; it has: evaluations, draws"):
                run.table(name)


def test_computed_tables_follow_from_the_stored(run: Run) -> None:
    comparison, gains = run.table("comparison"), run.table("gains")
    expected = 1 - comparison["mse_genetic"] / comparison["mse_evenly_spaced"]
    np.testing.assert_allclose(gains["gain_genetic"], expected)
    costs = run.table("sets").set_index("name")["expected_mse"]
    for name in run.sets:
        assert costs[name] == pytest.approx(comparison[f"mse_{name}"].mean())
    assert not set(COMPUTED) & set(KEYS)
    plan = run.table("sets").iloc[1, :10]  # as a notebook shows it
    assert plan.notna().all()
    assert (plan["label"], plan["measurement_times"]) == (
        "relaxation plan",
        run.best.measurement_times,
    )


@pytest.mark.parametrize("name", ["comparison", "gains", "trajectories"])
def test_the_first_draws_of_a_table_are_the_first_rows_of_all_draws(run: Run, name: str) -> None:
    first, every = run.table(name, 7), run.table(name)
    assert first.equals(every[every["draw"] < 7])
    assert first["draw"].nunique() == 7


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("bonds",), "got 'bonds'; did you mean 'bound'. Allowed: evaluations, "),
        ((3,), "must be one of .* got 3$"),
        (("sets", 5), "the table sets has no rows of draws"),
        (("comparison", 0), "draws must be at least 1, got 0"),
        (("comparison", 2.5), "draws must be an integer, got 2.5"),
    ],
)
def test_a_wrong_table_is_refused_in_a_line(run: Run, arguments: Any, says: str) -> None:
    with pytest.raises(ArgumentError, match=says) as refused:
        run.table(*arguments)
    assert "\n" not in str(refused.value)
