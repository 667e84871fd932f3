"""A model travels by value, with the modules and data beside its file, and nobody else's."""

import linecache
import pickle
import shutil
import subprocess
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from oracles.model_text import MEASURED
from pfdist.errors import ModelError
from pfdist.models import CarriedModel, carried, carried_model, load_model, squared_error
from pfdist.models.fingerprint import inspected

MODEL = (
    """
{before}
from pfdist import StateSpaceModel

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: ({formula},),
"""
    + MEASURED
    + """    data_files={data},
)
"""
)
FILES = {
    "helper.py": "from inner.deep import three\ndef triple(x): return three() * x\n",
    "inner/__init__.py": "",
    "inner/deep.py": "from . import other\nfrom .other import ONE\n"
    "def three(): return ONE + other.TWO\n",
    "inner/other.py": "import inner.deep\nONE, TWO = 1, 2\n",
    "bare/deep.py": "THREE = 3\n",
}
Write = Callable[..., CarriedModel]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a model with files beside it, and load it."""

    def found(
        before: str, formula: str = "x[0]", data: tuple[str, ...] = (), name: str = "a", **more: str
    ) -> CarriedModel:
        files = {**FILES, **{f"{key}.py": text for key, text in more.items()}}
        files["mine.py"] = MODEL.format(before=before, formula=formula, data=data)
        for file, text in files.items():
            path = tmp_path / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return carried_model(f"{name}/mine.py:model", tmp_path)

    return found


def moved(carried: CarriedModel) -> Any:
    """Give the state to which the model takes x = 2."""
    model = carried.model
    return model.transition((2.0,), 0, (0.0,), model.p)[0]


def moved_elsewhere(carried: CarriedModel) -> Any:
    """Give it as another process computes it, which has only what travels."""
    program = (
        "import pickle, sys\n"
        "model = pickle.load(sys.stdin.buffer).model\n"
        "print(model.transition((2.0,), 0, (0.0,), model.p)[0])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        input=pickle.dumps(carried),
        capture_output=True,
        check=True,
    )
    return float(done.stdout)


@pytest.mark.parametrize(
    ("before", "formula"),
    [
        ("import helper", "helper.triple(x[0])"),
        ("from helper import triple as f", "f(x[0])"),
        ("from helper import *", "triple(x[0])"),
        ("import inner.deep", "inner.deep.three() * x[0]"),
        ("import inner.deep as d", "d.three() * x[0]"),
        ("from inner import deep", "deep.three() * x[0]"),
        ("from bare import deep", "deep.THREE * x[0]"),
        ("import random", "x[0] * random.randint(3, 3)"),
        ("import numba\n@numba.njit\ndef f(x): return 3 * x", "f(x[0])"),
        ("def make(k): return lambda x: k * x\nf = make(3)", "f(x[0])"),
    ],
)
def test_what_lies_beside_travels_also_where_the_folder_is_gone(
    write: Write, tmp_path: Path, before: str, formula: str
) -> None:
    known = set(sys.modules)
    carried = write(before, formula)
    shutil.rmtree(tmp_path / "a")
    assert moved(carried) == 6.0
    assert moved_elsewhere(carried) == 6.0
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


def test_the_same_files_give_the_same_model(write: Write) -> None:
    """So its formulas are compiled once in a process."""
    first, second = (write("import helper", "helper.triple(x[0])") for _ in range(2))
    assert first.model is second.model


def test_a_file_that_hides_a_module_is_refused_by_its_name(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("random", "calendar", "numpy", "pfdist"):
        with pytest.raises(ModelError, match=rf"{name}\.py hides the module of this name: rename"):
            write(f"import {name}", name=name, **{name: "A = 1"})
    monkeypatch.delitem(sys.modules, "antigravity", raising=False)
    with pytest.raises(ModelError, match=r"antigravity\.py hides the module 'antigravity'"):
        write("import helper", helper="import antigravity", antigravity="A = 1")


def test_a_file_that_nobody_imports_hides_nothing(write: Write) -> None:
    assert moved(write("import calendar", test="raise RuntimeError")) == 2.0


READS = "from pathlib import Path\nC = float(Path(__file__).with_name('c.txt').read_text())"


def test_data_that_is_read_travels_in_the_constants(write: Write, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "c.txt").write_text("7")
    carried = write(READS, "C * x[0]", ("c.txt",))
    shutil.rmtree(tmp_path / "a")
    assert moved(carried) == moved_elsewhere(carried) == 14.0
    assert carried.fingerprint["C"] == 7.0
    assert "data_files.c.txt" in carried.fingerprint


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (("c.txt",), "data_files must name files that can be read, got 'c.txt': .*No such file"),
        *(
            (wrong, "data_files must be a tuple of names relative to")
            for wrong in (("../c.txt",), ("/etc/passwd",), "c.txt", (3,), ("",))
        ),
    ],
)
def test_data_that_is_missing_or_outside_the_folder_is_refused(
    write: Write, data: Any, says: str
) -> None:
    with pytest.raises(ModelError, match=f"^model mine: {says}"):
        write("", data=repr(data))


def test_errors_and_tracebacks_name_the_users_file_and_line(write: Write, tmp_path: Path) -> None:
    carried = write(
        "from helper import f", "f(x[0], t)", helper="def f(x, t):\n    return x / (3 - t)\n"
    )
    shutil.rmtree(tmp_path / "a")
    model = carried.model
    linecache.checkcache()
    with pytest.raises(ZeroDivisionError) as caught:
        model.transition((2.0,), 3, (0.0,), model.p)
    said = "".join(traceback.format_exception(caught.value))
    assert f'File "{tmp_path}/a/helper.py", line 2' in said


@pytest.mark.parametrize(
    ("before", "reason"),
    [
        ("import no_such", "ModuleNotFoundError: No module named 'no_such'"),
        ("from helper import no", "cannot import name 'no' from 'helper' ("),
        ("import broken", "ZeroDivisionError"),
        ("from . import helper", "write `import helper` in the place of"),
    ],
)
def test_an_import_that_fails_is_named_as_the_user_knows_it(
    write: Write, before: str, reason: str
) -> None:
    known = set(sys.modules)
    with pytest.raises(ModelError, match=r"mine\.py fails when loaded: ") as caught:
        write(before, broken="1 / 0")
    assert reason in str(caught.value)
    assert "pfdist_model" not in str(caught.value)
    assert not [name for name in set(sys.modules) - known if "pfdist_model" in name]


def test_a_changed_parameter_counts_in_the_fingerprint_and_travels() -> None:
    wide = carried_model("ungm").with_parameters({"process_sd": 2.0})
    assert wide.model.p.process_sd == wide.fingerprint["parameters.process_sd"] == 2.0
    assert wide.fingerprint == carried_model("ungm", parameters={"process_sd": 2.0}).fingerprint
    assert wide.key != carried_model("ungm").key


def test_the_error_of_the_squared_norm_stays_the_same_function() -> None:
    """Engines know it by its identity."""
    assert carried(load_model("ungm"), "python:mine").model.error is squared_error


def test_what_travels_is_known_by_the_same_fingerprint(write: Write) -> None:
    """Its compiled code is kept under this name, and must change with a module beside the model."""
    helper = "K = {}\ndef f(x): return K * x\n"
    keys = []
    for constant in (0.9, 0.8):
        known = write("import helper", "helper.f(x[0])", helper=helper.format(constant))
        again = carried(known.model, known.name)
        assert again.fingerprint == known.fingerprint
        assert known.with_parameters({}).fingerprint["helper.K"] == constant
        keys.append(known.key)
    assert keys[0] != keys[1]


def test_a_helper_that_two_formulas_share_travels_once(write: Write) -> None:
    helper = "C = 2.0\ndef f(a): return C * a\ndef h(a): return f(a) * f(f(a))\n"
    known = write("import helper", "helper.h(x[0]) + helper.f(x[0])", helper=helper)
    assert carried(known.model, known.name).fingerprint == known.fingerprint


def test_threads_load_each_their_own_helper(write: Write, tmp_path: Path) -> None:
    for name, k in (("a", 2), ("b", 5)):
        helper = f"import time\ntime.sleep(0.05)\ndef f(x): return {k} * x"
        write("from helper import f", "f(x[0])", name=name, helper=helper)
    path = sys.path.copy()
    with ThreadPoolExecutor(2) as pool:
        loaded = pool.map(lambda name: carried_model(f"{name}/mine.py:model", tmp_path), "abab")
        assert [moved(each) for each in loaded] == [4.0, 10.0, 4.0, 10.0]
    assert sys.path == path


def test_formulas_that_travelled_keep_their_source(write: Write) -> None:
    """Without it no formula has a fingerprint, or a line in an error."""
    arrived = pickle.loads(pickle.dumps(write("", "2 * x[0]"))).model
    assert Path(arrived.transition.__code__.co_filename).name == "mine.py"
    assert inspected(arrived).fingerprint
