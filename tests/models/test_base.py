import dataclasses
import math

import numpy as np
import pytest

from pfdist import StateSpaceModel
from pfdist.errors import ModelError


def initial(w, p):
    return (p.scale * w[0], w[1])


def transition(x, t, w, p):
    return (x[0] + t * x[1], x[1] + w[0])


def measurement(x, t, v, p):
    return (x[0] + v[0],)


def log_likelihood(y, x, t, p):
    return -0.5 * (y[0] - x[0]) ** 2


def quantity_of_interest(x, t, p):
    return (x[0], x[1], x[0] * x[1])


# n = 2, m = 1, q = 3; two initial noises, one process noise, one measurement noise.
GOOD = StateSpaceModel(
    name="good",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal", "uniform"),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"scale": 2.0, "shift": -1.0},
    parameter_ranges={"scale": (0.0, 10.0)},
)


def test_components_are_counted_by_calling_the_formulas():
    assert GOOD.components == (2, 1, 3)


def test_parameters_are_read_by_name_as_floats():
    model = dataclasses.replace(GOOD, parameters={"scale": 3})
    assert model.p.scale == 3.0
    assert type(model.p.scale) is float


def test_formulas_may_be_lambdas_and_have_other_argument_names():
    model = dataclasses.replace(
        GOOD,
        initial=lambda noise, parameters: (noise[0],),
        transition=lambda state, *rest: state,
        quantity_of_interest=lambda x, t, p=None: x,
    )
    assert model.components == (1, 1, 1)


def test_a_model_may_have_no_noise_at_all():
    model = dataclasses.replace(
        GOOD,
        initial=lambda w, p: (1.0,),
        transition=lambda x, t, w, p: (0.5 * x[0],),
        measurement=lambda x, t, v, p: (x[0],),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=(),
        process_noise=(),
        measurement_noise=(),
    )
    assert model.components == (1, 1, 1)


def fails(x, t, *_):
    raise KeyError("nothing here")


ERRORS = {
    "not callable": ({"initial": 3}, ["initial", "(w, p)", "got 3"]),
    "an argument too few": ({"initial": lambda w: (w[0],)}, ["initial", "(w, p)", "got (w)"]),
    "an argument too many": (
        {"log_likelihood": lambda y, x, t, p, q: 0.0},
        ["log_likelihood", "(y, x, t, p)", "got (y, x, t, p, q)"],
    ),
    "no tuple": ({"initial": lambda w, p: w[0]}, ["initial", "tuple", "(a,)", "got an array"]),
    "no value": ({"measurement": lambda x, t, v, p: None}, ["measurement", "got None"]),
    "a likelihood that is a tuple": (
        {"log_likelihood": lambda y, x, t, p: (0.0,)},
        ["log_likelihood", "one number", "got a tuple"],
    ),
    "a component lost": (
        {"transition": lambda x, t, w, p: (x[0],)},
        ["transition", "as many components as initial, 2", "got 1"],
    ),
    "an unknown noise": (
        {"process_noise": ("cauchy",)},
        ["process_noise", "'normal' or 'uniform'", "got ('cauchy',)"],
    ),
    "a noise that is no tuple": (
        {"process_noise": ["normal"]},
        ["process_noise", "tuple", "got ['normal']"],
    ),
    "a noise too few": ({"initial_noise": ("normal",)}, ["initial failed", "IndexError"]),
    "a parameter that is not there": (
        {"parameters": {}, "parameter_ranges": {}},
        ["initial failed", "AttributeError", "scale", "parameters: none"],
    ),
    "a formula that raises": ({"quantity_of_interest": fails}, ["KeyError: 'nothing here'"]),
    "a likelihood without return": (
        {"log_likelihood": lambda y, x, t, p: None},
        ["log_likelihood", "one number", "got None: is there no"],
    ),
    "no quantity of interest": (
        {"quantity_of_interest": lambda x, t, p: ()},
        ["quantity_of_interest", "tuple", "got an empty tuple"],
    ),
    "a builtin": ({"initial": min}, ["initial", "must be a function of (w, p)"]),
    "a range of nothing": (
        {"parameter_ranges": {"scael": (0.0, 1.0)}},
        ["parameter_ranges", "got 'scael'", "parameters: scale"],
    ),
    "a branch on a component": (
        {"transition": lambda x, t, w, p: x if x[0] > 0 else (0.0, 0.0)},
        ["transition failed on arrays", "ValueError", "pfdist.where(condition, a, b)"],
    ),
}


