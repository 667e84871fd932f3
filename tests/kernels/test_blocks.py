"""Blocks: programs as machine code have the values of their plain twins, on every processor."""

import math

import numpy as np
import pytest

from oracles.clocked import with_clock
from oracles.computed import called, called_elsewhere
from pfdist import load_model, where
from pfdist.kernels import lowering
from pfdist.kernels.blocks import Source, compile_blocks
from pfdist.kernels.lowering import split
from pfdist.models.program import Operation, Program, merged
from pfdist.models.repeating import repeated_steps
from pfdist.models.tracing import Formula, trace

MODELS = ("ungm", "robot", "epidemic_counts", "xray_tumour")
LAYOUT = {"x": ("slots", 0), "w": ("noise", 0), "y": ("given", 0)}


def formulas_of(model):
    n, m, _ = model.components
    yield "transition", model.transition, {"x": n, "t": 0, "w": len(model.process_noise), "p": 0}
    yield "quantity_of_interest", model.quantity_of_interest, {"x": n, "t": 0, "p": 0}
    yield "log_likelihood", model.log_likelihood, {"y": m, "x": n, "t": 0, "p": 0}


@pytest.mark.parametrize("name", MODELS)
def test_a_block_has_the_values_of_the_plain_twin(name):
    """At three instants, for 40 particles of each of two draws.

    Elementary functions of both are within 2 units in the last place; the tolerance allows for a
    hundred of them, and for a difference of terms that are 1,000 times larger.
    """
    model, rng = with_clock(load_model(name), 20), np.random.default_rng(1)
    x, w = rng.uniform(0.2, 1.5, size=(12, 2, 48)), rng.normal(size=(32, 2, 48)).astype(np.float32)
    y = rng.uniform(0.2, 1.5, size=(2, 8))
    for key, function, arguments in formulas_of(model):
        formula = Formula(function, key, arguments, model.parameters, name)
        traced = trace(formula, range(20))
        results = len(traced.programs[0].outputs)
        source = Source(traced, LAYOUT, model.parameters, results)
        compiled = compile_blocks([source], range(20))
        for t in (0, 7, 19):
            got = called(compiled.blocks, t, x, w, y, results)
            groups = {"x": x, "w": w.astype(float), "y": y.T[:, :, None]}
            expected = source.traced.values(groups, t, model.parameters)
            for row, values in zip(got, expected, strict=True):
                with np.errstate(invalid="ignore"):
                    apart = np.abs(row - values) / (1e3 * np.maximum(np.abs(values), 1.0))
                assert np.nanmax(apart, initial=0.0) < 200 * np.finfo(float).eps
                np.testing.assert_array_equal(np.isnan(row), np.isnan(values))


def test_a_program_of_single_instants_reads_its_constants():
    table = {t: 1.5**t for t in range(6)}

    def transition(x, t, w, p):
        return (x[0] * table[t] if t % 2 else x[0] + table[t],)

    formula = Formula(transition, "transition", {"x": 1, "t": 0, "w": 1, "p": 0}, {}, "mine")
    compiled = compile_blocks([Source(trace(formula, range(6)), LAYOUT, {}, 1)], range(6))
    x = np.arange(96.0).reshape(1, 2, 48)
    for t in range(6):
        (got,) = called(compiled.blocks, t, x, x.astype(np.float32), np.zeros((2, 1)), 1)
        np.testing.assert_array_equal(got, x[0] * table[t] if t % 2 else x[0] + table[t])


