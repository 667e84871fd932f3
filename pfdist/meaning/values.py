"""The content of a value of any kind, found in the parts from which Python would copy it."""

import copyreg
import functools
import gc
import threading
import types
import weakref
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from pfdist.kernels.content import UnknownContentError

# Values of these types hold nothing that a formula could read.
_EMPTY = (
    type(threading.Lock()), type(threading.RLock()), weakref.ReferenceType, weakref.WeakSet,
    weakref.WeakKeyDictionary, weakref.WeakValueDictionary,
)  # fmt: skip
# Attributes that describe an object, and do not change what it does.
_WORDS = functools.WRAPPER_ASSIGNMENTS


class UntoldValueError(Exception):
    """The content of a value cannot be read.

    Parameters
    ----------
    label : str
        Label, in a meaning, of the object that holds the value.
    what : str
        Description of the value.
    """

    def __init__(self, label: str, what: str) -> None:
        super().__init__(f"{label}: {what}")
        self.label, self.what = label, what


def copy_of(value: Any) -> tuple[Any, ...]:
    """Give the parts from which Python would make a copy of a value.

    Returns
    -------
    tuple
        The function that makes the copy, its arguments, the state of the copy, its entries as a
        list, and its entries as pairs of keys and values.

    Raises
    ------
    UnknownContentError
        The value can neither be copied nor iterated.
    """
    if isinstance(value, _EMPTY):
        return type(value), (), None, [], []
    if isinstance(value, np.ufunc):  # written in C, or made from a function by `np.frompyfunc`
        held = [entry for entry in gc.get_referents(value) if callable(entry)]
        if not held and all("O" in types for types in value.types):
            raise _unknown(value)
        return type(value), (value.__name__, *value.types), None, held, []
    if type(value).__module__.startswith("numba.typed") and isinstance(value, Collection):
        return _with_entries(value)
    try:
        copied = value.__reduce_ex__(4)
    except Exception as error:
        if type(value) in copyreg.dispatch_table:  # `pickle` would look here first
            copied = copyreg.dispatch_table[type(value)](value)
        elif isinstance(value, Collection):
            return _with_entries(value)
        else:
            raise _unknown(value) from error
    if isinstance(copied, str):  # the name of a global variable with this value
        return copied, (), _without_words(getattr(value, "__dict__", {})), [], []
    made_by, arguments, *rest = copied
    state, entries, items = (*rest, None, None, None)[:3]
    if isinstance(state, dict) and "__wrapped__" in state:  # from `functools.update_wrapper`
        state = _without_words(state)
    return made_by, arguments, state, list(entries or ()), list(items or ())


def _with_entries(value: Collection[Any]) -> tuple[Any, ...]:
    if isinstance(value, Mapping):
        return type(value), (), None, [], list(value.items())
    return type(value), (), None, list(value), []


def _without_words(state: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in state.items() if name not in _WORDS}


def _unknown(value: Any) -> UnknownContentError:
    return UnknownContentError(f"a value of the kind {type(value).__qualname__!r}")


def python_function(value: Any) -> types.FunctionType | None:
    """Give the Python function of a function that Numba compiled; None for any other value."""
    inner = getattr(value, "_dispatcher", None)
    function = getattr(value, "py_func", None) or getattr(inner, "py_func", None)
    if function is None and type(value).__module__.startswith("numba."):
        function = getattr(value, "__wrapped__", None)
    return function if isinstance(function, types.FunctionType) else None
