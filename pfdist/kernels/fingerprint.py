"""A hash of a function and of all that it uses, which names its compiled code.

Two functions with the same fingerprint compile to the same code. The hash covers the bytecode and
its line numbers, constants, defaults, closures, and the globals and module attributes that the
function names, recursively. Functions of NumPy, of the standard library and of this room count by
their names only; `pfdist.kernels.disk_cache` adds the versions and our source.
"""

import hashlib
import types
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

from pfdist.kernels.content import Content, Parts, UnknownContentError
from pfdist.kernels.formulas import is_ours

__all__ = ["UnknownContentError", "bytecode", "fingerprint"]

_VERSIONED = ("builtins", "math", "numpy")  # their contents count by name


def fingerprint(*values: Any) -> str:
    """Hash the content of values, functions among them with all that they use.

    Raises
    ------
    UnknownContentError
        A value, or something that it uses, is of a kind that cannot be hashed.
    """
    digest = hashlib.blake2b(digest_size=16)
    try:
        for part in _Compiled().entries(values):
            digest.update(len(part).to_bytes(8, "little") + part)
    except (AttributeError, RecursionError, ValueError) as error:  # an empty cell, for instance
        raise UnknownContentError(str(error)) from error
    return digest.hexdigest()


def bytecode(content: Content, code: types.CodeType) -> Parts:
    """Give the content of a code object: instructions, names and constants."""
    yield code.co_code
    yield f"{code.co_flags} {code.co_argcount} {code.co_kwonlyargcount}".encode()
    yield from content.parts((code.co_names, code.co_varnames, code.co_freevars))
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from bytecode(content, constant)
        else:
            yield from content.parts(constant)


class _Compiled(Content):
    """The content on which Numba's compilation of a function depends."""

    def code(self, function: types.FunctionType) -> Parts:
        yield from bytecode(self, function.__code__)
        yield from _lines(function.__code__)  # compiled errors contain them

    def by_name(self, value: Any) -> str | None:
        if isinstance(value, types.ModuleType):
            return value.__name__ if _is_versioned(value.__name__) else None
        if isinstance(value, types.FunctionType):
            # Its globals, because a decorator may copy another function's __module__.
            home = str(value.__globals__.get("__name__"))
            known = is_ours(value) or _is_versioned(home)
            return f"{value.__module__}.{value.__qualname__}" if known else None
        known = isinstance(value, np.ufunc) or (
            getattr(value, "__module__", None) in _VERSIONED and hasattr(value, "__name__")
        )
        return str(value.__name__) if known else None

    def dispatcher(self, function: CPUDispatcher) -> Parts:
        if function.locals or not function._can_compile:  # types that its author has fixed
            raise UnknownContentError(repr(function))
        yield from super().dispatcher(function)

    def other(self, value: Any) -> Parts:
        for kind in (bool, int, float, complex, str):
            if isinstance(value, kind):  # an IntEnum
                yield kind.__repr__(value).encode()
                return
        if not isinstance(value, tuple | list):
            raise UnknownContentError(repr(value))
        yield str(getattr(value, "_fields", "")).encode()
        yield from self.entries(value)


def _lines(code: types.CodeType) -> Parts:
    yield f"{code.co_filename} {list(code.co_lines())}".encode()
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _lines(constant)


def _is_versioned(module: str) -> bool:
    return module.split(".", maxsplit=1)[0] in _VERSIONED
