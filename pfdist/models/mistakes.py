"""Errors in a model's code as plain sentences: what failed, where, and what to write instead."""

import functools
import inspect
import sysconfig
from pathlib import Path
from types import CodeType
from typing import Any

import numba
import numpy as np

from pfdist.densities import DENSITIES

_LONGEST = 500  # characters of an error's text
_PACKAGE = Path(__file__).parents[1]
_STANDARD_LIBRARY = Path(sysconfig.get_path("stdlib"))
# Other installed packages may be the user's own, with models in them.
_LIBRARIES = [Path(str(package.__file__)).parent for package in (numba, np)]


# --- what failed, and where -----------------------------------------------------------------------


def is_interrupt(error: BaseException) -> bool:
    """Whether an exception comes from Ctrl-C or a batch system's signal, not from the model."""
    return type(error) is KeyboardInterrupt


def error_line(error: BaseException) -> str:
    """A model's exception in one line: its class and the beginning of its text."""
    return ": ".join(part for part in (type(error).__name__, text_of_mistake(error)) if part)


def text_of_mistake(error: BaseException) -> str:
    """An error's text as one line of at most 500 characters; empty if it has none."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # the text of a model's own exception may fail, too
        return ""
    return f"{text[:_LONGEST]} ..." if len(text) > _LONGEST else text


def place_of(error: BaseException) -> str:
    """An error's innermost place in a model as `` (file:line)``; empty if there is none."""
    place, trace = "", error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if is_a_models(file):
            place = f" ({file}:{trace.tb_lineno})"
        trace = trace.tb_next
    return place


def code_of(function: Any) -> CodeType | None:
    """The code of a function, of a method, or of the ``__call__`` of an object."""
    function = inspect.unwrap(function)
    while isinstance(function, functools.partial):
        function = function.func
    called = getattr(function, "__code__", None) or getattr(function.__call__, "__code__", None)
    return called if isinstance(called, CodeType) else None


def place_of_function(function: Any) -> str:
    """The place where a function is defined, as `` (file:line)``; empty if it has no source."""
    place: str | None = getattr(function, "place", None)  # of a formula that was recorded
    if place is not None:
        return place
    code = code_of(function)
    return f" ({code.co_filename}:{code.co_firstlineno})" if code else ""


def is_a_models(file: str) -> bool:
    """Whether a source file belongs to a model: a built-in model, or user code.

    User code is all code in files other than those of pfdist, Python, NumPy and Numba.
    """
    path = Path(file)
    if file.startswith("<"):
        return False
    if path.is_relative_to(_PACKAGE):
        return path.parent.name == "library"
    if path.is_relative_to(_STANDARD_LIBRARY):
        return "site-packages" in path.parts and not any(map(path.is_relative_to, _LIBRARIES))
    return not any(map(path.is_relative_to, _LIBRARIES))


# --- what to write instead --------------------------------------------------------------------

_COMPONENTS = "x, w, v, y and z are tuples: the first component is x[0], even if it is the only one"
_MATRIX = (
    "write each component out, for instance A[0, 0] * x[0] + A[0, 1] * x[1], or give np.array as "
    "many entries as the matrix has columns, all of them components"
)
NO_CLOCK = (
    "p.time[t] and p.dt[t] come from a clock, and there is none: give the job a clock, or "
    "take the model's on_clock(times)"
)
"""The advice where a formula reads the clock of a job that has none."""
_REMEDIES = {
    "inhomogeneous": _MATRIX,
    "core dimension": _MATRIX,
    "not aligned": _MATRIX,
    "sequence by non-int": _COMPONENTS,
    "'tuple' and": _COMPONENTS,
    "and 'tuple'": _COMPONENTS,
    "concatenate tuple": _COMPONENTS,
    "'tuple' object has no attribute": f"{_COMPONENTS}; parameters are p.name",
    "'tuple' object does not support item assignment": "give a new tuple, for instance (a, b)",
    "'Parameters' object has no attribute 'time'": NO_CLOCK,
    "'Parameters' object has no attribute 'dt'": NO_CLOCK,
    "tuple indices must be integers or slices, not str": "a parameter is read as p.name",
    "only integers, slices": "an index is an integer: write t // 2 instead of t / 2",
    "math domain error": "write np.log and np.sqrt, which give nan or inf instead of an error",
}
_ELSEWHERE = {
    "norm": "normal",
    "gaussian": "normal",
    "t": "student_t",
    "student": "student_t",
    "lognorm": "lognormal",
    "expon": "gamma",
    "exponential": "gamma",
    "vonmises": "von_mises",
    "binom": "binomial",
    "nbinom": "negative_binomial",
}
"""Names of densities in SciPy and elsewhere."""


def density_named(name: str) -> str:
    """The name in `DENSITIES` of a density from another library; empty if none fits."""
    name = name.lower().removesuffix("_gen")
    name = _ELSEWHERE.get(name, name)
    return name if name in DENSITIES else ""


def remedy(error: BaseException) -> str:
    """Advice on what to write instead, as ``; advice``; empty if there is none."""
    text = text_of_mistake(error)
    advice = next((cure for words, cure in _REMEDIES.items() if words in text), "")
    return f"; {advice}" if advice else ""
