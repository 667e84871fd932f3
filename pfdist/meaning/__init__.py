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

from pfdist.errors import ModelError
from pfdist.meaning.values import UntoldValueError
from pfdist.meaning.walk import Walk, digest
from pfdist.models import ModelSource, StateSpaceModel

Meaning = dict[str, Any]
"""Hashes and parameters by labels, such as ``transition``, ``helper.f`` or ``parameters.sd``."""

FORMULAS = (
    "initial", "transition", "measurement", "log_likelihood", "quantity_of_interest", "error",
)  # fmt: skip
_SETTINGS = ("initial_noise", "process_noise", "measurement_noise", "linear_gaussian")


def meaning_of(model: StateSpaceModel, source: ModelSource) -> Meaning:
    """Give the meaning of a model that was just loaded.

    Parameters
    ----------
    model : StateSpaceModel
    source : ModelSource
        The source of the model, with its files.

    Raises
    ------
    ModelError
        A formula uses a value whose content cannot be read.
    """
    try:
        table = Walk({name: getattr(model, name) for name in FORMULAS}, source).table()
    except UntoldValueError as error:
        raise ModelError(
            f"{_named(error.label, source.path)} is or holds {error.what}, which pfdist cannot "
            "read, so it could not tell whether a run goes on with the same model: "
            f"use numbers, text, arrays, functions, or objects made of these ({source.path})"
        ) from error
    settings = {name: digest([repr(getattr(model, name)).encode()]) for name in _SETTINGS}
    data = {f"data_files.{name}": source.sha256[name][:16] for name in model.data_files}
    return {**table, **settings, **data, **parameters_of(model.p._asdict())}


def parameters_of(values: Mapping[str, float]) -> Meaning:
    """Give parameters as entries of a meaning."""
    return {f"parameters.{name}": float(value) for name, value in values.items()}


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
    return f"{name} of {file if module not in ('', 'parameters') else Path(path).name}"
