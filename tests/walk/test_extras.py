"""Modules that need an extra name it where it is missing, and nothing else is skipped."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from oracles.extras import MODULES, ROOT, lack_of
from oracles.in_turn import in_turn
from pfdist.common.parsing import parse_toml

# Libraries of extras that the package imports; all others are needed by tests and docs alone.
LIBRARIES = ("anywidget", "jax", "starlette", "uvicorn", "websockets")
IMPORTS = f"""
import importlib, pkgutil, sys
sys.modules |= dict.fromkeys({LIBRARIES})
import pfdist
from pfdist.errors import PfdistError
for module in pkgutil.walk_packages(pfdist.__path__, "pfdist."):
    try:
        module.name != "pfdist.__main__" and importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        print(module.name, isinstance(error, PfdistError), error, sep=";")
"""
SKIPS = {  # tests that a machine may lack something for, in the words of their reasons
    "tests/crash/test_failing_models.py": "too little memory to take of",
    "tests/kernels/test_portable.py": "processors of another kind have it",
    "tests/runner/test_identity.py": "git makes the received repository",
}


@pytest.mark.plugins("accelerator", "explorer")
def test_without_any_extra_each_module_is_imported_or_names_the_extra() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True
    )
    found = [line.split(";") for line in done.stdout.splitlines()]
    expected = [module for module in MODULES if module.startswith("pfdist/")]
    assert len(found) >= len(expected)
    for name, is_ours, message in found:
        path = Path(*name.split("."))
        (extra,) = {
            MODULES[each]
            for each in expected
            if path.is_relative_to(each) or str(path) + ".py" == each
        }
        assert is_ours == "True"
        assert f"needs pip install -e '.[{extra}]', got no " in message


def test_what_is_skipped_is_said_with_the_extra_and_its_libraries() -> None:
    assert lack_of("test") == ""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("oracles.extras.requires", lambda _: ["nothing_of_this_name; extra=='a'"])
        assert lack_of("a") == "needs pip install -e '.[a]', got no nothing_of_this_name"
        assert lack_of("b") == ""


def test_a_mark_names_an_extra_that_there_is() -> None:
    extras = parse_toml((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    marked = {*MODULES.values()}
    for path in (ROOT / "tests").rglob("test_*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(func=ast.Attribute(attr="needs"), args=[ast.Constant(value=extra)]):
                    marked.add(extra)
    assert marked <= {*extras}


def test_no_example_of_a_docstring_is_skipped() -> None:
    files = (ROOT / "pfdist").rglob("*.py")
    assert [each for each in files if "doctest: +SKIP" in each.read_text(encoding="utf-8")] == []


@in_turn("path", [each.relative_to(ROOT) for each in (ROOT / "tests").rglob("*.py")])
def test_nothing_else_is_skipped(path: Path) -> None:
    """A skipped test is green without being run."""
    allowed = ("tests/conftest.py", "tests/oracles/extras.py")
    if str(path) in allowed:
        return
    skips = [
        node
        for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
        and node.attr in {"importorskip", "skip", "skipif"}
        and getattr(node.value, "id", getattr(node.value, "attr", "")) in {"pytest", "mark"}
    ]
    assert len(skips) == (str(path) in SKIPS)
    if skips:
        assert SKIPS[str(path)] in (ROOT / path).read_text(encoding="utf-8")
