"""Parameters that vary with t: compiled formulas read nothing that is not there, at full speed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from pfdist import load_model
from pfdist.errors import ModelError
from pfdist.filters import plain
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.questions.model_checks import check_loaded

HORIZON = 6
RATES = tuple(0.5 + 0.1 * t for t in range(HORIZON + 1))
WALK = replace(
    load_model("random_walk"),
    transition=lambda x, t, w, p: (p.rate[t] * x[0] + w[0],),
    parameters={"initial_sd": 1.0, "step_sd": 1.0, "measurement_sd": 1.0, "rate": RATES},
    linear_gaussian=False,
)


def _reassigned(x: Any, t: Any, w: Any, p: Any) -> Any:
    if t > 2:
        t = t + 100  # another t than the formula's
    return (x[0] + p.rate[t],)


def _in_a_loop(x: Any, t: Any, w: Any, p: Any) -> Any:
    (t,) = (3 * t,)
    return (x[0] + p.rate[t],)


@pytest.mark.slow
def test_a_parameter_at_t_is_that_of_numpy() -> None:
    draws = simulate(WALK, HORIZON, range(5), 1)
    fast, slow = (f(WALK, draws, (1, 4), 50, 2) for f in (filter_draws, plain.filter_draws))
    np.testing.assert_allclose(fast.mse, slow.mse, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("transition", "index"),
    [
        (lambda x, t, w, p: (x[0] + p.rate[t + 2],), 7),
        (lambda x, t, w, p: (x[0] + p.rate[2 * t],), 8),
        (_reassigned, 103),
        (_in_a_loop, 9),
    ],
)
def test_another_index_is_checked(transition: Callable[..., Any], index: int) -> None:
    model = replace(WALK, transition=transition)
    with pytest.raises(ModelError, match=f"IndexError: index {index} is out of bounds"):
        simulate(model, HORIZON, range(2), 1)


def test_a_parameter_that_is_too_short_is_refused() -> None:
    draws = simulate(WALK, HORIZON, range(2), 1)
    short = WALK.with_parameters({"rate": RATES[:4]})
    for compute in (
        lambda: simulate(short, HORIZON, range(2), 1),
        lambda: filter_draws(short, draws, (1, 4), 50, 2),
    ):
        with pytest.raises(ModelError, match="rate needs 7 values, one for each instant"):
            compute()


SOURCE = """
from dataclasses import replace
from pfdist import load_model

model = replace(
    load_model("random_walk"),
    transition=lambda x, t, w, p: (p.rate[t] * x[0] + w[0],),
    parameters={"initial_sd": 1.0, "step_sd": 1.0, "measurement_sd": 1.0, "rate": [0.5] * COUNT},
)
"""
JOB = """
seed = 1
[model]
name = "model.py:model"
[problem]
horizon = 30
measurement_budget = 2
"""


@pytest.mark.parametrize("count", [4, 32])
def test_a_job_says_how_many_numbers_a_parameter_needs(count: int, tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    path.write_text(JOB)
    path.with_name("model.py").write_text(SOURCE.replace("COUNT", "31"))
    model = pfdist.load_model(f"{path.with_name('model.py')}:model")
    wrong, change = model.with_parameters({"rate": [0.5] * count}), f"rate={[0.5] * count}"
    size: dict[str, Any] = {"horizon": 30, "measurement_budget": 2}
    problems = [
        ("model", pfdist.Problem(wrong, **size)),
        ("model.filter", pfdist.Problem(model, filter_model=wrong, **size)),
        ("model", pfdist.load_job(path, [f"model.parameters.{change}"])),
        ("model.filter", pfdist.load_job(path, [f"model.filter.parameters.{change}"])),
    ]
    for part, problem in problems:
        says = f"^{part}.parameters.rate needs 31 values, one for each instant, got {count}$"
        for function in (pfdist.simulate, pfdist.Planner, lambda each: pfdist.evaluate(each, [1])):
            with pytest.raises(ModelError, match=says):
                function(problem)


@pytest.mark.slow
def test_a_check_and_a_filter_say_how_many_numbers_a_parameter_needs(tmp_path: Path) -> None:
    """Before the formulas are called, which would end in an IndexError at some t."""
    (tmp_path / "model.py").write_text(SOURCE.replace("COUNT", "4"))
    *_, last = check_loaded(lambda: pfdist.load_model("model.py:model", tmp_path), 30, 50)
    assert last.state == "wrong"
    assert last.text == (
        "parameter rate needs 31 values, one for each instant, got 4; "
        "give them in the model, or in a job, and check the job"
    )
    model = pfdist.load_model(f"{tmp_path / 'model.py'}:model")
    for engine in ("compiled", "numpy", "kalman"):
        filtering = pfdist.Filter(model, particles=20, engine=engine)
        filtering.update(3, 0.5)
        with pytest.raises(ModelError, match=r"rate needs 7 values, .*, got 4$"):
            filtering.update(6, 0.5)
