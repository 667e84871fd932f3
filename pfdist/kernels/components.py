"""Tuples of components out of arrays and back, for compiled code.

A formula sees one particle's components as a tuple; the cloud is an array (components,
particles). Numba cannot build a tuple of a length that is only known when a model is given, so
these few functions are made from a line of source for each number of components.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit


def formula(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a formula so that it melts into the loop that calls it.

    Division by zero gives inf or nan as in NumPy: a branch to raise would stop vectorisation.
    """
    return njit(function, error_model="numpy", forceinline=True, nogil=True)


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
