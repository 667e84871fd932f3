"""The fingerprints of functions in the cache on disk: two that differ are never taken for one."""

import functools
import math
from collections import namedtuple
from types import ModuleType

import numpy as np
import pytest
from numba import njit, vectorize

from pfdist.kernels.fingerprint import UnknownContentError, fingerprint


def made(source, module="mine", **scope):
    """The function f of some source, which sees these names and NumPy."""
    scope = {"np": np, "__name__": module, **scope}
    exec(source, scope)
    return scope["f"]


def module_of(name="other", **attributes):
    module = ModuleType(name)
    module.__dict__.update(attributes)
    return module


ONE, OTHER = made("def f(x): return 2.0 * x"), made("def f(x): return 3.0 * x")
USE = made("def f(m): return m.C")


@pytest.mark.parametrize(
    ("first", "other"),
    [
        ("def f(x): return 2 * x", "def f(x): return 2 + x"),
        ("def f(x): return 2.0 * x", "def f(x): return 3.0 * x"),
        ("def f(x): return 2.0 * x", "def f(x): return 2 * x"),
        ("def f(x): return 0.0 * x", "def f(x): return -0.0 * x"),
        ("def f(x, k=2.0): return k * x", "def f(x, k=3.0): return k * x"),
        ("def f(x, *, k=2.0): return k * x", "def f(x, *, k=3.0): return k * x"),
        ("def f(x): return np.sin(x)", "def f(x): return np.cos(x)"),
        (
            "def f(x):\n def g(y): return 2 * y\n return g(x)",
            "def f(x):\n def g(y): return 3 * y\n return g(x)",
        ),
        (
            "def g(k):\n def f(x): return k * x\n return f\nf = g(2.0)",
            "def g(k):\n def f(x): return k * x\n return f\nf = g(3.0)",
        ),
    ],
    ids=[
        *("an operator", "a constant", "its kind", "its sign", "a default", "a keyword's default"),
        *("an attribute", "a function inside", "a closure's value"),
    ],
)
def test_functions_of_different_source_differ(first, other):
    assert fingerprint(made(first)) != fingerprint(made(other))


@pytest.mark.parametrize(
    ("expression", "first", "other"),
    [
        ("C * x", {"C": 2.0}, {"C": 3.0}),
        ("C * x - D", {"C": 2.0, "D": 1.0}, {"C": 1.0, "D": 2.0}),
        ("(lambda y: C * y)(x)", {"C": 2.0}, {"C": 3.0}),
        ("C[0] * x", {"C": (2.0, 1.0)}, {"C": (3.0, 1.0)}),
        ("C[0] * x", {"C": np.array([2.0])}, {"C": np.array([3.0])}),
        ("C[0] * x", {"C": np.zeros(1)}, {"C": np.zeros(1, np.int64)}),
        ("C.size * x", {"C": np.zeros((2, 3))}, {"C": np.zeros((3, 2))}),
        ("h(x)", {"h": ONE}, {"h": OTHER}),
        (
            "h(x)",
            {"h": made("def f(x): return C * x", C=2.0)},
            {"h": made("def f(x): return C * x", C=3.0)},
        ),
        ("h(x)", {"h": njit(ONE)}, {"h": njit(OTHER)}),
        ("h(x)", {"h": njit(ONE)}, {"h": njit(fastmath=True)(ONE)}),
        ("h(x)", {"h": np.sin}, {"h": np.cos}),
        ("h(x)", {"h": math.sin}, {"h": math.cos}),
        ("h(x)", {"h": np.floor}, {"h": math.floor}),
        ("m.sin(x)", {"m": np}, {"m": math}),
        ("m.C * x", {"m": module_of(C=2.0)}, {"m": module_of(C=3.0)}),
        (
            "m.n.C * x",
            {"m": module_of(n=module_of(C=2.0))},
            {"m": module_of(n=module_of(C=3.0))},
        ),
        ("h(m) * x", *({"m": module_of(C=c), "h": USE} for c in (2.0, 3.0))),
        (
            "C.a * x",
            {"C": namedtuple("C", "a b")(1.0, 2.0)},
            {"C": namedtuple("C", "b a")(1.0, 2.0)},
        ),
        (
            "h(x)",
            {"h": made("def f(x): return 2.0 * x", module="pfdist.models.shipped")},
            {"h": made("def f(x): return 3.0 * x", module="pfdist.models.shipped")},
        ),
    ],
    ids=[
        *("a global", "two globals", "one of a function inside", "a tuple's entry"),
        *("an array's content", "an array's kind", "an array's shape"),
        *("a helper's body", "a helper's global", "a compiled helper", "a compiler's option"),
        *("NumPy's function", "the standard library's", "whose", "whose module"),
        *("a module's attribute", "an inner module's attribute"),
        "an attribute of a module that is passed on",
        *("a named tuple's names", "a function of a model that ships"),
    ],
)
def test_functions_that_see_something_else_differ(expression, first, other):
    source = f"def f(x): return {expression}"
    assert fingerprint(made(source, **first)) != fingerprint(made(source, **other))


