"""Every model that ships has a lower bound, those with a wrong filter model too."""

from pathlib import Path

import pytest

import pfdist
from pfdist import load_job
from pfdist.models import installed_models
from pfdist.runner.bound_settings import LEAST_DRAWS, BoundSettings

SHIPPED = sorted(name for name, (module, _) in installed_models().items() if "pfdist." in module)
SLOW = {"epidemic", "pharmacokinetics", "tumour"}
JOB_OF = {"ungm": "plan"}
JOBS = Path(__file__).parents[2] / "jobs"
SMALL = [
    "problem.measurement_budget=4",
    "comparison.draws=100",
    "execution.pool=serial",
]
INSTANTS = {"pharmacokinetics": "problem.times=[0, 0.5, 1, 2, 3, 4, 6, 9, 12, 13, 30, 46, 47]"}


@pytest.mark.zoo
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in SHIPPED],
)
def test_a_bound_is_given(name: str, tmp_path: Path) -> None:
    instants = INSTANTS.get(name, "problem.horizon=12")
    job = load_job(JOBS / f"{JOB_OF.get(name, name)}.toml", [*SMALL, instants])
    run = pfdist.plan(job, tmp_path / "run", search="random", bound_draws=0, figures=False)
    for gap in pfdist.bound(run, BoundSettings(LEAST_DRAWS), pool="serial", figures=False).gaps:
        assert not gap.reason
        assert 0.0 <= gap.gap <= gap.gap_at_most < 1.0
