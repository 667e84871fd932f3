"""Tuples of components out of arrays and back, for compiled code.

A formula sees one particle's components as a tuple; the cloud is an array (components,
particles). Numba cannot build a tuple of a length that is only known when a model is given, so
these few functions are made from a line of source for each number of components.
"""

import contextlib
import re
import types
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numba.core.errors import NumbaError

from pfdist.errors import ModelError


def formula(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a formula so that it melts into the loop that calls it.

    Functions it calls by their own names are compiled with it. Division by zero gives inf or nan
    as in NumPy: a branch to raise would stop vectorisation.
    """
    return njit(_with_helpers(function), error_model="numpy", forceinline=True, nogil=True)


def _with_helpers(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, seeing compiled ones where it sees plain functions of its author."""

    def seen(value: Any) -> Any:
        plain = isinstance(value, types.FunctionType) and not value.__module__.startswith("pfdist.")
        return formula(value) if plain and value is not function else value

    used = {
        name: function.__globals__[name]
        for name in _names(function.__code__)
        if name in function.__globals__
    }
    cells = [types.CellType(seen(cell.cell_contents)) for cell in function.__closure__ or ()]
    scope = function.__globals__ | {name: seen(value) for name, value in used.items()}
    return types.FunctionType(
        function.__code__, scope, function.__name__, function.__defaults__, tuple(cells)
    )


def _names(code: types.CodeType) -> set[str]:
    inner = [
        _names(constant) for constant in code.co_consts if isinstance(constant, types.CodeType)
    ]
    return set(code.co_names).union(*inner)


_OURS = re.compile(r"(^|/)pfdist/(kernels/|draws\.py|particle_filter\.py)")


@contextlib.contextmanager
def formulas_of(model: str) -> Iterator[None]:
    """Turn what goes wrong in a model's formulas into one line.

    Raises
    ------
    ModelError
        A formula cannot be compiled, with the reason and the line at fault; or it raised.
    """
    try:
        yield
    except NumbaError as error:
        text = str(error)
        reasons = re.findall(
            r"^.*(?:Untyped global name|No implementation of function|Unknown "
            r"attribute|Cannot|cannot|Invalid use|Use of unsupported).*$",
            text,
            re.M,
        )
        places = re.findall(r'File "(.*?)", line (\d+)', text)
        own = [f"{file}:{line}" for file, line in places if not _OURS.search(file)]
        raise ModelError(
            f"model {model} cannot be compiled by Numba: "
            f"{(reasons or text.strip().splitlines())[0].strip()}"
            f"{f' ({own[-1]})' if own else ''}; formulas may use operators, NumPy's elementwise "
            "functions on numbers, pfdist.where and pfdist.clip"
        ) from error
    except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise ModelError(
            f"model {model}: a formula failed: {type(error).__name__}: {error}"
        ) from error


@cache
def reader(components: int) -> Callable[..., Any]:
    """``read(array, i) -> (array[0, i], array[1, i], ...)`` as float64."""
    entries = "".join(f"float64(array[{c}, i])," for c in range(components))
    return _made(f"def read(array, i):\n    return ({entries})\n", "read")


@cache
def writer(components: int) -> Callable[..., Any]:
    """``write(array, i, values)`` puts a tuple of components into column i."""
    lines = "".join(f"    array[{c}, i] = values[{c}]\n" for c in range(components))
    return _made(f"def write(array, i, values):\n{lines or '    pass'}\n", "write")


def _made(source: str, name: str) -> Callable[..., Any]:
    scope: dict[str, Any] = {"float64": np.float64}
    exec(source, scope)  # noqa: S102  the source is made above, of a number alone
    return njit(scope[name], forceinline=True, nogil=True)
