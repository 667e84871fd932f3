"""The content of values as bytes, where functions include all that they use.

The walk has two users. The cache of compiled code reads bytecode (`pfdist.kernels.fingerprint`).
The identity of a run reads syntax (`pfdist.meaning`).
"""

import types
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

from pfdist.kernels.uses import Uses, globals_in, uses_in

Parts = Iterator[bytes]

_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))


class UnknownContentError(Exception):
    """The content of a value cannot be given as bytes."""


class Content(ABC):
    """A walk through values that gives their content as bytes, in parts.

    A subclass defines the content of code, which values count by their names only, and how to treat
    global variables and values of further kinds.
    """

    def __init__(self) -> None:
        self.told: list[Any] = []  # functions and modules that were visited: ends a recursion
        self._within: list[int] = []  # containers around the value at hand

    @abstractmethod
    def code(self, function: types.FunctionType) -> Parts:
        """Give the content of a function's code, without that of what it uses."""

    @abstractmethod
    def by_name(self, value: Any) -> str | None:
        """Give the name of a value that counts by its name; None if its content counts."""

    def variable(self, scope: Mapping[str, Any], name: str, uses: Uses | None) -> Parts:
        """Give the content of a global variable; `uses` says what a function uses of it."""
        yield name.encode()
        yield from self.parts(scope[name], uses)

    def dispatcher(self, function: CPUDispatcher) -> Parts:
        """Give the content of a function that its author compiled with Numba."""
        yield repr(sorted(function.targetoptions.items())).encode()
        yield from self.parts(function.py_func)

    def other(self, value: Any) -> Parts:
        """Give the content of a value of another kind."""
        raise UnknownContentError(repr(value))

    def parts(self, value: Any, uses: Uses | None = None) -> Parts:
        """Give the content of a value.

        `uses` are the names in the code around the value: only the attributes of a module that are
        named there matter. None means all attributes, also of modules inside the value.
        """
        yield type(value).__name__.encode()
        name = self.by_name(value)
        if name is not None:
            yield name.encode()
        elif type(value) in _PLAIN:
            yield repr(value).encode()
        elif isinstance(value, np.generic) and value.dtype.kind in "biufcSUMm":
            yield from (value.dtype.str.encode(), value.tobytes())
        elif type(value) is np.ndarray and value.dtype.kind in "biufc":
            yield from (value.dtype.str.encode(), str(value.shape).encode(), value.tobytes())
        elif isinstance(value, types.FunctionType):
            yield from self._function(value)
        elif isinstance(value, types.ModuleType):
            yield from self._module(value, uses)
        elif id(value) in self._within:  # a list in itself
            yield str(self._within.index(id(value))).encode()
        else:
            self._within.append(id(value))
            yield from self._structure(value)
            self._within.pop()

    def entries(self, values: Collection[Any]) -> Parts:
        """Give the content of the entries of a sequence."""
        yield str(len(values)).encode()
        for entry in values:
            yield from self.parts(entry)

    def cell(self, cell: types.CellType, uses: Uses | None = None) -> Parts:
        """Give the content of a variable in a closure."""
        yield from self.parts(cell.cell_contents, uses)

    def _structure(self, value: Any) -> Parts:
        if type(value) in (tuple, list):
            yield from self.entries(value)
        elif isinstance(value, CPUDispatcher):
            yield from self.dispatcher(value)
        else:
            yield from self.other(value)

    def _function(self, function: types.FunctionType) -> Parts:
        if function in self.told:
            yield str(self.told.index(function)).encode()
            return
        self.told.append(function)
        code, scope = function.__code__, function.__globals__
        uses = uses_in(code)
        yield from self.code(function)
        keywords = tuple(sorted((function.__kwdefaults__ or {}).items()))
        yield from self.parts((function.__defaults__, keywords))
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            yield from self.cell(cell, uses.through(name))
        for name in sorted(globals_in(code) & scope.keys()):
            yield from self.variable(scope, name, uses.through(name))

    def _module(self, module: types.ModuleType, uses: Uses | None) -> Parts:
        yield module.__name__.rpartition(".")[2].encode()
        if (module, uses) in self.told:
            return
        self.told.append((module, uses))
        scope = vars(module)
        wanted = scope.keys() if uses is None else {*uses.named, "__getattr__"} & scope.keys()
        for name in sorted(wanted):
            yield from self.variable(scope, name, None if uses is None else uses.through(name))
