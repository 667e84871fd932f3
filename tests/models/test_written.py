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

from oracles.batched import batched
from oracles.in_turn import in_turn
from pfdist.errors import ModelError
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model
from pfdist.models.recorded import recorded
from pfdist.models.written import MOST_LISTS, models_of, text_of_models

MODEL = recorded(load_model("ungm"), range(5))
SECONDS = 5.0


def program(data: Any, formula: str = "transition") -> Any:
    """The first program of a formula of the truth."""
    return data["truth"]["formulas"][formula][0]["programs"][0]


def changed(change: Callable[[Any], Any]) -> bytes:
    data = json.loads(text_of_models(MODEL, MODEL))
    change(data)
    return json.dumps(data).encode()


def operation(number: int, *content: Any) -> Callable[[Any], Any]:
    """A change of an operation of the transition."""

    def change(data: Any) -> None:
        program(data)["operations"][number] = list(content)

    return change


LAST = len(program(json.loads(text_of_models(MODEL, MODEL)))["operations"]) - 1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (operation(LAST, "system", [0], None), "unknown operation 'system'"),
        (operation(LAST, "add", [0], None), "add has 1 arguments"),
        (operation(LAST, "add", [0, -1], None), "an argument of add comes later"),
        (operation(LAST, "where", [0, 1, 1], None), "an argument of where is of a wrong kind"),
        (operation(LAST, "x", [], 99), "transition failed"),
        (operation(LAST, "x", [], -1), "x of a wrong entry"),
        (operation(LAST, "constant", [], 10**6), "a constant is missing"),
        (operation(LAST, "take", [0], 10**6), "a table is missing"),
        (operation(LAST, "parameter", [], "nothing"), "transition failed"),
        (operation(LAST, "covariate", [0], "speed"), "an entry of a parameter at a computed"),
        (operation(LAST, "add", [0, 1], "more"), "add of something"),
        (lambda data: program(data).update(outputs=[10**6]), "a result is missing"),
        (lambda data: program(data).update(outputs=[0, 0]), "as many components"),
        (lambda data: program(data, "log_likelihood").update(outputs=[0] * 500), "other results"),
        (lambda data: program(data).update(outputs=[0] * 10**6), "1,000,000 results"),
        (lambda data: data["truth"].update(name=None), "name must be a string, got None"),
        (lambda data: data["truth"].update(process_noise=["normal"] * 10**5), "at most 1000 items"),
        (operation(LAST, "sin", "", None), "arguments must be lists"),
        (lambda data: program(data).update(constants=[]), "no row of constants"),
        (lambda data: program(data)["constants"][0].__setitem__(0, "x"), "a part is missing"),
        (lambda data: program(data)["constants"][0].__setitem__(0, None), "a number is expected"),
        (lambda data: data["truth"].pop("name"), "unexpected or missing keys"),
        (lambda data: data.pop("filter"), "two models"),
        (lambda data: data["truth"]["formulas"].pop("transition"), "transition"),
        (lambda data: data["truth"]["formulas"].update(error=[]), "error has no program"),
        (lambda data: data["truth"].update(initial_noise=["cauchy"]), "initial_noise must be"),
        (lambda data: data["truth"].update(parameters={"a": "b"}), "a part is missing"),
    ],
)
def test_a_part_that_is_wrong_is_named_in_a_line(change: Callable[[Any], Any], says: str) -> None:
    with pytest.raises(ValueError, match=says) as caught:
        models_of(changed(change))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


LOOP = recorded(load_model("lotka_volterra"), range(5))


@in_turn(
    ("name", "change", "says"),
    [
        ("repeat", {2: 0}, "a loop has wrong sizes"),
        ("repeat", {2: 10**9}, "a loop has wrong sizes"),
        ("repeat", {2: 9}, "nth of a loop of another size"),  # it would read behind the noise
        ("repeat", {2: "ten"}, "repeat of a wrong entry"),
        ("repeat", {1: [38]}, "a loop has wrong sizes"),
        ("repeat", {1: [38, 0]}, "state of a loop of another size"),
        ("state", {2: 2}, "state of a loop of another size"),
        ("state", {1: [0]}, "an argument of state is of a wrong kind"),
        ("nth", {1: [53, 3]}, "nth of a loop of another size"),
        ("nth", {1: [53, *[54] * 10]}, "nth takes a value of a step"),
        ("again", {1: [53, 100]}, "again of a loop of another size"),
        ("again", {0: "add", 1: [0, 1]}, "a loop does not end"),
        ("final", {1: [53]}, "an argument of final is of a wrong kind"),
        ("final", {2: 2}, "a value of a loop is missing"),
        ("final", {0: "add", 1: [0, 100], 2: None}, "add takes a value of a step"),
        ("step", {0: "repeat", 1: [38, 0], 2: 10}, "a loop begins in another"),
        ("step", {0: "add", 1: [0, 53]}, "an argument of add is of a wrong kind"),
    ],
)
def test_a_loop_that_is_wrong_is_named_in_a_line(
    name: str, change: dict[int, Any], says: str
) -> None:
    data = json.loads(text_of_models(LOOP, LOOP))
    operations = program(data)["operations"]
    number = [each[0] for each in operations].index(name)
    for place, content in change.items():
        operations[number][place] = content
    with pytest.raises(ValueError, match=says):
        models_of(json.dumps(data).encode())


