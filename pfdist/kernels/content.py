"""The content of values as bytes, functions among them with all that they use.

One walk serves two readers. The cache of compiled code reads bytecode
(`pfdist.kernels.fingerprint`); the identity of a run reads syntax (`pfdist.meaning`).
"""

import dis
import types
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

from pfdist.jitted import names_in

Parts = Iterator[bytes]
Names = frozenset[str] | None

_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))
_GLOBAL = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS")


class UnknownContentError(Exception):
    """A value whose content cannot be told."""


class Content(ABC):
    """A walk through values that gives their content as bytes, in parts.

    A subclass says how it tells code, what it tells by its name alone, and what it does with the
    global variables of functions and with values of further kinds.
    """

    def __init__(self) -> None:
        self.told: list[Any] = []  # functions, and modules with names: what recurs ends
        self._within: list[int] = []  # containers around the value at hand

    @abstractmethod
    def code(self, function: types.FunctionType) -> Parts:
        """Give the content of a function's code, without that of what it uses."""

    @abstractmethod
    def by_name(self, value: Any) -> str | None:
        """Give the name of a value that is told by its name; None if it is walked through."""

    def variable(self, scope: Mapping[str, Any], name: str, names: Names) -> Parts:
        """Give the content of a module's global variable, which a function with `names` uses."""
        yield name.encode()
        yield from self.parts(scope[name], names)

    def other(self, value: Any, names: Names) -> Parts:
        """Give the content of a value of a kind that is not known here."""
        raise UnknownContentError(repr(value))

    def parts(self, value: Any, names: Names = None) -> Parts:
        """Give the content of a value.

        `names` are those that the code around the value uses: of a module only these matter. None
        stands for all.
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
            yield from self._module(value, names)
        elif id(value) in self._within:  # a list in itself
            yield str(self._within.index(id(value))).encode()
        else:
            self._within.append(id(value))
            yield from self._structure(value, names)
            self._within.pop()

    def entries(self, values: Any, names: Names) -> Parts:
        """Give the content of the entries of a sequence."""
        yield str(len(values)).encode()
        for entry in values:
            yield from self.parts(entry, names)

    def _structure(self, value: Any, names: Names) -> Parts:
        if type(value) in (tuple, list):
            yield from self.entries(value, names)
        elif isinstance(value, CPUDispatcher):
            if value.locals or not value._can_compile:  # types that its author has fixed
                raise UnknownContentError(repr(value))
            yield repr(sorted(value.targetoptions.items())).encode()
            yield from self.parts(value.py_func, names)
        else:
            yield from self.other(value, names)

    def _function(self, function: types.FunctionType) -> Parts:
        if function in self.told:
            yield str(self.told.index(function)).encode()
            return
        self.told.append(function)
        names = frozenset(names_in(function.__code__))
        yield from self.code(function)
        keywords = tuple(sorted((function.__kwdefaults__ or {}).items()))
        yield from self.parts((function.__defaults__, keywords), names)
        for cell in function.__closure__ or ():
            yield from self.parts(cell.cell_contents, names)
        scope = function.__globals__
        for name in sorted(globals_in(function.__code__) & scope.keys()):
            yield from self.variable(scope, name, names)

    def _module(self, module: types.ModuleType, names: Names) -> Parts:
        yield module.__name__.rpartition(".")[2].encode()
        if (module, names) in self.told:
            return
        self.told.append((module, names))
        scope = vars(module)
        for name in sorted(scope.keys() if names is None else names & scope.keys()):
            yield from self.variable(scope, name, names)


@cache
def globals_in(code: types.CodeType) -> frozenset[str]:
    """Names of global variables that a function and those it defines read."""
    names = {step.argval for step in dis.get_instructions(code) if step.opname in _GLOBAL}
    inner = [globals_in(inner) for inner in code.co_consts if isinstance(inner, types.CodeType)]
    return frozenset(names).union(*inner)


@cache
def imports(code: types.CodeType) -> bool:
    """Whether a function, or one that it defines, imports something when it is called."""
    inner = (inner for inner in code.co_consts if isinstance(inner, types.CodeType))
    own = any(step.opname == "IMPORT_NAME" for step in dis.get_instructions(code))
    return own or any(map(imports, inner))
