"""A plugin is its folder and its line: without them, everything else stands."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from pfdist.common.plugins import plugins
from pfdist.plugins import PLUGINS

ROOT = Path(__file__).parents[2]
COPIED = (
    "pfdist", "jobs", "docs", "docker", "benchmarks", "tests", "results", "requirements", ".ci",
    ".github", "pyproject.toml", "MANIFEST.in", "LICENSE",
    *(each.name for each in ROOT.glob("*.md")),
)  # fmt: skip
ARCHIVE = "tests/docs/test_archive.py"  # of a clone, and a copy is none
IMPORT_ALL = """
import importlib, pkgutil, pfdist
from pfdist.errors import MissingExtraError
for each in pkgutil.walk_packages(pfdist.__path__, "pfdist."):
    try:
        if not each.name.endswith("__main__"):
            importlib.import_module(each.name)
    except MissingExtraError:
        pass
print(pfdist.__file__)
"""


def test_each_folder_is_in_the_list() -> None:
    folders = {each.parent.name for each in (ROOT / "pfdist" / "plugins").glob("*/__init__.py")}
    assert folders == {*PLUGINS}


def test_the_example_of_contributing_is_a_plugin(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.DOTALL)
    assert len(code.splitlines()) <= 60
    (tmp_path / "gaps.py").write_text(code)
    metadata = tmp_path / "gaps-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: gaps\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[pfdist.plugins]\ngaps = gaps:PLUGIN\n")
    words = "gaps", "results/example", "--json"
    done = subprocess.run(
        [sys.executable, "-m", "pfdist", *words], cwd=ROOT, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(tmp_path)}, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["longest"]["evenly_spaced"] == 3.0


def standing_on(name: str) -> set[str]:
    """The plugin, and those that import it, which are deleted with it."""
    folders = (ROOT / "pfdist" / "plugins" / each for each in PLUGINS)
    texts = {
        folder.name: "".join(file.read_text(encoding="utf-8") for file in folder.rglob("*.py"))
        for folder in folders
    }
    found = {name}
    for _ in PLUGINS:
        found |= {
            each for each in texts for other in found if f"pfdist.plugins.{other}." in texts[each]
        }
    return found


def _without(deleted: set[str], copy: Path) -> Callable[..., str]:
    """Make a copy without some plugins; give the function that calls Python in it."""
    copy.mkdir()
    for each in COPIED:
        make = shutil.copytree if (ROOT / each).is_dir() else shutil.copy2
        make(ROOT / each, copy / each)
    environment = os.environ | {"PYTHONPATH": str(copy)}

    def python(*words: str) -> str:
        done = subprocess.run(
            [sys.executable, *words], cwd=copy, env=environment, capture_output=True, text=True,
            check=False, timeout=3000,
        )  # fmt: skip
        assert done.returncode == 0, (words, done.stdout[-2000:], done.stderr[-2000:])
        return done.stdout

    plugin_list = copy / "pfdist" / "plugins" / "__init__.py"
    text = plugin_list.read_text(encoding="utf-8")
    for each in deleted:
        shutil.rmtree(copy / "pfdist" / "plugins" / each)
        shutil.rmtree(copy / "tests" / "plugins" / each, ignore_errors=True)
        sections = [f"\n[{key}]\n" for key in plugins()[each].sections]
        for job in copy.glob("jobs/*.toml"):
            if any(section in job.read_text(encoding="utf-8") for section in sections):
                job.unlink()
        text = re.sub(rf'"{each}",? ?', "", text)
    plugin_list.write_text(text, encoding="utf-8")
    python("docs/tables.py")
    assert str(copy) in python("-c", IMPORT_ALL)
    return python


@pytest.mark.slow
def test_the_core_stands_alone(tmp_path: Path) -> None:
    """All its tests pass without any plugin, but those that use one and say so."""
    python = _without({*PLUGINS}, tmp_path / "copy")
    assert " passed" in python("-m", "pytest", "-q", "-n", "2", "tests", "--ignore", ARCHIVE)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLUGINS)
def test_without_a_plugin_everything_else_stands(name: str, tmp_path: Path) -> None:
    python = _without(standing_on(name), tmp_path / "copy")
    shown = python("-m", "pfdist", "--help")
    for commands in plugins()[name].commands.values():
        assert not [each for each in commands if f"│ {each} " in shown]
    python("-m", "pytest", "-q", "-n", "0", "tests/contracts")
    python("-m", "pfdist", "plan", "jobs/quick.toml", "--results", "run", "--no-report")
    if find_spec("importlinter") is None:
        return  # it is part of the extra `dev`
    linter = "from importlinter.cli import lint_imports_command as check; check()"
    python("-c", linter)
