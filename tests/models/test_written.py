"""Reading a model's text runs nothing: one line says what somebody wrote wrongly into it.

SECURITY.md: what a run that somebody has sent can do.
"""

import dataclasses
import json
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pfdist.errors import ModelError
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model
from pfdist.models.recorded import recorded
from pfdist.models.written import MOST_LISTS, models_of, text_of

MODEL = recorded(load_model("robot"), range(5))
SECONDS = 5.0


def program(data: Any, formula: str = "transition") -> Any:
    """The first program of a formula of the truth."""
    return data["truth"]["formulas"][formula][0]["programs"][0]


def changed(change: Callable[[Any], Any]) -> bytes:
    data = json.loads(text_of(MODEL, MODEL))
    change(data)
    return json.dumps(data).encode()


def operation(number: int, *content: Any) -> Callable[[Any], Any]:
    """A change of an operation of the transition."""

    def change(data: Any) -> None:
        program(data)["operations"][number] = list(content)

    return change


LAST = len(program(json.loads(text_of(MODEL, MODEL)))["operations"]) - 1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (operation(LAST, "system", [0], None), "unknown operation 'system'"),
        (operation(LAST, "add", [0], None), "add has 1 arguments"),
        (operation(LAST, "add", [0, LAST], None), "an argument of add comes later"),
        (operation(LAST, "add", [0, -1], None), "an argument of add comes later"),
        (operation(LAST, "add", [0, 1.0], None), "an argument of add comes later"),
        (operation(LAST, "where", [0, 1, 1], None), "an argument of where is of a wrong kind"),
        (operation(LAST, "x", [], 99), "transition failed"),
        (operation(LAST, "x", [], -1), "x of a wrong entry"),
        (operation(LAST, "y", [], 0), "transition failed"),
        (operation(LAST, "constant", [], 10**6), "a constant is missing"),
        (operation(LAST, "take", [0], 10**6), "a table is missing"),
        (operation(LAST, "parameter", [], "nothing"), "transition failed"),
        (operation(LAST, "parameter", [], 3), "parameter of a wrong name"),
        (operation(LAST, "covariate", [0], "speed"), "an entry of a parameter at a computed"),
        (operation(LAST, ["add"], [0, 1], None), "unknown operation"),
        (operation(LAST, "add", [0, 1], "more"), "add of something"),
        (lambda data: program(data).update(outputs=[10**6]), "a result is missing"),
        (lambda data: program(data).update(outputs=[0]), "as many components"),
        (lambda data: program(data, "log_likelihood").update(outputs=[0] * 500), "other results"),
        (lambda data: program(data).update(outputs=[]), "0 results"),
        (lambda data: program(data).update(outputs=[0] * 10**6), "1,000,000 results"),
        (lambda data: data["truth"].update(name=None), "name must be a string, got None"),
        (lambda data: data["truth"].update(normalised="x"), "normalised must be true or false"),
        (lambda data: data["truth"].update(circular={}), "circular must be a list, got {}"),
        (
            lambda data: data["truth"].update(process_noise=["normal"] * 10**5),
            "at most 1,000 entries",
        ),
        (operation(LAST, "sin", "", None), "arguments must be lists"),
        (lambda data: program(data).update(constants=[]), "no row of constants"),
        (lambda data: program(data)["constants"].append([1.0]), "equal lengths"),
        (lambda data: program(data)["constants"][0].__setitem__(0, "x"), "a part is missing"),
        (lambda data: program(data)["constants"][0].__setitem__(0, None), "a number is expected"),
        (lambda data: program(data)["constants"][0].__setitem__(0, True), "a number is expected"),
        (lambda data: data["truth"].pop("name"), "unexpected or missing keys"),
        (lambda data: data["truth"].update(more=1), "unexpected or missing keys"),
        (lambda data: data.pop("filter"), "two models"),
        (lambda data: data["truth"]["formulas"].pop("transition"), "transition"),
        (lambda data: data["truth"]["formulas"].update(error=[]), "error has no program"),
        (lambda data: data["truth"].update(initial_noise=["cauchy"]), "initial_noise must be"),
        (lambda data: data["truth"].update(parameters={"a": "b"}), "a part is missing"),
        (lambda data: data["truth"].update(parameters=[]), "a part is missing"),
        (lambda data: data["truth"].update(formulas=7), "a part is missing"),
    ],
)
def test_a_part_that_is_wrong_is_named_in_a_line(change: Callable[[Any], Any], says: str) -> None:
    with pytest.raises(ValueError, match=says) as caught:
        models_of(changed(change))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"null",
        b"[]",
        b"{",
        b"\xff\xfe",
        b"[" * 100_000,
        b"[" * (MOST_LISTS + 1),
        b'{"a":' * 100_000,
        text_of(MODEL, MODEL).replace("0.0", "NaN", 1).encode(),
        text_of(MODEL, MODEL).replace("0.0", "Infinity", 1).encode(),
    ],
)
def test_a_text_that_is_no_model_is_refused(content: bytes) -> None:
    start = time.monotonic()
    with pytest.raises(ValueError, match=r"\w"):
        models_of(content)
    assert time.monotonic() - start < SECONDS


