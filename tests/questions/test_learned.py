"""Jobs whose filter learns parameters: all questions, and what is refused."""

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.learned import WALK
from pfdist import Run
from pfdist.errors import JobError, ModelError, PfdistError

LEARNED = {
    "parameters": {"drift": {"normal": [0.0, 0.3]}, "gain": {"lognormal": [1.0, 0.3]}},
    "filter": "learned",
}
LISTED = {"parameters": [{"drift": -0.3}, {"drift": 0.4}], "weights": [3, 1], "filter": "learned"}


def problem(scenarios: Any, **others: Any) -> pfdist.Problem:
    given = {"horizon": 8, "measurement_budget": 2, "particles": 40, "scenarios": scenarios}
    return pfdist.Problem(WALK, **(given | others))


PLAIN: dict[str, Any] = {"search": "random", "pool": "serial", "figures": False}
PLAIN["changes"] = ["comparison.draws=48", "search.random.evaluations=3"]


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return pfdist.plan(problem(LISTED), tmp_path_factory.mktemp("learned") / "run", **PLAIN)


def test_a_plan_has_no_scenarios_and_a_proof(planned: Run) -> None:
    assert "scenarios" not in planned.tables
    assert planned.as_json()["scenarios"] is None
    assert planned.table("bound")["gap_at_most"].between(0.0, 1.0).all()


@pytest.mark.plugins("filter", "online", "why")
def test_a_run_answers_questions_without_the_model(planned: Run) -> None:
    """Its model.json has the model with the components, which are not added again."""
    folder = planned.path.parent / "compared"
    compared = pfdist.compare(
        planned.path, times={"one": [2, 6], "two": [3, 8]}, draws=48, results=folder, figures=False
    )
    assert {"one", "two"} <= {*compared.names}
    assert {"control_one", "control_two"} <= {*compared.table("comparison")}
    why = pfdist.why(planned.path, draws=48, figures=False)
    assert why.profile["error"].notna().all()
    measured = pd.DataFrame({"t": [2], "y0": [0.3]})
    assert pfdist.next_time(planned.path, measured).plan
    filtered = pfdist.filter_measurements(planned.path, measured, report=False)
    assert filtered.table.filter(like="estimate").notna().all(axis=None)


@pytest.mark.plugins("online")
def test_times_are_chosen_one_after_another(tmp_path: Path) -> None:
    """Each plan starts from particles with the parameters that they have learned so far."""
    run = pfdist.online(
        problem(LISTED), tmp_path / "run", draws=6, pool="serial", figures=False,
        changes=["comparison.draws=48", "online.draws=24"],
    )  # fmt: skip
    assert run.table("online")["measurement_times"].map(len).eq(2).all()


def test_the_parameters_can_be_what_is_estimated() -> None:
    """Measurements of the walk lower the error of its drift, the second component of z."""
    few, many = (
        pfdist.evaluate(problem(LISTED, measurement_budget=len(times)), times, draws=960)
        for times in ([8], [2, 4, 6, 8])
    )
    assert many.expected_mse < few.expected_mse


@in_turn(
    ("change", "says"),
    [
        ({"criterion": "worst"}, "'learned' takes 'mean' as scenarios.criterion, got 'worst'"),
        ({"motion": 0.1, "filter": "nominal", "count": 4}, r"motion needs .* got 0.1"),
        ({"parameters": {"speed": {"uniform": [-1.0, 1.0]}}}, "unknown parameter 'speed'"),
    ],
)
def test_what_does_not_fit_is_one_line(change: dict[str, Any], says: str) -> None:
    with pytest.raises(PfdistError, match=says) as refused:
        pfdist.evaluate(problem(LEARNED | change), [2, 6], draws=48)
    assert isinstance(refused.value, JobError | ModelError)
    assert "\n" not in str(refused.value)


def test_a_motion_makes_the_filter_another_model(tmp_path: Path) -> None:
    """So there is no control variate; the bound is that of the model without it."""
    run = pfdist.plan(problem(LEARNED | {"motion": 0.05}), tmp_path / "run", **PLAIN)
    assert "control_regular" not in run.table("comparison")
    assert run.table("bound")["gap_at_most"].between(0.0, 1.0).all()
