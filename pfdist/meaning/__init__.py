"""What a model means: everything that its formulas reach, each thing with a hash.

Two models of one meaning give the same figures. A function counts by its syntax without docstrings
and comments, a constant by its value, through all of the user's modules and the formulas of other
models. NumPy and the standard library count by the names that are used; another installed
distribution by names and its version; `pfdist` itself has a version and a kernel version in a run's
identity already.
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
"""Hashes and parameters by the names of what they belong to: ``transition``, ``helper.f``."""

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
        What it was loaded from, with its files.

    Raises
    ------
    ModelError
        A formula uses a value whose content cannot be read.
    """
    try:
        table = Walk({name: getattr(model, name) for name in FORMULAS}, source).table()
    except UntoldValueError as error:
        raise ModelError(
            f"model.name: {_thing(error.label, source.path)} is or holds {error.what}, which "
            "pfdist cannot read, so it could not tell whether a run goes on with the same model: "
            f"use numbers, text, arrays, functions, or objects made of these ({source.path})"
        ) from error
    settings = {name: digest([repr(getattr(model, name)).encode()]) for name in _SETTINGS}
    data = {f"data_files.{name}": source.sha256[name][:16] for name in model.data_files}
    return {**table, **settings, **data, **parameters_of(model.p._asdict())}


def parameters_of(values: Mapping[str, float]) -> Meaning:
    """Give parameters as they stand in a meaning."""
    return {f"parameters.{name}": float(value) for name, value in values.items()}


@cache
def loaded_meaning(source: ModelSource) -> Meaning:
    """Give the meaning of the model that `source.load` gives in this process."""
    return meaning_of(source.load(), source)


def differences(here: Mapping[str, Any], there: Mapping[str, Any]) -> list[str]:
    """Names of what has not the same meaning in two models."""
    return sorted(name for name in here.keys() | there.keys() if here.get(name) != there.get(name))


def check_is_constant(
    here: Mapping[str, Any], there: Mapping[str, Any], path: str, where: str
) -> None:
    """Raise an error if a model that was loaded twice has two meanings.

    Parameters
    ----------
    here, there : mapping
        The meanings of both loads.
    path : str
        Of the model's file.
    where : str
        What is said of it: "each time it is loaded".

    Raises
    ------
    ModelError
        With the first difference by its name.
    """
    found = differences(here, there)
    if found:
        # What a formula is comes of the constants: these first.
        thing = _thing(max(found, key=lambda name: "." in name), path)
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise ModelError(
            f"model.name: {thing} has another value {where}{more}; what formulas use must be the "
            f"same in every process: write the value down, or draw it with a fixed seed ({path})"
        )


def _thing(label: str, path: str) -> str:
    """Name in words what has a label in a meaning: ``C of helper.py``."""
    module, _, name = label.rpartition(".")
    file = f"{module.replace('.', '/')}.py"
    return f"{name} of {file if module not in ('', 'parameters') else Path(path).name}"
