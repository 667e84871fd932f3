"""A recorded model is its programs: they tell whether it is the same, and compute the same."""

import dataclasses
import itertools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from oracles.model_text import WALK
from pfdist.errors import ModelError
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import Sensor, StateSpaceModel, load_model
from pfdist.models.recorded import differences, recorded, recorded_if_it_holds
from pfdist.models.written import key_of_model, models_of, text_of_models

INSTANTS = range(13)
IMPORTS = """
import collections, dataclasses, functools, types
import numpy as np
import numba
import pandas as pd
"""
PARAMETERS = '    parameters={"sigma": 0.9},\n'
_folders = itertools.count()
Write = Callable[..., StateSpaceModel]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a model with some lines before it, a formula, and files beside it, and record it."""

    def written(before: str, formula: str, **files: str) -> StateSpaceModel:
        folder = tmp_path / f"{next(_folders)}"
        files["mine"] = WALK.format(before=IMPORTS + before, formula=formula, after=PARAMETERS)
        for name, text in files.items():
            file = folder / f"{name}.py"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        return recorded(load_model("mine.py:model", folder), INSTANTS)

    return written


HELPER = "C = {0}\ndef f(x): return {0} * x\ndef g(x): return h(x)\ndef h(x): return C * x\n"


@pytest.mark.parametrize(
    ("before", "formula"),
    [
        ("C = {}", "C * x[0]"),
        ("C = dict(a=1.0, b={})", "C['b'] * x[0]"),
        ("C = pd.DataFrame(dict(a=[1.0, {}]))", "C.loc[1, 'a'] * x[0]"),
        ("def g(x, k={}): return k * x", "g(x[0])"),
        ("def make(k): return lambda x: k * x\ng = make({})", "g(x[0])"),
        ("from helper import f", "f(x[0])"),
        ("import helper", "helper.g(x[0])"),
        ("m = types.ModuleType('m'); m.C = {}", "m.C * x[0]"),
        ("@functools.lru_cache\ndef g(t): return {}", "g(t) * x[0]"),
        ("class P:\n    def rate(self, t): return {} * (t + 1)\nC = P()", "C.rate(t) * x[0]"),
    ],
)
def test_a_constant_that_a_formula_reaches_is_shown_before_and_now(
    write: Write, before: str, formula: str
) -> None:
    def taken(value: str) -> StateSpaceModel:
        texts = (text.replace("{}", value) for text in (before, formula))
        return write(*texts, **dict.fromkeys(("helper", "inner/deep"), HELPER.format(value)))

    first, second = taken("2.0"), taken("3.0")
    assert not [*differences(first, taken("2.0"))]
    assert [*differences(first, second)] == [("transition", "the constant 2 -> 3")]
    assert key_of_model(first) == key_of_model(taken("2.0")) != key_of_model(second)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("np.sin(x[0])", "np.cos(x[0])"),
        ("x[0] + w[0]", "w[0] + x[0]"),
        ("np.where(x[0] > 0, 1.0, 2.0)", "np.where(x[0] >= 0, 1.0, 2.0)"),
        ("(3.0 if t % 3 else 2.0) * x[0]", "(3.0 if t % 4 else 2.0) + x[0]"),
    ],
)
def test_another_computation_is_named_by_its_formula(write: Write, first: str, second: str) -> None:
    says = [("transition", "it computes something else")]
    assert [*differences(write("", first), write("", second))] == says


def test_words_and_what_is_not_reached_make_no_difference(write: Write) -> None:
    helper = "def f(x):\n    return 2 * x\n"
    first = write("from helper import f", "f(p.sigma * x[0])", helper=helper)
    second = write(
        '"""A model."""\nunused = [3]\nimport other as o\n',
        "o.double(  p.sigma*x[ 0 ]\n )",
        other="def double(x: float) -> float:\n    return 2*x  # so\n",
    )
    assert not [*differences(first, second)]
    assert key_of_model(first) == key_of_model(second)


def test_fields_and_parameters_are_named(write: Write) -> None:
    first = write("", "x[0]")
    for change, key in (
        ({"process_noise": ("uniform",)}, "process_noise"),
        ({"linear_gaussian": True}, "linear_gaussian"),
        ({"z_names": ("position [m]",)}, "z_names"),
        ({"parameters": {"sigma": 0.8}}, "parameters.sigma"),
        ({"parameters": {"sigma": 0.9, "k": 1.0}}, "parameters.k"),
        ({"parameter_ranges": {"sigma": (0.0, 1.0)}}, "parameter_ranges"),
    ):
        second = dataclasses.replace(first, **change)
        assert [name for name, _ in differences(first, second)] == [key]
        assert key_of_model(first) != key_of_model(second)


def test_last_bits_of_constants_make_no_other_model_and_more_do(write: Write) -> None:
    """NumPy's exp and power differ in the last bit between processors."""
    first, near, far = (
        write(f"C = {value!r}", "C * x[0]") for value in (0.1, 0.1 + 2e-17, 0.1 + 1e-12)
    )
    assert not [*differences(first, near)]
    assert key_of_model(first) != key_of_model(near)
    assert [key for key, _ in differences(first, far)] == ["transition"]


