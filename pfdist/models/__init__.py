"""State-space models: the class, the search for a model by its name, and the models that ship.

A model consists of formulas. It knows neither filters nor simulations.
"""

from pfdist.models.base import StateSpaceModel, squared_error
from pfdist.models.checked_fields import is_in_folder
from pfdist.models.loader import PYTHON, ModelSource, find_model, installed_models, load_model

__all__ = [
    "PYTHON",
    "ModelSource",
    "StateSpaceModel",
    "find_model",
    "installed_models",
    "is_in_folder",
    "load_model",
    "squared_error",
]
