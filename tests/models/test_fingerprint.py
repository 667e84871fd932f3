"""The fingerprint of a model: all that its formulas compute with, and nothing else."""

import importlib
import itertools
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from oracles.model_text import MEASURED
from pfdist.errors import ModelError
from pfdist.models import carried_model, fingerprint, load_model
from pfdist.models.fingerprint import Fingerprint, inspected

MODEL = (
    """
import collections, dataclasses, enum, functools, math, types
import numpy as np
import numba
import pandas as pd
from pfdist import StateSpaceModel, clip
{before}

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: ({formula},),
"""
    + MEASURED
    + """    parameters={{"sigma": 0.9}},
)
"""
)
Take = Callable[..., Fingerprint]
_folders = itertools.count()


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """The folder of a model with some lines before it, a formula, and files beside it."""

    def written(before: str, formula: str, **files: str) -> Path:
        folder = tmp_path / f"{next(_folders)}"
        for name, text in files.items():
            file = folder / f"{name}.py"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        folder.mkdir(exist_ok=True)
        (folder / "mine.py").write_text(MODEL.format(before=before, formula=formula))
        return folder

    return written


@pytest.fixture
def take(write: Callable[..., Path]) -> Take:
    """Fingerprint of a model that is written so."""

    def taken(before: str, formula: str, **files: str) -> Fingerprint:
        return carried_model("mine.py:model", write(before, formula, **files)).fingerprint

    return taken


def differing(first: Fingerprint, second: Fingerprint) -> list[str]:
    return sorted(key for key in first.keys() | second if first.get(key) != second.get(key))


# The module beside a model, by the value that changes.
HELPER = "C = {0}\ndef f(x): return {0} * x\ndef g(x): return h(x)\ndef h(x): return C * x\n"


@pytest.mark.parametrize(
    ("before", "formula", "first", "second", "name"),
    [
        ("C = {}", "C * x[0]", "2.0", "3.0", "C"),
        ("C = {}", "C * x[0]", "1.0", "1", "C"),
        ("C = {}", "C * x[0]", "np.float32(1)", "1.0", "C"),
        ("C = np.array({})", "C[0] * x[0]", "[1.0, 2]", "[1.0, 3]", "C"),
        ("C = np.array({})", "C[0] * x[0]", "[1.0]", "[1]", "C"),
        ("C = (1, ({}, 'a'))", "C[0] * x[0]", "2", "3", "C"),
        ("C = [1.0, {}]", "C[0] * x[0]", "2.0", "3.0", "C"),
        ("C = {}", "C[0] * x[0]", "(2, 3)", "[2, 3]", "C"),
        ("C = dict(a=1.0, b={})", "C['a'] * x[0]", "2.0", "3.0", "C"),
        ("C = dict({}=1.0)", "sum(C.values()) * x[0]", "a", "b", "C"),
        ("C = pd.DataFrame(dict(a=[1.0, {}]))", "C.loc[0, 'a'] * x[0]", "2.0", "3.0", "C"),
        ("C = pd.DataFrame(dict({}=[1.0]))", "C.iloc[0, 0] * x[0]", "a", "b", "C"),
        ("C = pd.Series([1.0], index=[{}])", "C.iloc[0] * x[0]", "2", "3", "C"),
        ("P = collections.namedtuple('P', 'a b')\nC = P(1.0, {})", "C.a * x[0]", "2", "3", "C"),
        ("C = {}", "C * x[0] if C is not None else x[0]", "None", "1.0", "C"),
        ("C = {}", "x[0] if C == 'a' else 2 * x[0]", "'a'", "'b'", "C"),
        ("def g(x): return {} * x", "g(x[0])", "2.0", "3.0", "formulas"),
        ("def g(x, k={}): return k * x", "g(x[0])", "2.0", "3.0", "g.k"),
        ("def g(x, *, k={}): return k * x", "g(x[0])", "2.0", "3.0", "g.k"),
        ("@numba.njit\ndef g(x): return {} * x", "g(x[0])", "2.0", "3.0", "formulas"),
        ("def make(k): return lambda x: k * x\ng = make({})", "g(x[0])", "2.0", "3.0", "g.k"),
        ("from helper import f", "f(x[0])", "2.0", "3.0", "formulas"),
        ("import helper", "helper.f(x[0])", "2.0", "3.0", "formulas"),
        ("import helper", "helper.g(x[0])", "2.0", "3.0", "helper.C"),
        ("import helper", "helper.C * x[0]", "2.0", "3.0", "helper.C"),
        ("import inner.deep", "inner.deep.C * x[0]", "2.0", "3.0", "inner.deep.C"),
        ("import helper\ndef g(x, h=helper): return h.C * x", "g(x[0])", "2.0", "3.0", "helper.C"),
        ("m = types.ModuleType('m'); m.C = {}", "m.C * x[0]", "2.0", "3.0", "m.C"),
        ("np.OWN = {}", "np.OWN * x[0]", "2.0", "3.0", "numpy.OWN"),
        ("C = np.array([[1., 2], [3, 4]], order={})", "C[0, 0] * x[0]", "'C'", "'F'", "C"),
        ("def g(x): return x if x.sum() < 9 else h(x)\ndef h(x): return {} * g(x)",
         "g(x[0])", "2.0", "3.0", "formulas"),
        ("", "{} * x[0]", "2.0", "3.0", "formulas"),
        ("", "{}(x[0])", "np.sin", "np.cos", "formulas"),
        ("g = {}", "g(x[0])", "np.sin", "np.cos", "formulas"),
        ("__C = {}", "__C * x[0]", "2.0", "3.0", "__C"),
        ("C = {}\n@numba.njit('f8(f8)')\ndef g(x): return C * x",
         "x[0] + g(1.0)", "2.0", "3.0", "C"),
    ],
)  # fmt: skip
def test_a_change_of_what_a_formula_reaches_is_named_and_no_other(
    take: Take, before: str, formula: str, first: str, second: str, name: str
) -> None:
    def taken(value: str) -> Fingerprint:
        texts = (text.replace("{}", value) for text in (before, formula))
        return take(*texts, **dict.fromkeys(("helper", "inner/deep"), HELPER.format(value)))

    assert taken(first) == taken(first)
    assert differing(taken(first), taken(second)) == [name]


