"""The syntax of functions, without everything that has no effect; and the modules they import.

Comments, docstrings, annotations, positions and the version of Python make no difference.
"""

import ast
import importlib.util
import linecache
import types
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from typing import Any

_Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_Position = tuple[int, int]
_Place = tuple[int, str]

# Annotations do nothing, and the other fields say what the rest of the tree says.
_LEFT_OUT = ("annotation", "returns", "type_params", "type_comment", "simple", "kind", "ctx")


def syntax_of(function: types.FunctionType) -> bytes | None:
    """Give a function's syntax, without its defaults and decorators, which count by value.

    Returns
    -------
    bytes or None
        None if no source is known that compiles to the function's very code: it was made by
        ``exec``, or its file has been edited since it was loaded.
    """
    scope, code = function.__globals__, function.__code__
    loader: Any = scope.get("__loader__")
    try:
        text = loader.get_source(scope.get("__name__"))
    except (AttributeError, ImportError, OSError, SyntaxError):
        text = "".join(linecache.getlines(code.co_filename))  # a notebook keeps its cells there
    return _syntax_of_code(code, text) if text else None


@cache
def _syntax_of_code(code: types.CodeType, text: str) -> bytes | None:
    node = _node_of(code, text)
    return None if node is None else repr(_told_function(node)).encode("utf-8", "surrogatepass")


@cache
def _parsed(text: str) -> tuple[dict[_Place, list[_Function]], dict[_Place, list[types.CodeType]]]:
    """Give the functions of a source, and all its code objects by their lines and names."""
    try:
        tree, code = ast.parse(text), compile(text, "source", "exec", dont_inherit=True)
    except (SyntaxError, ValueError):  # the file has been edited
        return {}, {}
    nodes, codes = defaultdict(list), defaultdict(list)
    for node in ast.walk(tree):
        if isinstance(node, _Function):
            nodes[_first_line(node), getattr(node, "name", "<lambda>")].append(node)
    for inner in _codes(code):
        codes[inner.co_firstlineno, inner.co_name].append(inner)
    return nodes, codes


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield constant
            yield from _codes(constant)


def _node_of(code: types.CodeType, text: str) -> _Function | None:
    """Find the syntax from which a code object was compiled."""
    nodes_at, codes_at = _parsed(text)
    place = code.co_firstlineno, code.co_name
    nodes = nodes_at.get(place, []) if code in codes_at.get(place, []) else []
    if len(nodes) > 1:  # lambdas on one line
        spans = list(_spans(code))
        nodes = [node for node in nodes if spans and _holds(node, spans)]
        nodes = nodes[-1:]  # a tree is walked from the outside inwards
    return nodes[0] if nodes else None


def _first_line(node: _Function) -> int:
    decorators: list[ast.expr] = getattr(node, "decorator_list", [])
    return min([node.lineno, *(decorator.lineno for decorator in decorators)])


def _spans(code: types.CodeType) -> Iterator[tuple[_Position, _Position]]:
    """The start and end in the source of each instruction that has a position."""
    for line, end_line, column, end_column in code.co_positions():
        if line is None or end_line is None or column is None or end_column is None:
            continue
        if (line, column) != (end_line, end_column):
            yield (line, column), (end_line, end_column)


def _holds(node: _Function, spans: list[tuple[_Position, _Position]]) -> bool:
    """Whether all instructions come from a lambda's body."""
    body = node.body
    if isinstance(body, list):
        return False
    last = body.end_lineno or 0, body.end_col_offset or 0
    return all((body.lineno, body.col_offset) <= first and end <= last for first, end in spans)


def _told_function(node: _Function) -> Any:
    """Describe a function without its defaults."""
    arguments = [
        (field, _told(value))
        for field, value in ast.iter_fields(node.args)
        if field not in ("defaults", "kw_defaults")
    ]
    return type(node).__name__, arguments, _told(node.body)


def _told(node: Any) -> Any:
    """Describe a node of a tree, or a list of nodes, as nested tuples."""
    if isinstance(node, list):
        return [_told(entry) for entry in node if not _does_nothing(entry)]
    if isinstance(node, ast.Constant):
        return type(node.value).__name__, repr(node.value)
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        return "Assign", [("targets", [_told(node.target)]), ("value", _told(node.value))]
    if isinstance(node, ast.AST):
        fields = [
            (field, _told(value))
            for field, value in ast.iter_fields(node)
            if field not in _LEFT_OUT and value is not None and value != []
        ]
        return type(node).__name__, fields
    return repr(node)


def _does_nothing(node: Any) -> bool:
    """Whether a statement is a docstring, or has no effect for another reason."""
    constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return constant or isinstance(node, ast.Pass)


def imported_in(text: str, package: str, by_functions: bool = False) -> Iterator[str]:
    """Give the modules that a source may import, with the packages around them.

    A name may turn out to be a variable's: ``from helper import C`` gives ``helper, helper.C``.

    Parameters
    ----------
    text : str
        The source.
    package : str
        The package to which its imports are relative.
    by_functions : bool
        Whether only those count that functions do when they are called.

    Raises
    ------
    SyntaxError, ValueError
        The text is no source.
    """
    tree = ast.parse(text)
    functions = [node for node in ast.walk(tree) if isinstance(node, _Function)]
    around = functions if by_functions else [tree]
    for statement in (node for outer in around for node in ast.walk(outer)):
        if isinstance(statement, ast.Import | ast.ImportFrom):
            for name in _imported(statement, package):
                parts = name.split(".")
                yield from (".".join(parts[: count + 1]) for count in range(len(parts)))


def _imported(statement: ast.Import | ast.ImportFrom, package: str) -> Iterator[str]:
    names = [alias.name for alias in statement.names]
    if isinstance(statement, ast.Import):
        yield from names
        return
    module = statement.module or ""
    if statement.level:
        try:
            module = importlib.util.resolve_name(f"{'.' * statement.level}{module}", package)
        except ImportError:  # it leads out of the package: an error when it is called
            return
    yield from (f"{module}.{name}" for name in names)
