"""The expected error of any set over time, by `pfdist.evaluate` and ``pfdist evaluate``.

Its mean with the column ``weight`` is the expected MSE.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.kalman import TRACKING, kalman_filter

SETS = {"few": [0, 6], "many": "0:12:3"}
WEIGHTS = "problem.instant_weights=[0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1, 0]"


def test_that_of_a_linear_gaussian_model_is_the_variance_of_the_kalman_filter() -> None:
    system, times = TRACKING, (0, 3, 8)
    nothing = np.zeros((13, len(system.c)))
    expected = kalman_filter(system, nothing, times)[1].sum(axis=1)
    problem = {"horizon": 12, "measurement_budget": 3}
    exact, found = (
        pfdist.evaluate(
            pfdist.Problem(system.as_model(), **problem, **keys), times, draws=4000, profile=True
        )
        for keys in ({"engine": "kalman"}, {"particles": 1000, "engine": "compiled"})
    )
    np.testing.assert_allclose(exact.profile["error"], expected, rtol=1e-9)
    assert not exact.profile["standard_error"].any()
    profile = found.profile  # 1,000 particles add about 0.1 % to the error, 13 instants are tested
    apart = np.abs(profile["error"] - expected) - 0.005 * expected
    assert (apart < 4 * profile["standard_error"]).all()
    for each in (exact, found):
        assert each.profile["error"].mean() == pytest.approx(each.expected_mse, rel=1e-12)
        assert each.profile["measured"].to_numpy().nonzero()[0].tolist() == [*times]


@pytest.mark.parametrize("changes", [[], [WEIGHTS]], ids=["alike", "weights"])
def test_that_of_the_compiled_filter_is_that_of_its_plain_twin(
    changes: list[str], small_job: pfdist.Job
) -> None:
    compiled, plain = (
        pfdist.evaluate(
            small_job.with_changes([*changes, f"filter.engine={engine}"]), SETS, profile=True
        )
        for engine in ("compiled", "numpy")
    )
    for name, found in compiled.items():
        for column in ("error", "standard_error"):
            expected = plain[name].profile[column]
            np.testing.assert_allclose(found.profile[column], expected, rtol=1e-9)
        mean = (found.profile["weight"] * found.profile["error"]).mean()
        assert mean == pytest.approx(found.expected_mse, rel=1e-12)
        assert (found.profile["name"] == name).all()
        assert (found.profile["weight"][0] == 0) == bool(changes)
        assert (found.profile["draws"] == 30).all()
    without = pfdist.evaluate(small_job.with_changes(changes), SETS)
    assert without["few"].profile is None
    assert without["few"].mse.tolist() == compiled["few"].mse.tolist()


@pytest.mark.parametrize("engine", ["compiled", "kalman"])
def test_it_is_that_of_the_worst_scenario_where_this_decides(
    engine: str, small_job: pfdist.Job
) -> None:
    changes = ["model.name=random_walk", f"filter.engine={engine}", "scenarios.criterion=worst"]
    scenarios = ["scenarios.parameters=[{step_sd=0.5}, {step_sd=1.0}]", "scenarios.filter=told"]
    job = small_job.with_changes([*changes, *scenarios])
    found = pfdist.evaluate(job, [0, 4, 8], profile=True)
    assert found.profile["error"].mean() == pytest.approx(found.expected_mse, rel=1e-12)
    assert "name" not in found.profile


def test_the_command_has_it_as_a_table_and_as_json(
    small_job: pfdist.Job, said: Callable[..., str]
) -> None:
    path = str(small_job.path)
    words = ["evaluate", path, "--times", "few=0,6", "--times", "many=0:12:3"]
    shown = said(*words, "--profile")
    assert "Expected error at each instant" in shown
    answer: dict[str, Any] = json.loads(said(*words, "--profile", "--json"))["sets"]
    found = pfdist.evaluate(Path(path), SETS, profile=True)
    for name, each in found.items():
        profile = each.profile[["t", "weight", "error", "standard_error"]].to_dict("list")
        assert answer[name]["profile"] == profile
    assert "profile" not in json.loads(said(*words, "--json"))["sets"]["few"]