def test_infinite_constants_and_nan_are_the_same_only_as_themselves(write: Write) -> None:
    texts = ("np.inf", "-np.inf", "np.nan", "1.0")
    models = [write(f"C = {text}", "C * x[0]") for text in texts]
    for first, second in itertools.product(range(4), repeat=2):
        assert bool([*differences(models[first], models[second])]) == (first != second)


BRANCHES = "(x[0] if p.sigma < 1 else 2.0 * x[0])"


def test_parameters_that_are_numbers_have_programs_of_their_own(write: Write, tmp_path) -> None:
    write("", BRANCHES)
    (folder,) = (each.parent for each in tmp_path.glob("*/mine.py"))
    model = load_model("mine.py:model", folder)
    known = recorded(model, INSTANTS, [{"sigma": 1.5}])
    for each in (known, models_of(text_of_models(known, known).encode())[0]):
        for sigma, expected in ((0.9, 3.0), (1.5, 6.0)):
            changed = each.with_parameters({"sigma": sigma})
            assert changed.transition((3.0,), 0, (0.0,), changed.p) == (expected,)
        with pytest.raises(
            ModelError,
            match=r"sigma cannot be changed here, because .* transition contains the value",
        ):
            each.with_parameters({"sigma": 0.5})


def test_a_run_with_a_formula_that_was_not_traced_is_not_read(write: Write) -> None:
    """Versions before kept the values of such a formula for some numbers."""
    known = write("", "x[0]")
    data = json.loads(text_of_models(known, known))
    data["truth"]["formulas"]["transition"] = {"values": [[[0.5]]]}
    with pytest.raises(ValueError, match="transition has no program, which versions before allow"):
        models_of(json.dumps(data).encode())


@pytest.mark.parametrize("name", ["ungm", "two_compartments"])
def test_a_model_computes_the_same_by_its_text(name: str) -> None:
    model = load_model(name)
    clock = [float(t) for t in INSTANTS] if model.reads_clock else None
    model = model.on_clock(clock) if clock else model
    known = recorded(model, INSTANTS)
    read, believed = models_of(text_of_models(known, known).encode())
    assert believed is read
    assert not [*differences(known, read)]
    assert key_of_model(known) == key_of_model(read)
    expected, *found = (simulate(each, 12, range(20), 1) for each in (model, known, read))
    mse = filter_draws(model, expected, (0, 3, 6), 50, 2).mse
    for each, draws in zip((known, read), found, strict=True):
        np.testing.assert_array_equal(draws.x, expected.x)
        np.testing.assert_array_equal(draws.y, expected.y)
        np.testing.assert_array_equal(filter_draws(each, draws, (0, 3, 6), 50, 2).mse, mse)


