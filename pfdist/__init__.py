"""When to measure: optimal measurement times for particle filtering, computed in parallel."""

from importlib.metadata import version
from pathlib import Path

from pfdist.analysis import Run, open_run
from pfdist.elementwise import clip, where
from pfdist.errors import PfdistError
from pfdist.evaluation import Evaluation
from pfdist.job import Job, load_job
from pfdist.models import StateSpaceModel, find_model
from pfdist.models.linear_gaussian import linear_gaussian
from pfdist.runner.budget import budget
from pfdist.runner.evaluate import evaluate
from pfdist.runner.plan import plan
from pfdist.runner.run import run

__version__ = version("pfdist")

__all__ = [
    "Evaluation",
    "Job",
    "PfdistError",
    "Run",
    "StateSpaceModel",
    "budget",
    "clip",
    "evaluate",
    "linear_gaussian",
    "load_job",
    "load_model",
    "open_run",
    "plan",
    "run",
    "where",
]


def load_model(name: str) -> StateSpaceModel:
    """Load a model by its name.

    Parameters
    ----------
    name : str
        A model that ships, an installed entry point of the group ``pfdist.models``, or
        ``path/file.py:object``.

    Returns
    -------
    StateSpaceModel

    Raises
    ------
    ModelError
        There is no such model, or it cannot be loaded.
    """
    return find_model(name, Path()).load()
