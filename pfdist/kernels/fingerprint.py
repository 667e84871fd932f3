"""The content of a function and of all that it uses, as a hash.

Two functions with one fingerprint compile to the same code: their own code and the lines it stands
in, constants, defaults, closures, the globals and the modules' attributes they name, all the way
down. What is NumPy's, the
standard library's or this floor's is told by its name; `pfdist.kernels.disk_cache` adds versions
and source.
"""

import hashlib
import types
from collections.abc import Iterator
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

from pfdist.kernels.formulas import is_ours, names_in

_VERSIONED = ("builtins", "math", "numpy")  # what is in them is told by its name


class UnknownContentError(Exception):
    """A value whose content cannot be told."""


def fingerprint(*values: Any) -> str:
    """Hash the content of values, functions among them with all that they use.

    Raises
    ------
    UnknownContentError
        One of them, or what it uses, is of a kind whose content cannot be told.
    """
    digest = hashlib.blake2b(digest_size=16)
    try:
        for part in _parts(values, frozenset(), []):
            digest.update(len(part).to_bytes(8, "little") + part)
    except (AttributeError, RecursionError, ValueError) as error:  # an empty cell, for instance
        raise UnknownContentError(str(error)) from error
    return digest.hexdigest()


def _parts(value: Any, names: frozenset[str], seen: list[Any]) -> Iterator[bytes]:  # noqa: C901
    """The content of a value as bytes.

    `names` are those that the code around it uses: of a module they are what matters. `seen`
    are the functions that have been told already, so that one that calls itself ends.
    """
    yield type(value).__name__.encode()
    if value is None or isinstance(value, bool | int | float | complex | str | np.generic):
        yield repr(value).encode()
    elif isinstance(value, bytes):
        yield value
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        yield from (value.dtype.str.encode(), str(value.shape).encode(), value.tobytes())
    elif isinstance(value, tuple | list):
        yield f"{len(value)} {getattr(value, '_fields', '')}".encode()
        for entry in value:
            yield from _parts(entry, names, seen)
    elif isinstance(value, CPUDispatcher):
        if value.locals or not value._can_compile:  # types that its author has fixed
            raise UnknownContentError(repr(value))
        yield repr(sorted(value.targetoptions.items())).encode()
        yield from _parts(value.py_func, names, seen)
    elif isinstance(value, types.FunctionType):
        yield from _function_parts(value, seen)
    elif isinstance(value, types.ModuleType):
        yield from _module_parts(value, names, seen)
    elif isinstance(value, np.ufunc) or (
        getattr(value, "__module__", None) in _VERSIONED and hasattr(value, "__name__")
    ):
        yield value.__name__.encode()
    else:
        raise UnknownContentError(repr(value))


def _function_parts(function: types.FunctionType, seen: list[Any]) -> Iterator[bytes]:
    if function in seen:
        yield str(seen.index(function)).encode()
        return
    seen.append(function)
    home = str(function.__globals__.get("__name__"))  # a decorator may copy another's __module__
    if is_ours(function) or home.split(".", maxsplit=1)[0] in _VERSIONED:
        yield f"{function.__module__}.{function.__qualname__}".encode()
        return
    names = frozenset(names_in(function.__code__))
    yield from _code_parts(function.__code__, names, seen)
    keywords = tuple(sorted((function.__kwdefaults__ or {}).items()))
    yield from _parts((function.__defaults__, keywords), names, seen)
    for cell in function.__closure__ or ():
        yield from _parts(cell.cell_contents, names, seen)
    for name in sorted(names & function.__globals__.keys()):
        yield name.encode()
        yield from _parts(function.__globals__[name], names, seen)


def _code_parts(code: types.CodeType, names: frozenset[str], seen: list[Any]) -> Iterator[bytes]:
    yield code.co_code
    yield f"{code.co_filename} {list(code.co_lines())}".encode()  # compiled errors tell their line
    yield f"{code.co_flags} {code.co_argcount} {code.co_kwonlyargcount}".encode()
    yield from _parts((code.co_names, code.co_varnames, code.co_freevars), names, seen)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _code_parts(constant, names, seen)
        else:
            yield from _parts(constant, names, seen)


def _module_parts(
    module: types.ModuleType, names: frozenset[str], seen: list[Any]
) -> Iterator[bytes]:
    yield module.__name__.encode()
    if module.__name__.split(".")[0] in _VERSIONED or (module, names) in seen:
        return
    seen.append((module, names))
    for name in sorted(names & module.__dict__.keys()):
        yield name.encode()
        yield from _parts(module.__dict__[name], names, seen)
