"""Derivatives of formulas by reverse accumulation, which records further operations.

Source: Griewank, Walther, "Evaluating derivatives", 2008, section 3.2. Where a function has a jump
or a kink, the derivative is that of one side; that of a step is 0.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from pfdist.models.program import LOOPS, MASKS
from pfdist.models.symbols import Recording, RefusedError, Symbol, choose


def pulled(seeds: Sequence[tuple[Any, Any]], to: Sequence[Symbol]) -> list[Any]:
    """The derivatives of a weighted sum of values with respect to other values.

    Parameters
    ----------
    seeds : sequence of (value, weight)
        Numbers among the values count as constants.
    to : sequence of Symbol
        At least one.

    Returns
    -------
    list of Symbol or float
        One for each value of `to`; 0 where the sum does not depend on it.

    Raises
    ------
    RefusedError
        The sum depends on these values through a loop with a varying number of steps.
    """
    recording = to[0].recording
    depends = _depends(recording, {each.number for each in to})
    found = dict[int, Any]()
    for value, weight in seeds:
        if isinstance(value, Symbol):
            _add(found, value.number, weight)
    for number in range(len(depends) - 1, -1, -1):
        if number not in found or not depends[number]:
            continue
        name, arguments, _ = recording.operations[number]
        if name in LOOPS:
            raise RefusedError("a loop whose number of steps varies has no derivative")
        if name not in RULES:
            continue
        values = [_symbol(recording, each) for each in (number, *arguments)]
        for each, part in zip(arguments, RULES[name](found[number], *values), strict=True):
            if part is not None and depends[each]:
                _add(found, each, part())
    return [found.get(each.number, 0.0) for each in to]


def _symbol(recording: Recording, number: int) -> Symbol:
    is_mask = recording.operations[number].name in MASKS
    return Symbol(recording, number, "mask" if is_mask else "float")


def _depends(recording: Recording, on: set[int]) -> list[bool]:
    """Whether each operation depends on some of them."""
    depends = list[bool]()
    for number, (_, arguments, _) in enumerate(recording.operations):
        depends.append(number in on or any(depends[each] for each in arguments))
    return depends


def _add(found: dict[int, Any], number: int, value: Any) -> None:
    found[number] = found[number] + value if number in found else value


# --- the rule of each operation -------------------------------------------------------------------
#
# A rule gets the derivative d by the value of the operation, that value, and the arguments. For
# each argument it gives a function that records its part of the derivative, or None.


def product(a: Any, b: Any) -> Any:
    """The product of two values; a factor 0 or 1 records no operation."""
    for first, second in ((a, b), (b, a)):
        if isinstance(first, float) and first in (0.0, 1.0):
            return second if first else 0.0
    return a * b


def _of_one(slope: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """The rule of a function with a slope, from the argument and the value."""
    return lambda d, value, a: (lambda: product(d, slope(a, value)),)


def _of_two(first: Callable[..., Any], second: Callable[..., Any]) -> Callable[..., Any]:
    """The rule of a function of a and b with two slopes, from the value, a and b."""
    return lambda d, value, a, b: (
        lambda: product(d, first(value, a, b)),
        lambda: product(d, second(value, a, b)),
    )


def _chosen(takes_first: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """The rule of a function that gives one of its arguments."""
    return lambda d, _, a, b: (
        lambda: choose(takes_first(a, b), d, 0.0),
        lambda: choose(takes_first(a, b), 0.0, d),
    )


_LARGER = _chosen(lambda a, b: (a >= b) | np.isnan(b))
_SMALLER = _chosen(lambda a, b: (a <= b) | np.isnan(b))
RULES: Mapping[str, Callable[..., Any]] = {
    "add": _of_two(lambda value, a, b: 1.0, lambda value, a, b: 1.0),
    "subtract": _of_two(lambda value, a, b: 1.0, lambda value, a, b: -1.0),
    "multiply": _of_two(lambda value, a, b: b, lambda value, a, b: a),
    "divide": _of_two(lambda value, a, b: 1.0 / b, lambda value, a, b: -value / b),
    "power": _of_two(
        lambda value, a, b: b * a ** (b - 1.0), lambda value, a, b: value * np.log(a)
    ),
    "where": lambda d, _, mask, a, b: (
        None, lambda: choose(mask, d, 0.0), lambda: choose(mask, 0.0, d),
    ),
    "maximum": _LARGER, "fmax": _LARGER, "minimum": _SMALLER, "fmin": _SMALLER,
    "logaddexp": _of_two(
        lambda value, a, b: np.exp(a - value), lambda value, a, b: np.exp(b - value)
    ),
    "hypot": _of_two(lambda value, a, b: a / value, lambda value, a, b: b / value),
    "arctan2": _of_two(
        lambda value, a, b: b / (a * a + b * b), lambda value, a, b: -a / (a * a + b * b)
    ),
    "remainder": _of_two(lambda value, a, b: 1.0, lambda value, a, b: -np.floor(a / b)),
    "fmod": _of_two(lambda value, a, b: 1.0, lambda value, a, b: -np.trunc(a / b)),
    "copysign": _of_two(
        lambda value, a, b: np.copysign(1.0, a) * np.copysign(1.0, b), lambda value, a, b: 0.0
    ),
    "negative": _of_one(lambda a, value: -1.0),
    "absolute": _of_one(lambda a, value: np.sign(a)),
    "sqrt": _of_one(lambda a, value: 0.5 / value),
    "cbrt": _of_one(lambda a, value: 1.0 / (3.0 * value * value)),
    "exp": _of_one(lambda a, value: value),
    "exp2": _of_one(lambda a, value: value * np.log(2.0)),
    "expm1": _of_one(lambda a, value: value + 1.0),
    "log": _of_one(lambda a, value: 1.0 / a),
    "log2": _of_one(lambda a, value: 1.0 / (a * np.log(2.0))),
    "log10": _of_one(lambda a, value: 1.0 / (a * np.log(10.0))),
    "log1p": _of_one(lambda a, value: 1.0 / (1.0 + a)),
    "sin": _of_one(lambda a, value: np.cos(a)),
    "cos": _of_one(lambda a, value: -np.sin(a)),
    "tan": _of_one(lambda a, value: 1.0 + value * value),
    "arcsin": _of_one(lambda a, value: 1.0 / np.sqrt(1.0 - a * a)),
    "arccos": _of_one(lambda a, value: -1.0 / np.sqrt(1.0 - a * a)),
    "arctan": _of_one(lambda a, value: 1.0 / (1.0 + a * a)),
    "sinh": _of_one(lambda a, value: np.cosh(a)),
    "cosh": _of_one(lambda a, value: np.sinh(a)),
    "tanh": _of_one(lambda a, value: 1.0 - value * value),
    "arcsinh": _of_one(lambda a, value: 1.0 / np.sqrt(a * a + 1.0)),
    "arccosh": _of_one(lambda a, value: 1.0 / np.sqrt(a * a - 1.0)),
    "arctanh": _of_one(lambda a, value: 1.0 / (1.0 - a * a)),
}  # fmt: skip
"""The rules; operations without one are steps, whose derivative is 0."""
