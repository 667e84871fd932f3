"""Errors in a model's code in plain English: what failed, where, and what to write instead."""

import contextlib
import functools
import inspect
import linecache
import math
import re
import sysconfig
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numba
import numpy as np

from pfdist.common.stopping import check
from pfdist.densities import DENSITIES
from pfdist.errors import ModelError, PfdistError

_LONGEST = 500  # characters of an error's text
_PACKAGE = Path(__file__).parents[1]
_MACHINERY = {
    *("__init__", "base", "carried", "checks", "fingerprint", "loader", "mistakes"),
    *("parameters", "program", "seeing", "symbols", "syntax", "tracing", "twin"),
}  # the modules of pfdist.models that are no models
_STANDARD_LIBRARY = Path(sysconfig.get_path("stdlib"))
# Other installed packages may be the user's own, with models in them.
_LIBRARIES = [Path(str(package.__file__)).parent for package in (numba, np)]


# --- what failed, and where -----------------------------------------------------------------------


def is_interrupt(error: BaseException) -> bool:
    """Whether an exception is the user's Ctrl-C or a batch system's signal, not a model's error."""
    return type(error) is KeyboardInterrupt


def error_line(error: BaseException) -> str:
    """An exception of a model in a line: its class and the beginning of its text."""
    return ": ".join(part for part in (type(error).__name__, text_of(error)) if part)


def text_of(error: BaseException) -> str:
    """An error's text as a line, of 500 characters at most; empty if it has none."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # the text of a model's own exception may fail, too
        return ""
    return f"{text[:_LONGEST]} ..." if len(text) > _LONGEST else text


def frames_of(error: BaseException) -> Iterator[tuple[FrameType, int]]:
    """Frames and lines of an error's traceback in a model's source, the outermost first."""
    trace = error.__traceback__
    while trace is not None:
        if is_a_models(trace.tb_frame.f_code.co_filename):
            yield trace.tb_frame, trace.tb_lineno
        trace = trace.tb_next


def place_of(error: BaseException) -> str:
    """An error's innermost place in a model as `` (file:line)``; empty if there is none."""
    places = [f" ({frame.f_code.co_filename}:{line})" for frame, line in frames_of(error)]
    return places[-1] if places else ""


def code_of(function: Any) -> CodeType | None:
    """The code of a function or method, or of what is called when an object is."""
    function = inspect.unwrap(function)
    while isinstance(function, functools.partial):
        function = function.func
    called = getattr(function, "__code__", None) or getattr(function.__call__, "__code__", None)
    return called if isinstance(called, CodeType) else None


def place_of_function(function: Any) -> str:
    """The place where a function is defined, as `` (file:line)``; empty without a source."""
    code = code_of(function)
    return f" ({code.co_filename}:{code.co_firstlineno})" if code else ""


def ships(module: str) -> bool:
    """Whether a module of `pfdist.models` is a model, as ``"ungm"`` is and ``"base"`` is not."""
    return module not in _MACHINERY


def is_a_models(file: str) -> bool:
    """Whether a source file is a model's: one that ships, or code of the user.

    Code of the user is all code in files but pfdist, Python's standard library, NumPy and Numba.
    """
    path = Path(file)
    if file.startswith("<"):
        return False
    if path.is_relative_to(_PACKAGE):
        return path.parent.name == "models" and ships(path.stem)
    if path.is_relative_to(_STANDARD_LIBRARY):
        return "site-packages" in path.parts and not any(map(path.is_relative_to, _LIBRARIES))
    return not any(map(path.is_relative_to, _LIBRARIES))


@contextlib.contextmanager
def formulas_of(model: str, formulas: Mapping[str, Callable[..., Any]]) -> Iterator[None]:
    """Turn an error of a model's formulas in NumPy into a `ModelError` of one line.

    It has the formula's name, the instant if it is known, and the line.
    """
    check()
    try:
        yield
    except (MemoryError, PfdistError):
        raise
    except BaseException as error:  # a formula may raise whatever it likes
        place = place_of(error)
        if is_interrupt(error) or not (isinstance(error, Exception) or place):
            raise
        name, instant = _formula_at_fault(error, formulas)
        at = "" if instant is None else f" at t = {instant}"
        raise ModelError(
            f"model {model}: {name} failed: {error_line(error)}{at}{remedy(error)}{place}"
        ) from error


def _formula_at_fault(
    error: BaseException, formulas: Mapping[str, Callable[..., Any]]
) -> tuple[str, int | None]:
    """Name of the formula that an error passed through, and the value of its t if it has one."""
    names = dict[CodeType | None, list[str]]()
    for name, function in formulas.items():  # methods of one class may have the same code
        names.setdefault(code_of(function), []).append(name)
    for frame, _ in frames_of(error):
        if frame.f_code in names:
            return " or ".join(names[frame.f_code]), frame.f_locals.get("t")
    return "a formula", None


# --- what to write instead --------------------------------------------------------------------

