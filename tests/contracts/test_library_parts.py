"""The package uses public parts of Numba, llvmlite and Ray alone, in versions that CI tests."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
LIBRARIES = ("llvmlite", "numba", "ray")
PUBLIC = {
    "llvmlite", "llvmlite.binding", "llvmlite.ir", "numba", "numba.core.cgutils", "numba.errors",
    "numba.config", "numba.extending", "numba.types",
    "numba.core.typing.templates.AttributeTemplate",  # which `infer_getattr` demands
}  # fmt: skip


def _bound(tree: ast.Module) -> dict[str, str]:
    """``module:name`` of each name that a file imports; no name for a whole library."""
    bound: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            module = node.module or ""
            bound |= {alias.asname or alias.name: f"{module}:{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            tops = [alias.name.partition(".")[0] for alias in node.names if not alias.asname]
            bound |= {top: f"{top}:" for top in tops}
    return {
        name: part
        for name, part in bound.items()
        if part.partition(":")[0].partition(".")[0] in LIBRARIES
    }


def parts(path: Path) -> Iterator[str]:
    """``module:name`` of everything that a file takes from the libraries, attributes included."""
    text = path.read_text(encoding="utf-8")
    if not re.search(rf"^\s*(from|import) ({'|'.join(LIBRARIES)})\b", text, re.MULTILINE):
        return  # most files need not be parsed
    tree = ast.parse(text)
    bound = _bound(tree)
    yield from (part for part in bound.values() if not part.endswith(":"))
    for node in ast.walk(tree):
        names, value = [], node
        while isinstance(value, ast.Attribute):
            names.insert(0, value.attr)
            value = value.value
        if names and isinstance(value, ast.Name) and value.id in bound:
            module, _, name = bound[value.id].partition(":")
            yield f"{module}:{'.'.join([name, *names] if name else names)}"


USED = {
    part: str(path.relative_to(PROJECT / "pfdist"))
    for path in sorted((PROJECT / "pfdist").rglob("*.py"))
    for part in parts(path)
}


def is_public(part: str) -> bool:
    module, _, name = part.partition(":")
    known = module in PUBLIC or f"{module}.{name.partition('.')[0]}" in PUBLIC
    private = [each for each in name.split(".") if each.startswith("_")]
    return known and private in ([], ["__version__"])


def test_no_private_parts_are_used() -> None:
    private = {USED[part] for part in USED if not is_public(part)}
    assert private == set()


@pytest.mark.parametrize("library", ["llvmlite", "numba"])
def test_the_compiler_has_no_version_beyond_those_that_ci_tests(library: str) -> None:
    """Both are released together and before 1.0, so each minor version may change what is used."""
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    tested = [
        re.search(rf"^{library}==0\.(\d+)\.", (PROJECT / "requirements" / name).read_text(), re.M)
        for name in ("lowest.txt", "locked.txt")
    ]
    lowest, locked = (int(found[1]) for found in tested if found is not None)
    assert f"{library}>=0.{lowest},<0.{locked + 1}" in project["dependencies"]
