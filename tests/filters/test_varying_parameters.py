"""Parameters that vary with t: compiled formulas read nothing that is not there, at full speed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import load_model
from pfdist.errors import ModelError
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate

HORIZON = 6
RATES = tuple(0.5 + 0.1 * t for t in range(HORIZON + 1))
WALK = replace(
    load_model("random_walk"),
    transition=lambda x, t, w, p: (p.rate[t] * x[0] + w[0],),
    parameters={"initial_sd": 1.0, "step_sd": 1.0, "measurement_sd": 1.0, "rate": RATES},
    linear_gaussian=False,
)


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


@pytest.mark.plugins("online", "simulate")
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
