"""The meaning of a model: all that its formulas reach, and nothing else."""

import importlib
import itertools
import os
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from pfdist.errors import ModelError
from pfdist.meaning import Meaning, check_is_constant, differences, meaning_of
from pfdist.meaning.chosen import choose
from pfdist.meaning.origins import version_of
from pfdist.models import find_model

MODEL = """
import collections, contextlib, dataclasses, enum, functools, math, re, threading, types
import numpy as np
import numba
from pfdist import StateSpaceModel, clip

class Scaled:
    def __init__(self, f, scale):
        functools.update_wrapper(self, f)
        self.scale = scale
    def __call__(self, x): return self.scale * self.__wrapped__(x)

class Locked:
    def __init__(self, a): self.a, self.lock = a, threading.Lock()
{before}

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
    parameters={{"sigma": 0.9}},
)
"""
Means = Callable[..., Meaning]
_folders = itertools.count()


@pytest.fixture
def means(tmp_path: Path) -> Means:
    """Meaning of a model with some lines before it, a formula, and files beside it."""

    def meaning(before: str, formula: str, **files: str) -> Meaning:
        folder = tmp_path / f"{next(_folders)}"
        folder.mkdir()
        for name, text in files.items():
            (folder / f"{name}.py").write_text(text)
        (folder / "mine.py").write_text(MODEL.format(before=before, formula=formula))
        return meaning_of(*find_model("mine.py:model", folder).record())

    return meaning


OF_UNGM = """
import collections
from pfdist.models.ungm import transition
p = collections.namedtuple("P", "process_sd")({})
def f(x):
    return transition((x,), 0, (0.0,), p)[0]
"""
HELPERS = "from helper import f\nimport helper"