def test_words_and_what_is_not_reached_make_no_difference(take: Take) -> None:
    helpers = "from helper import f\nimport helper\n"
    helper = "def f(x):\n    return 2 * x\n"
    first = take(helpers, "f(p.sigma * x[0])", helper=helper)
    second = take(
        f'"""A model."""\nunused = [3]\n{helpers}def nobody(x): return x\nsigma = 3\n',
        "f(  p.sigma*x[ 0 ]\n )",
        helper='"""Words."""\nunused = 1\ndef f(x: float) -> float:\n    return 2*x  # so\n',
    )
    assert first == second


@pytest.mark.parametrize(
    ("before", "formula", "what"),
    [
        ("C = {'a': object()}", "x[0] * len(C)", "C is a value of the kind dict "),
        ("C = [1.0]; C.append(C)", "C[0] * x[0]", "C is a value of the kind list "),
        ("C = open(__file__)", "x[0] * bool(C)", "C is .*TextIOWrapper"),
        ("C = (1, object())", "C[0] * x[0]", "C is a tuple that holds something else"),
        ("class P:\n    A = 1.0", "P.A * x[0]", "P is the class P"),
        ("@dataclasses.dataclass\nclass P:\n    a: float\nC = P(1.0)", "C.a * x[0]", "C is .* P"),
        ("g = functools.partial(np.multiply, 2.0)", "g(x[0])", "g is .* partial"),
        ("@functools.lru_cache\ndef g(t): return 2.0", "g(t) * x[0]", "g is .*lru_cache"),
        ("@np.vectorize\ndef g(a): return 2 * a", "g(x[0])", "g is .*vectorize"),
        ("def g(a): return g.k * a\ng.k = 2.0", "g(x[0])", "g has an attribute of its own, k"),
        ("class P(collections.namedtuple('P', 'a')):\n    def s(self): return 2.0\nC = P(1.)",
         "C.s() * x[0]", "C is .* P"),
        ("class A(np.ndarray): k = 2.0\nC = np.zeros(1).view(A)", "C.k * x[0]", "C is .* A"),
        ("C = np.zeros(1, np.longdouble)", "C[0] * x[0]", "C is .* ndarray"),
        ("exec('def g(x): return 2.0 * x')", "g(x[0])", "the source of g is not known"),
        ("def g(x):\n    import helper\n    return helper.C * x", "g(x[0])",
         "g imports helper when it is called: import it above"),
        ("import helper", "getattr(helper, 'C') * x[0]", "getattr, which may reach anything"),
        ("from helper import C", "eval('C') * x[0]", "eval, which may reach anything"),
        ("from helper import C", "globals()['C'] * x[0]", "globals, which may reach anything"),
        ("import helper", "helper.__dict__['C'] * x[0]", "__dict__, which may reach anything"),
        ("import helper\ndef use(m): return m.C", "use(helper) * x[0]",
         "the module helper, used as a value: write helper.NAME"),
        ("@numba.vectorize\ndef g(x): return 2.0 * x", "g(x[0])",
         r"model mine: transition may call .*, got 'g', a DUFunc \(.*mine\.py:\d+\)"),
        ("from pfdist import load_model\nbase = load_model('ungm')",
         "base.transition(x, t, w, base.p)[0] if t > 99 else x[0]", "base is .*StateSpaceModel"),
        # The line is that of the function that uses the value, also after another call.
        ("from helper import f\nz = {'a': object()}", "f(x[0]) * len(z)",
         r"z is .* dict .*mine\.py:\d+\)$"),
    ],
)  # fmt: skip
def test_values_that_could_change_without_notice_have_no_fingerprint(
    write: Callable[..., Path], before: str, formula: str, what: str
) -> None:
    folder = write(before, formula, helper=HELPER.format(2.0))
    with pytest.raises(ModelError, match=what) as error:
        inspected(load_model("mine.py:model", folder))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("before", "formula"),
    [
        ("class P:\n    A = VALUE", "P.A * x[0]"),
        ("class P: pass\nC = P(); C.a = VALUE", "C.a * x[0]"),
        ("g = functools.partial(np.multiply, VALUE)", "g(x[0])"),
        ("C = {VALUE}", "max(C) * x[0]"),
        ("def g(a): return g.k * a\ng.k = VALUE", "g(x[0])"),
        ("class P:\n    def rate(self, t): return VALUE * t\nC = P()", "C.rate(t) * x[0]"),
        ("class P:\n    def rate(self, t): return [VALUE] * 9\nC = P()", "C.rate(t)[t] * x[0]"),
    ],
)
def test_a_model_without_such_a_fingerprint_has_that_of_its_programs(
    write: Callable[..., Path], before: str, formula: str
) -> None:
    def taken(value: str) -> Fingerprint:
        folder = write(*(text.replace("VALUE", value) for text in (before, formula)))
        known = carried_model("mine.py:model", folder)
        assert known.fingerprint == {}
        arrived = pickle.loads(pickle.dumps(known))
        return arrived.at(arrived.model, 5).fingerprint

    assert taken("2.0") == taken("2.0")
    assert differing(taken("2.0"), taken("3.0")) == ["formulas"]


