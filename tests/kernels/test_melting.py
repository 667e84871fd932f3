"""Functions that are only inlined: they become no machine code, unless Python's memory is used."""

from collections.abc import Callable

import pytest
from numba import njit

from pfdist.kernels.melting import melted


def _twice(x):
    return x + x


def _printing(x):
    print((x, x))  # noqa: T201
    return x + x


def _raising(x):
    if x > 0.0:
        raise ValueError("too large:", x)
    return x + x


def _calling(function: Callable[..., float]) -> Callable[..., float]:
    """A compiled function that calls a function which is inlined into it."""
    inner = melted(function)
    return njit(lambda x: inner(x))  # noqa: PLW0108  Numba compiles a function of Python


def _is_translated(function: Callable[..., float]) -> bool:
    """Whether a function, which was inlined into another, was translated to machine code itself."""
    inner = melted(function)
    njit(lambda x: inner(x))(-2.5)  # noqa: PLW0108
    (result,) = inner._melting.overloads.values()
    return bool(result.library._translated)


def test_a_function_that_is_only_inlined_becomes_no_machine_code() -> None:
    assert _calling(_twice)(2.5) == 5.0
    assert not _is_translated(_twice)
    assert _is_translated(_printing)


def test_a_function_that_is_inlined_may_print(capfd: pytest.CaptureFixture[str]) -> None:
    assert _calling(_printing)(2.5) == 5.0
    assert capfd.readouterr().out == "(2.5, 2.5)\n"


def test_a_function_that_is_inlined_may_raise_an_error_with_a_value() -> None:
    with pytest.raises(ValueError, match=r"too large:.*2\.5"):
        _calling(_raising)(2.5)
