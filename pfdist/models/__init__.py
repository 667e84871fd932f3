"""State-space models: the class, the loader of models by name, and the built-in models.

A model consists of formulas. It depends on neither filters nor simulations.
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
