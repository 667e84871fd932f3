"""Models that ship have nothing wrong."""

import pytest

from oracles.clocked import times_of
from pfdist.models import installed_models, load_model
from pfdist.plugins.check.model_checks import check_loaded

SHIPPED = sorted(name for name, (module, _) in installed_models().items() if "pfdist." in module)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.zoo] * (name != "ungm")) for name in SHIPPED],
)
def test_check_model_finds_nothing_wrong(name: str) -> None:
    times = times_of(30) if load_model(name).reads_clock else ()
    checks = list(check_loaded(lambda: load_model(name), 30, 100, times))
    assert [check for check in checks if check.state == "wrong"] == []
    assert checks[-1].name == "an evaluation"
