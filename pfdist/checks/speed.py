"""Finds formulas that are slow because they make arrays for each particle."""

import ast
import linecache
import types
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from pfdist.filters.draws import Draws
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation
from pfdist.models import StateSpaceModel
from pfdist.models.seeing import names_in
from pfdist.models.syntax import node_of

_OUT = "write each component out, for instance A[0, 0] * x[0] + A[0, 1] * x[1]"
_SLOW = {
    **dict.fromkeys(
        ("array", "asarray", "zeros", "ones", "full", "empty", "stack", "hstack", "concatenate",
         "dot", "matmul", "inner", "outer", "cross", "sum", "prod", "mean", "norm"), _OUT,
    ),
    **dict.fromkeys(("solve", "inv", "det", "cholesky"), "compute it above, once"),
    "select": "give np.select tuples in the place of lists, or write pfdist.where",
    "interp": "compute its tables above, once",
}  # fmt: skip


def speed(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: which formulas make or index arrays for each particle, and on which lines."""
    indexed = [
        f"{array} in {name} ({place})"
        for name, function in model.formulas.items()
        for array, place in _indexed(function)
    ]
    if not Evaluator(model, draws.instants[-1], estimations=(Estimation(1),)).makes_arrays:
        if not indexed:
            return "ok", "no formula makes or indexes an array for a particle"
        return "note", (
            f"{', '.join(dict.fromkeys(indexed))}: each index is checked for each particle, which "
            "may take 8 times the time; a parameter p.NAME[t] needs no check"
        )
    places = [
        f"{what} in {name} ({place}): {cure}"
        for name, function in model.formulas.items()
        for what, place, cure in _slow_places(function)
    ]
    return "note", (
        "formulas that make arrays for each particle take 30 to 500 ns where others take 1: "
        + ("; ".join(dict.fromkeys(places)) or f"which is not known; {_OUT}")
    )


def _slow_places(function: Callable[..., Any]) -> Iterator[tuple[str, str, str]]:
    """Yield calls that make an array, in a function and those it calls, with place and remedy."""
    for called in _functions(function):
        code = called.__code__
        lines = {line for *_, line in code.co_lines() if line}
        for node in ast.walk(_parsed(code.co_filename)):
            line = getattr(node, "lineno", None)
            if line not in lines:
                continue
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
                yield "@", f"{code.co_filename}:{line}", _OUT
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name):
                name = getattr(node.func, "attr", getattr(node.func, "id", ""))
                if name in _SLOW:
                    yield name, f"{code.co_filename}:{line}", _SLOW[name]


def _indexed(function: Callable[..., Any]) -> Iterator[tuple[str, str]]:
    """Yield the global arrays that a function and those it calls index, and the places."""
    for called in _functions(function):
        node = node_of(called)
        for each in ast.walk(node) if node else ():
            if isinstance(each, ast.Subscript) and isinstance(each.value, ast.Name):
                value = called.__globals__.get(each.value.id)
                if isinstance(value, np.ndarray):
                    yield each.value.id, f"{called.__code__.co_filename}:{each.lineno}"


def _parsed(file: str) -> ast.AST:
    try:
        return ast.parse("".join(linecache.getlines(file)))
    except (SyntaxError, ValueError):  # it was edited since, or is no file
        return ast.Module(body=[], type_ignores=[])


def _functions(function: Any) -> Iterator[types.FunctionType]:
    """A function and the module's functions that it calls."""
    waiting, seen = [function], set[int]()
    while waiting:
        value = waiting.pop()
        if not isinstance(value, types.FunctionType) or id(value) in seen:
            continue
        seen.add(id(value))
        yield value
        waiting += [value.__globals__.get(name) for name in names_in(value.__code__)]
