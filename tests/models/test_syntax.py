"""The syntax of a function: what it does makes a difference, how it is written makes none."""

import importlib.util
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pfdist.models.syntax import syntax_of

_names = itertools.count()


@pytest.fixture
def made(tmp_path: Path) -> Callable[[str], Any]:
    """The function f, or f[0], of a module with some text."""

    def make(text: str) -> Any:
        path = tmp_path / f"module_{next(_names)}.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.f

    return make


PLAIN = "def f(x, k=2):\n    y = x + k\n    return y\n"


SAME = {
    "docstring and comment": "def f(x, k=2):\n    'Words.'\n    y = x + k  # so\n    return y\n",
    "layout": "\n\nX = 1\ndef f( x,k = 2 ) :\n  y=(x+\n   k)\n\n  return (y)\n",
    "annotations": "def f(x: float, k: int = 2) -> 'float':\n    y: float = x + k\n    return y\n",
    "decorator": f"def same(g): return g\n@same\n{PLAIN.replace('return', 'pass; return')}",
    "default, told as a value": PLAIN.replace("k=2", "k=3"),
}
OTHER = {
    "operator": PLAIN.replace("+", "-"),
    "constant": PLAIN.replace("+ k", "+ 1 * k"),
    "result": PLAIN.replace("return y", "return x"),
    "keyword": PLAIN.replace("k=2", "*, k=2"),
    "order": PLAIN.replace("x, k=2", "k, x=2"),
    "function inside": PLAIN.replace("    y =", "    def g(a=1): return a\n    y ="),
}


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_what_does_nothing_makes_no_difference(made: Callable[[str], Any], text: str) -> None:
    assert syntax_of(made(PLAIN)) == syntax_of(made(text)) is not None


@pytest.mark.parametrize("text", OTHER.values(), ids=OTHER)
def test_what_does_something_makes_a_difference(made: Callable[[str], Any], text: str) -> None:
    assert syntax_of(made(PLAIN)) != syntax_of(made(text)) is not None


def test_a_default_of_a_function_inside_makes_a_difference(made: Callable[[str], Any]) -> None:
    text = "def f(x):\n    def g(a={}): return a\n    return g()\n"
    assert syntax_of(made(text.format(1))) != syntax_of(made(text.format(2)))


@pytest.mark.parametrize(
    "line",
    [
        "f = (lambda x: x + 1), (lambda x: x + 2), (lambda x: 1), (lambda x: 2)",
        "f = lambda x: x, lambda x: -x, (lambda y: (lambda z: z + y))(3), (lambda a: (lambda: a))",
    ],
)
def test_lambdas_on_one_line_are_told_apart(made: Callable[[str], Any], line: str) -> None:
    together = [syntax_of(function) for function in made(line)]
    assert None not in together
    assert len(set(together)) == len(together)


def test_a_lambda_is_the_same_wherever_it_stands(made: Callable[[str], Any]) -> None:
    alone = made("f = lambda x: x * 2")
    among = made("f = [(lambda y: y), (lambda x: x * 2), lambda x: x * 3][1]")
    inside = made("f = (lambda: (lambda x:\n x * 2))()")
    assert syntax_of(alone) == syntax_of(among) == syntax_of(inside) is not None


def test_source_that_is_not_what_was_loaded_is_not_told(
    made: Callable[[str], Any], tmp_path: Path
) -> None:
    function = made(PLAIN)
    file = Path(function.__code__.co_filename)
    for text in (PLAIN.replace("+", "-"), "\n" + PLAIN, "def f(", ""):
        file.write_text(text)
        assert syntax_of(function) is None
    file.unlink()
    assert syntax_of(function) is None


def test_a_function_made_by_exec_has_no_source() -> None:
    scope: dict[str, Any] = {"__name__": "mine"}
    exec("def f(x): return x", scope)
    assert syntax_of(scope["f"]) is None
