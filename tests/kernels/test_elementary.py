"""Our elementary functions against extended precision, and their special values against NumPy's."""

import math
import platform
import re
from fractions import Fraction
from functools import cache

import llvmlite.binding as llvm
import numpy as np
import pytest
from numba import config, njit

from pfdist.kernels.elementary import LARGEST_ANGLE, ULPS
from pfdist.kernels.formulas import formula
from pfdist.kernels.overloads import ELEMENTARY

EXTENDED = np.longdouble
COUNT = 30_000
SMALLEST, LARGEST = np.finfo(float).smallest_subnormal, np.finfo(float).max
TURNS, PLANAR = ("sin", "cos", "tan"), ("arctan2", "hypot")
functions = pytest.mark.parametrize("name", ELEMENTARY)
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy's, of domain errors


@cache
def loop_of(name, *, own=True):
    """Compile a loop over a formula; of a function of one argument the second goes unused."""
    function = getattr(np, name)
    of_one, of_two = lambda x, y: function(x), lambda x, y: function(x, y)  # noqa: PLW0108  Numba's
    call = (formula if own else njit)(of_one if function.nin == 1 else of_two)

    @njit("(f8[::1], f8[::1], f8[::1])", error_model="numpy")
    def loop(x, y, out):
        for i in range(out.size):
            out[i] = call(x[i], y[i])

    return loop


def ours(name, *arguments):
    x = np.ascontiguousarray(arguments[0], float)
    out = np.empty_like(x)
    loop_of(name)(x, np.ascontiguousarray(arguments[-1], float), out)
    return out


def assert_within_ulps(given, exact):
    nearest = exact.astype(float)
    finite = np.isfinite(nearest)
    np.testing.assert_array_equal(given[~finite], nearest[~finite])
    given, exact, unit = given[finite], exact[finite], np.spacing(np.abs(nearest[finite]))
    assert (np.abs(given.astype(EXTENDED) - exact) <= ULPS * unit).all()


# --- arguments ---

RNG = np.random.default_rng(1)


def uniform(low, high):
    return RNG.uniform(low, high, COUNT)


def magnitudes(low, high):
    """Give numbers of both signs, from 10^low to 10^high."""
    return 10.0 ** uniform(low, high) * RNG.choice([-1, 1], COUNT)


SUBNORMAL = SMALLEST * RNG.integers(1, 2**52, COUNT)
EVERY = magnitudes(-307, 308)
NEAR_ONE = 1 + magnitudes(-16, -0.5)
ANGLES = [magnitudes(-307, 0), uniform(-10, 10), SUBNORMAL]
EXPONENTS = [magnitudes(-307, 0), uniform(-2, 2), uniform(-746, 709.7), SUBNORMAL]
POSITIVE = [np.abs(EVERY), NEAR_ONE, SUBNORMAL]
IN_ONE = [magnitudes(-307, 0), uniform(-1, 1), RNG.choice([-1, 1], COUNT) * (2 - NEAR_ONE.clip(1))]
PLANE = [
    (EVERY, magnitudes(-307, 308)),
    (uniform(-2, 2), uniform(-2, 2)),
    (SUBNORMAL, magnitudes(-323, -300)),
    (magnitudes(-3, 3), np.ones(COUNT)),
]
ARGUMENTS = {
    **dict.fromkeys(TURNS, ANGLES),
    **dict.fromkeys(("exp", "expm1", "sinh", "cosh", "tanh"), EXPONENTS),
    **dict.fromkeys(("log", "log2", "log10"), POSITIVE),
    "log1p": [NEAR_ONE - 1, -np.abs(NEAR_ONE - 1), *POSITIVE, -SUBNORMAL],
    **dict.fromkeys(("arcsin", "arccos"), IN_ONE),
    "arctan": [EVERY, uniform(-3, 3), NEAR_ONE, SUBNORMAL],
}


@pytest.mark.skipif(np.finfo(EXTENDED).nmant < 63, reason="no extended precision to compare with")
@functions
def test_a_function_is_within_its_ulps(name):
    for arguments in PLANE if name in PLANAR else ((x,) for x in ARGUMENTS[name]):
        exact = getattr(np, name)(*(x.astype(EXTENDED) for x in arguments))
        assert_within_ulps(ours(name, *arguments), exact)


