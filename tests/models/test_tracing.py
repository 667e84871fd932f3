"""Tracing: what a formula computes becomes a program; what cannot be traced has a clear error."""

import dataclasses
import functools
import math
import random
import types

import numpy as np
import pytest
from numba import njit
from scipy import stats
from scipy.integrate import solve_ivp

from oracles.clocked import with_clock
from oracles.in_turn import in_turn
from pfdist import load_model
from pfdist.common import telling
from pfdist.densities import gamma_logpdf, poisson_draw
from pfdist.elementwise import clip
from pfdist.errors import ModelError, TraceError
from pfdist.models import tracing
from pfdist.models.checks import ARGUMENTS
from pfdist.models.program import Operation, Program, evaluate_program, merged
from pfdist.models.recorded import recorded
from pfdist.models.symbols import take
from pfdist.models.tracing import MODES, Formula, trace

SYMBOLS, T_NUMBER, NUMBERS = MODES
SHIPPED = (
    *("bearings_only", "constant_velocity", "epidemic", "epidemic_counts", "linear_gaussian"),
    *("lorenz63", "lotka_volterra", "pharmacokinetics", "random_walk", "robot"),
    *("stochastic_volatility", "tumour", "two_compartments", "ungm", "ungm_gordon", "xray_tumour"),
)
RATE = tuple(0.5 + 0.1 * t for t in range(8))


def traced(function, instants=range(8), parameters=None, **sizes):
    sizes = sizes or {"x": 2, "t": 0, "w": 1, "p": 0}
    given = {"sd": 2.0, "rate": RATE} if parameters is None else parameters
    formula = Formula(function, "transition", sizes, given, "mine")
    return trace(formula, instants), given


def values(function, t, x=(0.5, -1.5), w=(0.25,)):
    """The values of the program for two particles at t, and those of the formula, one by one."""
    result, given = traced(function)
    p = types.SimpleNamespace(**{k: np.asarray(v) for k, v in given.items()})
    particles = [(np.array(x) + k, np.array(w) - k) for k in range(2)]
    x, w = (np.stack(each, axis=1) for each in zip(*particles, strict=True))
    got = result.values({"x": x, "w": w}, t, given)
    with np.errstate(all="ignore"):
        expected = [function(tuple(a), t, tuple(b), p) for a, b in particles]
    return _broadcast(got, 2), np.array(expected, float).T


# --- the models that ship -------------------------------------------------------------------------


@in_turn("name", SHIPPED)
def test_each_model_that_ships_is_traced_with_symbols_alone(name):
    """On a clock of uneven steps; the twin and the merged program have the formula's values."""
    rng = np.random.default_rng(3)
    for way in with_clock(load_model(name), 30).ways:
        model, (n, m, q) = way.model, way.model.components
        sizes = {"x": n, "y": m, "z": q, "estimate": q, "t": 0, "p": 0}
        sizes["v"] = len(model.measurement_noise)
        for key, function in model.formulas.items():
            sizes["w"] = len(model.initial_noise if key == "initial" else model.process_noise)
            arguments = {each: sizes[each] for each in ARGUMENTS[key]}
            result = trace(Formula(function, key, arguments, model.parameters, name), range(30))
            assert result.mode == SYMBOLS
            groups = {
                each: tuple(rng.normal(size=(count, 20)) * 1.3)
                for each, count in arguments.items() if each not in "tp"
            }  # fmt: skip
            for t in (0, 7, 29):
                with np.errstate(all="ignore"):
                    expected = function(
                        *(t if a == "t" else model.p if a == "p" else groups[a] for a in arguments)
                    )
                expected = expected if isinstance(expected, tuple) else (expected,)
                got = result.values(groups, t, model.parameters)
                got, expected = _broadcast(got, 20), _broadcast(expected, 20)
                np.testing.assert_allclose(got, expected, rtol=1e-12)
                same = evaluate_program(merged(result.programs[0]), groups, t, model.parameters)
                np.testing.assert_array_equal(_broadcast(same, 20), got)


def _broadcast(components, particles):
    return np.stack([np.broadcast_to(each, particles) for each in components])


# --- what may be written --------------------------------------------------------------------------

