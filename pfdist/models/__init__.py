"""State-space models: what a model is, how one is found by its name, and those that ship.

Here only NumPy and the elementwise functions: a model is formulas, and knows neither filter nor
simulation.
"""

from pfdist.models.base import StateSpaceModel, is_in_folder, squared_error
from pfdist.models.loader import ModelSource, find_model, installed_models, load_model

__all__ = [
    "ModelSource",
    "StateSpaceModel",
    "find_model",
    "installed_models",
    "is_in_folder",
    "load_model",
    "squared_error",
]
