"""Derivatives that are recorded, against differences of the same programs and closed forms."""

import math
from collections.abc import Callable
from itertools import chain
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.in_turn import in_turn
from pfdist import where
from pfdist.models import load_model
from pfdist.models.derivatives import RULES, pulled
from pfdist.models.program import BINARY, OPERATORS, UNARY, evaluate_program
from pfdist.models.recorded import recorded
from pfdist.models.repeating import repeated_steps
from pfdist.models.symbols import Recording, RefusedError, Symbol
from pfdist.models.tracing import Formula, trace

Array = NDArray[np.float64]
AT = np.array([0.31, 0.84, 0.57, 0.12]), np.array([0.77, 0.45, 1.9, 0.6])
STEPS = {"floor", "ceil", "trunc", "rint", "sign", "isnan", "isinf", "isfinite", "signbit"}
"""Functions whose derivative is 0 wherever they have one."""
WITHIN = {"arccosh": 1.5}  # what is added to the arguments
STEP = 1e-6
CLOSE = 1e-7  # of central differences: STEP squared times a third derivative, and rounding


def values_and_slopes(function: Callable[..., Any], *at: Array) -> tuple[Array, Array]:
    """The value of a function of some numbers, and its derivative by each of them."""
    recording = Recording()
    x = tuple(Symbol(recording, recording.add("x", (), i)) for i in range(len(at)))
    value = function(*x)
    program = recording.closed([value, *pulled([(value, 1.0)], x)])
    first, *slopes = evaluate_program(program, {"x": at}, 0, {})
    return first, np.array([np.broadcast_to(each, at[0].shape) for each in slopes])


def differences(function: Callable[..., Any], *at: Array) -> Array:
    """Central differences of a function by each of its arguments."""
    changes = []
    for k in range(len(at)):
        up, down = ([v + s * (i == k) for i, v in enumerate(at)] for s in (STEP, -STEP))
        changes.append((function(*up) - function(*down)) / (2.0 * STEP))
    return np.array(changes)


@in_turn("name", [name for name in UNARY if name not in STEPS])
def test_functions_of_a_number(name: str) -> None:
    function, at = getattr(np, name), AT[0] + WITHIN.get(name, 0.0)
    value, slopes = values_and_slopes(function, at)
    np.testing.assert_allclose(value, function(at))
    np.testing.assert_allclose(slopes, differences(function, at), rtol=CLOSE)


@in_turn("name", sorted(STEPS))
def test_steps_have_the_derivative_0(name: str) -> None:
    _, slopes = values_and_slopes(lambda x: getattr(np, name)(x) + 0.0 * x, AT[0])
    assert not slopes.any()
    assert name not in RULES


@in_turn("name", [*BINARY, *OPERATORS[:4], "remainder", "power"])
def test_functions_of_two_numbers(name: str) -> None:
    function = getattr(np, name)
    value, slopes = values_and_slopes(function, *AT)
    np.testing.assert_allclose(value, function(*AT))
    expected = differences(function, *AT)
    np.testing.assert_allclose(slopes, expected, rtol=CLOSE, atol=CLOSE)


def test_a_choice_has_the_derivative_of_what_is_chosen_even_where_the_other_one_fails() -> None:
    at = np.array([-2.0, 3.0])
    _, slopes = values_and_slopes(lambda x: where(x > 0.0, np.log(x), x * x), at)
    np.testing.assert_allclose(slopes[0], [-4.0, 1 / 3])


def test_second_derivatives_are_those_of_the_first() -> None:
    """The Hessian of log cosh(a b): it has mixed terms, which closed forms give."""
    recording = Recording()
    a, b = (Symbol(recording, recording.add("x", (), i)) for i in range(2))
    gradient = pulled([(np.log(np.cosh(a * b)), 1.0)], (a, b))
    hessian = [pulled([(each, 1.0)], (a, b)) for each in gradient]
    found = np.array(evaluate_program(recording.closed([*chain(*hessian)]), {"x": AT}, 0, {}))
    x, y = AT
    tanh, sech2 = np.tanh(x * y), np.cosh(x * y) ** -2
    mixed = tanh + x * y * sech2
    np.testing.assert_allclose(found, [y * y * sech2, mixed, mixed, x * x * sech2], rtol=1e-12)


def test_numbers_and_what_does_not_depend_on_a_value_have_the_derivative_0() -> None:
    recording = Recording()
    a, b = (Symbol(recording, recording.add("x", (), i)) for i in range(2))
    before = len(recording.operations)
    assert pulled([(2.0, 1.0), (np.sin(b), 1.0)], (a,)) == [0.0]
    assert len(recording.operations) == before + 1  # the sine alone


def test_a_loop_that_is_written_out_has_the_derivative_of_its_steps() -> None:
    """The third power of a matrix, by three steps."""

    def cubed(x: Any, p: Any) -> Any:
        x[0].recording.unrolls = True
        values = repeated_steps(lambda x, k, _: (x[0] + 0.5 * x[1], x[1] - 0.25 * k * x[0]), x, 3)
        return (*pulled([(values[0], 1.0)], x), *pulled([(values[1], 1.0)], x))

    formula = Formula(cubed, "cubed", {"x": 2, "p": 0}, {}, "a model", 4)
    found = trace(formula, range(1)).values({"x": [np.array([0.3]), np.array([0.7])]}, 0, {})
    expected = np.eye(2)
    for k in range(3):
        expected = np.array([[1.0, 0.5], [-0.25 * k, 1.0]]) @ expected
    np.testing.assert_allclose(np.array(found).ravel(), expected.ravel(), rtol=1e-14)


def test_a_loop_that_is_not_written_out_is_refused() -> None:
    recording = Recording()
    x = Symbol(recording, recording.add("x", (), 0))
    (value,) = repeated_steps(lambda x, k, _: (2.0 * x[0],), (x,), 3)
    with pytest.raises(RefusedError, match=r"a loop .* has no derivative"):
        pulled([(value, 1.0)], (x,))


@pytest.mark.parametrize("name", ["ungm", "robot", "epidemic"])
def test_the_transitions_of_models(name: str) -> None:
    """Also of recorded ones, whose loops were recorded as loops."""
    model = load_model(name)
    model = recorded(model.on_clock((0.0, 0.5, 1.5)) if model.reads_clock else model, range(3))
    n, noises = model.components[0], len(model.process_noise)

    def slopes(x: Any, w: Any, p: Any) -> Any:
        x[0].recording.unrolls = True
        values = model.transition(x, 1, w, p)
        return tuple(chain(*(pulled([(each, 1.0)], [*x, *w]) for each in values)))

    given = {"x": n, "w": noises, "p": 0}
    formula = Formula(slopes, "slopes", given, model.parameters, name, n * (n + noises))
    traced, rng = trace(formula, range(1, 2)), np.random.default_rng(3)
    x, w = rng.uniform(1.0, 2.0, (n, 5)), rng.uniform(0.1, 0.9, (noises, 5))
    found = traced.values({"x": x, "w": w}, 1, model.parameters)

    def moved(*at: Array) -> Array:
        return np.array(np.broadcast_arrays(*model.transition(at[:n], 1, at[n:], model.p)))

    expected = differences(moved, *x, *w).swapaxes(0, 1).reshape(-1, 5)
    found = np.array([np.broadcast_to(each, 5) for each in found])
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    assert math.isfinite(found.sum())