TABLE = {t: 1.0 / (1 + t) for t in range(8)}
LEVELS = np.array([3.0, 1.0, 4.0, 1.5])
MATRIX = np.array([[1.0, 0.5], [-0.25, 0.75]])
TWO_LEVELS = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])


@njit
def helper(a, b):
    return a * b + math.exp(0.5)


def by_dictionary(x, t, w, p):
    return (x[0] * TABLE[t], x[1] + w[0])


def by_branch_on_t(x, t, w, p):
    if t % 3 == 0:
        return (x[0] + w[0], x[1])
    return (x[0] * p.sd, x[1] - w[0])


def by_neighbour(x, t, w, p):
    return (x[0] * p.rate[t - 1], x[1] + p.rate[t] * w[0])


def by_branch_on_parameter(x, t, w, p):
    return (x[0] + w[0], x[1] if p.sd > 1 else x[0])


def by_generator(x, t, w, p):
    return tuple(a * k + w[0] for k, a in enumerate(x))


def by_matrix(x, t, w, p):
    return MATRIX @ np.array(x) + np.array([w[0], 0.0])


def by_stack(x, t, w, p):
    state = np.stack([x[0], x[1]])
    return (np.sum(MATRIX[0] * state), np.dot(MATRIX[1], state) + w[0])


def by_functions(x, t, w, p):
    a = np.exp(-abs(x[0])) + np.log1p(x[1] ** 2) + np.tanh(x[0]) ** 3 + np.hypot(x[0], x[1])
    b = np.clip(x[1], -1.0, 1.0) + clip(x[0], 0.0, 1.0) + x[0] % 0.7 + x[1] // 0.3
    c = np.select([x[0] > 1, x[0] > 0], [x[1], 2 * x[1]], 7.0) + np.round(x[0], 1)
    return (a + c, b + np.logaddexp(x[0], x[1]) + np.degrees(w[0]) + 2.0 ** x[0])


def by_powers(x, t, w, p):
    simple = [x[0] ** power for power in (-1, 0, 1, 2, 3, 4)]
    return (sum(k * each for k, each in enumerate(simple, 1)), abs(x[1]) ** 0.5 + x[0] ** -2)


def by_masks(x, t, w, p):
    both = (x[0] > 0) & ~(x[1] > 0) | (np.isnan(x[0]) ^ (x[1] < -1))
    return (both * x[0] + (x[1] != 0), np.where(both, x[1], w[0]))


def by_table(x, t, w, p):
    return (take(LEVELS, np.abs(x[0]).astype(int)), np.interp(x[1], [-1, 0, 1], [2, 0, 5]))


def by_table_of_two_dimensions(x, t, w, p):
    row = take(TWO_LEVELS, (x[0] > 0).astype(int), axis=0)
    return (row[0] + row[2], x[1] + w[0])


def by_densities(x, t, w, p):
    y = 1.0 + x[0] ** 2
    return (gamma_logpdf(y, 2.0, 3.0) + x[1], poisson_draw(0.5 + 0.1 * np.tanh(w[0]), y))


WRITTEN = {
    by_dictionary: T_NUMBER, by_branch_on_t: T_NUMBER,
    by_neighbour: T_NUMBER, by_branch_on_parameter: NUMBERS, by_generator: SYMBOLS,
    by_matrix: SYMBOLS, by_functions: SYMBOLS, by_powers: SYMBOLS, by_masks: SYMBOLS,
    by_stack: SYMBOLS, by_table: SYMBOLS, by_table_of_two_dimensions: SYMBOLS,
    by_densities: SYMBOLS,
}  # fmt: skip


@in_turn("function", WRITTEN)
def test_a_formula_may_be_written_so(function):
    """The program has the values of the formula on arrays, with as many symbols as possible."""
    assert traced(function)[0].mode == WRITTEN[function]
    for t in (1, 3, 5):
        got, expected = values(function, t)
        np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_small_matrices_are_elementwise_in_particles():
    """NumPy would sum over arrays of particles, too; a traced formula has one particle."""
    x, w = (np.array([1.0, 2.0]), np.array([3.0, -1.0])), (np.array([0.5, 0.25]),)
    result, given = traced(by_stack)
    first, second = result.values({"x": x, "w": w}, 1, given)
    np.testing.assert_allclose(first, MATRIX[0, 0] * x[0] + MATRIX[0, 1] * x[1])
    np.testing.assert_allclose(second, MATRIX[1, 0] * x[0] + MATRIX[1, 1] * x[1] + w[0])
    result, given = traced(by_table_of_two_dimensions)
    first, _ = result.values({"x": x, "w": w}, 1, given)
    np.testing.assert_allclose(first, 4.0 + 6.0)


