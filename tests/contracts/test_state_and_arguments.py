"""Functions take few arguments, and objects get all their attributes in ``__init__``."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "pfdist"
ROOMS = ("kernels", "filters", "store", "pools", "common", "models")
MOST_ARGUMENTS = 9  # the public `filter_draws`, and the rounds of a cipher

pytestmark = pytest.mark.quick


def late_attributes(tree: ast.Module) -> Iterator[str]:
    """Attributes of ``self`` that a class sets without having them from ``__init__``."""
    for kind in (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)):
        named: dict[bool, set[str]] = {True: set(), False: set()}
        for method in (node for node in kind.body if isinstance(node, ast.FunctionDef)):
            named[method.name == "__init__"] |= {
                node.attr
                for node in ast.walk(method)
                if isinstance(node, ast.Attribute)
                and isinstance(node.ctx, ast.Store)
                and isinstance(node.value, ast.Name)
                and node.value.id == "self"
            }
        yield from (f"{kind.name}.{name}" for name in sorted(named[False] - named[True]))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and ast.unparse(node) == "self.__dict__":
            yield f"self.__dict__ in line {node.lineno}"


def long_signatures(tree: ast.Module, most: int) -> Iterator[str]:
    """Functions with too many arguments."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            if len([argument for argument in given if argument.arg != "self"]) > most:
                yield f"{node.name} ({len(given)} arguments)"


@pytest.mark.parametrize("room", ROOMS)
def test_state_is_made_at_once_and_no_signature_is_long(room: str) -> None:
    found = []
    for path in sorted((PACKAGE / room).glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        problems = [*late_attributes(tree), *long_signatures(tree, MOST_ARGUMENTS)]
        found += [f"{path.name}: {problem}" for problem in problems]
    assert not found


def test_such_faults_are_found() -> None:
    tree = ast.parse(
        "class A:\n"
        "    def __init__(self): self.a = 1\n"
        "    def f(self, x, y): self.a = 2; self.b = 3; self.__dict__\n"
    )
    assert list(late_attributes(tree)) == ["A.b", "self.__dict__ in line 3"]
    assert list(long_signatures(tree, 1)) == ["f (3 arguments)"]
