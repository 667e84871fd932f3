"""Advice for the commonest mistakes in formulas, in plain English."""

import linecache
import re

from pfdist.mistakes.endings import text_of
from pfdist.mistakes.places import frames_of

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
_ONE_NUMBER = "a component may be an array: np.sin in the place of math.sin, np.int64 of int"
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
    "math domain error": "np.log and np.sqrt give nan or inf where math.log and math.sqrt end",
}
_MATH = re.compile(r"\bmath\.(\w+)")
_INTEGER = re.compile(r"(?<![\w.])(int|round)\(")
_FLOAT = re.compile(r"(?<![\w.])float\(")


def remedy(error: BaseException) -> str:
    """Advise what to write instead, as ``; remedy``; empty if there is no advice."""
    text = text_of(error)
    found = next((cure for words, cure in _REMEDIES.items() if words in text), "")
    if found is _ONE_NUMBER:
        found = _of_one_number(_line(error))
    return f"; {found}" if found else ""


def _of_one_number(line: str) -> str:
    called = _MATH.search(line)
    if called:
        name = re.sub(r"^a(?=sin|cos|tan)", "arc", called[1])
        return f"a component may be an array: write np.{name} in the place of math.{called[1]}"
    if _INTEGER.search(line):
        return "a component may be an array: write np.int64(a) in the place of int(a)"
    if _FLOAT.search(line):
        return "a component may be an array: leave float() out"
    return _ONE_NUMBER


def _line(error: BaseException) -> str:
    """The line of a model's source at which an error was raised."""
    places = [(frame.f_code.co_filename, number) for frame, number in frames_of(error)]
    return linecache.getline(*places[-1]) if places else ""