def test_an_index_outside_a_table_gives_nan():
    result, given = traced(by_table)
    inside = np.array([0.2, 3.9, 4.0, -0.5, -5.2, np.nan, np.inf])
    x = np.where(inside < 0, inside - 10, inside), np.zeros(7)
    got, _ = result.values({"x": x, "w": (np.zeros(7),)}, 1, given)
    np.testing.assert_array_equal(got, [3.0, 1.5] + [np.nan] * 5)


def test_a_jitted_helper_is_given_as_its_python_function():
    """Numba compiles without checks of indices, and takes no symbols."""

    def model(function):
        return dataclasses.replace(
            load_model("random_walk"), transition=lambda x, t, w, p: (function(x[0], w[0]),)
        )

    with pytest.raises(ModelError, match=r"write f\.py_func instead of f \(.*test_tracing\.py:"):
        recorded(model(helper), range(3))
    result, _ = traced(model(helper.py_func).transition, x=1, t=0, w=1, p=0)
    (got,) = result.values({"x": (np.array([2.0]),), "w": (np.array([3.0]),)}, 0, {})
    np.testing.assert_allclose(got, 6.0 + math.exp(0.5))


def test_programs_of_instants_with_the_same_operations_are_one():
    result, _ = traced(by_dictionary)
    (program,) = result.programs
    np.testing.assert_array_equal(result.row, np.arange(8))
    varying = (program.constants != program.constants[0]).any(axis=0)
    np.testing.assert_allclose(program.constants[:, varying].ravel(), [*TABLE.values()])
    two, _ = traced(by_branch_on_t)
    np.testing.assert_array_equal(two.which, [0, 1, 1, 0, 1, 1, 0, 1])


def at_meals(x, t, w, p):
    meal = np.exp(-p.sd) if p.rate[t] in (RATE[2], RATE[5]) else 0.0
    return (x[0] * np.exp(-p.rate[t]) + meal * sum(0.5 for _ in range(1, int(2 * p.sd))),)


@functools.cache
def of_a_number(rate):
    return math.exp(-rate)


def by_cache(x, t, w, p):
    return (x[0] * of_a_number(p.sd) + (1.0 if t in (3, 7) else 0.0),)


def test_a_cache_of_the_user_gets_numbers():
    for _ in range(2):  # the cache has kept no symbol
        of_instants, _ = traced(by_cache)
        (found,) = of_instants.values({"x": (1.0, 0.0), "w": (0.0,)}, 3, {"sd": 2.0, "rate": RATE})
        np.testing.assert_allclose(found, math.exp(-2.0) + 1.0)


def test_a_branch_on_parameters_leaves_their_functions_to_the_program():
    """No constant is computed by NumPy, whose last bit depends on the processor."""
    of_instants, _ = traced(at_meals)
    assert (of_instants.mode, len(of_instants.programs)) == (NUMBERS, 2)
    assert of_instants.read == {"sd": 2.0, "rate": RATE}
    for program in of_instants.programs:
        assert {*program.constants.ravel()} <= {0.0, 1.5, *range(8)}
        assert "exp" in {each.name for each in program.operations}
    x = np.array([0.3, -1.2])
    for t in range(8):
        found = of_instants.values({"x": (x, x), "w": (x,)}, t, {"sd": 2.0, "rate": RATE})
        meal = 1.5 * np.exp(-2.0) * (t in (2, 5))
        np.testing.assert_allclose(*found, x * np.exp(-RATE[t]) + meal, rtol=1e-15)


