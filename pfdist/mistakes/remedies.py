"""Advice for the commonest mistakes in formulas, in plain English."""

import linecache
import math
import re
import traceback

import numpy as np

from pfdist.mistakes.endings import text_of
from pfdist.mistakes.places import is_a_models

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
    "p.time[t] and p.dt[t] are the clock's, and there is no clock: give a job problem.time_step, "
    "problem.time_unit or problem.times, and without a job take model.on_clock(times)"
)
"""What is wrong where a formula reads the clock of a job that has none."""
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
    "math domain error": "np.log and np.sqrt give nan or inf where math.log and math.sqrt end",
}
_CALLED = re.compile(r"(?:\w+\.)?(\w+)\(")
_INSTEAD = {
    "dist": "np.hypot(a - c, b - d)",
    "fma": "a * b + c",
    "frexp": "np.floor(np.log2(np.abs(a))) + 1 for the exponent",
    "fsum": "a + b",
    "gcd": "np.gcd(np.int64(a), np.int64(b))",
    "hypot": "np.hypot, or np.hypot(np.hypot(a, b), c) for three components,",
    "isqrt": "np.floor(np.sqrt(a))",
    "lcm": "np.lcm(np.int64(a), np.int64(b))",
    "log": "np.log, or np.log(a) / np.log(b) for the base b,",
    "modf": "a - np.trunc(a) and np.trunc(a)",
    "pow": "np.power",
    "remainder": "a - b * np.rint(a / b)",
    "ulp": "np.spacing(np.abs(a))",
}
"""What formulas use in the place of functions of `math` that differ from those of NumPy."""


def remedy(error: BaseException) -> str:
    """Advise what to write instead, as ``; remedy``; empty if there is no advice."""
    text = text_of(error)
    found = next((cure for words, cure in _REMEDIES.items() if words in text), "")
    if found is _ONE_NUMBER:
        found = f"a component may be an array: {_of_one_number(_called(error))}"
    return f"; {found}" if found else ""


def _of_one_number(name: str) -> str:
    """Say what to write in the place of a function of one number."""
    if name in ("int", "round"):
        return "write np.int64(a) in the place of int(a)"
    if name == "float":
        return "leave float() out"
    if not hasattr(math, name):
        return _ONE_NUMBER
    in_numpy = re.sub(r"^a(?=sin|cos|tan)", "arc", name)
    if name in _INSTEAD or hasattr(np, in_numpy):
        return f"write {_INSTEAD.get(name, f'np.{in_numpy}')} in the place of math.{name}"
    return (
        f"NumPy has no {name}: leave out a term of log_likelihood that does not depend on x, or "
        f"write np.interp(a, GRID, TABLE) with an array TABLE of math.{name} at the points GRID, "
        "made above the formula"
    )


def _called(error: BaseException) -> str:
    """Name of the function whose call in a model's source raised an error; empty if unknown."""
    for call in reversed(traceback.extract_tb(error.__traceback__)):
        if is_a_models(call.filename):
            found = _CALLED.match(linecache.getline(call.filename, call.lineno or 0)[call.colno :])
            return found[1] if found else ""
    return ""
