"""Modules and data beside a model's file: found wherever it is loaded, and nobody else's."""

import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from pfdist.errors import ModelError
from pfdist.models import ModelSource, find_model

MODEL = """
{before}
from pfdist import StateSpaceModel

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: ({formula},),
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    data_files={data},
)
"""
FILES = {
    "helper.py": "from inner.deep import three\ndef triple(x): return three() * x\n",
    "inner/__init__.py": "",
    "inner/deep.py": "from . import other\nfrom .other import ONE\n"
    "def three(): return ONE + other.TWO\n",
    "inner/other.py": "import inner.deep\nONE, TWO = 1, 2\n",
    "bare/deep.py": "THREE = 3\n",
    "random.py": "raise RuntimeError('the standard library goes first')\n",
}
Write = Callable[..., ModelSource]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a model with files beside it, and find it."""

    def found(
        before: str, formula: str = "x[0]", data: tuple[str, ...] = (), name: str = "a", **more: str
    ) -> ModelSource:
        files = {**FILES, **{f"{key}.py": text for key, text in more.items()}}
        files["mine.py"] = MODEL.format(before=before, formula=formula, data=data)
        for file, text in files.items():
            path = tmp_path / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return find_model(f"{name}/mine.py:model", tmp_path)

    return found


def moved(source: ModelSource) -> Any:
    """Give the state to which the model takes x = 2."""
    model = source.load()
    return model.transition((2.0,), 0, (0.0,), model.p)[0]


@pytest.mark.parametrize(
    ("before", "formula"),
    [
        ("import helper", "helper.triple(x[0])"),
        ("from helper import triple as f", "f(x[0])"),
        ("from helper import *", "triple(x[0])"),
        ("import inner.deep", "inner.deep.three() * x[0]"),
        ("import inner.deep as d", "d.three() * x[0]"),
        ("from inner import deep", "deep.three() * x[0]"),
        ("from .inner.deep import three", "three() * x[0]"),
        ("from bare import deep", "deep.THREE * x[0]"),
        ("import random", "x[0] * random.randint(3, 3)"),
        ("def f(x):\n    from helper import triple\n    return triple(x)", "f(x[0])"),
    ],
)
def test_what_lies_beside_is_imported_also_where_the_folder_is_gone(
    write: Write, tmp_path: Path, before: str, formula: str
) -> None:
    source = write(before, formula)
    before_that = set(sys.modules)
    assert moved(source) == 6.0
    _, carried = source.record()
    shutil.rmtree(tmp_path / "a")
    assert moved(carried) == 6.0
    assert not {"helper", "inner", "bare", "mine"} & (set(sys.modules) - before_that)


def test_all_that_is_imported_travels_and_nothing_else(write: Write) -> None:
    _, source = write("import helper\nfrom bare import deep", "x[0]").record()
    assert [name for name, _ in source.files or ()] == [
        "bare/deep.py", "helper.py", "inner/__init__.py", "inner/deep.py", "inner/other.py",
    ]  # fmt: skip


def test_two_models_have_each_their_own_helper(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = ModuleType("helper")
    monkeypatch.setitem(sys.modules, "helper", theirs)
    first, second = (
        write("from helper import f", "f(x[0])", name=name, helper=f"def f(x): return {k} * x")
        for name, k in (("a", 2), ("b", 5))
    )
    assert [moved(first), moved(second), moved(first)] == [4.0, 10.0, 4.0]
    assert sys.modules["helper"] is theirs


def test_an_edited_helper_is_loaded_anew(write: Write) -> None:
    for k in (2, 5):
        source = write("from helper import f", "f(x[0])", helper=f"def f(x): return {k} * x")
        assert moved(source) == 2.0 * k


def test_the_same_source_gives_the_same_model(write: Write) -> None:
    first, second = (write("import helper").record()[1] for _ in range(2))
    assert first.load() is second.load()


READS = "from pathlib import Path\nC = float(Path(__file__).with_name('c.txt').read_text())"


def test_data_that_is_declared_travels(write: Write, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "c.txt").write_text("7")
    _, source = write(READS, "C * x[0]", ("c.txt",)).record()
    shutil.rmtree(tmp_path / "a")
    assert moved(source) == 14.0
    assert not list(Path(tempfile.gettempdir()).glob("pfdist-model-*/c.txt"))


def test_data_that_is_read_and_not_declared_is_an_error_that_says_so(
    write: Write, tmp_path: Path
) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "c.txt").write_text("7")
    with pytest.raises(ModelError, match=r"as in a worker, with only its data_files") as caught:
        write(READS, "C * x[0]").load()
    assert "\n" not in str(caught.value)
    assert f"No such file or directory: '{tmp_path}/a/c.txt'" in str(caught.value)


def test_data_that_is_declared_and_missing_is_an_error(write: Write, tmp_path: Path) -> None:
    with pytest.raises(ModelError) as caught:
        write("", data=("c.txt",)).load()
    assert str(caught.value) == (
        "model mine: data_files must name files that can be read, got 'c.txt': "
        f"{tmp_path}/a/c.txt: there is no such file"
    )


@pytest.mark.parametrize("data", [("../c.txt",), ("/etc/passwd",), "c.txt", (3,), ("",)])
def test_data_outside_the_folder_is_refused(write: Write, data: Any) -> None:
    with pytest.raises(ModelError, match="data_files must be a tuple of names relative to"):
        write("", data=repr(data)).load()


def test_errors_and_tracebacks_name_the_users_file_and_line(write: Write, tmp_path: Path) -> None:
    source = write(
        "from helper import f", "f(x[0], t)", helper="def f(x, t):\n    return x / (3 - t)\n"
    )
    _, carried = source.record()
    model = carried.load()
    shutil.rmtree(tmp_path / "a")
    with pytest.raises(ZeroDivisionError) as caught:
        model.transition((2.0,), 3, (0.0,), model.p)
    said = "".join(traceback.format_exception(caught.value))
    assert f'File "{tmp_path}/a/helper.py", line 2' in said
    assert "return x / (3 - t)" in said


@pytest.mark.parametrize(
    ("before", "reason"),
    [
        ("import no_such", "ModuleNotFoundError: No module named 'no_such'"),
        ("from helper import no", "cannot import name 'no' from 'helper' ("),
        ("import broken", "ZeroDivisionError"),
    ],
)
def test_an_import_that_fails_is_named_as_the_user_knows_it(
    write: Write, before: str, reason: str
) -> None:
    with pytest.raises(ModelError, match=r"mine\.py fails when loaded: ") as caught:
        write(before, broken="1 / 0").load()
    assert reason in str(caught.value)
    assert "pfdist_model" not in str(caught.value)
    assert not [name for name in sys.modules if name.startswith("pfdist_model_recorded")]


LATE = """
def late(x, t):
    if t > 4:  # which no model is tried with when it is loaded
        from inner import deep as inner_deep
        import later
        return inner_deep.three() + later.first() + x
    return x
"""


def test_what_functions_may_import_later_travels_and_is_found_after_the_model_is_forgotten(
    write: Write,
) -> None:
    later = "def first():\n    from last import ONE\n    return ONE\n"
    source = write(LATE, "late(x[0], t)", later=later, last="ONE = 1", broken="def")
    model, recorded = source.record()
    assert {name for name, _ in recorded.files or ()} == {
        "inner/__init__.py", "inner/deep.py", "inner/other.py", "last.py", "later.py",
    }  # fmt: skip
    for loaded in (model, recorded.load()):
        assert loaded.transition((2.0,), 5, (0.0,), loaded.p)[0] == 3 + 1 + 2.0
    assert not [name for name in sys.modules if name.startswith("pfdist_model_recorded")]


def test_a_broken_module_that_a_function_may_import_breaks_nothing_before(write: Write) -> None:
    source = write(LATE.replace("later", "broken"), "late(x[0], t)", broken="def")
    assert moved(source) == 2.0
