"""Properties of all models that ship: measurements help, and parameters have their ranges."""

import pytest

from oracles.in_turn import in_turn
from pfdist.errors import ModelError
from pfdist.models import load_model

OUTSIDE = {
    "constant_velocity": {"acceleration_sd": -0.1, "range_sd": 0.0, "bearing_sd": 0.0},
    "epidemic": {"sensitivity": 1.0, "return_days": 0.0, "first_infectious": 1.5},
    "epidemic_counts": {"consulting": 1.5, "background": 0.0},
    "lorenz63": {"step": 0.3, "diffusion": -0.1, "measurement_sd": 0.0},
    "lotka_volterra": {"birth": -0.5, "step": -1.0, "measurement_sd": 0.0},
    "pharmacokinetics": {"clearance": 0.0, "volume_sd": -0.1, "measurement_sd": 0.0},
    "robot": {"concentration": -1.0, "slip": -0.1},
    "stochastic_volatility": {"phi": 1.0, "sigma": -0.1},
    "two_compartments": {"clearance": 0.0, "dose_sd": -0.1, "immunoassay_sd": 0.0},
    "tumour": {"frequency_sd": -0.1, "measurement_sd": 0.0},
    "ungm": {"initial_sd": -1.0, "process_sd": -1.0, "measurement_sd": 0.0},
    "ungm_gordon": {"process_sd": -1.0, "measurement_sd": 0.0},
    "xray_tumour": {"damping": 1.0, "lateral_sd": -0.1, "measurement_sd": 0.0},
}


@in_turn("name", OUTSIDE)
def test_a_parameter_has_its_range(name):
    for parameter, value in OUTSIDE[name].items():
        with pytest.raises(ModelError, match=f"{name}: parameter {parameter} must .*got {value}"):
            load_model(name).with_parameters({parameter: value})
