"""State-space models: the class, the search for a model by its name, and the models that ship.

A model consists of formulas. It knows neither filters nor simulations.
"""

from pfdist.models.base import Sensor, StateSpaceModel, squared_error
from pfdist.models.loader import (
    PYTHON,
    NamedModel,
    check_name,
    installed_models,
    installed_name,
    load_model,
)

__all__ = [
    "PYTHON",
    "NamedModel",
    "Sensor",
    "StateSpaceModel",
    "check_name",
    "installed_models",
    "installed_name",
    "load_model",
    "squared_error",
]