def test_merging_changes_no_value_and_keeps_different_columns_apart():
    """a[t] x + b[t] x has one structure also where a[t] = b[t]."""
    operations = (
        Operation("x", (), 0), Operation("constant", (), 0), Operation("constant", (), 1),
        Operation("multiply", (0, 1)), Operation("multiply", (0, 2)), Operation("add", (3, 4)),
        Operation("sin", (0,)),
    )  # fmt: skip
    same = merged(Program(operations, (5,), np.array([[1.0, 1.0], [2.0, 2.0]])))
    apart = merged(Program(operations, (5,), np.array([[1.0, 1.0], [2.0, 3.0]])))
    assert [len(each.operations) for each in (same, apart)] == [4, 6]  # without the sine
    for program, expected in ((same, 4.0 * 5), (apart, 5.0 * 5)):
        assert evaluate_program(program, {"x": [5.0]}, 1, {}, 1) == (expected,)


# --- what is refused ------------------------------------------------------------------------------

STATE = {"calls": 0}


def counts_calls(x, t, w, p):
    STATE["calls"] += 1
    return (x[0] + STATE["calls"], x[1])


def is_random(x, t, w, p):
    return (x[0] + random.random(), x[1])


def takes_minimum(x, t, w, p):
    return (min(x[0], x[1]), x[1])


def indexes(x, t, w, p):
    return (LEVELS[x[0].astype(int)], x[1])


def loops(x, t, w, p):
    while x[0] < 1:
        x = (2 * x[0], x[1])
    return x


def assigns(x, t, w, p):
    state = np.zeros(2)
    state[0] = x[0]
    return state


def rounds(x, t, w, p):
    return (round(x[0]), x[1])


def divides_by_zero(x, t, w, p):
    return (x[0] * TABLE[t], x[1] / (t - 3) + 1 / (t - 3))


def never_ends(x, t, w, p):
    a = x[0]
    while True:
        a = a + 1.0


def sums_one_component(x, t, w, p):
    return (np.sum(x[0]) + w[0], x[1])


def takes_bits(x, t, w, p):
    return (x[0] + (w[0].astype(int) & 1), x[1])


def looks_at_types(x, t, w, p):
    return (x[0] + (0.0 if isinstance(x[0], float) else 1.0), x[1])


def looks_up(x, t, w, p):
    return (TABLE[x[0]], x[1])


def gives_text(x, t, w, p):
    return ("x", x[1])


def adds_conditions(x, t, w, p):
    return (x[0] + ((x[0] > 0) + (w[0] > 0)), x[1])


def takes_bytes(x, t, w, p):
    return ((x[0] * 100).astype(np.uint8) + w[0], x[1])


def calls_a_density_of_scipy(x, t, w, p):
    return (stats.norm.logpdf(x[0], x[1], 0.5), x[1])


def calls_an_array_of_scipy(x, t, w, p):
    return (stats.multivariate_normal.logpdf(x, x, 0.25), x[1])


class Tank:
    """A simulator, which a formula cannot be."""

    def __init__(self):
        self.rng = np.random.default_rng(1)

    def solves(self, x, t, w, p):
        solved = solve_ivp(lambda _, level: -level, (0.0, 1.0), [x[0]])
        return (solved.y[0, -1] + w[0], x[1])

    def draws(self, x, t, w, p):
        return (self.rng.normal(x[0], 1.0), x[1])


SIMULATED = "declare functions of arrays as a pfdist.BatchedModel, see docs/simulators.md"
REFUSED = {
    calls_a_density_of_scipy: "logpdf of scipy takes numbers, and not values of particles: write "
    "pfdist.densities.normal_logpdf",
    calls_an_array_of_scipy: f"logpdf of scipy takes numbers, and not values of particles: "
    f"{SIMULATED}",
    Tank().solves: f"write pfdist.ode, or {SIMULATED}",
    Tank().draws: f"write x[0] + p.sd * w[0], or {SIMULATED}",
    looks_up: "take(table, value.astype(int))",
    gives_text: "must give numbers, got str",
    adds_conditions: "add of two conditions: write a.astype(int)",
    takes_bytes: "astype(uint8)",
    takes_bits: "write n % 2 and n // 2 for bits",
    looks_at_types: "it computes something else with numbers than with symbols",
    sums_one_component: "np.sum of a single value",
    counts_calls: "must compute the same whenever it is called",
    is_random: "noise from w is a pfdist.BatchedModel, see docs/simulators.md",
    takes_minimum: "np.minimum",
    indexes: "it is take(table, value.astype(int))",
    loops: "pfdist.where(condition, a, b)",
    assigns: "np.array([a, b])",
    rounds: "np.round",
    never_ends: "at most 50,000 operations",
}


