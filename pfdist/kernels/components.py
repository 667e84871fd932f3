"""Compiled functions that read tuples from arrays, and write tuples to arrays.

A formula has one particle's components as a tuple; an array has them along one of its axes. Numba
cannot build a tuple whose length depends on a variable. So these functions are made from a line of
source for each number of components.
"""

import re
from collections import namedtuple
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from pfdist.kernels.melting import melted

_VARYING = "[t]"  # the end of the name of an array that has an entry for each instant


@cache
def tuple_of(
    components: int, arguments: str, entry: str | tuple[str, ...], **functions: Callable[..., Any]
) -> Callable[..., Any]:
    """Compile a function whose result is a tuple with an entry for each component.

    `arguments` names the function's arguments. `entry` is the expression of entry c, for instance
    ``"a[c] + b[c]"``, or there is an expression for each entry. `functions` are those that the
    expressions call, by name.
    """
    expressions = (entry,) * components if isinstance(entry, str) else entry
    entries = "".join(f"{_for_component(c, text)}," for c, text in enumerate(expressions))
    return _made(f"def result({arguments}):\n    return ({entries})\n", **functions)


def reader(components: int, axes: str) -> Callable[..., Any]:
    """Compile ``read(array, ...)``, which gives a tuple of float64 along the axis called c.

    For instance the axes ``"c, i"`` give ``read(array, i) -> (array[0, i], array[1, i], ...)``.
    """
    return tuple_of(components, f"array, {_other(axes)}", f"float64(array[{axes}])")


@cache
def writer(components: int, axes: str) -> Callable[..., Any]:
    """Compile ``write(array, ..., values)``, which writes a tuple; see `reader`."""
    lines = "".join(
        f"    {_for_component(c, f'array[{axes}] = values[c]')}\n" for c in range(components)
    )
    return _made(f"def result(array, {_other(axes)}, values):\n{lines or '    pass'}\n")


def _for_component(component: int, text: str) -> str:
    return re.sub(r"\bc\b", str(component), text)


def _other(axes: str) -> str:
    return ", ".join(axis for axis in axes.split(", ") if axis != "c")


@cache
def naming(names: tuple[str, ...]) -> Callable[..., Any]:
    """Compile ``named(values)``, which gives a named tuple of the entries of an array.

    A name such as ``rate[t]`` stands for an array. The arrays follow the numbers, and all have the
    same length.
    """
    varying = [name for name in names if name.endswith(_VARYING)]
    numbers, length = len(names) - len(varying), f"(values.size - {len(names) - len(varying)})"
    length = f"{length} // {max(1, len(varying))}"
    places = {name: str(i) for i, name in enumerate(n for n in names if n not in varying)} | {
        name: f"{numbers} + {k} * length : {numbers} + {k + 1} * length"
        for k, name in enumerate(varying)
    }
    kind = namedtuple("Parameters", [name.removesuffix(_VARYING) for name in names])  # type: ignore[misc]
    entries = ", ".join(f"values[{places[name]}]" for name in names)
    source = f"def result(values):\n    length = {length}\n    return kind({entries})\n"
    return _made(source, kind=kind)


def _made(source: str, **names: Any) -> Callable[..., Any]:
    scope: dict[str, Any] = {"float64": np.float64, "uintp": np.uintp, **names}
    exec(source, scope)  # noqa: S102  the source above consists of numbers and our own words
    return melted(scope["result"])
