from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

import pfdist.models
from oracles.model_text import MEASURED
from pfdist import StateSpaceModel
from pfdist.errors import ModelError
from pfdist.models import installed_models, load_model

MODEL = (
    """
from pfdist import StateSpaceModel

damped = StateSpaceModel(
    name="damped",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: (p.factor * x[0] + w[0],),
"""
    + MEASURED
    + """    parameters={"factor": 0.9},
)
number = 3
"""
)
FOLDER = Path(pfdist.models.__file__).parent / "library"
SHIPPED = {
    file.stem for file in FOLDER.glob("*.py") if "\nmodel = " in file.read_text(encoding="utf-8")
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "mine.py").write_text(MODEL, encoding="utf-8")
    return tmp_path


@pytest.fixture
def plug(monkeypatch, folder):
    """Install an entry point, as another package would."""

    def install(name, value):
        entry = EntryPoint(name, value, "pfdist.models")
        found = {"pfdist.models": [entry]}
        monkeypatch.setattr("pfdist.models.loader.entry_points", lambda *, group: found[group])
        installed_models.cache_clear()

    monkeypatch.syspath_prepend(folder / "sub")
    yield install
    installed_models.cache_clear()


def test_the_models_that_ship_are_those_with_a_model_found_by_their_names() -> None:
    homes = {name: home for name, home in installed_models().items() if "pfdist.models" in home[0]}
    assert homes == {name: (f"pfdist.models.library.{name}", "model") for name in SHIPPED}
    assert {load_model(name).name for name in SHIPPED} == SHIPPED


def test_a_path_is_relative_to_the_folder_or_absolute(folder):
    for model in (
        load_model("sub/mine.py:damped", folder),
        load_model(f"{folder}/sub/mine.py:damped"),
    ):
        assert isinstance(model, StateSpaceModel)
        assert model.p.factor == 0.9


def test_an_entry_point_is_a_model_but_takes_no_name_of_a_model_that_ships(plug):
    plug("plugged", "mine:damped")
    assert installed_models()["plugged"] == ("mine", "damped")
    assert load_model("plugged").name == "damped"
    plug("ungm", "mine:damped")
    assert load_model("ungm").name == "ungm"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("sub/other.py:damped", ["cannot read", "sub/other.py", "got 'sub/other.py:damped'"]),
        ("sub/mine.py:model", ["mine.py must contain a StateSpaceModel named 'model'", "nothing"]),
        ("sub/mine.py:number", ["named 'number', got int", "Models in this file: damped"]),
        ("ghost", ["no_such_package.module", "failed: ModuleNotFoundError"]),
    ],
)
def test_a_name_without_its_model_is_an_error(plug, folder, name, words):
    plug("ghost", "no_such_package.module:model")
    with pytest.raises(ModelError) as caught:
        load_model(name, folder)
    assert [part for part in words if part not in str(caught.value)] == []


def test_a_file_alone_names_no_model():
    with pytest.raises(ModelError, match=r"must be FILE:NAME, as mine\.py:model, got 'mine\.py'"):
        load_model("mine.py")
    with pytest.raises(ModelError, match=r"got the job file .mine\.toml.: give the name"):
        load_model("mine.toml")


@pytest.mark.parametrize("name", ["ungn", "mine", ""])
def test_an_unknown_name_lists_the_known_ones(name):
    with pytest.raises(ModelError) as caught:
        load_model(name)
    known = [f"got {name!r}", "path/file.py:object", *SHIPPED]
    assert [word for word in known if word not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"1 / 0", "broken.py failed: ZeroDivisionError: division by zero"),
        (b"raise SystemExit(0)", "broken.py failed: SystemExit"),
        (b"def f(:", "broken.py failed: SyntaxError"),
        (b"'\xff'", "text must be UTF-8, got byte 0xff"),
        (b"", "Models in this file: none"),
        (MODEL.replace("(w[0],)", "w[0]").encode(), "model damped: initial must give a tuple"),
    ],
)
def test_a_file_that_makes_no_model_says_why(folder, content, reason):
    (folder / "broken.py").write_bytes(content)
    with pytest.raises(ModelError) as caught:
        load_model("broken.py:model", folder)
    assert reason in str(caught.value)


def test_an_entry_point_may_import_from_its_own_package(plug, folder):
    package = folder / "sub" / "their_package"
    package.mkdir()
    (package / "__init__.py").write_text("", encoding="utf-8")
    (package / "constants.py").write_text("FACTOR = 0.9\n", encoding="utf-8")
    (package / "models.py").write_text("from .constants import FACTOR\n" + MODEL, encoding="utf-8")
    plug("theirs", "their_package.models:damped")
    assert load_model("theirs").name == "damped"


def test_a_model_file_may_hold_dataclasses_with_postponed_annotations(folder):
    text = "from __future__ import annotations\nfrom dataclasses import dataclass\n" + MODEL
    text += "\n@dataclass\nclass Settings:\n    a: int = 1\n"
    (folder / "annotated.py").write_text(text, encoding="utf-8")
    assert load_model("annotated.py:damped", folder).name == "damped"