@pytest.mark.parametrize("function", REFUSED)
def test_what_cannot_be_traced_is_named_with_its_line(function):
    with pytest.raises(TraceError) as caught:
        traced(function)
    message = str(caught.value)
    assert REFUSED[function] in message
    assert message.startswith("model mine: transition ")
    assert "\n" not in message
    if function not in (counts_calls, is_random, gives_text, looks_at_types):
        first = function.__code__.co_firstlineno
        assert any(f"test_tracing.py:{first + k})" in message for k in (1, 2, 3))
        assert "pfdist.BatchedModel" in message


def test_a_formula_that_fails_with_numbers_fails_in_numpy_too():
    with pytest.raises(ModelError, match=r"failed: ZeroDivisionError.* at t = 3 \(.*py:\d+\)$"):
        traced(divides_by_zero)


def divides_by_symbol(x, t, w, p):
    return (x[0] + 1 / (t - 3), w[0])


def divides_particles(x, t, w, p):
    return (x[0] / (p.rate[t] - p.rate[3]), w[0] / (t - 3))


def test_a_division_by_zero_at_one_instant_fails_only_if_it_fails_in_python():
    with pytest.raises(ModelError, match=r"failed: ZeroDivisionError.* at t = 3 \(.*py:\d+\)$"):
        traced(divides_by_symbol)
    assert traced(divides_by_symbol, range(3))[0].mode == SYMBOLS
    assert traced(divides_particles)[0].mode == SYMBOLS  # arrays of NumPy become infinite


def test_bits_of_t_are_those_of_a_number():
    """Also where the first, the middle and the last instant do not show the difference."""
    result, _ = traced(lambda x, t, w, p: (x[0] + (t & 1), w[0]), range(14))
    assert result.mode == T_NUMBER
    at = [result.values({"x": [0.0, 0.0], "w": [0.0]}, t, {})[0] for t in range(14)]
    assert at == [t & 1 for t in range(14)]


def test_an_index_that_arrays_of_particles_have_is_one_of_a_batched_model():
    def indexes_arrays(x, t, w, p):
        return (np.stack(x)[0, :],)

    with pytest.raises(TraceError, match=r"too many indices.*BatchedModel"):
        dataclasses.replace(load_model("ungm"), transition=indexes_arrays)


def test_a_value_kept_from_another_call_is_an_error():
    kept = []

    def keeps(x, t, w, p):
        kept.append(x[0])
        return (kept[0] + w[0], x[1])

    with pytest.raises(TraceError, match="kept from another call"):
        traced(keeps)


def test_too_many_structures_are_refused():
    def differs(x, t, w, p):
        return (sum([x[0]] * (t + 1)), x[1])

    assert len(traced(differs, range(32))[0].programs) == 32
    with pytest.raises(TraceError, match="at most 32 different things"):
        traced(differs, range(33))


def test_too_many_constants_are_refused(monkeypatch):
    monkeypatch.setattr(tracing, "MOST_CONSTANTS", 100)
    doses = dict.fromkeys(range(200), 1.5)

    def takes(x, t, w, p):
        return (x[0] + doses[t], w[0])

    assert traced(takes, range(50))[0].mode == T_NUMBER
    with pytest.raises(TraceError, match="at most 100 constants over all instants"):
        traced(takes, range(150))


def test_tracing_that_takes_long_is_told_in_a_terminal(monkeypatch, capsys):
    """A line every two seconds; here at each of 8 instants."""

    def takes(x, t, w, p):
        return (x[0] + dict.fromkeys(range(8), 2.0)[t], w[0])

    monkeypatch.setattr(telling, "SECONDS", 0.0)
    traced(takes)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    traced(takes)
    assert "Tracing transition of mine: 7 of 8 instants\n" in capsys.readouterr().err


def test_tracing_keeps_up_with_long_horizons():
    """8,000 instants of a formula that needs t as a number have one structure."""
    doses = {t: float(t % 7) for t in range(8000)}
    result, _ = traced(lambda x, t, w, p: (x[0] + doses[t], w[0]), range(8000))
    assert [each.constants.shape for each in result.programs] == [(8000, 1)]
