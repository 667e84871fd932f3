"""Copies of formulas with the same code, in which names refer to other objects.

A formula may call functions that its author compiled with `numba.njit`. Numba compiles these
without checks of their indices, and they take no symbols. So a model takes the Python functions
from which they were made.
"""

import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

from numba.extending import is_jitted

from pfdist.errors import ModelError
from pfdist.models.mistakes import place_of_function

_PLACE = {"__file__", "__path__"}  # show that a module is the user's
_LIBRARIES = sys.stdlib_module_names | {
    *("llvmlite", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "ray", "scipy"),
}


def is_library(module: str) -> bool:
    """Whether a module belongs to Python, to a known library, or to pfdist itself.

    The built-in models do not count as a library.
    """
    top, _, rest = module.partition(".")
    if top == "pfdist":
        return not rest.startswith("models.library")
    return top in _LIBRARIES


def _codes_in(code: types.CodeType) -> Iterator[types.CodeType]:
    """The code of a function, and of the functions that it defines."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes_in(constant)


def names_in(code: types.CodeType) -> set[str]:
    """Names of globals and attributes in a function and in the functions that it defines."""
    return {name for each in _codes_in(code) for name in each.co_names}


def seeing(function: types.FunctionType, instead: Callable[[Any], Any]) -> types.FunctionType:
    """A function with the same code, in which names refer to other objects.

    `instead` gives the replacement of a global variable, a variable of its closure or a default. A
    user's module is replaced by a copy with the variables that the function names.
    """
    scope, names = function.__globals__, names_in(function.__code__)
    copies: dict[int, types.ModuleType] = {}

    def seen(value: Any) -> Any:
        if type(value) is tuple:
            return tuple(map(seen, value))
        if isinstance(value, types.ModuleType) and not is_library(value.__name__):
            if id(value) not in copies:
                copies[id(value)] = copy = types.ModuleType(value.__name__)
                own = vars(value)
                keys = (names | _PLACE) & own.keys()
                copy.__dict__.update({key: seen(own[key]) for key in keys})
            return copies[id(value)]
        return instead(value)

    cells = [_same_cell(cell, seen) for cell in function.__closure__ or ()]
    same = types.FunctionType(
        function.__code__,
        scope | {key: seen(scope[key]) for key in names & scope.keys()},
        function.__name__,
        function.__defaults__ and tuple(map(seen, function.__defaults__)),
        tuple(cells),
    )
    keywords = function.__kwdefaults__
    same.__kwdefaults__ = keywords and {key: seen(value) for key, value in keywords.items()}
    same.__qualname__ = function.__qualname__
    return same


def _same_cell(cell: types.CellType, seen: Callable[[Any], Any]) -> types.CellType:
    try:
        return types.CellType(seen(cell.cell_contents))
    except ValueError:  # it has no value yet
        return cell


def in_python(function: Any) -> Any:
    """A formula in which compiled functions are replaced by their Python functions.

    It is the formula itself if there is no compiled function; a callable object is left unchanged.
    Raises `ModelError` if a function was compiled by anything but `numba.njit`.
    """
    if is_jitted(function):
        function = function.py_func
    if isinstance(function, types.MethodType):
        seen = in_python(function.__func__)
        return function if seen is function.__func__ else types.MethodType(seen, function.__self__)
    if not isinstance(function, types.FunctionType):
        return function
    same, changed = _in_python(function, (), {})
    return same if changed else function


def home_of(function: types.FunctionType) -> str:
    """The name of the module in which a function is defined."""
    return str(function.__globals__.get("__name__"))


_Copies = dict[types.FunctionType, tuple[types.FunctionType, bool]]


def _in_python(
    function: types.FunctionType, callers: tuple[types.FunctionType, ...], copies: _Copies
) -> tuple[types.FunctionType, bool]:
    """The formula that sees Python functions, and whether it reaches a compiled function."""
    if function in copies:
        return copies[function]
    changed, called_by = False, (*callers, function)

    def instead(value: Any) -> Any:
        nonlocal changed
        replacement = value.py_func if is_jitted(value) else value
        if isinstance(replacement, types.FunctionType):
            if is_library(home_of(replacement)) or replacement in called_by:
                return replacement
            replacement, inside = _in_python(replacement, called_by, copies)
            changed |= inside or is_jitted(value)
        elif type(value).__module__.startswith("numba."):
            raise ModelError(
                "may call functions that numba.njit compiles, got "
                f"{getattr(value, '__name__', value)!r}, a {type(value).__name__}"
                f"{place_of_function(function)}"
            )
        return replacement

    same = seeing(function, instead)
    copies[function] = same, changed
    return copies[function]
