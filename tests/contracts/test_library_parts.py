"""The package uses public parts of Numba and llvmlite, and private ones of Ray.

`pyproject.toml` admits Ray up to the version that was tested. Whoever raises the bound learns here
which part has gone, and which file uses it.
"""

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

from oracles.in_turn import in_turn

PROJECT = Path(__file__).parents[2]
LIBRARIES = ("llvmlite", "numba", "ray")
PUBLIC = {
    "llvmlite", "llvmlite.binding", "llvmlite.ir", "numba", "numba.core.cgutils", "numba.errors",
    "numba.config", "numba.extending", "numba.types",
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
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield from _extended(node, bound)


def _extended(node: ast.ClassDef, bound: dict[str, str]) -> Iterator[str]:
    """Methods that a class extends, of the library's class that it inherits from."""
    bases = [
        bound[base.id] for base in node.bases if isinstance(base, ast.Name) and base.id in bound
    ]
    for inner in ast.walk(node):
        if isinstance(inner, ast.Attribute) and isinstance(inner.value, ast.Call):
            called = inner.value.func
            if isinstance(called, ast.Name) and called.id == "super":
                yield from (f"{base}.{inner.attr}" for base in bases)


def is_there(part: str) -> bool:
    """Whether a part is there. A class may set its attributes in ``__init__``: one level counts."""
    module, _, names = part.partition(":")
    try:
        value = import_module(module)
    except ImportError:
        return False
    for name in names.split("."):
        if not hasattr(value, name):
            try:
                value = import_module(f"{value.__name__}.{name}")
            except (AttributeError, ImportError):
                return False
        else:
            value = getattr(value, name)
    return True


USED = {
    part: str(path.relative_to(PROJECT / "pfdist"))
    for path in sorted((PROJECT / "pfdist").rglob("*.py"))
    for part in parts(path)
}


@in_turn("part", sorted(USED))
def test_a_part_of_a_library_that_is_used_is_there(part: str) -> None:
    library = part.partition(":")[0].partition(".")[0]
    assert is_there(part), (
        f"{library} {version(library)} has no {part}, which pfdist/{USED[part]} uses: "
        "change that file, or lower the bound in pyproject.toml"
    )


def test_parts_are_found_in_the_source_and_a_missing_part_is_noticed(tmp_path: Path) -> None:
    source = tmp_path / "file.py"
    source.write_text(
        "import ray\nfrom numba.core import cgutils\nfrom numba.gone import x\n"
        "ray._private.services.gone()\ncgutils.alloca_once(1)\ncgutils.gone\n"
        "from numba.core.lowering import Lower\n"
        "class Mine(Lower):\n    def lower_gone(self): super().lower_gone(); super().lower()\n"
    )
    found = set(parts(source))
    assert {part for part in found if not is_there(part)} == {
        "numba.gone:x",
        "numba.core:cgutils.gone",
        "numba.core.lowering:Lower.lower_gone",
        "ray:_private.services.gone",
    }
    assert "numba.core:cgutils.alloca_once" in found


def is_public(part: str) -> bool:
    module, _, name = part.partition(":")
    known = module in PUBLIC or f"{module}.{name.partition('.')[0]}" in PUBLIC
    private = [each for each in name.split(".") if each.startswith("_")]
    return known and private in ([], ["__version__"])


def test_no_private_parts_are_used() -> None:
    private = {USED[part] for part in USED if not is_public(part)}
    assert private == set()
