"""The syntax of functions, without everything that has no effect.

Comments, docstrings, annotations, positions and the version of Python make no difference.
"""

import __future__

import ast
import functools
import linecache
import operator
import types
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from typing import Any

Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_FUTURE = functools.reduce(
    operator.or_, (getattr(__future__, name).compiler_flag for name in __future__.all_feature_names)
)
_Position = tuple[int, int]
_Place = tuple[int, str]

# Annotations do nothing, and the other fields say what the rest of the tree says.
_LEFT_OUT = ("annotation", "returns", "type_params", "type_comment", "simple", "kind", "ctx")


def syntax_of(function: types.FunctionType) -> bytes | None:
    """A function's syntax, without its defaults and decorators, which count by value.

    It is None if no source is known that compiles to the function's very code. Either ``exec`` made
    it, or its file has been edited since it was loaded.
    """
    node = node_of(function)
    return (
        None if node is None else repr(_function_as_tuples(node)).encode("utf-8", "surrogatepass")
    )


def node_of(function: Any) -> Function | None:
    """The syntax tree from which a function was compiled; None if no source is known."""
    text = source_of(function)
    return _node_of(function.__code__, text) if text else None


def source_of(function: Any) -> str:
    """The text of the file or cell that defines a function; empty if it is not known."""
    scope = function.__globals__
    loader: Any = scope.get("__loader__")
    try:
        text = loader.get_source(scope.get("__name__"))
    except (AttributeError, ImportError, OSError, SyntaxError):
        text = None
    # A notebook keeps its cells in this cache.
    return text or "".join(linecache.getlines(function.__code__.co_filename))


@cache
def _parsed(
    text: str, flags: int
) -> tuple[dict[_Place, list[Function]], dict[_Place, list[types.CodeType]]]:
    """The functions of a source, and all its code objects, by their first lines and names."""
    try:
        tree, code = ast.parse(text), compile(text, "source", "exec", flags, dont_inherit=True)
    except (SyntaxError, ValueError):  # the file has been edited
        return {}, {}
    nodes, codes = defaultdict(list), defaultdict(list)
    for node in ast.walk(tree):
        if isinstance(node, Function):
            nodes[_first_line(node), getattr(node, "name", "<lambda>")].append(node)
    for inner in codes_in(code):
        codes[inner.co_firstlineno, inner.co_name].append(inner)
    return nodes, codes


def codes_in(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield the code of a function, or of a source, and of all functions that it defines."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes_in(constant)


@cache
def _node_of(code: types.CodeType, text: str) -> Function | None:
    """The syntax from which a code object was compiled; None if the text compiles to other code."""
    nodes_at, codes_at = _parsed(text, code.co_flags & _FUTURE)
    place = code.co_firstlineno, code.co_name
    nodes = nodes_at.get(place, []) if code in codes_at.get(place, []) else []
    if len(nodes) > 1:  # lambdas on one line
        spans = list(_spans(code))
        nodes = [node for node in nodes if spans and _holds(node, spans)]
        nodes = nodes[-1:]  # a tree is walked from the outside inwards
    return nodes[0] if nodes else None


def _first_line(node: Function) -> int:
    decorators: list[ast.expr] = getattr(node, "decorator_list", [])
    return min([node.lineno, *(decorator.lineno for decorator in decorators)])


def _spans(code: types.CodeType) -> Iterator[tuple[_Position, _Position]]:
    """The start and end in the source of each instruction that has a position."""
    for line, end_line, column, end_column in code.co_positions():
        if line is None or end_line is None or column is None or end_column is None:
            continue
        if (line, column) != (end_line, end_column):
            yield (line, column), (end_line, end_column)


def _holds(node: Function, spans: list[tuple[_Position, _Position]]) -> bool:
    """Whether all instructions come from a lambda's body."""
    body = node.body
    if isinstance(body, list):
        return False
    last = body.end_lineno or 0, body.end_col_offset or 0
    return all((body.lineno, body.col_offset) <= first and end <= last for first, end in spans)


def _function_as_tuples(node: Function) -> Any:
    """Describe a function without its defaults."""
    arguments = [
        (field, _as_tuples(value))
        for field, value in ast.iter_fields(node.args)
        if field not in ("defaults", "kw_defaults")
    ]
    return type(node).__name__, arguments, _as_tuples(node.body)


def _as_tuples(node: Any) -> Any:
    """Describe a node of a tree, or a list of nodes, as nested tuples."""
    if isinstance(node, list):
        return [_as_tuples(entry) for entry in node if not _does_nothing(entry)]
    if isinstance(node, ast.Constant):
        return type(node.value).__name__, repr(node.value)
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        return "Assign", [("targets", [_as_tuples(node.target)]), ("value", _as_tuples(node.value))]
    if isinstance(node, ast.AST):
        fields = [
            (field, _as_tuples(value))
            for field, value in ast.iter_fields(node)
            if field not in _LEFT_OUT and value is not None and value != []
        ]
        return type(node).__name__, fields
    return repr(node)


def _does_nothing(node: Any) -> bool:
    """Whether a statement is a docstring, or has no effect for another reason."""
    constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return constant or isinstance(node, ast.Pass)


def imported_by(text: str) -> set[str]:
    """The top-level modules that a source imports; SyntaxError or ValueError if it is no source."""
    modules = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            modules |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            modules.add(node.module.partition(".")[0])
    return modules