def pi_from_integers(bits):
    """2^bits pi, rounded down in its last few bits (Machin: 16 arctan 1/5 - 4 arctan 1/239)."""
    unit = 1 << (bits + 32)

    def arctan_of_inverse(n):
        powers = ((-1) ** k * unit // (n ** (2 * k + 1) * (2 * k + 1)) for k in range(bits))
        return sum(powers)

    return (16 * arctan_of_inverse(5) - 4 * arctan_of_inverse(239)) >> 32


HALF_PI = Fraction(pi_from_integers(300), 2**301)


def reduced(x):
    """The nearest multiple of pi/2, as an integer, and what is left, in extended precision."""
    turns = round(Fraction(x) / HALF_PI)
    rest = Fraction(x) - turns * HALF_PI
    high = float(rest)
    return turns % 4, EXTENDED(high) + EXTENDED(float(rest - Fraction(high)))


@pytest.mark.skipif(np.finfo(EXTENDED).nmant < 63, reason="no extended precision to compare with")
@pytest.mark.parametrize("name", TURNS)
def test_angles_of_many_turns_are_reduced_as_by_exact_arithmetic(name):
    # Also those that are nearest to a multiple of pi/2, where what is left is almost nothing.
    near = [float(k * HALF_PI) for k in RNG.integers(1, 6 * 10**14, 2000).tolist()]
    x = np.concatenate([magnitudes(0, 15)[:4000], near])
    turns, rest = map(np.array, zip(*map(reduced, x.tolist()), strict=True))
    sine, cosine = np.sin(rest), np.cos(rest)
    exact = {
        "sin": np.choose(turns, [sine, cosine, -sine, -cosine]),
        "cos": np.choose(turns, [cosine, -sine, -cosine, sine]),
        "tan": np.where(turns % 2, -cosine / sine, sine / cosine),
    }[name]
    assert_within_ulps(ours(name, x), exact)


@pytest.mark.parametrize("name", TURNS)
def test_an_angle_of_which_no_digit_is_known_gives_nan(name):
    known = np.abs(EVERY) < LARGEST_ANGLE
    assert 0.3 < known.mean() < 0.7
    np.testing.assert_array_equal(np.isnan(ours(name, EVERY)), ~known)


# --- special values ---

SPECIAL = np.array(
    [0.0, 1, 2, 0.5, 709.7, 711, 746, 1e5, 1e15, SMALLEST, 1e-310, LARGEST, np.inf, np.nan]
)
SPECIAL = np.concatenate([SPECIAL, -SPECIAL])
PAIRS = tuple(grid.ravel() for grid in np.meshgrid(SPECIAL, SPECIAL))


@functions
def test_special_values_and_their_signs_are_numpys(name):
    known = ~(np.isfinite(SPECIAL) & (np.abs(SPECIAL) > 1e15))
    arguments = PAIRS if name in PLANAR else (SPECIAL[known] if name in TURNS else SPECIAL,)
    expected, given = getattr(np, name)(*arguments), ours(name, *arguments)
    np.testing.assert_allclose(
        given, expected, rtol=ULPS * np.finfo(float).eps, atol=ULPS * SMALLEST
    )
    zero_or_infinite = (expected == 0) | np.isinf(expected)
    np.testing.assert_array_equal(given[zero_or_infinite], expected[zero_or_infinite])
    number = ~np.isnan(expected) & ~np.isnan(given)
    np.testing.assert_array_equal(np.signbit(given[number]), np.signbit(expected[number]))


def test_the_hypotenuse_of_an_infinite_side_is_infinite_whatever_the_other():
    sides = [np.inf, np.nan, -np.inf, np.nan]
    np.testing.assert_array_equal(ours("hypot", sides, sides[::-1]), np.inf)


# --- how they are compiled ---


@functions
def test_called_from_python_a_function_is_numpys(name):
    arguments = [np.linspace(0.1, 0.9, 7)] * getattr(np, name).nin
    assert ELEMENTARY[name](*arguments).tobytes() == getattr(np, name)(*arguments).tobytes()


@pytest.mark.parametrize("argument", [1, True, np.float32(1), np.int32(1)], ids=repr)
def test_any_real_number_is_taken_as_a_float(argument):
    assert formula(lambda x: np.arctan2(x, 2) + np.exp(x))(argument) == pytest.approx(
        math.atan2(1, 2) + math.e, rel=1e-15
    )


def test_on_an_array_a_compiled_formula_has_numpys_values():
    x = np.linspace(0, 3, 7)
    np.testing.assert_allclose(formula(lambda x: -np.sin(x))(x), -np.sin(x), rtol=1e-15)


VECTORS = (
    platform.machine().lower() in ("x86_64", "amd64")
    and llvm.get_host_cpu_features().get("fma", False)
    and config.CPU_NAME != "generic"  # what Numba compiles for, where the environment names it
)
needs_vectors = pytest.mark.skipif(not VECTORS, reason="reads the instructions of x86-64 with FMA")


def calls_and_vectors(loop):
    """Names of what the loop calls, and its fused multiplications of several numbers at once."""
    (assembly,) = loop.inspect_asm().values()
    named = re.findall(r"movabsq\s+\$(\w+)|call\w*\s+(\w+)", assembly)
    fused = r"\bvfn?m(?:add|sub)\d+pd\b.*%[yz]mm"
    return {name for names in named for name in names}, re.findall(fused, assembly)


@needs_vectors
@functions
def test_a_loop_is_vectorised_and_calls_no_mathematics(name):
    calls, vectors = calls_and_vectors(loop_of(name))
    assert calls.isdisjoint([*dir(math), "fma"])
    assert vectors


@needs_vectors
def test_a_loop_over_numpys_function_is_not():
    calls, vectors = calls_and_vectors(loop_of("sin", own=False))
    assert any("sin" in call for call in calls)
    assert not vectors


@pytest.mark.parametrize("exponent", [-1074, -1023, -1, 0, 1, 3, 52, 1023])
def test_the_binary_logarithm_of_a_power_of_two_is_exact(exponent):
    assert ours("log2", [2.0**exponent])[0] == exponent
