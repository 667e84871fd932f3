"""The advice about a function of `math` names what exists in NumPy and compiles."""

import inspect
import math
import re
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

import pfdist
from pfdist.models.mistakes import remedy

A = np.array([0.25, 0.5, 0.75])
WHOLE = np.array([2.0, 4.0, 9.0])
OF_TWO = {"atan2", "copysign", "fmod", "isclose", "nextafter", "pow"}
OF_WHOLE_NUMBERS = {"comb", "factorial", "gcd", "isqrt", "lcm", "perm"}
RIGHT = {"prod", "sumprod"}  # they take tuples of arrays as they are
LOG = "pfdist.densities.lgamma"
# A call, what the advice names for it, and what this is as an expression.
CALLS = {
    "comb": ("comb(a, b)", f"np.rint(np.exp({LOG}(a + 1) - {LOG}(b + 1) - {LOG}(a - b + 1)))"),
    "dist": ("dist((a, b), (c, b))", "np.hypot(a - c, b - d)"),
    "erf": ("erf(a)", "pfdist.densities.erf(a)"),
    "erfc": ("erfc(a)", "pfdist.densities.erfc(a)"),
    "factorial": ("factorial(a)", f"np.rint(np.exp({LOG}(a + 1)))"),
    "fma": ("fma(a, b, c)", "a * b + c"),
    "frexp": ("frexp(a)[1]", "np.floor(np.log2(np.abs(a))) + 1"),
    "fsum": ("fsum((a, b))", "a + b"),
    "gamma": ("gamma(a)", f"np.exp({LOG}(a))"),
    "gcd": ("gcd(a, b)", "np.gcd(np.int64(a), np.int64(b))"),
    "hypot": ("hypot(a, b, c)", "np.hypot(np.hypot(a, b), c)"),
    "isqrt": ("isqrt(a)", "np.floor(np.sqrt(a))"),
    "lcm": ("lcm(a, b)", "np.lcm(np.int64(a), np.int64(b))"),
    "ldexp": ("ldexp(a, 2)", "np.ldexp"),
    "lgamma": ("lgamma(a)", f"{LOG}(a)"),
    "log": ("log(a, b)", "np.log(a) / np.log(b)"),
    "modf": ("modf(a)[0]", "a - np.trunc(a)"),
    "perm": ("perm(a, b)", f"np.rint(np.exp({LOG}(a + 1) - {LOG}(a - b + 1)))"),
    "remainder": ("remainder(a, b)", "a - b * np.rint(a / b)"),
    "ulp": ("ulp(a)", "np.spacing(np.abs(a))"),
}


def advice_of(source: str, folder: Path) -> str:
    """Give the remedy of a formula of one line that fails on arrays."""
    (folder / "mine.py").write_text(
        "import math as m\nimport math\nfrom math import lgamma\n\n"
        f"def call(a, b, c, d):\n    return math.sqrt(2 * math.pi) * {source}\n"
    )
    with pytest.raises(TypeError) as raised:
        run_path(str(folder / "mine.py"))["call"](A, A, A, A)
    return remedy(raised.value)


@pytest.mark.parametrize(
    "name", sorted({name for name, each in vars(math).items() if inspect.isbuiltin(each)} - RIGHT)
)
def test_what_takes_the_place_of_a_function_of_math_is_the_same_in_both_engines(
    name: str, tmp_path: Path
) -> None:
    arguments = "a, b" if name in OF_TWO else "a"
    call, expression = CALLS.get(name, (f"{name}({arguments})", ""))
    advice = advice_of(f"math.{call}", tmp_path)
    assert f"math.{name}" in advice
    for found in re.findall(r"np\.(\w+)", advice):
        assert hasattr(np, found), advice
    if not expression:
        (expression,) = re.findall(r"write (np\.\w+) in", advice)
    assert expression.removesuffix("(a)") in advice
    if "(" not in expression and " " not in expression:
        expression += call.removeprefix(name)
    a, b, c = (
        (WHOLE, 2 if name in ("comb", "perm") else 6, 1)
        if name in OF_WHOLE_NUMBERS
        else (A, 2.0, 0.5)
    )
    a = 1 + a if name == "acosh" else a
    exact = eval(f"lambda a, b, c: math.{call}", {"math": math})
    expected = [exact(type(b)(each), b, c) for each in a]
    scope = {"np": np, "pfdist": pfdist}
    follow = eval(f"lambda a, b, c, d: {expression}", scope)
    np.testing.assert_allclose(follow(a, b, c, b), expected, rtol=1e-14)


LGAMMA = "write pfdist.densities.lgamma in the place of math.lgamma"


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("int(a)", "write np.int64(a) in the place of int(a)"),
        ("round(a)", "write np.rint(a) in the place of round(a)"),
        ("float(a)", "leave float() out"),
        ("math.acos(a)", "write np.arccos in the place of math.acos"),
        *((call, LGAMMA) for call in ("math.lgamma(a)", "m.lgamma(a)", "abs(lgamma(a))")),
    ],
)
def test_the_call_that_failed_is_found_in_its_line(source: str, says: str, tmp_path: Path) -> None:
    """The line calls `math.sqrt` of a number before."""
    advice = advice_of(source, tmp_path)
    assert advice.startswith(f"; a component may be an array: {says}")
    assert "sqrt" not in advice


@pytest.mark.parametrize(("name", "advice"), [("lgamma", "lgamma"), ("erf", "erf"), ("expit", "")])
def test_a_special_function_that_numpy_lacks_is_answered_by_advice(name: str, advice: str) -> None:
    with pytest.raises(AttributeError) as raised:
        getattr(np, name)
    assert remedy(raised.value) == (advice and f"; write pfdist.densities.{advice}")