@pytest.mark.parametrize(
    ("before", "formula", "what"),
    [
        ("@functools.lru_cache\ndef g(t): return 2.0", "g(t) * x[0]", "g is .*lru_cache"),
        ("def g(x):\n    import helper\n    return helper.C * x", "g(x[0])", "g imports helper"),
        ("class P: pass", "np.piecewise(x[0], [x[0] > 0], [1.0, hash(P) % 1])", "P is the class"),
    ],
)
def test_a_model_that_cannot_travel_or_be_traced_either_is_refused_by_name(
    write: Callable[..., Path], before: str, formula: str, what: str
) -> None:
    folder = write(before, formula, helper=HELPER.format(2.0))

    def identified() -> None:
        known = carried_model("mine.py:model", folder)
        known.at(known.model, 5)

    with pytest.raises(ModelError, match=what):
        identified()


def test_a_file_that_changed_since_it_was_imported_has_no_fingerprint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "changing_model.py"
    file.write_text(MODEL.format(before="", formula="x[0]"))
    module = importlib.import_module("changing_model")
    inspected(module.model)
    file.write_text(MODEL.format(before="", formula="2 * x[0]"))
    with pytest.raises(ModelError, match=r"transition is not known: its file has changed since"):
        inspected(module.model)


def test_models_that_ship_reach_into_each_other() -> None:
    first, second = (carried_model(name).fingerprint for name in ("ungm", "ungm_gordon"))
    assert first["formulas"] != second["formulas"]
    changed = carried_model("constant_velocity").model.formulas["log_likelihood"]
    assert "wrapped" in changed.__code__.co_names  # of bearings_only