@pytest.mark.parametrize(
    "values", [{"n": 3, "dt": 0.5}, {"n": np.float64(3), "dt": np.float64(0.5)}]
)
def test_numbers_of_any_kind_are_known_again_and_count(values) -> None:
    """Also a parameter with the name of a clock's, where the job has no clock."""

    def made(**changes) -> StateSpaceModel:
        model = dataclasses.replace(
            load_model("random_walk"),
            linear_gaussian=False,
            transition=lambda x, t, w, p: (sum([p.dt * x[0]] * int(p.n)) + w[0],),
            parameters=load_model("random_walk").parameters | values | changes,
            parameter_ranges={"n": [0, 10], "dt": (0, 1)},
        )
        return recorded(model, INSTANTS)

    known = made()
    read, _ = models_of(text_of_models(known, known).encode())
    assert not [*differences(known, read)]
    assert key_of_model(known) == key_of_model(read)
    for change in ({"dt": 0.9}, {"n": 4}):
        (name,) = change
        assert key_of_model(made(**change)) != key_of_model(known)
        assert f"parameters.{name}" in dict(differences(known, made(**change)))


def test_other_parameters_of_a_recorded_model_call_no_formula(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its programs have as many components with all values; a fit changes them at each step."""
    model = load_model("ungm")
    given = {name: 2.0 * value for name, value in model.parameters.items()}
    kept, expected = recorded(model, range(4)), recorded(model.with_parameters(given), range(4))
    monkeypatch.setattr("pfdist.models.base.count_components", None)
    changed = kept.with_parameters(given)
    assert (changed.parameters, changed.components) == (expected.parameters, expected.components)


def test_other_instants_than_the_recorded_are_refused_in_words() -> None:
    table = np.arange(13.0)
    model = dataclasses.replace(
        load_model("random_walk"),
        linear_gaussian=False,
        transition=lambda x, t, w, p: (table[t] * x[0] + w[0],),
    )
    known = recorded(model, INSTANTS)
    assert recorded(known, range(3, 9)) is known
    says = r"model random_walk: transition: it was recorded for t = 0 to 11, got t = 0 to 13: give"
    with pytest.raises(ModelError, match=says):
        recorded(known, range(15))


def test_the_order_of_sensors_and_their_noise_are_named() -> None:
    walk = load_model("random_walk")

    def sensor(sd: float, *noise: str) -> Sensor:
        return Sensor(
            lambda x, t, v, p: (x[0] + sd * v[0],),
            lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / sd) ** 2,
            noise,
        )

    def with_sensors(**sensors: Sensor) -> StateSpaceModel:
        fields = {each.name: getattr(walk, each.name) for each in dataclasses.fields(walk)}
        own = "measurement", "log_likelihood", "measurement_noise", "linear_gaussian", "y_names"
        for name in own:
            del fields[name]
        return recorded(StateSpaceModel(**fields | {"sensors": sensors}), range(4))

    a, b, c = sensor(1.0, "normal"), sensor(2.0, "normal"), sensor(2.0, "uniform")
    known = with_sensors(a=a, b=b)
    for other, key in (
        (with_sensors(b=b, a=a), "sensors"),
        (with_sensors(a=a, b=c), "sensors.b"),
        (with_sensors(a=b, b=b), "a.measurement"),
    ):
        assert key in dict(differences(known, other))
        assert key_of_model(known) != key_of_model(other)
    read, _ = models_of(text_of_models(known, known).encode())
    assert not [*differences(known, read)]
    assert key_of_model(known) == key_of_model(read)


def test_a_model_whose_programs_hold_for_one_value_is_not_replaced_by_them() -> None:
    """A branch on a parameter leaves its value in the program; the others stay symbols."""
    model = StateSpaceModel(
        name="branch",
        initial=lambda w, p: (w[0],),
        transition=lambda x, t, w, p: (x[0] * (0.5 if p.rate > 1.0 else 0.9) + p.sd * w[0],),
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        parameters={"rate": 0.5, "sd": 1.0},
    )
    assert recorded_if_it_holds(model, range(4), ["rate", "sd"]) is model
    found = recorded_if_it_holds(model, range(4), ["sd"])
    assert found == recorded(model, range(4))
    assert found.with_parameters({"sd": 2.0}) == recorded(
        model.with_parameters({"sd": 2.0}), range(4)
    )
