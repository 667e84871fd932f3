"""Trial calls of a model's formulas on arrays of two particles, and what is wrong with the values.

A trial call finds the numbers of components, and mistakes such as a missing comma or `return`, as
soon as a model is made.
"""

import contextlib
from typing import Any

import numpy as np

from pfdist.errors import ModelError
from pfdist.mistakes.endings import is_interrupt, kept_alive, told
from pfdist.mistakes.places import place_of, place_of_function
from pfdist.mistakes.remedies import remedy

ARGUMENTS = {
    "initial": ("w", "p"),
    "transition": ("x", "t", "w", "p"),
    "measurement": ("x", "t", "v", "p"),
    "log_likelihood": ("y", "x", "t", "p"),
    "quantity_of_interest": ("x", "t", "p"),
    "error": ("z", "estimate", "t", "p"),
}
"""Names of a model's formulas, and of their arguments."""

_PARTICLES = 2
_ONE_NUMBER = {
    "log_likelihood": "one number a particle",
    "error": "one number for z and its estimate",
}


def count_components(model: Any, p: Any) -> tuple[int, int, int]:
    """Give the numbers of components of x, y and z, by calling every formula once.

    Parameters
    ----------
    model : StateSpaceModel
    p : named tuple
        The parameters as formulas read them.

    Raises
    ------
    ModelError
        A formula fails, or gives values of a wrong kind or number.
    """
    with np.errstate(all="ignore"):
        x = _call(model, "initial", _variates(model.initial_noise), p)
        following = _call(model, "transition", x, 0, _variates(model.process_noise), p)
        if len(following) != len(x):
            raise ModelError(
                f"model {model.name}: transition must give as many components as initial, "
                f"{len(x)}, got {len(following)}"
            )
        y = _call(model, "measurement", x, 0, _variates(model.measurement_noise), p)
        z = _call(model, "quantity_of_interest", x, 0, p)
        _call(model, "log_likelihood", y, x, 0, p)
        _call(model, "error", z, z, 0, p)
    return len(x), len(y), len(z)


def _variates(kinds: tuple[str, ...]) -> tuple[Any, ...]:
    return tuple(np.full(_PARTICLES, 0.5) for _ in kinds)


def _call(model: Any, name: str, *arguments: Any) -> Any:
    """Give the value of a formula, after checking it."""
    formula = getattr(model, name)
    try:
        with kept_alive():
            value = formula(*arguments)
    except BaseException as error:  # a formula may raise any exception
        if is_interrupt(error):
            raise
        raise ModelError(
            f"model {model.name}: {name} failed on arrays: {told(error)}"
            f"{_advice(model, name, arguments, error)}{place_of(error)}"
        ) from error
    wrong = _wrong_kind(name, value) or _wrong_shape(value)
    if wrong:
        place = place_of_function(formula)
        raise ModelError(f"model {model.name}: {name} must give {wrong}{place}")
    return value


def _advice(model: Any, name: str, arguments: tuple[Any, ...], error: BaseException) -> str:
    """Say what to write instead, with the sizes that only the model knows."""
    if "tuple index out of range" in str(error):
        sizes = [
            f"{argument} has {len(value)}"
            for argument, value in zip(ARGUMENTS[name], arguments, strict=True)
            if argument != "p" and isinstance(value, tuple)
        ]
        return f"; numbers of components: {', '.join(sizes)}, and the first is [0]"
    if "'Parameters' object" in str(error):
        return f"; parameters: {', '.join(model.parameters) or 'none'}"
    return remedy(error)


def _wrong_kind(name: str, value: Any) -> str:
    """Say which kind of value a formula must give, and which it gave; empty if it is right."""
    if name in _ONE_NUMBER:
        right = _is_number(value)
        return "" if right else f"{_ONE_NUMBER[name]}, got {_described(value)}"
    if isinstance(value, tuple) and value and all(map(_is_number, value)):
        return ""
    return f"a tuple of components, even of a single component: (a,), got {_described(value)}"


def _wrong_shape(value: Any) -> str:
    for number in value if isinstance(value, tuple) else (value,):
        if np.shape(number) not in ((), (_PARTICLES,)):
            return (
                f"a number or an array of {_PARTICLES} for {_PARTICLES} particles, got an array of "
                f"shape {np.shape(number)}: is a tuple used as a component, w in place of w[0]?"
            )
    return ""


def _is_number(value: Any) -> bool:
    """Whether a value is a number or an array of numbers."""
    return not isinstance(value, tuple | list) and np.asarray(value).dtype.kind in "fiub"


def _described(value: Any) -> str:
    """Describe a wrong value, and what it lacks."""
    if value is None:
        return "None: is there no `return`?"
    if isinstance(value, list):
        return "a list: write (a, b) in place of [a, b]"
    if isinstance(value, tuple):
        wrong = next((entry for entry in value if not _is_number(entry)), None)
        if wrong is None:
            return f"{'an empty' if not value else 'a'} tuple"
        return f"a tuple that contains {_kind(wrong)}"
    return _kind(value)


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"a {type(value).__name__}"
    with contextlib.suppress(TypeError, ValueError):
        kind = np.asarray(value).dtype.kind
        if kind == "c":
            return "complex numbers"
        if kind in "fiub":
            return "an array" if np.ndim(value) else "a number"
    return type(value).__name__
