"""A model is checked when it is made: its formulas, noises, parameters and names."""

import dataclasses
import math
from functools import partial

import numpy as np
import pytest

from oracles.in_turn import in_turn
from pfdist import StateSpaceModel, load_model
from pfdist.errors import ModelError
from pfdist.models.library.linear_gaussian import linear_gaussian
from pfdist.models.recorded import recorded


def log_likelihood(y, x, t, p):
    return -0.5 * (y[0] - x[0]) ** 2


# n = 2, m = 1, q = 3; two initial noises, one process noise, one measurement noise.
GOOD = StateSpaceModel(
    name="good",
    initial=lambda w, p: (p.scale * w[0], w[1]),
    transition=lambda x, t, w, p: (x[0] + t * x[1], x[1] + w[0]),
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=log_likelihood,
    quantity_of_interest=lambda x, t, p: (x[0], x[1], x[0] * x[1]),
    initial_noise=("normal", "uniform"),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"scale": 2.0, "shift": -1.0},
    parameter_ranges={"scale": (0.0, 10.0)},
)


def changed(**changes):
    return dataclasses.replace(GOOD, **changes)


def test_components_are_counted_by_calling_the_formulas():
    assert GOOD.components == (2, 1, 3)


def test_formulas_may_have_other_argument_names():
    model = changed(
        initial=lambda noise, parameters: (noise[0],),
        transition=lambda state, *rest: state,
        quantity_of_interest=lambda x, t, p=None: x,
    )
    assert model.components == (1, 1, 1)


def test_a_model_may_have_no_noise_at_all():
    model = changed(
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


NEITHER = ((1.0, 2.0), (2.0, 1.0)), ((1.0, 0.0), (0.5, 1.0)), ((1.0, 0.5),)


def measured_with(noise):
    """A linear model whose two measurements have this covariance."""
    others = ("initial_noise", "transition", "process_noise", "quantity_of_interest")
    ones = {key: [[1]] for key in others}
    return linear_gaussian(
        "good", measurement=[[1], [2]], measurement_noise=noise, covariances=True, **ones
    )


@in_turn(
    ("make", "words"),
    [
        # formulas
        (lambda: changed(initial=3), ["initial", "(w, p)", "got 3"]),
        (lambda: changed(initial=min), ["initial", "must be a function of (w, p)"]),
        (lambda: changed(initial=lambda w: (w[0],)), ["initial", "(w, p)", "got (w)"]),
        (lambda: changed(initial=lambda w, p: w[0]), ["initial", "tuple", "(a,)", "got an array"]),
        (
            lambda: changed(log_likelihood=lambda y, x, t, p: None),
            ["log_likelihood", "one number", "got None: is there no"],
        ),
        (
            lambda: changed(transition=lambda x, t, w, p: (x[0],)),
            ["transition", "as many components as initial, 2", "got 1"],
        ),
        (lambda: changed(quantity_of_interest=fails), ["KeyError: 'nothing here'"]),
        (
            lambda: changed(transition=lambda x, t, w, p: x if x[0] > 0 else (0.0, 0.0)),
            ["transition failed: a condition on a value", "pfdist.where(condition, a, b)"],
        ),
        # a negative eigenvalue, two different correlations, too few rows
        *(
            (partial(measured_with, each), ["covariance matrix must be symmetric", f"{[*each[0]]}"])
            for each in NEITHER
        ),
        # noises
        (
            lambda: changed(process_noise=("cauchy",)),
            ["each entry of process_noise must be 'normal', 'uniform' or", "got 'cauchy'"],
        ),
        # parameters
        (
            lambda: changed(parameter_ranges={"scael": (0.0, 1.0)}),
            ["parameter_ranges", "got 'scael'", "parameters: scale"],
        ),
        (lambda: changed(parameters={"a b": 1.0}, parameter_ranges={}), ["a variable, got 'a b'"]),
        (
            lambda: changed(parameters={"scale": "x"}),
            ["scale must be a number, or a sequence of", "got 'x'"],
        ),
        (lambda: GOOD.with_parameters({"scales": 1.0}), ["unknown", "'scales'", ": scale, shift"]),
        (lambda: GOOD.with_parameters({"scale": -0.1}), ["parameter scale", "0..10, got -0.1"]),
        (lambda: GOOD.with_parameters({"scale": math.nan}), ["parameter scale", "got nan"]),
        (lambda: GOOD.on_clock([0.0]), ["a clock needs two times or more, got [0.0]"]),
        # names of components
        (lambda: changed(z_names=("a", "b")), ["a name for each of 3 components, got 2"]),
        (
            lambda: changed(z_names=("a", "b c", "B-c [mg]")),
            ["different columns, got 'b c' and 'B-c', which both end with"],
        ),
    ],
)
def test_a_mistake_in_a_model_is_named_when_it_is_made(make, words):
    with pytest.raises(ModelError) as caught:
        make()
    assert [part for part in ["model good", *words] if part not in str(caught.value)] == []
    assert "\n" not in str(caught.value)


@in_turn("name", ["1", "", "c [mg", "c []", "c [a\nb]", f"c [{'m' * 21}]", "c" * 41, "c.d"])
def test_a_name_that_makes_no_column_is_refused(name):
    with pytest.raises(ModelError, match=r"^model good: z_names: a name must be a letter.*got .*$"):
        changed(z_names=("a", "b", name))


def test_names_of_components_give_columns_labels_and_units():
    model = changed(x_names=("Größe [cm]", "b-2"), z_names=("a", "a  b", "A_B c [1/(µg s)]"))
    assert [each.suffix for each in model.named("x")] == ["größe", "b_2"]
    assert [each.suffix for each in model.named("z")] == ["a", "a_b", "a_b_c"]
    assert [each.label for each in model.named("x")] == ["Größe [cm]", "b-2"]
    assert model.named("z")[2].unit == "1/(µg s)"
    assert [each.suffix for each in GOOD.named("z")] == ["0", "1", "2"]
    assert not any(each.label for each in GOOD.named("z"))


def test_with_parameters_changes_these_and_leaves_the_model():
    wide = GOOD.with_parameters({"scale": 10})
    assert wide.p._asdict() == {"scale": 10.0, "shift": -1.0}
    assert type(wide.p.scale) is float
    assert wide.initial((np.ones(2), np.zeros(2)), wide.p)[0].tolist() == [10.0, 10.0]
    assert GOOD.p._asdict() == {"scale": 2.0, "shift": -1.0}


@pytest.mark.parametrize(
    ("field", "kinds", "says"),
    [
        ("measurement_noise", ("poisson",), "poisson_draw(v[0], mean) in the formula"),
        ("process_noise", ("t",), "student_t_draw(w[0], w[1], df, location, scale) in the formula"),
        ("process_noise", ("gaussian",), "got 'gaussian'"),
    ],
)
def test_noise_of_the_name_of_a_density_is_answered_by_its_draw(field, kinds, says):
    with pytest.raises(ModelError, match="'normal', 'uniform' or 'centred', got") as raised:
        changed(**{field: kinds})
    assert str(raised.value).endswith(says)


def test_a_model_shows_the_names_of_its_formulas_and_no_address() -> None:
    for name in ("pharmacokinetics", "two_compartments"):
        text = repr(load_model(name))
        assert text.startswith(f"StateSpaceModel(name={name!r}, initial=initial, transition=")
        assert " at 0x" not in text
    text = repr(recorded(load_model("ungm"), range(3)))
    assert text.startswith("StateSpaceModel(name='ungm', initial=initial, transition=")
    assert " at 0x" not in text