@pytest.mark.parametrize("most_together", [5, 300])
def test_a_loop_has_the_values_of_the_plain_twin(most_together, monkeypatch):
    """Also where it is one of several pieces, and where its number of steps varies with t.

    Each step takes its own of some variates, and its own of some values that were computed.
    """
    monkeypatch.setattr(lowering, "MOST_TOGETHER", most_together)
    counts = [1, 3, 2, 4, 0, 9, math.nan]  # at least one step, and at most four

    def transition(x, t, w, p):
        def step(state, k, entries):
            a, b = state
            noise, computed = entries
            larger = (a > b) & (k > 0.0)
            return (where(larger, a * p.rate, a + noise), 0.5 * b + computed * k / x[1])

        computed = [np.exp(-k * x[0]) for k in range(4)]
        a, b = repeated_steps(step, x, counts[t], [w[1::2], computed], 4)
        again, _ = repeated_steps(step, (b, a), 2, [w[0:4], computed], 4)
        return (np.sin(a) + b, again)

    parameters = {"rate": 0.75}
    formula = Formula(
        transition, "transition", {"x": 2, "t": 0, "w": 8, "p": 0}, parameters, "mine"
    )
    traced, rng = trace(formula, range(7)), np.random.default_rng(2)
    assert len(traced.programs) == 1
    x, w = rng.uniform(0.2, 1.5, (2, 2, 48)), rng.normal(size=(8, 2, 48)).astype(np.float32)
    compiled = compile_blocks([Source(traced, LAYOUT, parameters, 2)], range(7))
    for t in range(7):
        got = called(compiled.blocks, t, x, w, np.zeros((2, 1)), 2)
        groups = {"x": x, "w": w.astype(float)}
        np.testing.assert_allclose(got, traced.values(groups, t, parameters), rtol=1e-13)


def test_what_all_particles_share_is_not_computed_for_each():
    """A reciprocal of a shared number replaces a division, unless it would have fewer digits."""
    operations = (
        Operation("x", (), 0), Operation("t"), Operation("cos", (1,)), Operation("divide", (0, 2)),
    )  # fmt: skip
    program = merged(Program(operations, (3,), np.empty((1, 0))))
    names = [each.name for each in split(program, LAYOUT).particles.operations]
    assert names == ["slots", "shared", "multiply"]
    names = [each.name for each in split(program, LAYOUT, exact=True).particles.operations]
    assert names == ["slots", "shared", "divide"]

    def transition(x, t, w, p):
        return (x[0] / p.tiny,)

    for tiny in (1e-3, 3e-310):
        formula = Formula(
            transition, "transition", {"x": 1, "t": 0, "w": 1, "p": 0}, {"tiny": tiny}, "mine"
        )
        source = Source(trace(formula, range(1)), LAYOUT, {"tiny": tiny}, 1)
        x = np.full((1, 2, 48), 1.7e-300)
        blocks = compile_blocks([source], range(1)).blocks
        (got,) = called(blocks, 0, x, x.astype(np.float32), np.zeros((2, 1)), 1)
        np.testing.assert_allclose(got, x[0] / tiny, rtol=4e-16)


@pytest.mark.parametrize(
    ("triple", "processor"),
    [
        ("x86_64-unknown-linux-gnu", "haswell"),
        pytest.param("aarch64-unknown-linux-gnu", "neoverse-n1", marks=pytest.mark.slow),
    ],
)
def test_machine_code_calls_no_library(triple, processor):
    """So the last digit does not depend on the C library."""
    halves = []
    for name in MODELS:
        model = with_clock(load_model(name), 3)
        for key, function, arguments in formulas_of(model):
            formula = Formula(function, key, arguments, model.parameters, name)
            (program, *_) = trace(formula, range(3)).programs
            halves += split(merged(program), LAYOUT)[::2]
    assert not called_elsewhere(halves, triple, processor)


def test_a_long_program_has_the_same_bits_in_pieces(monkeypatch):
    model, rng = load_model("robot"), np.random.default_rng(1)
    x, w = rng.uniform(0.2, 1.5, size=(3, 1, 48)), rng.normal(size=(2, 1, 48)).astype(np.float32)
    arguments = {"x": 3, "t": 0, "w": 2, "p": 0}
    formula = Formula(model.transition, "transition", arguments, model.parameters, "robot")
    source, results = Source(trace(formula, range(1)), LAYOUT, model.parameters, 3), []
    for most in (300, 7):
        monkeypatch.setattr(lowering, "MOST_TOGETHER", most)
        lowering.machine_code.cache_clear()
        compiled = compile_blocks([source], range(1))
        results.append(called(compiled.blocks, 0, x, w, np.zeros((1, 1)), 3))
    lowering.machine_code.cache_clear()
    np.testing.assert_array_equal(*results)