def test_another_distribution_counts_by_its_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tmp_path / "site-packages"
    (installed / "theirs_installed").mkdir(parents=True)
    (installed / "theirs_installed-1.0.dist-info").mkdir()
    metadata = installed / "theirs_installed-1.0.dist-info" / "METADATA"
    text = MODEL.format(before="from theirs_installed import f", formula="f(x[0])")
    (installed / "plugged_model.py").write_text(text)
    monkeypatch.syspath_prepend(installed)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    entry = EntryPoint("plugged", "plugged_model:model", "pfdist.models")
    monkeypatch.setattr("pfdist.models.loader.entry_points", lambda *, group: [entry])

    def taken(constant: int, version: str) -> Fingerprint:
        for name in ("plugged_model", "theirs_installed"):
            sys.modules.pop(name, None)
        fingerprint._version_of.cache_clear()
        (installed / "theirs_installed" / "__init__.py").write_text(
            f"C = {constant}\ndef f(x): return C*x\n"
        )
        metadata.write_text(f"Metadata-Version: 2.1\nName: theirs_installed\nVersion: {version}\n")
        importlib.invalidate_caches()
        return carried_model("plugged").fingerprint

    first = taken(1, "1.0")
    assert first["package theirs_installed"] == "1.0"
    assert first == taken(22, "1.0")
    assert differing(first, taken(1, "1.1")) == ["package theirs_installed"]


def test_noise_parameters_data_and_linearity_are_part_of_it(tmp_path: Path) -> None:
    data = 'data_files=("a.csv",), name="mine",'
    text = MODEL.format(before="", formula="x[0]").replace('name="mine",', data)
    changes = {
        'process_noise=("normal",)': ('process_noise=("uniform",)', "formulas"),
        "0.9": ("0.8", "parameters.sigma"),
        'name="mine",': ('name="mine", linear_gaussian=True,', "formulas"),
    }
    (tmp_path / "a.csv").write_text("1\n")
    (tmp_path / "mine.py").write_text(text)
    first = carried_model("mine.py:model", tmp_path).fingerprint
    for old, (new, name) in changes.items():
        (tmp_path / "mine.py").write_text(text.replace(old, new))
        assert differing(first, carried_model("mine.py:model", tmp_path).fingerprint) == [name]
    (tmp_path / "mine.py").write_text(text)
    (tmp_path / "a.csv").write_text("2\n")
    second = carried_model("mine.py:model", tmp_path).fingerprint
    assert differing(first, second) == ["data_files.a.csv"]


def test_it_is_the_same_in_another_process_and_in_another_folder(tmp_path: Path) -> None:
    text = MODEL.format(before="C, D = 'b', np.arange(3.0)", formula="len(C) * D[1] + x[0]")
    (tmp_path / "mine.py").write_text(text)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "yours.py").write_text(text)
    program = (
        "from pathlib import Path\nfrom pfdist.models import carried_model\n"
        f"print(carried_model('mine.py:model', Path({str(tmp_path)!r})).fingerprint)"
    )
    said = {
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True,
            env=os.environ | {"PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    }  # fmt: skip
    here = carried_model("yours.py:model", tmp_path / "other").fingerprint
    assert said == {f"{here}\n"}
