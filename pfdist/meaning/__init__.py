"""The meaning of a model: a hash for every function and constant that its formulas reach.

Two models with the same meaning give the same figures. A function counts by its syntax without
docstrings and comments, and a constant by its value, through all of the user's modules and the
formulas of other models. NumPy and the standard library count by the names that are used. Any other
installed distribution counts by the names used and its version. The identity of a run already has
the version of pfdist and of its kernel.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pfdist.errors import ModelError
from pfdist.meaning.model_value import ModelValue
from pfdist.meaning.values import UntoldValueError
from pfdist.meaning.walk import Walk, digest
from pfdist.models import ModelSource, StateSpaceModel

Meaning = dict[str, Any]
"""Hashes and parameters by labels, such as ``transition``, ``helper.f`` or ``parameters.sd``."""

FORMULAS = (
    "initial", "transition", "measurement", "log_likelihood", "quantity_of_interest", "error",
)  # fmt: skip
_SETTINGS = ("initial_noise", "process_noise", "measurement_noise", "linear_gaussian")
_NAMES = ("x_names", "y_names", "z_names")  # they name columns


def meaning_of(model: StateSpaceModel, source: ModelSource | ModelValue, main: str = "") -> Meaning:
    """Give the meaning of a model that was just loaded, or given as an object.

    Parameters
    ----------
    model : StateSpaceModel
    source : ModelSource or ModelValue
        The source of the model, with its files.
    main : str, optional
        A module whose variables have labels as those of a script, wherever they are defined.

    Raises
    ------
    ModelError
        A formula uses a value whose content cannot be read.
    """
    try:
        table = Walk({name: getattr(model, name) for name in FORMULAS}, source, main).table()
    except UntoldValueError as error:
        raise ModelError(
            f"{_named(error.label, source.path)} is or holds {error.what}, which pfdist cannot "
            "read, so it could not tell whether a run goes on with the same model: "
            f"use numbers, text, arrays, functions, or objects made of these ({source.path})"
        ) from error
    settings = {name: digest([repr(getattr(model, name)).encode()]) for name in _SETTINGS}
    files = source.sha256
    data = {f"data_files.{name}": files[name][:16] for name in model.data_files if name in files}
    names = {name: ", ".join(given) for name in _NAMES if (given := getattr(model, name))}
    return {**table, **settings, **names, **data, **parameters_of(model.p._asdict())}


def parameters_of(values: Mapping[str, Any]) -> Meaning:
    """Give parameters as entries of a meaning: numbers, and hashes of sequences."""
    return {f"parameters.{name}": _told(value) for name, value in values.items()}


def _told(value: Any) -> float | str:
    if isinstance(value, list | tuple | np.ndarray):
        return digest([np.array(value, np.float64).tobytes()])
    return float(value)


@cache
def loaded_meaning(source: ModelSource) -> Meaning:
    """Give the meaning of the model that `source.load` gives in this process."""
    return meaning_of(source.load(), source)


def differences(here: Mapping[str, Any], there: Mapping[str, Any]) -> list[str]:
    """Give the labels that differ between two meanings, sorted."""
    return sorted(name for name in here.keys() | there.keys() if here.get(name) != there.get(name))


def check_is_constant(
    here: Mapping[str, Any], there: Mapping[str, Any], path: str, where: str
) -> None:
    """Raise an error if two loads of a model have different meanings.

    Parameters
    ----------
    here, there : mapping
        The meanings of both loads.
    path : str
        Path of the model's file.
    where : str
        When the two differ, for the error: "each time it is loaded".

    Raises
    ------
    ModelError
        The meanings differ. The message names the first difference.
    """
    found = differences(here, there)
    if found:
        # A formula differs because a constant does, so the error names the constant.
        thing = _named(max(found, key=lambda name: "." in name), path)
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise ModelError(
            f"{thing} has another value {where}{more}; what formulas use must be the same in every "
            f"process: write the value down, or draw it with a fixed seed ({path})"
        )


def _named(label: str, path: str) -> str:
    """Give a label of a meaning in words, such as ``C of helper.py``."""
    module, _, name = label.rpartition(".")
    file = f"{module.replace('.', '/')}.py"
    own = module in ("", "parameters", "__main__")
    return f"{name} of {Path(path).name if own else file}"
