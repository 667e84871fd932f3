"""Parameters of models: numbers, and sequences with a number for each instant."""

import math
from collections import namedtuple
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pfdist.common.measurement_times import CLOCK, DATES
from pfdist.errors import ModelError

Parameter = float | Sequence[float]
"""A number, or a number for each instant 0..T."""

NOT_NEGATIVE, POSITIVE = (0.0, math.inf), (1e-9, math.inf)
"""Ranges of parameters of the built-in models."""

_INSTANTS = 100  # length of the clock of a trial call, which is made for t = 0


def values_of_parameter(value: Any) -> Iterable[Any]:
    """The numbers of a parameter."""
    value = _plain(value)
    return value if isinstance(value, list | tuple) and value else (value,)


def fixed_parameter(value: Any) -> Any:
    """A checked parameter that can be compared: a sequence becomes a tuple."""
    value = _plain(value)
    return tuple(map(float, value)) if isinstance(value, list | tuple) else float(value)


def _plain(value: Any) -> Any:
    """An array, or a column of a DataFrame, as a list; other values as they are."""
    is_column = hasattr(value, "tolist") and getattr(value, "ndim", 0) == 1
    return value.tolist() if is_column else value


def named_parameters(parameters: Mapping[str, Any]) -> Any:
    """A named tuple of floats and read-only arrays."""
    kind = namedtuple("Parameters", parameters)  # type: ignore[misc]
    return kind(**{name: _as_read(value) for name, value in parameters.items()})


def trial_parameters(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters for a trial call, with a clock and dates in case the formulas read them."""
    clock = dict.fromkeys((*CLOCK, *DATES), (1.0,) * _INSTANTS) | {"time": tuple(range(_INSTANTS))}
    return clock | dict(parameters)


def _as_read(value: Any) -> Any:
    if not isinstance(value, tuple):
        return float(value)
    array = np.array(value)
    array.flags.writeable = False
    return array


def check_lengths(
    parameters: Mapping[str, Any], instants: int, where: str = "parameter ", exactly: bool = False
) -> None:
    """Raise `ModelError` unless each parameter that varies with t has a number for each instant.

    `where` comes before a parameter's name in the error. With `exactly`, more numbers than instants
    are also wrong.
    """
    for name, value in parameters.items():
        got = len(value) if isinstance(value, tuple) else instants
        if got < instants or (exactly and got > instants):
            raise ModelError(
                f"{where}{name} needs {instants} values, one for each instant, got {got}"
            )
