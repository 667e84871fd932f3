"""What every model that ships must do."""

import numpy as np
import pytest

from pfdist import load_model, plain
from pfdist.draws import simulate
from pfdist.measurement_times import regular
from pfdist.models import installed_models
from pfdist.particle_filter import filter_draws
from pfdist.runner.check_model import check_model

SHIPPED = sorted(name for name, (module, _) in installed_models().items() if "pfdist." in module)
BELIEVED = {"tumour": {"frequency_sd": 0.005}}  # by the filter, where that is not the truth


@pytest.mark.parametrize("resampling", ["multinomial", "systematic"])
@pytest.mark.parametrize("name", SHIPPED)
def test_compiled_and_plain_filter_agree(name: str, resampling: str) -> None:
    truth = load_model(name)
    draws = simulate(truth, 30, range(4), 17)
    model = truth.with_parameters(BELIEVED.get(name, {}))
    arguments = (model, draws, regular(30, 11), 130, 23, resampling)
    fast, slow = (f(*arguments, trajectories=True) for f in (filter_draws, plain.filter_draws))
    np.testing.assert_allclose(fast.mse, slow.mse, rtol=1e-9)
    np.testing.assert_allclose(fast.estimate, slow.estimate, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", SHIPPED)
def test_check_model_finds_nothing_wrong(name: str) -> None:
    checks = list(check_model(name, horizon=30, particles=100))
    assert [check for check in checks if check.state == "wrong"] == []
    assert checks[-1].name == "an evaluation"
