"""Checks of the fields that a user gives to a model."""

import inspect
import keyword
import math
from pathlib import PurePosixPath
from typing import Any

from pfdist.errors import ModelError, shown
from pfdist.mistakes.places import place_of_function
from pfdist.models.parameters import Parameter, values_of_parameter
from pfdist.models.trial_calls import ARGUMENTS

NOISE_KINDS = ("normal", "uniform")


def check_fields(model: Any) -> None:
    """Refuse fields of a model that are wrong before any formula is called.

    Parameters
    ----------
    model : StateSpaceModel

    Raises
    ------
    ModelError
        A formula does not take its arguments, a kind of noise is unknown, a data file lies outside
        the folder, or a parameter has a wrong name or value. The message names the field.
    """
    for name, arguments in ARGUMENTS.items():
        _check_signature(model, name, arguments)
    for name in ("initial_noise", "process_noise", "measurement_noise"):
        _check_noise(model, name)
    _check_data_files(model)
    for name in model.parameter_ranges:
        if name not in model.parameters:
            raise ModelError(
                f"model {model.name}: parameter_ranges must name parameters, got {name!r}; "
                f"parameters: {', '.join(model.parameters) or 'none'}"
            )
    for name, value in model.parameters.items():
        _check_parameter(model, name, value)


def _check_signature(model: Any, name: str, arguments: tuple[str, ...]) -> None:
    function = getattr(model, name)
    expected = f"model {model.name}: {name} must be a function of ({', '.join(arguments)})"
    if not inspect.isfunction(function):
        raise ModelError(f"{expected}, got {function!r}")
    signature = inspect.signature(function)
    try:
        signature.bind(*arguments)
    except TypeError as error:
        place = place_of_function(function)
        raise ModelError(f"{expected}, got {signature}{place}") from error


def _check_noise(model: Any, name: str) -> None:
    kinds = getattr(model, name)
    if not isinstance(kinds, tuple) or any(kind not in NOISE_KINDS for kind in kinds):
        allowed = " or ".join(map(repr, NOISE_KINDS))
        raise ModelError(
            f"model {model.name}: {name} must be a tuple of {allowed}, an entry for each "
            f"component, got {kinds!r}"
        )


def _check_data_files(model: Any) -> None:
    files = model.data_files
    if not isinstance(files, tuple) or not all(map(is_in_folder, files)):
        raise ModelError(
            f"model {model.name}: data_files must be a tuple of names relative to the folder of "
            f"the model's file, and in it, got {files!r}"
        )


def _check_parameter(model: Any, name: str, value: Parameter) -> None:
    if not name.isidentifier() or name.startswith("_") or keyword.iskeyword(name):
        raise ModelError(
            f"model {model.name}: the name of a parameter must be that of a variable, got {name!r}"
        )
    low, high = model.parameter_ranges.get(name, (-math.inf, math.inf))
    for number in values_of_parameter(value):
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise ModelError(
                f"model {model.name}: parameter {name} must be a number, or a sequence of "
                f"numbers, one for each instant, got {shown(value)}"
            )
        if not (math.isfinite(number) and low <= number <= high):
            raise ModelError(
                f"model {model.name}: parameter {name} must be a finite number in "
                f"{low:g}..{high:g}, got {number!r}"
            )


def is_in_folder(name: Any) -> bool:
    """Whether a name is a path relative to a folder that stays in this folder."""
    if not isinstance(name, str):
        return False
    path = PurePosixPath(name)
    return (
        bool(path.parts) and "\0" not in name and not path.is_absolute() and ".." not in path.parts
    )
