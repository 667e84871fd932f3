"""Parameters of models: numbers, and sequences with a number for each instant."""

from collections import namedtuple
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from pfdist.errors import ModelError

Parameter = float | Sequence[float]
"""A number, or a number for each instant 0..T."""

_INSTANTS = 100  # of the clock of a trial call, which is made for t = 0

CLOCK: Final = ("time", "dt")
"""Parameters that the clock of a job gives: the time of each instant, and the time to the next."""


def values_of_parameter(value: Any) -> Iterable[Any]:
    """Give the numbers of a parameter."""
    if isinstance(value, np.ndarray) and value.ndim == 1:
        return list(value.tolist())
    return value if isinstance(value, list | tuple) and value else (value,)


def fixed_parameter(value: Any) -> Any:
    """Give a checked parameter so that it can be compared: a sequence becomes a tuple."""
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(map(float, values_of_parameter(value)))
    return value


def named_parameters(parameters: Mapping[str, Any]) -> Any:
    """Give a named tuple of floats, and of arrays that cannot be written."""
    kind = namedtuple("Parameters", parameters)  # type: ignore[misc]
    return kind(**{name: _as_read(value) for name, value in parameters.items()})


def trial_parameters(parameters: Mapping[str, Any]) -> Any:
    """Give the parameters for a trial call, with a clock in case that the formulas read it."""
    clock = dict(zip(CLOCK, (tuple(range(_INSTANTS)), (1.0,) * _INSTANTS), strict=True))
    return named_parameters(clock | dict(parameters))


def _as_read(value: Any) -> Any:
    if not isinstance(value, tuple):
        return float(value)
    array = np.array(value)
    array.flags.writeable = False
    return array


def parameter_names(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Give the names of parameters as compiled code is told them: a varying one as ``name[t]``."""
    return tuple(
        f"{name}[t]" if isinstance(value, tuple) else name for name, value in parameters.items()
    )


def check_lengths(
    parameters: Mapping[str, Any], instants: int, where: str = "parameter ", exactly: bool = False
) -> None:
    """Raise an error unless each parameter that varies with t has a number for each instant.

    Parameters
    ----------
    parameters : mapping of str to float or tuple of float
    instants : int
    where : str
        The words before a parameter's name in the error.
    exactly : bool
        Whether more numbers are wrong, too.

    Raises
    ------
    ModelError
        A parameter has too few numbers, or too many.
    """
    for name, value in parameters.items():
        got = len(value) if isinstance(value, tuple) else instants
        if got < instants or (exactly and got > instants):
            raise ModelError(
                f"{where}{name} must have a number for each of {instants} instants, got {got}"
            )


def flat_parameters(parameters: Mapping[str, Any], instants: int) -> Any:
    """Give all numbers of parameters in an array: first the constant ones, then the varying ones.

    The varying parameters have as many numbers as there are instants, one parameter after another.

    Raises
    ------
    ModelError
        A varying parameter has fewer numbers than there are instants. Compiled formulas rely on
        this check: they read ``p.rate[t]`` without one.
    """
    check_lengths(parameters, instants)
    numbers = [value for value in parameters.values() if not isinstance(value, tuple)]
    varying = [value for value in parameters.values() if isinstance(value, tuple)]
    return np.array(
        [*numbers, *(number for values in varying for number in values[:instants])], np.float64
    )
