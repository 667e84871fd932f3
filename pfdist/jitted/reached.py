"""The walk from a formula to every function and value that it can reach."""

import functools
import sys
import types
from collections.abc import Iterator, Mapping
from typing import Any

from numba.core.registry import CPUDispatcher
from numba.np.ufunc.dufunc import DUFunc
from numba.np.ufunc.gufunc import GUFunc

COMPILED = (CPUDispatcher, DUFunc, GUFunc)
"""Kinds of functions that Numba compiled from a Python function."""

_LIBRARIES = sys.stdlib_module_names | {
    *("llvmlite", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "ray", "scipy"),
}

_UNNAMED = frozenset({"__call__", "__wrapped__", "__getitem__", "__getattr__"})
"""Attributes that are used without being named."""


def python_function(compiled: Any) -> types.FunctionType:
    """Give the Python function from which a compiled function was made."""
    if isinstance(compiled, CPUDispatcher):
        return compiled.py_func
    dispatcher = (
        compiled._dispatcher if isinstance(compiled, DUFunc) else compiled.gufunc_builder.nb_func
    )
    return dispatcher.py_func


def is_library(module: str) -> bool:
    """Whether a module belongs to Python, to a known library or to pfdist itself.

    The models that ship with pfdist do not count as a library.
    """
    top = module.partition(".")[0]
    own = top == "pfdist" and not module.startswith("pfdist.models")
    return own or top in _LIBRARIES


def reached(*roots: Any) -> list[Any]:
    """Give everything that values reach, each object once, the values first.

    From a function, the walk goes to its global variables, closure and default arguments. From a
    module, a class or an object, it goes to the attributes whose names occur in any function that
    was reached. From `functools.partial`, methods, tuples, lists, sets and dictionaries, it goes to
    their entries. It ends at libraries.
    """
    found: dict[int, Any] = {}
    scopes: dict[int, Mapping[str, Any]] = {}  # of modules, classes and objects
    names: set[str] = set()
    waiting = list(roots)
    while waiting:
        while waiting:
            value = waiting.pop()
            if id(value) in found:
                continue
            found[id(value)] = value
            if isinstance(value, types.FunctionType):
                names |= names_in(value.__code__)
            scope = _scope_of(value)
            if scope is not None:
                scopes[id(scope)] = scope
            waiting += _parts_of(value)
        waiting += [
            value
            for scope in scopes.values()
            for name, value in list(scope.items())
            if (name in names or name in _UNNAMED) and id(value) not in found
        ]
    return list(found.values())


def names_in(code: types.CodeType) -> set[str]:
    """Names of globals and attributes in a function and in the functions that it defines."""
    inner = [
        names_in(constant) for constant in code.co_consts if isinstance(constant, types.CodeType)
    ]
    return set(code.co_names).union(*inner)


def _scope_of(value: Any) -> Mapping[str, Any] | None:
    """Variables of a value; only those that a reached function names count."""
    if isinstance(value, types.FunctionType):
        return None if is_library(str(value.__module__)) else value.__globals__
    if isinstance(value, types.ModuleType):
        return None if is_library(value.__name__) else vars(value)
    if isinstance(value, type) and is_library(str(value.__module__)):
        return None
    slots = getattr(type(value), "__slots__", ())
    named = {name: getattr(value, name) for name in slots if hasattr(value, name)}
    return named | vars(value) if hasattr(value, "__dict__") else named or None


def _parts_of(value: Any) -> Iterator[Any]:
    """Parts of a value that all count, whether a function names them or not."""
    if isinstance(value, COMPILED):
        yield python_function(value)
    elif isinstance(value, types.FunctionType) and not is_library(str(value.__module__)):
        yield from value.__defaults__ or ()
        yield from (value.__kwdefaults__ or {}).values()
        yield from (cell.cell_contents for cell in value.__closure__ or () if _is_full(cell))
    elif isinstance(value, functools.partial):
        yield from (value.func, *value.args, *value.keywords.values())
    elif isinstance(value, types.MethodType):
        yield from (value.__self__, value.__func__)
    elif isinstance(value, staticmethod | classmethod):
        yield value.__func__
    elif isinstance(value, property):
        yield from (value.fget, value.fset)
    elif isinstance(value, dict):
        yield from list(value.values())
    elif isinstance(value, tuple | list | set | frozenset):
        yield from list(value)
    else:
        yield from _kinds_of(value)


def _kinds_of(value: Any) -> Iterator[type]:
    """The base classes of a class, or the class of an object, without those of libraries."""
    kinds = value.__bases__ if isinstance(value, type) else (type(value),)
    yield from (kind for kind in kinds if not is_library(str(kind.__module__)))


def _is_full(cell: Any) -> bool:
    try:
        cell.cell_contents  # noqa: B018  it raises where a function inside is not defined yet
    except ValueError:
        return False
    return True
