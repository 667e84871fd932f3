"""Finds formulas that are slow because they make arrays for each particle."""

import ast
import linecache
import types
from collections.abc import Callable, Iterator
from typing import Any

from pfdist.evaluation.compiling import makes_arrays
from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Estimation
from pfdist.filters.draws import Draws
from pfdist.kernels.formulas import names_in
from pfdist.models import StateSpaceModel

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
    """Look for arrays in what the formulas were compiled to, and for the lines that make them."""
    if not makes_arrays(Evaluator(model, draws.instants[-1]), Estimation(1)):
        return "ok", "no formula makes an array for a particle"
    found = [
        f"{what} in {name} ({place}): {cure}"
        for name, function in model.formulas.items()
        for what, place, cure in _slow_places(function)
    ]
    return "note", (
        "formulas that make arrays for each particle take 30 to 500 ns where others take 1: "
        + ("; ".join(dict.fromkeys(found)) or f"which is not known; {_OUT}")
    )


def _slow_places(function: Callable[..., Any]) -> Iterator[tuple[str, str, str]]:
    """Give what makes an array in a function and in those it calls, where, and what to write."""
    for code in _codes(function):
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


def _parsed(file: str) -> ast.AST:
    try:
        return ast.parse("".join(linecache.getlines(file)))
    except (SyntaxError, ValueError):  # it was edited since, or is no file
        return ast.Module(body=[], type_ignores=[])


def _codes(function: Any) -> Iterator[types.CodeType]:
    """Code of a function and of the module's functions that it calls."""
    waiting, seen = [function], set[int]()
    while waiting:
        value = waiting.pop()
        value = getattr(value, "py_func", value)
        if not isinstance(value, types.FunctionType) or id(value) in seen:
            continue
        seen.add(id(value))
        yield value.__code__
        waiting += [value.__globals__.get(name) for name in names_in(value.__code__)]