def test_a_loop_of_many_steps_is_read_at_once() -> None:
    """Reading a model calls its formulas, but computes one step of a loop."""
    data = json.loads(text_of_models(LOOP, LOOP))
    changed = program(data)
    begin = [["x", [], 0], ["x", [], 1], ["constant", [], 0], ["repeat", [2, 0, 1], 10_000]]
    body = [["state", [3], 0], *(["sin", [4 + k], None] for k in range(9_999))]
    last = len(begin) + len(body) - 1
    end = [["again", [3, last, last], None], ["final", [last + 1], 0], ["final", [last + 1], 1]]
    changed.update(operations=begin + body + end, outputs=[last + 2, last + 3])
    for row in changed["constants"]:
        row[0] = 10_000.0
    start = time.process_time()
    models_of(json.dumps(data).encode())
    assert time.process_time() - start < SECONDS


@pytest.mark.parametrize(
    ("declared", "says"),
    [
        ({"version": 1}, "an identity must consist of texts"),
        ({"files": {"a": 3}}, "an identity must consist of texts"),
        ({"libraries": []}, "a part is missing"),
        ({"coupled": 1}, "coupled must be true or false"),
        ({"together": 0}, "together must be at least 1"),
        ({"more": "x"}, "an identity has other keys"),
    ],
)
def test_a_declaration_that_is_wrong_is_named_in_a_line(declared: Any, says: str) -> None:
    model = batched(load_model("ungm"))
    data = json.loads(text_of_models(model, model))
    data["truth"]["formulas"]["transition"]["declared"].update(declared)
    with pytest.raises(ValueError, match=says):
        models_of(json.dumps(data).encode())


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999", "9" * 30, "[" * 100_000])
def test_a_number_that_no_model_has_is_refused(number: str) -> None:
    data = json.loads(text_of_models(MODEL, MODEL))
    data["truth"]["parameters"]["dt"] = "here"
    with pytest.raises(ValueError, match=r"numbers must be finite|64 bits|deep") as refused:
        models_of(json.dumps(data).replace('"here"', number).encode())
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("results", [0, -1, 10**9, "1", None])
def test_a_wrong_number_of_results_is_refused(results: Any) -> None:
    model = batched(load_model("ungm"))
    data = json.loads(text_of_models(model, model))
    data["truth"]["formulas"]["transition"]["results"] = results
    with pytest.raises(ValueError, match="a number of results is wrong"):
        models_of(json.dumps(data).encode())


def test_values_for_steps_are_limited_because_they_compile_slowly() -> None:
    data = json.loads(text_of_models(LOOP, LOOP))
    operations = program(data)["operations"]
    number = [each[0] for each in operations].index("nth")
    operations[number][1] += [3] * 10_000
    with pytest.raises(ValueError, match=r"must take at most 10,000 values, got 10,039"):
        models_of(json.dumps(data).encode())


def test_a_result_within_a_loop_is_refused() -> None:
    data = json.loads(text_of_models(LOOP, LOOP))
    program(data)["outputs"] = [100, 101]
    with pytest.raises(ValueError, match="a result is of a step"):
        models_of(json.dumps(data).encode())


@in_turn(
    "content",
    [
        b"null",
        b"{",
        b"\xff\xfe",
        b"[" * 100_000,
        b"[" * (MOST_LISTS + 1),
        b'{"a":' * 100_000,
        text_of_models(MODEL, MODEL).replace("0.0", "NaN", 1).encode(),
        text_of_models(MODEL, MODEL).replace("0.0", "Infinity", 1).encode(),
    ],
)
def test_a_text_that_is_no_model_is_refused(content: bytes) -> None:
    start = time.monotonic()
    with pytest.raises(ValueError, match=r"\w"):
        models_of(content)
    assert time.monotonic() - start < SECONDS


@pytest.mark.parametrize("count", [50_001, 10_000_000])
def test_many_operations_are_refused_at_once(count: int) -> None:
    head, tail = json.dumps(json.loads(text_of_models(MODEL, MODEL))).split('"operations": [', 1)
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
    assert models_of(text_of_models(read, read).encode())[0] == read


def test_each_program_of_a_formula_gives_as_many_results() -> None:
    """Compiled code writes them into arrays of this length."""
    table = {0: 1.0, 1: 2.0}
    model = dataclasses.replace(
        load_model("random_walk"),
        linear_gaussian=False,
        log_likelihood=lambda y, x, t, p: -((y[0] - x[0]) ** 2) * table.get(t, t),
    )
    known = recorded(model, range(5))
    data = json.loads(text_of_models(known, known))
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
