"""An author's compiled functions check what they do, however a formula reaches them."""

# ruff: noqa: PLW0108  a lambda names what it calls, which is what is tested

import functools
import math
import types

import numpy as np
import pytest
from numba import guvectorize, njit, vectorize
from numba.extending import overload

from pfdist.errors import CompileError, ModelError
from pfdist.jitted import guard_what_it_calls
from pfdist.kernels.formulas import formula, formulas_of

TABLE = np.array([1.0, 2.0, 3.0])


def python_look_up(k):
    return TABLE[k]


def compiled():
    """A compiled function that nobody has seen yet."""
    return njit(python_look_up)


def of_module(function):
    module = types.ModuleType("helper_of_a_test")
    module.look_up = function
    return lambda t: module.look_up(t)


def of_tuple(function):
    functions = (function,)
    return lambda t: functions[0](t)


def of_default(function):
    def helper(k, look_up=function):
        return look_up(k)

    return lambda t: helper(t)


def of_lambda(function):
    apply = njit(lambda inner, k: inner(k))
    return lambda t: apply(lambda k: TABLE[k], t)


def of_dictionary(function):
    functions = {"look_up": function}
    return lambda t: functions["look_up"](t)


def of_partial(function):
    partial = functools.partial(function)
    return lambda t: partial(t)


def of_class(function):
    class Tables:
        look_up = function

    return lambda t: Tables.look_up(t)


def of_instance(function):
    table = types.SimpleNamespace(look_up=function)
    return lambda t: table.look_up(t)


def of_slots(function):
    class Tables:
        __slots__ = ("look_up",)

    table = Tables()
    table.look_up = function
    return lambda t: table.look_up(t)


def of_another(function):
    helper = njit(lambda k: function(k))
    return lambda t: helper(t)


def itself(function):
    return lambda t: function(t)


REACHED = (
    itself, of_module, of_tuple, of_default, of_dictionary, of_partial, of_class, of_instance,
    of_slots, of_another,
)  # fmt: skip
IN_MACHINE_CODE = (itself, of_module, of_tuple, of_default, of_lambda, of_another)
KINDS = {
    "njit": lambda: njit(python_look_up),
    "njit of fixed types": lambda: njit("float64(int64)")(python_look_up),
    "parallel": lambda: njit(python_look_up, parallel=True),
    "vectorize": lambda: vectorize(python_look_up),
    "vectorize of fixed types": lambda: vectorize(["float64(int64)"])(python_look_up),
}


def gathered(values, k, out):
    out[0] = values[k[0]]


@pytest.mark.filterwarnings("ignore:First-class function:numba.NumbaExperimentalFeatureWarning")
@pytest.mark.parametrize("reaching", IN_MACHINE_CODE)
def test_machine_code_reads_no_memory_that_is_not_its_own(reaching):
    transition = reaching(compiled())
    guard_what_it_calls(transition)
    called = formula(transition, "transition")
    assert called(2) == 3.0
    with (
        pytest.raises(ModelError, match=r"transition failed: IndexError: .* at t = 3 \(.*:\d+\)$"),
        formulas_of("mine", {"transition": transition}),
    ):
        called(3)


@pytest.mark.parametrize("reaching", REACHED)
def test_python_reads_no_memory_that_is_not_its_own(reaching):
    transition = reaching(compiled())
    guard_what_it_calls(transition)
    assert transition(2) == 3.0
    with pytest.raises(IndexError):
        transition(3)


@pytest.mark.filterwarnings("ignore:The keyword argument 'parallel=True':Warning")
@pytest.mark.parametrize("kind", KINDS)
def test_whatever_compiled_it(kind):
    function = KINDS[kind]()
    if "vectorize" in kind:
        function(1)  # compiled before anybody guards it
    transition = itself(function)
    guard_what_it_calls(transition)
    called = formula(transition, "transition")
    for call in (called, transition):
        assert call(2) == 3.0
        with (
            pytest.raises(ModelError, match=r"IndexError: .*out of bounds.* at t = 3"),
            formulas_of("mine", {"transition": transition}),
        ):
            call(3)


def test_integers_are_checked_where_python_calls_compiled_code():
    power = njit(lambda k: 10**k)
    guard_what_it_calls(lambda t: power(t))
    assert power(18) == 10**18
    with pytest.raises(OverflowError):
        power(19)


def test_a_general_function_is_checked_in_numpy_and_not_compiled():
    gather = guvectorize(["void(float64[:], int64[:], float64[:])"], "(n),(m)->(m)")(gathered)

    def transition(t):
        out = np.zeros(1)
        gather(TABLE, np.array([t]), out)
        return out[0]

    guard_what_it_calls(transition)
    assert transition(2) == 3.0
    with pytest.raises(IndexError):
        transition(3)
    with pytest.raises(CompileError, match="gathered"), formulas_of("mine", {}):
        formula(transition)(2)


@pytest.mark.parametrize("reaching", [of_class, of_dictionary, of_partial])
def test_what_machine_code_cannot_reach_is_not_compiled(reaching):
    with pytest.raises(CompileError), formulas_of("mine", {}):
        formula(reaching(compiled()))(2)


def test_a_vectorized_function_of_an_array_is_not_compiled():
    look_up = vectorize(python_look_up)
    places = np.array([0, 1])
    transition = lambda t: look_up(places + t).sum()  # noqa: E731
    guard_what_it_calls(transition)
    with pytest.raises(CompileError, match="call it with numbers"), formulas_of("mine", {}):
        formula(transition)(0)


@overload(math.perm)
def _permutations(value):
    return lambda value: TABLE[value]


def test_an_extension_of_numba_that_the_author_wrote_is_refused():
    with pytest.raises(CompileError, match="extension of Numba"), formulas_of("mine", {}):
        formula(lambda t: math.perm(t))(1)