@pytest.mark.parametrize("count", [50_001, 1_000_000, 10_000_000])
def test_many_operations_are_refused_at_once(count: int) -> None:
    head, tail = json.dumps(json.loads(text_of(MODEL, MODEL))).split('"operations": [', 1)
    content = f'{head}"operations": [{count * "[1,[],2],"}{tail}'.encode()
    start = time.process_time()
    with pytest.raises(ValueError, match=r"operations|lists"):
        models_of(content)
    assert time.process_time() - start < SECONDS


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 5e-324, -0.0, 0.1, 1e308])
def test_every_number_comes_back_bit_for_bit(value: float) -> None:
    def change(data: Any) -> None:
        row = program(data)["constants"][0]
        row[0] = value if math.isfinite(value) else str(value)

    read, _ = models_of(changed(change))
    constants = read.transition.variants[0].programs[0].constants
    np.testing.assert_array_equal(np.float64(value).tobytes(), constants[0, :1].tobytes())
    assert models_of(text_of(read, read).encode())[0] == read


def test_each_program_of_a_formula_gives_as_many_results() -> None:
    """Compiled code writes them into arrays of this length."""
    table = {0: 1.0, 1: 2.0}
    model = dataclasses.replace(
        load_model("random_walk"),
        linear_gaussian=False,
        log_likelihood=lambda y, x, t, p: -((y[0] - x[0]) ** 2) * table.get(t, t),
    )
    known = recorded(model, range(5))
    data = json.loads(text_of(known, known))
    (traced,) = data["truth"]["formulas"]["log_likelihood"]
    traced["programs"].append(json.loads(json.dumps(traced["programs"][0])))
    traced["programs"][1]["outputs"] *= 300
    traced["programs"][1]["constants"] = traced["programs"][0]["constants"][4:]
    del traced["programs"][0]["constants"][4:]
    traced["which"][4] = 1
    with pytest.raises(ValueError, match="log_likelihood has other results"):
        models_of(json.dumps(data).encode())


@pytest.mark.parametrize("name", ["log_likelihood", "error", "transition", "measurement"])
def test_a_formula_gives_as_many_results_at_each_instant(name: str) -> None:
    model = load_model("random_walk")
    formula = getattr(model, name)

    def more(*arguments: Any) -> Any:
        value, t = formula(*arguments), arguments[-2 if name in ("log_likelihood", "error") else 1]
        parts = value if isinstance(value, tuple) else (value,)
        return value if t < 3 else parts * 300

    wrong = dataclasses.replace(model, linear_gaussian=False, **{name: more})
    says = rf"model random_walk: {name} must give 1 result at each instant, got 300 at t = 3"
    with pytest.raises(ModelError, match=says):
        recorded(wrong, range(6))
    with pytest.raises(ModelError, match=says):
        filter_draws(wrong, simulate(wrong, 5, range(3), 1), (2, 4), 20, 2)