@pytest.mark.parametrize("mistake", ERRORS)
def test_a_mistake_in_a_model_is_named_when_it_is_made(mistake):
    changes, fragments = ERRORS[mistake]
    with pytest.raises(ModelError) as caught:
        dataclasses.replace(GOOD, **changes)
    assert [part for part in ["model good", *fragments] if part not in str(caught.value)] == []


@pytest.mark.parametrize("value", [-0.1, 10.1, math.nan, math.inf])
def test_a_parameter_outside_its_range_is_an_error(value):
    with pytest.raises(ModelError, match=rf"^model good: parameter scale .* 0\.\.10, got {value}$"):
        GOOD.with_parameters({"scale": value})


@pytest.mark.parametrize("value", [math.nan, -math.inf])
def test_a_parameter_without_a_range_must_be_finite(value):
    with pytest.raises(ModelError, match=rf"parameter shift .* finite .* got {value}$"):
        GOOD.with_parameters({"shift": value})


def test_with_parameters_changes_these_and_leaves_the_model():
    changed = GOOD.with_parameters({"scale": 10.0})
    assert changed.p._asdict() == {"scale": 10.0, "shift": -1.0}
    assert changed.initial((np.ones(2), np.zeros(2)), changed.p)[0].tolist() == [10.0, 10.0]
    assert GOOD.p._asdict() == {"scale": 2.0, "shift": -1.0}


def test_with_parameters_lists_the_parameters_that_there_are():
    with pytest.raises(
        ModelError, match=r"^model good: unknown parameter 'scales', .*: scale, shift"
    ):
        GOOD.with_parameters({"scales": 1.0})


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"a b": 1.0}, "that of a variable, got 'a b'"),
        ({"_a": 1.0}, "that of a variable, got '_a'"),
        ({"lambda": 1.0}, "that of a variable, got 'lambda'"),
        ({"scale": "x"}, "scale must be a number, or a sequence of .* got 'x'"),
    ],
)
def test_a_parameter_is_a_variables_name_and_a_number(parameters, message):
    with pytest.raises(ModelError, match=message):
        dataclasses.replace(GOOD, parameters=parameters, parameter_ranges={})


def test_names_of_components_give_columns_labels_and_units():
    model = dataclasses.replace(
        GOOD, x_names=("Größe [cm]", "b-2"), z_names=("a", "a  b", "A_B c [1/(µg s)]")
    )
    assert [each.suffix for each in model.named("x")] == ["größe", "b_2"]
    assert [each.suffix for each in model.named("z")] == ["a", "a_b", "a_b_c"]
    assert [each.label for each in model.named("x")] == ["Größe [cm]", "b-2"]
    assert model.named("z")[2].unit == "1/(µg s)"
    assert [each.suffix for each in GOOD.named("z")] == ["0", "1", "2"]
    assert not any(each.label for each in GOOD.named("z"))


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("dose", "z_names: must be a tuple, a name for each component, got 'dose'"),
        (("a", "b"), "z_names: must have a name for each of 3 components, got 2"),
        (("a", "b c", "B-c [mg]"), "different columns, got 'b c' and 'B-c', which both end with"),
        (("a", "b", "1"), "got '1'"),
        (("a", "b", ""), "got ''"),
        (("a", "b", 3), "got 3"),
        (("a", "b", "c [mg"), "got 'c [mg'"),
        (("a", "b", "c []"), "got 'c []'"),
        (("a", "b", "c [a\nb]"), "a name must be a letter, then letters, digits"),
        (("a", "b", f"c [{'m' * 21}]"), "a unit in brackets (at most 20)"),
        (("a", "b", "c" * 41), "(at most 40 characters)"),
        (("a", "b", "c.d"), "got 'c.d'"),
    ],
)
def test_wrong_names_are_told_in_one_line(names, words):
    with pytest.raises(ModelError) as caught:
        dataclasses.replace(GOOD, z_names=names)
    assert words in str(caught.value)
    assert str(caught.value).startswith("model good: z_names: ")
    assert "\n" not in str(caught.value)