@pytest.mark.parametrize(
    ("before", "formula", "first", "second", "name"),
    [
        ("C = {}", "C * x[0]", "2.0", "3.0", "mine.C"),
        ("C = {}", "C * x[0]", "1.0", "1", "mine.C"),
        ("C = np.array({})", "C[0] * x[0]", "[1.0, 2]", "[1.0, 3]", "mine.C"),
        ("C = {}", "C['a'] * x[0]", "{'a': 1.0}", "{'a': 2.0}", "mine.C"),
        ("C = {}", "x[0] * len(C)", "{1, 2}", "{1, 3}", "mine.C"),
        ("C = np.zeros(2, [('a', 'f8')]); C['a'] = {}", "C['a'][0] * x[0]", "1", "2", "mine.C"),
        (
            "P = collections.namedtuple('P', 'a b')\nC = P(1.0, {})",
            "C.a * x[0]", "2.0", "3.0", "mine.C",
        ),
        (
            "@dataclasses.dataclass\nclass P:\n    a: float\nC = P({})",
            "C.a * x[0]", "2.0", "3.0", "mine.C",
        ),
        (
            "class P:\n    def a(self): return {}\nC = P()",
            "C.a() * x[0]", "2.0", "3.0", "mine.C",
        ),
        ("class P:\n    A = {}", "P.A * x[0]", "2.0", "3.0", "mine.P"),
        ("class P(enum.Enum):\n    A = {}", "P.A.value * x[0]", "2.0", "3.0", "mine.P"),
        ("def g(x): return {} * x", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("def g(x, k={}): return k * x", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("def g(x, *, k={}): return k * x", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("@numba.njit\ndef g(x): return {} * x", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("@functools.lru_cache\ndef g(t): return {}", "g(t) * x[0]", "2.0", "3.0", "mine.g"),
        ("g = functools.partial(np.multiply, {})", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("def make(k): return lambda x: k * x\ng = make({})", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("exec('def g(x): return {} * x')", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("def g(x): return x if x.sum() < 9 else h(x)\ndef h(x): return {} * g(x)",
         "g(x[0])", "2.0", "3.0", "mine.h"),
        ("C = [{}]; C.append(C)", "C[0] * x[0]", "2.0", "3.0", "mine.C"),
        ("", "{} * x[0]", "2.0", "3.0", "transition"),
        ("g = np.frompyfunc(lambda x: {} * x, 1, 1)", "x[0] + (g(t) > 9)", "2.0", "3.0", "mine.g"),
        ("C = iter([{}])", "x[0] * bool(C)", "2.0", "3.0", "mine.C"),
        ("__C = {}", "__C * x[0]", "2.0", "3.0", "mine.__C"),
        ("__version__ = {}", "__version__ * x[0]", "2.0", "3.0", "mine.__version__"),
        ("def __f(x): return {} * x", "__f(x[0])", "2.0", "3.0", "mine.__f"),
        ("C = types.MappingProxyType({'a': {}})", "C['a'] * x[0]", "2.0", "3.0", "mine.C"),
        ("C = {'a': {}}.values()", "list(C)[0] * x[0]", "2.0", "3.0", "mine.C"),
        ("C = re.compile('{}')", "float(C.pattern) * x[0]", "2.0", "3.0", "mine.C"),
        ("C = numba.typed.List([{}])", "C[0] * x[0]", "2.0", "3.0", "mine.C"),
        ("C = Locked({})", "C.a * x[0]", "2.0", "3.0", "mine.C"),
        ("C = {}\n@numba.njit('f8(f8)')\ndef g(x): return C * x",
         "x[0] + g(1.0)", "2.0", "3.0", "mine.C"),
        ("@numba.njit('f8({})')\ndef g(x): return x",
         "x[0] + g(1.0)", "f8", "f4", "mine.g"),
        ("@numba.cfunc('f8(f8)')\ndef g(x): return {} * x",
         "x[0] * bool(g)", "2.0", "3.0", "mine.g"),
        ("g = Scaled(lambda x: x, {})", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("g = Scaled(lambda x: {} * x, 1)", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("@functools.singledispatch\ndef g(x): return {} * x", "g(x[0])", "2.0", "3.0", "mine.g"),
        ("@contextlib.contextmanager\ndef g(): yield {}",
         "x[0] + (lambda: g().__enter__())()", "2.0", "3.0", "mine.g"),
        ("class M(type):\n    A = property(lambda cls: {})\nclass P(metaclass=M): pass",
         "P.A * x[0]", "2.0", "3.0", "mine.P"),
    ],
)  # fmt: skip
def test_a_change_of_what_a_formula_reaches_is_named(
    means: Means, before: str, formula: str, first: str, second: str, name: str
) -> None:
    def meaning(value: str) -> Meaning:
        return means(before.replace("{}", value), formula.replace("{}", value))

    assert differences(meaning(first), meaning(first)) == []
    assert differences(meaning(first), meaning(second)) == [name]


@pytest.mark.parametrize(
    ("formula", "first", "second", "names"),
    [
        ("f(x[0])", "def f(x): return 2 * x", "def f(x): return 3 * x", ["helper.f"]),
        ("helper.f(x[0])", "def f(x): return 2 * x", "def f(x): return 3 * x", ["helper.f"]),
        (
            "f(x[0])",
            "C = 2\ndef f(x): return g(x)\ndef g(x): return C * x",
            "C = 3\ndef f(x): return g(x)\ndef g(x): return C * x",
            ["helper.C"],
        ),
        (
            "f(x[0])",
            OF_UNGM.replace("{}", "1.0"),
            OF_UNGM.replace("{}", "2.0"),
            ["helper.p"],
        ),
    ],
    ids=["a function", "a module's function", "a helper's helper's constant", "beside another's"],
)  # fmt: skip
def test_a_change_in_a_helper_module_is_named(
    means: Means, formula: str, first: str, second: str, names: list[str]
) -> None:
    assert (
        differences(means(HELPERS, formula, helper=first), means(HELPERS, formula, helper=first))
        == []
    )
    found = differences(
        means(HELPERS, formula, helper=first), means(HELPERS, formula, helper=second)
    )
    assert found == names


def test_words_and_what_is_not_reached_make_no_difference(means: Means) -> None:
    helper = "def f(x):\n    return 2 * x\n"
    first = means(HELPERS, "f(x[0])", helper=helper)
    second = means(
        '"""A model."""\nunused = 3\n' + HELPERS + "\ndef nobody(x): return x\nsigma = 3\n",
        "f(  x[ 0 ]\n )",
        helper='"""Words."""\nunused = 1\ndef f(x: float) -> float:\n    return 2*x  # so\n',
    )
    assert differences(first, second) == []


def test_a_global_that_has_a_parameters_name_is_not_reached(means: Means) -> None:
    first, second = (means(f"sigma = {value}", "p.sigma * x[0]") for value in (1, 2))
    assert differences(first, second) == []


@pytest.mark.parametrize(
    "formula", ["getattr(helper, 'f')(x[0])", "__import__('functools').partial(helper.g)(x[0])"]
)
def test_what_is_reached_dynamically_counts_by_the_text_of_all_files(
    means: Means, formula: str
) -> None:
    text = "def f(x): return x\ndef g(x): return x\n"
    first, second = (means(HELPERS, formula, helper=text + more) for more in ("", "# seen\n"))
    assert differences(first, second) == ["transition"]


@pytest.mark.parametrize(
    ("before", "formula"),
    [
        ("def g(x):\n    from helper import C\n    return C * x", "g(x[0])"),
        ("def g(x):\n    import helper\n    return helper.C * x", "g(x[0])"),
        ("def g(x):\n    import helper as h\n    return use(h) * x", "g(x[0])"),
        ("def g(x):\n    return x if x.sum() < 9 else late()\n"
         "def late():\n    import helper\n    return helper.C", "g(x[0])"),
        ("import helper", "use(helper) * x[0]"),
        ("import helper", "use_all(helper) * x[0]"),
        ("import helper\nimport operator\ng = operator.attrgetter('C')", "g(helper) * x[0]"),
        ("import helper\ndef g(): return helper", "g().C * x[0]"),
        ("import helper\ndef g(m=helper): return use(m)", "g() * x[0]"),
        ("import helper\ng = [helper]", "use(g[0]) * x[0]"),
        ("import helper\ndef make(m):\n    return lambda: use(m)\ng = make(helper)", "g() * x[0]"),
        ("import helper", "vars(helper)['C'] * x[0]"),
        ("import helper", "helper.__dict__['C'] * x[0]"),
        ("from helper import C", "eval('C') * x[0]"),
        ("from helper import C", "globals()['C'] * x[0]"),
    ],
    ids=[
        *("from, in a function", "import, in a function", "import as, passed on"),
        *("import in a branch", "passed on", "in star-arguments", "to attrgetter", "returned"),
        *("a default", "in a list", "in a closure", "vars", "__dict__", "eval", "globals"),
    ],
)  # fmt: skip
def test_what_a_helper_module_holds_counts_by_its_value_wherever_the_module_goes(
    means: Means, before: str, formula: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    uses = "\ndef use(m): return m.C\ndef use_all(*ms): return ms[0].C\n"
    found = []
    for constant in ("2.0", "3.0"):  # the text of all files is the same
        monkeypatch.setenv("PFDIST_TEST_C", constant)
        helper = "import os\nC = float(os.environ['PFDIST_TEST_C'])\n"
        found.append(means(before + uses, formula, helper=helper))
    assert {"helper.C", "mine.C"} & set(differences(*found))


def test_a_module_on_the_path_that_a_formula_imports_counts(
    means: Means, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = "def g(x):\n    import on_the_path\n    return on_the_path.C * x\n"
    found = []
    for constant in ("2.0", "3.00"):
        (tmp_path / "on_the_path.py").write_text(f"C = {constant}\n")
        monkeypatch.delitem(sys.modules, "on_the_path", raising=False)
        importlib.invalidate_caches()
        found.append(means(before, "g(x[0])"))
    monkeypatch.delitem(sys.modules, "on_the_path")
    assert differences(*found) == ["on_the_path.C"]


def test_what_a_module_makes_up_when_it_is_asked_counts(means: Means) -> None:
    first, second = (
        means("import helper", "helper.C * x[0]", helper=f"def __getattr__(name): return {value}")
        for value in (2, 3)
    )
    assert differences(first, second) == ["helper.__getattr__"]


def test_of_a_module_that_is_not_passed_on_only_what_is_named_counts(means: Means) -> None:
    before = "import helper\ndef g(x):\n    import helper as h\n    return h.C * x\n"
    first, second = (
        means(before, "g(x[0]) + helper.C", helper=f"C = 1.0\nunused = {value}") for value in (2, 3)
    )
    assert differences(first, second) == []


@pytest.mark.parametrize(
    ("before", "formula", "kind"),
    [
        pytest.param("C = (v for v in [1])", "x[0] * bool(C)", "'generator'", id="generator"),
        pytest.param("C = open(__file__)", "x[0] * bool(C)", "'TextIOWrapper'", id="file"),
        pytest.param("C = {'a': [np.nditer([1.0])]}", "x[0] * len(C)", "'nditer'", id="inside"),
        pytest.param("class P:\n    def __reduce_ex__(self, k): return 1 / 0\nC = P()",
                     "x[0] * bool(C)", "kind 'P'", id="raises"),
        pytest.param("C = []\nfor k in range(9999): C = [C]", "x[0] * len(C)", "nested", id="deep"),
    ],
)  # fmt: skip
def test_a_value_that_cannot_be_read_is_refused_in_one_line(
    means: Means, before: str, formula: str, kind: str
) -> None:
    with pytest.raises(
        ModelError, match=f"C of mine.py is or holds .*{kind}.*: use numbers"
    ) as error:
        means(before, formula)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("before", "formula"),
    [
        pytest.param("__C = np.random.rand()", "__C * x[0]", id="two underscores"),
        pytest.param("C = np.random.rand()\n@numba.njit('f8(f8)')\ndef g(v): return v * C",
                     "g(1.0) * x[0]", id="used by a compiled function of fixed types"),
        pytest.param("D = types.MappingProxyType({'C': np.random.rand()})", "D['C'] * x[0]",
                     id="in a mapping"),
        pytest.param("def g():\n    from helper import C\n    return C", "g() * x[0]",
                     id="imported in a function"),
        pytest.param("C = np.random.rand()\ng = np.frompyfunc(lambda v: C * v, 1, 1)",
                     "x[0] + (g(t) > 9)", id="used by a ufunc"),
    ],
)  # fmt: skip
def test_a_random_constant_differs_between_two_loads(
    tmp_path: Path, before: str, formula: str
) -> None:
    (tmp_path / "helper.py").write_text("import numpy as np\nC = np.random.rand()\n")
    (tmp_path / "mine.py").write_text(MODEL.format(before=before, formula=formula))
    with pytest.raises(ModelError, match="has another value each time it is loaded"):
        choose("model", "mine.py:model", tmp_path, {})


def test_models_that_ship_reach_into_each_other() -> None:
    found = {}
    for name in ("ungm", "ungm_gordon", "constant_velocity"):
        found[name] = meaning_of(*find_model(name).record())
    changed = differences(found["ungm"], found["ungm_gordon"])
    assert "transition" not in changed  # it is ungm's own
    assert "measurement" in changed
    assert "pfdist.models.bearings_only.wrapped" in found["constant_velocity"]


def test_what_another_distribution_has_installed_counts_by_name_and_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = tmp_path / "site-packages"
    for package in ("theirs_installed", "ours_installed"):
        (installed / package).mkdir(parents=True)
        (installed / package / "__init__.py").touch()
    (installed / "theirs_installed-1.0.dist-info").mkdir()
    metadata = installed / "theirs_installed-1.0.dist-info" / "METADATA"
    text = MODEL.format(
        before="from theirs_installed import f\nfrom ours_installed.helper import g",
        formula="f(g(x[0]))",
    )
    (installed / "ours_installed" / "model.py").write_text(text)
    monkeypatch.syspath_prepend(installed)
    entry = EntryPoint("plugged", "ours_installed.model:model", "pfdist.models")
    monkeypatch.setattr("pfdist.models.loader.entry_points", lambda *, group: [entry])

    def means(constant: int, version: str, factor: int) -> Meaning:
        for name in [name for name in sys.modules if "s_installed" in name]:
            del sys.modules[name]
        version_of.cache_clear()
        (installed / "theirs_installed" / "__init__.py").write_text(
            f"C = {constant}\ndef f(x): return C*x\n"
        )
        (installed / "ours_installed" / "helper.py").write_text(f"def g(x): return {factor} * x\n")
        metadata.write_text(f"Metadata-Version: 2.1\nName: theirs_installed\nVersion: {version}\n")
        importlib.invalidate_caches()
        return meaning_of(*find_model("plugged").record())

    with monkeypatch.context() as patch:
        patch.setattr(sys, "dont_write_bytecode", True)
        first = means(1, "1.0", 1)
        _, source = find_model("plugged").record()
        assert differences(first, meaning_of(source.load(), source)) == []
        assert differences(first, means(22, "1.0", 1)) == []
        assert differences(first, means(1, "1.1", 1)) == ["transition"]
        assert differences(first, means(1, "1.0", 22)) == ["ours_installed.helper.g"]


def test_noise_parameters_data_and_linearity_are_part_of_it(tmp_path: Path) -> None:
    text = MODEL.format(before="", formula="x[0]")
    changes = {
        "process_noise": ('process_noise=("normal",)', 'process_noise=("uniform",)'),
        "parameters.sigma": ("0.9", "0.8"),
        "linear_gaussian": ('name="mine",', 'name="mine", linear_gaussian=True,'),
    }
    meanings = []
    for number, (old, new) in enumerate([("", ""), *changes.values()]):
        (tmp_path / f"m{number}").mkdir()
        (tmp_path / f"m{number}" / "mine.py").write_text(text.replace(old, new))
        meanings.append(meaning_of(*find_model(f"m{number}/mine.py:model", tmp_path).record()))
    for name, meaning in zip(changes, meanings[1:], strict=True):
        assert differences(meanings[0], meaning) == [name]


def test_a_data_file_counts_by_its_content(tmp_path: Path) -> None:
    text = MODEL.format(before="", formula="x[0]")
    (tmp_path / "mine.py").write_text(text.replace("name=", 'data_files=("a.csv",), name='))
    found = []
    for content in ("1\n", "2\n"):
        (tmp_path / "a.csv").write_text(content)
        found.append(meaning_of(*find_model("mine.py:model", tmp_path).record()))
    assert differences(*found) == ["data_files.a.csv"]


def test_a_meaning_is_the_same_in_another_process(tmp_path: Path) -> None:
    before = "C = {'b', 'a', 'c'}\nclass P(enum.Enum):\n    A = 1\n"
    (tmp_path / "mine.py").write_text(MODEL.format(before=before, formula="len(C) * P.A.value"))
    program = (
        "from pathlib import Path\nfrom pfdist.meaning import meaning_of\n"
        "from pfdist.models import find_model\n"
        f"print(meaning_of(*find_model('mine.py:model', Path({str(tmp_path)!r})).record()))"
    )
    said = {
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True,
            env=os.environ | {"PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    }  # fmt: skip
    assert said == {f"{meaning_of(*find_model('mine.py:model', tmp_path).record())}\n"}


@pytest.mark.parametrize(
    ("here", "there", "says"),
    [
        ({"mine.C": "a", "t": "1"}, {"mine.C": "b", "t": "2"}, "C of mine.py has .*and 1 more"),
        ({"a.b.C": "a"}, {}, "C of a/b.py has another value in each process"),
        ({"parameters.k": 1.0}, {"parameters.k": 2.0}, "k of my.py has another value"),
        ({"transition": "a"}, {"transition": "b"}, "transition of my.py has another value"),
    ],
)
def test_what_differs_between_two_loads_is_said(here: Meaning, there: Meaning, says: str) -> None:
    check_is_constant(here, dict(here), "x/my.py", "in each process")
    with pytest.raises(ModelError, match=says) as caught:
        check_is_constant(here, there, "x/my.py", "in each process")
    assert "\n" not in str(caught.value)


def test_fields_that_came_later_leave_the_meaning_of_older_models(means: Means) -> None:
    """Also where a formula reaches a model: an older model's attributes lack these fields."""
    base = "from pfdist.models import ungm\nbase = dataclasses.replace(ungm.model{})\n"
    formula = "base.transition(x, t, w, base.p)[0]"
    fields = ("normalised", "missing_components")
    older = base.format("") + "".join(f"del vars(base)['{field}']\n" for field in fields)
    meaning = means(older, formula)
    assert meaning == means(base.format(""), formula)
    assert not meaning.keys() & set(fields)
    for field in fields:
        changed = means(base.format(f", {field}=True"), formula)
        assert differences(meaning, changed) == ["mine.base"]


def test_a_model_that_a_formula_reaches_has_one_meaning_whatever_was_computed_of_it(
    means: Means,
) -> None:
    """The model of an installed module is shared: the driver may have used it, a worker not."""
    formula = "x[0] * len(base.name)"
    unused = "from pfdist.models import ungm\nbase = dataclasses.replace(ungm.model)\n"
    assert means(unused + "base.p\n", formula) == means(unused, formula)
