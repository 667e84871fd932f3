"""What stands for values of kinds that the walk does not know: how they would be copied."""

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

# They hold nothing of their own that a formula could read.
_EMPTY = (
    type(threading.Lock()), type(threading.RLock()), weakref.ReferenceType, weakref.WeakSet,
    weakref.WeakKeyDictionary, weakref.WeakValueDictionary,
)  # fmt: skip
# Names that tell nothing of what an object does.
_WORDS = functools.WRAPPER_ASSIGNMENTS


class UntoldValueError(Exception):
    """A value whose content cannot be told.

    Parameters
    ----------
    label : str
        Of what holds the value, as in a meaning.
    what : str
        What the value is, in words.
    """

    def __init__(self, label: str, what: str) -> None:
        super().__init__(f"{label}: {what}")
        self.label, self.what = label, what


def copy_of(value: Any) -> tuple[Any, ...]:
    """Give what a copy of a value would be made of.

    Returns
    -------
    tuple
        What makes the copy, its arguments, the copy's state, and its entries as a list and as
        pairs of keys and values.

    Raises
    ------
    UnknownContentError
        The value cannot be copied, and it holds no entries either.
    """
    if isinstance(value, _EMPTY):
        return type(value), (), None, [], []
    if isinstance(value, np.ufunc):  # made of a function by `np.frompyfunc`, or written in C
        held = [entry for entry in gc.get_referents(value) if callable(entry)]
        if not held and all("O" in types for types in value.types):
            raise _unknown(value)
        return type(value), (value.__name__, *value.types), None, held, []
    if type(value).__module__.startswith("numba.typed") and isinstance(value, Collection):
        return _with_entries(value)
    try:
        copied = value.__reduce_ex__(4)
    except Exception as error:
        if type(value) in copyreg.dispatch_table:  # where `pickle` would look first
            copied = copyreg.dispatch_table[type(value)](value)
        elif isinstance(value, Collection):
            return _with_entries(value)
        else:
            raise _unknown(value) from error
    if isinstance(copied, str):  # the name of a global variable that holds it
        return copied, (), _without_words(getattr(value, "__dict__", {})), [], []
    made_by, arguments, *rest = copied
    state, entries, items = (*rest, None, None, None)[:3]
    if isinstance(state, dict) and "__wrapped__" in state:  # by `functools.update_wrapper`
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
    """Give the function that Numba's compiled functions were made of; None of any other value."""
    inner = getattr(value, "_dispatcher", None)
    function = getattr(value, "py_func", None) or getattr(inner, "py_func", None)
    if function is None and type(value).__module__.startswith("numba."):
        function = getattr(value, "__wrapped__", None)
    return function if isinstance(function, types.FunctionType) else None
