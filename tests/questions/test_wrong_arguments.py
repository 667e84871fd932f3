"""Wrong arguments of each public function end in one line of one tree of exceptions."""

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from oracles.in_turn import in_turn
from pfdist import PfdistError

pytestmark = pytest.mark.plugins(
    "backtest", "budget", "check", "explorer", "filter", "fit", "online", "rule", "runs",
    "simulate", "sweep", "why",
)  # fmt: skip

PROBLEM = pfdist.Problem("random_walk", horizon=12, measurement_budget=4, engine="kalman")
FINISHED = "finished"  # stands for the job of a finished run
MEASURED = pd.DataFrame({"t": [0], "y0": [0.1]})
# A check that several functions share, such as that of a job or of a folder, stands once.
CASES: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    ("Problem", (5,), {"horizon": 12, "measurement_budget": 4}),
    ("Problem", ("ungm",), {"horizon": 12, "measurement_budget": 4, "particle": 3}),
    ("run", (5,), {}),
    ("run", (PROBLEM,), {"results": 5}),
    ("run", (PROBLEM,), {"changes": [3]}),
    ("run", (PROBLEM,), {"progress": 5}),
    ("plan", (PROBLEM,), {"search": "genetc"}),
    ("online", (PROBLEM,), {"draws": "many"}),
    ("budget", (PROBLEM, 3), {}),
    ("evaluate", (PROBLEM, "abc"), {}),
    ("evaluate", (PROBLEM, range(10**9)), {}),
    ("Problem", ("ungm",), {"horizon": 12, "total_price": 3.0, "price": range(10**9)}),
    ("particle_losses", (PROBLEM, (50, 0)), {}),
    ("compare", (PROBLEM,), {"times": {"a": 4, "b": [0]}}),
    ("simulate", (PROBLEM,), {"draws": 0}),
    ("check_model", (5,), {}),
    ("why", ("lacking",), {}),
    ("rule", ("lacking",), {}),
    ("bound", (FINISHED, 5), {}),
    ("filter_measurements", (FINISHED, 5), {}),
    ("filter_measurements", (FINISHED, MEASURED), {"prior": "lacking.csv"}),
    ("filter_measurements", (FINISHED, pd.DataFrame({"t": [0], "y0": ["high"]})), {}),
    ("backtest", (FINISHED, 5), {}),
    ("backtest", (FINISHED, MEASURED.assign(patient="a")), {"replicate": "nobody"}),
    ("backtest", (FINISHED, MEASURED.assign(patient="a")), {"times": {"mine": [99]}}),
    ("fit", (FINISHED, MEASURED.assign(patient="a"), ["process_sd"]), {}),
    ("explore", (5,), {}),
    ("next_time", (FINISHED, MEASURED), {"now": "late"}),
    ("filter_measurements", (FINISHED, MEASURED), {"prior": "a\0b"}),
    ("filter_measurements", (FINISHED, MEASURED + 0.5j), {}),
    ("Filter", ("ungm",), {"prior": pd.DataFrame()}),
    ("Planner", (PROBLEM,), {"times": [0, 1, 2, 99]}),
    ("Filter", (5,), {}),
    ("Cloud", (0, [[1.0]]), {}),
    ("report", ("lacking",), {}),
    ("table", (), {}),
    ("list_runs", ("lacking",), {}),
    ("sweep", (5, {"seed": [1]}), {}),
    ("sweep", (PROBLEM, 5), {}),
    ("sweep", (PROBLEM, {"seed": [1]}), {"part": 1.5}),
    ("open_run", (5,), {}),
    ("load_job", (5,), {}),
    ("load_job", ("a\0b",), {}),
    ("load_model", (5,), {}),
]
NO_CASES = {"Run", "Job", "Evaluation", "StateSpaceModel", "PfdistError", "Sweep", "plots"}
NO_CASES |= {"ode", "sde", "BatchedModel", "Rule"}  # see test_continuous, test_batched, test_rule
NO_CASES |= {
    "clip",
    "densities",
    "take",
    "where",
    "linear_gaussian",
    "Sensor",
    "Options",
}  # what makes models


@in_turn(("name", "arguments", "options"), CASES)
def test_a_wrong_argument_ends_in_one_line(
    name: str,
    arguments: tuple[Any, ...],
    options: dict[str, Any],
    finished: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = finished("model.name=random_walk", "filter.engine=kalman")
    run = {FINISHED: folder / "job.toml"}
    given = [run.get(each, each) if isinstance(each, str) else each for each in arguments]
    function: Callable[..., Any] = getattr(pfdist, name)
    with pytest.raises(PfdistError) as caught:
        function(*given, **options)
    text = str(caught.value)
    assert text
    assert "\n" not in text
    assert "Traceback" not in text
    assert "--" not in text  # arguments have no dashes in Python
    assert not list(tmp_path.iterdir()), "a wrong argument left a file"


def test_every_public_name_has_a_case() -> None:
    assert {*pfdist.__all__} - NO_CASES == {name for name, _, _ in CASES}


def test_all_errors_are_in_one_tree() -> None:
    from pfdist import errors

    for _, error in inspect.getmembers(errors, inspect.isclass):
        if issubclass(error, Exception) and not issubclass(error, Warning):
            assert issubclass(error, PfdistError)