def test_what_a_function_does_not_use_makes_no_difference():
    source = "# {}\nk = 1.5\ndef f(x):\n def g(y): return C[0] * y + k\n return g(m.D * x)"
    first, other = (
        made(source.format(i), C=np.array([2.0]), m=module_of(D=1.0, E=i), unused=object())
        for i in range(2)
    )
    assert fingerprint(first) == fingerprint(other)


def test_values_one_by_one_and_together_differ():
    assert len({fingerprint(*v) for v in ([1, 2], [(1, 2)], [12], ["12"], [1, (2,)], [])}) == 6


def test_a_function_that_calls_itself_has_a_fingerprint():
    first, other = (made(f"def f(n): return {k} if n < 1 else n * f(n - 1)") for k in (1.0, 2.0))
    assert fingerprint(first) != fingerprint(other)


def test_functions_that_call_each_other_have_fingerprints():
    source = "def f(n): return n < 1 or g(n - 1)\ndef g(n): return n > {} and f(n - 1)"
    first, again, other = (fingerprint(made(source.format(k))) for k in (1, 1, 2))
    assert first == again != other


def cyclic():
    first, other = module_of("first", C=1.0), module_of("other", D=1.0)
    first.other, other.first = other, first
    return made("def f(x): return first.C * x + other.D", first=first, other=other)


def not_yet_defined():
    def f(x):
        return later(x)

    if False:
        later = None
    return f


@pytest.mark.parametrize(
    "function",
    [
        made("def f(x): return C * x", C=object()),
        made("def f(x): return C['a'] * x", C={"a": 1.0}),
        made("def f(x): return x in {1, 2}"),
        made("def f(x): return C[0] * x", C=np.array([object()])),
        made("def f(x): return C[0].a * x", C=np.zeros(1, [("a", "f8")])),
        made("def f(x): return h(x)", h=vectorize(lambda x: 2 * x)),
        made("def f(x): return h(x)", h=njit("float64(float64)")(made("def f(x): return x"))),
        not_yet_defined(),
    ],
    ids=[
        *(
            "an object",
            "a dict",
            "a set",
            "an array of objects",
            "an array of records",
            "a compiled ufunc",
            "a compiled function of fixed types",
        ),
        "a name not yet defined",
    ],
)
def test_what_cannot_be_told_is_an_error_of_its_own(function):
    with pytest.raises(UnknownContentError):
        fingerprint(function)


def test_modules_that_import_each_other_have_fingerprints():
    assert fingerprint(cyclic()) == fingerprint(cyclic())


def test_a_decorator_that_copies_a_name_hides_nothing():
    def scaled(factor):
        @functools.wraps(math.sin)
        def f(x):
            return factor * x

        return f

    assert fingerprint(scaled(1.0)) != fingerprint(scaled(2.0))
