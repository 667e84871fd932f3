"""A model's file is imported with the modules beside it, and with nobody else's."""

import importlib
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import pfdist
from oracles.model_text import WALK
from pfdist.errors import ModelError
from pfdist.models import StateSpaceModel, load_model, loader
from pfdist.models.by_value import by_value

FILES = {
    "helper.py": "from inner.deep import three\ndef triple(x): return three() * x\n",
    "inner/__init__.py": "",
    "inner/deep.py": "from . import other\nfrom .other import ONE\n"
    "def three(): return ONE + other.TWO\n",
    "inner/other.py": "ONE, TWO = 1, 2\n",
    "bare/deep.py": "THREE = 3\n",
}
Write = Callable[..., StateSpaceModel]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a model with files beside it, and load it."""

    def found(before: str, formula: str = "x[0]", name: str = "a", **more: str) -> StateSpaceModel:
        files = {**FILES, **{f"{key}.py": text for key, text in more.items()}}
        files["mine.py"] = WALK.format(before=before, formula=formula, after="")
        for file, text in files.items():
            path = tmp_path / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return load_model(f"{name}/mine.py:model", tmp_path)

    return found


def moved(model: StateSpaceModel) -> Any:
    """Give the state to which the model takes x = 2."""
    return model.transition((2.0,), 0, (0.0,), model.p)[0]


def moved_elsewhere(*models: StateSpaceModel) -> list[float]:
    """Give it as another process computes it, which has only what travels."""
    program = (
        "import sys\n"
        "from pfdist.models.by_value import models_made\n"
        "for model in models_made(sys.stdin.buffer.read()):\n"
        "    print(model.transition((2.0,), 0, (0.0,), model.p)[0])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], input=by_value(models), capture_output=True, check=True
    )
    return [float(line) for line in done.stdout.split()]


def test_what_lies_beside_travels_also_where_the_folder_is_gone(
    write: Write, tmp_path: Path
) -> None:
    known = set(sys.modules)
    ways = [
        ("import helper", "helper.triple(x[0])"),
        ("from helper import triple as f", "f(x[0])"),
        ("from helper import *", "triple(x[0])"),
        ("import inner.deep", "inner.deep.three() * x[0]"),
        ("import inner.deep as d", "d.three() * x[0]"),
        ("from inner import deep", "deep.three() * x[0]"),
        ("from bare import deep", "deep.THREE * x[0]"),
        ("import random", "x[0] * random.randint(3, 3)"),
        ("def make(k): return lambda x: k * x\nf = make(3)", "f(x[0])"),
    ]
    models = [write(*way, name=f"model-{number}") for number, way in enumerate(ways)]
    for folder in tmp_path.glob("model-*"):
        shutil.rmtree(folder)
    assert [moved(model) for model in models] == [6.0] * len(ways)
    assert moved_elsewhere(*models) == [6.0] * len(ways)
    assert not {"helper", "inner", "bare", "mine"} & (set(sys.modules) - known)


def test_two_models_have_each_their_own_helper_and_an_edited_one_is_loaded_anew(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = ModuleType("helper")
    monkeypatch.setitem(sys.modules, "helper", theirs)
    first, second, edited = (
        write("from helper import f", "f(x[0])", name=name, helper=f"def f(x): return {k} * x")
        for name, k in (("a", 2), ("b", 5), ("a", 3))
    )
    assert [moved(each) for each in (first, second, first, edited)] == [4.0, 10.0, 4.0, 6.0]
    assert sys.modules["helper"] is theirs


def test_a_file_that_hides_a_module_is_refused_by_its_name(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("random", "calendar", "numpy", "pfdist"):
        with pytest.raises(ModelError, match=rf"{name}\.py hides the module of this name: rename"):
            write(f"import {name}", name=name, **{name: "A = 1"})
    monkeypatch.delitem(sys.modules, "antigravity", raising=False)
    with pytest.raises(ModelError, match=r"antigravity\.py hides the module 'antigravity'"):
        write("import helper", helper="import antigravity", antigravity="A = 1")


def test_the_package_may_lie_below_the_folder_of_a_model(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a clone beside the model; a part of the package that the model loads hides nothing."""
    monkeypatch.delitem(sys.modules, "pfdist.common.nearest")
    folder = Path(pfdist.__file__).parents[1]
    with loader._beside(folder):
        importlib.import_module("pfdist.common.nearest")
    assert "pfdist.common.nearest" in sys.modules


def test_a_file_that_nobody_imports_hides_nothing(write: Write) -> None:
    assert moved(write("import calendar", test="raise RuntimeError")) == 2.0


@pytest.mark.parametrize(
    ("before", "reason"),
    [
        ("import no_such", "ModuleNotFoundError: No module named 'no_such'"),
        ("from helper import no", "cannot import name 'no' from 'helper' ("),
        ("import broken", "ZeroDivisionError"),
        ("from . import helper", "write `import helper` instead of"),
    ],
)
def test_an_import_that_fails_is_named_as_the_user_knows_it(
    write: Write, before: str, reason: str
) -> None:
    known = set(sys.modules)
    with pytest.raises(ModelError, match=r"loading .*mine\.py failed: ") as caught:
        write(before, broken="1 / 0")
    assert reason in str(caught.value)
    assert "pfdist_model" not in str(caught.value)
    assert not [name for name in set(sys.modules) - known if "pfdist_model" in name]


def test_threads_load_each_their_own_helper(write: Write, tmp_path: Path) -> None:
    for name, k in (("a", 2), ("b", 5)):
        helper = f"import time\ntime.sleep(0.05)\ndef f(x): return {k} * x"
        write("from helper import f", "f(x[0])", name=name, helper=helper)
    path = sys.path.copy()
    with ThreadPoolExecutor(2) as pool:
        loaded = pool.map(lambda name: load_model(f"{name}/mine.py:model", tmp_path), "abab")
        assert [moved(each) for each in loaded] == [4.0, 10.0, 4.0, 10.0]
    assert sys.path == path