_BRANCH = (
    "a component may be an array, so a branch is pfdist.where(condition, a, b), `and` is &, `or` "
    "is |, 0 < a < 1 is (0 < a) & (a < 1), and max(a, b) is np.maximum(a, b)"
)
_COMPONENTS = "x, w, v, y and z are tuples: the first component is x[0], also where it is the only"
_MATRIX = (
    "write each component out, for instance A[0, 0] * x[0] + A[0, 1] * x[1], or give np.array as "
    "many entries as the matrix has columns, all of them components"
)
NO_CLOCK = (
    "p.time[t] and p.dt[t] are the clock's, and there is no clock: give the job a clock, or "
    "take the model's on_clock(times)"
)
"""The advice where a formula reads the clock of a job that has none."""
_ONE_NUMBER = "write np.sin in the place of math.sin, np.int64 of int"
_REMEDIES = {
    "truth value of an array": _BRANCH,
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
    "only integers, slices": "an index is an integer: t // 2 in the place of t / 2",
    "must be real number, not": _ONE_NUMBER,
    "can be converted to Python scalars": _ONE_NUMBER,
    "can be converted to a scalar index": _ONE_NUMBER,
    "doesn't define __trunc__": _ONE_NUMBER,
    "doesn't define __round__": _ONE_NUMBER,
    "math domain error": "np.log and np.sqrt give nan or inf where math.log and math.sqrt end",
}
_LOG = "pfdist.densities.lgamma"
_CALLED = re.compile(r"(?:\w+\.)?(\w+)\(")
_INSTEAD = {
    "comb": f"np.rint(np.exp({_LOG}(a + 1) - {_LOG}(b + 1) - {_LOG}(a - b + 1)))",
    "dist": "np.hypot(a - c, b - d)",
    "erf": "pfdist.densities.erf",
    "erfc": "pfdist.densities.erfc",
    "factorial": f"np.rint(np.exp({_LOG}(a + 1)))",
    "fma": "a * b + c",
    "frexp": "np.floor(np.log2(np.abs(a))) + 1 for the exponent",
    "fsum": "a + b",
    "gamma": f"np.exp({_LOG}(a))",
    "gcd": "np.gcd(np.int64(a), np.int64(b))",
    "hypot": "np.hypot, or np.hypot(np.hypot(a, b), c) for three components,",
    "isqrt": "np.floor(np.sqrt(a))",
    "lcm": "np.lcm(np.int64(a), np.int64(b))",
    "lgamma": _LOG,
    "log": "np.log, or np.log(a) / np.log(b) for the base b,",
    "modf": "a - np.trunc(a) and np.trunc(a)",
    "perm": f"np.rint(np.exp({_LOG}(a + 1) - {_LOG}(a - b + 1)))",
    "pow": "np.power",
    "remainder": "a - b * np.rint(a / b)",
    "ulp": "np.spacing(np.abs(a))",
}
"""Replacements in formulas for functions of `math` that NumPy lacks or has otherwise."""
_NOT_IN_NUMPY = re.compile(r"module 'numpy' has no attribute '(\w+)'")
_DENSITIES_ELSEWHERE = {
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
_SPECIAL_ELSEWHERE = {"gammaln": "lgamma", "loggamma": "lgamma"}


def density_named(name: str) -> str:
    """The name in `DENSITIES` of a density that has another name elsewhere; empty if none fits."""
    name = name.lower().removesuffix("_gen")
    name = _DENSITIES_ELSEWHERE.get(name, name)
    return name if name in DENSITIES else ""


def advice_on_special(name: str) -> str:
    """Advice on a special function that NumPy lacks, as ``; advice``; empty if there is none."""
    name = _SPECIAL_ELSEWHERE.get(name, name)
    if name == "logsumexp":
        return "; write pfdist.densities.logsumexp((a, b))"
    return f"; write {_INSTEAD[name]}" if "densities" in _INSTEAD.get(name, "") else ""


def remedy(error: BaseException) -> str:
    """Advice on what to write instead, as ``; advice``; empty if there is none."""
    text = text_of(error)
    if missing := _NOT_IN_NUMPY.search(text):
        return advice_on_special(missing[1])
    advice = next((cure for words, cure in _REMEDIES.items() if words in text), "")
    if advice is _ONE_NUMBER:
        advice = f"a component may be an array: {_of_one_number(_called(error))}"
    return f"; {advice}" if advice else ""


def _of_one_number(name: str) -> str:
    """Advice on what to write instead of a function that takes only single numbers."""
    if name == "int":
        return "write np.int64(a) in the place of int(a)"
    if name == "round":
        return "write np.rint(a) in the place of round(a)"
    if name == "float":
        return "leave float() out"
    if not hasattr(math, name):
        return _ONE_NUMBER
    in_numpy = re.sub(r"^a(?=sin|cos|tan)", "arc", name)
    return f"write {_INSTEAD.get(name, f'np.{in_numpy}')} in the place of math.{name}"


def _called(error: BaseException) -> str:
    """Name of the function whose call in a model's source raised an error; empty if unknown."""
    for call in reversed(traceback.extract_tb(error.__traceback__)):
        if is_a_models(call.filename):
            match = _CALLED.match(linecache.getline(call.filename, call.lineno or 0)[call.colno :])
            return match[1] if match else ""
    return ""
