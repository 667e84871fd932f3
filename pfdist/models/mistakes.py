"""Errors in a model's code as plain sentences: what failed, where, and what to write instead."""

import functools
import inspect
import sysconfig
from pathlib import Path
from traceback import walk_tb
from types import CodeType, FrameType
from typing import Any

import numba
import numpy as np

from pfdist.common.measurement_times import DATES
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
    lines, place, _ = _steps_of(error)
    return f" ({lines[place][0].f_code.co_filename}:{lines[place][1]})" if place >= 0 else ""


def _steps_of(error: BaseException) -> tuple[list[tuple[FrameType, int]], int, str]:
    """Frames and lines of a traceback, the place of the model's innermost one, and its package.

    Libraries that an installed model calls are not its own.
    """
    steps, place, own = [*walk_tb(error.__traceback__)], -1, ""
    for number, (frame, _) in enumerate(steps):
        file = frame.f_code.co_filename
        if is_a_models(file) and (place < 0 or _package(file) in ("", own)):
            place, own = number, own if place >= 0 else _package(file)
    return steps, place, own


def _package(file: str) -> str:
    """The installed package of a file; empty if the file is not installed."""
    _, _, inside = file.replace("\\", "/").rpartition("/site-packages/")
    return inside.partition("/")[0]


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
    if file.startswith("<") or path.suffix == ".pyx":
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
NO_DATES = (
    "p.day_of_year[t], p.hour[t] and p.weekday[t] need a job with dates: give its clock a start"
)
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
    **{f"'Parameters' object has no attribute {name!r}": NO_DATES for name in DATES},
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


BATCHED = "declare functions of arrays as a pfdist.BatchedModel, see docs/simulators.md"
"""The advice where a formula cannot be traced."""
RANDOM = "a formula takes randomness from the noise it is given, and changes nothing outside"


def refusal(error: BaseException) -> str:
    """The text of a refusal; or what a model writes instead of a library that got a symbol."""
    steps, place, own = _steps_of(error)
    if not 0 <= place < len(steps) - 1:
        return str(error)
    frame, _ = steps[place + 1]
    file, function = frame.f_code.co_filename, frame.f_code.co_name
    if file.startswith("numpy/random"):
        return f"{RANDOM}: write x[0] + p.sd * w[0], or {BATCHED}"
    library = _package(file)
    if library in ("", own) or Path(file).is_relative_to(_PACKAGE):
        return str(error)
    density = density_named(type(frame.f_locals.get("self")).__name__)
    if library == "scipy" and density:
        instead = f"write pfdist.densities.{DENSITIES[density].log_density.__name__}"
    else:
        instead = f"write pfdist.ode, or {BATCHED}" if function == "solve_ivp" else BATCHED
    return f"{function} of {library} takes numbers, and not values of particles: {instead}"


def remedy(error: BaseException) -> str:
    """Advice on what to write instead, as ``; advice``; empty if there is none."""
    text = text_of_mistake(error)
    advice = next((cure for words, cure in _REMEDIES.items() if words in text), "")
    return f"; {advice}" if advice else ""
