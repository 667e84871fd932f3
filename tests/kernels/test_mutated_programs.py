"""Programs that somebody changed: an error in a line, or the values of the plain twin.

All operations here are rounded exactly, so machine code and NumPy must give the same bits,
also for indices that lie outside of a table, and for NaN.
"""

import dataclasses
import json
import random

import numpy as np
import pytest

from oracles.computed import called
from pfdist import load_model, where
from pfdist.kernels import lowering
from pfdist.kernels.blocks import Source, compile_blocks
from pfdist.models.program import GROUPS, TAKES
from pfdist.models.recorded import recorded
from pfdist.models.repeating import repeated_steps
from pfdist.models.symbols import take
from pfdist.models.written import models_of, text_of_models

LAYOUT = {"x": ("slots", 0), "w": ("noise", 0)}
EXACT = {
    *("add", "subtract", "multiply", "negative", "absolute", "sqrt", "floor", "ceil", "trunc"),
    *("rint", "maximum", "minimum", "fmax", "fmin", "less", "less_equal", "greater", "equal"),
    *("greater_equal", "not_equal", "logical_and", "logical_or", "logical_xor", "logical_not"),
    *("isnan", "isinf", "isfinite", "float", "where", "take", *GROUPS, "t", "constant", "repeat"),
    *("state", "step", "nth", "again", "final"),
}
ODD = [
    np.nan,
    np.inf,
    -np.inf,
    -1.0,
    -0.0,
    0.5,
    2.0,
    3.0,
    7.999,
    8.0,
    1e9,
    2.0**53,
    -(2.0**63),
    1e300,
]
INSTANTS = 6


def transition(x, t, w, p):
    """Tables, two loops, and different programs over t."""
    level = take([0.5, -1.0, 2.0, 4.0, 8.0, 0.25, 3.0, 1.0], (x[0] * 2.0 + 1.0).astype(int))

    def step(state, k, entries):
        a, b = state
        noise, kept = entries
        return where(a > b, b + noise, take([1.0, 2.0, 4.0], k.astype(int)) - a), kept * a

    levels = [level * x[0], level + x[0], x[0] - level, level - 1.0]
    a, b = repeated_steps(step, (x[0], level), t + 1, [w, levels], 4)
    if t % 3 == 0:
        a, b = repeated_steps(lambda s, k, _: (s[1] + k, s[0] * 0.5), (x[0], level), 3)
    if t == 4:
        return (b - a * level,)
    return (a + take([2.0, 0.5], where(b > 1.0, 1.0, 0.0).astype(int)) * np.floor(b) + w[0],)


MODEL = recorded(
    dataclasses.replace(
        load_model("random_walk"),
        linear_gaussian=False,
        process_noise=("normal",) * 4,
        transition=transition,
    ),
    range(INSTANTS + 1),
)
TEXT = text_of_models(MODEL, MODEL)


def mutated(rng):
    """The text of the model, of which one or two parts were changed."""
    data = json.loads(TEXT)
    (traced,) = data["truth"]["formulas"]["transition"]
    for _ in range(rng.choice([1, 1, 2])):
        rng.choice([change_operation, move_operations, change_data])(traced, rng)
    return json.dumps(data).encode()


def change_operation(traced, rng):
    operations = rng.choice(traced["programs"])["operations"]
    number = rng.randrange(len(operations))
    operation, what = operations[number], rng.choice(["name", "taken", "taken", "which"])
    if what == "name":
        alike = [each for each in sorted(EXACT) if TAKES[each] == TAKES[operation[0]]]
        operation[0] = rng.choice(alike)
        operation[2] = 0 if operation[0] == "take" else None if operation[1] else operation[2]
    elif what == "taken" and operation[1]:
        chosen = [rng.randrange(max(1, number)), rng.randrange(len(operations)), -1]
        operation[1][rng.randrange(len(operation[1]))] = rng.choices(chosen, [8, 2, 1])[0]
    elif operation[2] is not None:
        operation[2] = rng.choice([0, 1, 2, 3, 5, 99, -1])


def move_operations(traced, rng):
    """Add an operation, which one behind it takes, or remove one."""
    program = rng.choice(traced["programs"])
    operations, shift = program["operations"], rng.choice([1, 1, -1])
    number = rng.randrange(len(operations))
    for each in operations[number:]:
        each[1] = [k + shift if k >= number else k for k in each[1]]
    program["outputs"] = [k + shift if k >= number else k for k in program["outputs"]]
    if shift < 0:
        del operations[number]
        return
    taken = [rng.randrange(max(1, number)) for _ in range(2)]
    new = [["take", taken[:1], rng.randrange(2)], [rng.choice(["add", "less"]), taken, None]]
    operations.insert(number, rng.choice(new))
    behind = [each for each in operations[number + 1 :] if each[1]]
    rng.choice([*behind, operations[number]])[1][-1] = number


def change_data(traced, rng):
    program = rng.choice(traced["programs"])
    what = rng.choice(["constant", "table", "result", "instant"])
    if what == "constant":
        row = rng.choice(program["constants"])
        row[rng.randrange(len(row))] = rng.choice(["nan", "inf", "-inf", *ODD[3:]])
    elif what == "table" and program["tables"]:
        table = rng.choice(program["tables"])
        table[:] = rng.choice([table[:1], [*table, 7.0, "nan"], ["inf", *table[1:]], []])
    elif what == "result":
        program["outputs"] = [rng.randrange(len(program["operations"]))]
    else:
        traced["which"][rng.randrange(INSTANTS)] = rng.randrange(len(traced["programs"]))


@pytest.mark.parametrize("most_together", [300, 8])
@pytest.mark.parametrize(
    ("first", "count"), [(0, 5), pytest.param(1000, 2000, marks=pytest.mark.slow)]
)
def test_a_mutated_program_has_the_values_of_its_twin_or_is_not_accepted(
    first, count, most_together, monkeypatch
):
    """Programs whose number of steps differs between particles are left out: they have no twin."""
    monkeypatch.setattr(lowering, "MOST_TOGETHER", most_together)
    compared = 0
    for seed in range(first, first + count):
        rng = random.Random(seed)
        try:
            (model, _) = models_of(mutated(rng))
        except ValueError:
            continue
        (traced,) = model.transition.variants
        if all(has_one_number_of_steps(each) for each in traced.programs):
            compare(traced, np.random.default_rng(seed))
            compared += 1
    assert compared > count / 4


def has_one_number_of_steps(program):
    loops = (each for each in program.operations if each.name == "repeat")
    return all(program.is_shared[each.arguments[0]] for each in loops)


def compare(traced, rng):
    x = np.round(rng.normal(1.0, 2.0, (1, 1, 32)), 2)
    x[0, 0, : len(ODD)] = ODD
    w = np.round(rng.normal(size=(4, 1, 32)), 2).astype(np.float32)
    lowering.machine_code.cache_clear()  # the number of values in a piece is no part of its key
    blocks = compile_blocks([Source(traced, LAYOUT, {}, 1)], traced.instants).blocks
    for t in traced.instants:
        got = called(blocks, t, x, w, np.zeros((1, 1)), 1)
        expected = np.broadcast_to(
            *traced.values({"x": x, "w": w.astype(float)}, t, {}), x[0].shape
        )
        np.testing.assert_array_equal(got[0], expected)
