"""A number is given with the digits that its error allows: two of the error's."""

import math
import re

from hypothesis import given, settings
from hypothesis import strategies as st

from oracles.in_turn import in_turn
from pfdist.common.rounding import rounded, with_error, with_interval

LARGE_AND_SMALL = st.floats(-300, 300).map(lambda exponent: 10.0**exponent)
exactly = settings(max_examples=100)


def _read(text: str) -> tuple[float, float]:
    """The value and the error that a text gives."""
    mantissas = re.fullmatch(r"\((.*) ± (.*)\)e(.*)", text)
    if mantissas is None:
        value, error = text.split(" ± ")
        return float(value), float(error)
    value, error, exponent = mantissas.groups()
    return float(f"{value}e{exponent}"), float(f"{error}e{exponent}")


@in_turn(
    ("value", "error", "text"),
    [
        (22.7345, 0.0304, "22.735 ± 0.030"),
        (0.0001, 0.000003, "0.0001000 ± 0.0000030"),  # was 0.0001 ± 0.0000
        (1.234e108, 4e107, "(1.23 ± 0.40)e+108"),  # was 108 digits
        (1e-9, 3e-11, "(1.000 ± 0.030)e-09"),
        (1234.5, 249.0, "1230 ± 250"),
        (9.96, 0.0996, "9.96 ± 0.10"),  # rounded, the error has another first digit
        (-0.0001, 0.05, "0.000 ± 0.050"),
        (0.0, 0.5, "0.00 ± 0.50"),
        (22.7345678, 0.0, "22.735"),  # exact
        (math.inf, math.inf, "infinite"),
        (math.nan, 1.0, "unknown"),
        (None, None, "unknown"),
        (5.0, math.inf, "5.0000 ± infinite"),
        (5e-324, 5e-324, "(4.9 ± 4.9)e-324"),
        (9.99e-9, 1e-9, "(1.00 ± 0.10)e-08"),  # the exponent is that of the rounded value
        (9.99e9, 1e9, "(1.00 ± 0.10)e+10"),
        (1e-320, 1e-321, "(1.00 ± 0.10)e-320"),  # a double of few digits
        (0.0, 1e-9, "(0.0 ± 1.0)e-09"),
    ],
)
def test_a_value_has_the_places_of_two_digits_of_its_error(
    value: float | None, error: float | None, text: str
) -> None:
    assert with_error(value, error) == text


@exactly
@given(LARGE_AND_SMALL, st.floats(-9, 9).map(lambda exponent: 10.0**exponent), st.booleans())
def test_rounding_moves_neither_by_more_than_half_of_the_errors_second_digit(
    error: float, ratio: float, negative: bool
) -> None:
    value = math.copysign(error * ratio, -negative)
    text = with_error(value, error)
    value_told, error_told = _read(text)
    half_place = 0.05 * error_told * (1 + 1e-9)  # two digits: one place is 1 to 10 % of the error
    assert abs(error_told - error) <= half_place
    assert abs(value_told - value) <= half_place + 1e-12 * abs(value)
    assert len(text) < 40


@in_turn(
    ("value", "low", "high", "texts"),
    [
        (17.632, 16.21, 19.04, ("17.6", "16.2", "19.0")),
        (25.771, 25.62, 25.91, ("25.77", "25.62", "25.91")),
        (-3.7, -5.14, -2.2, ("-3.7", "-5.1", "-2.2")),
        (0.25, 0.25, 0.25, ("0.25000", "0.25000", "0.25000")),
        (14.7351, None, None, ("14.7", "unknown", "unknown")),
        (-8e108, -9e108, -7e108, ("-8.0e+108", "-9.0e+108", "-7.0e+108")),
        (1e-9, 0.0, 2e-9, ("1.0e-09", "0", "2.0e-09")),
        (1e-9, 1e-12, 2e-9, ("1.0e-09", "0", "2.0e-09")),
        (9.99e-9, 8.9e-9, 1.1e-8, ("1.00e-08", "8.9e-09", "1.10e-08")),
    ],
)
def test_an_interval_has_the_places_of_two_digits_of_its_half_width(
    value: float, low: float | None, high: float | None, texts: tuple[str, ...]
) -> None:
    assert with_interval(value, low, high) == texts


def test_a_number_without_an_error_has_five_digits() -> None:
    numbers = (31.2, 0.0, 1e-9, 1e108, -0.00012345, math.inf, -math.inf)
    assert [rounded(number) for number in numbers] == [
        "31.200", "0", "1.0000e-09", "1.0000e+108", "-0.00012345", "infinite", "-infinite",
    ]  # fmt: skip
    assert rounded(123.4, 2) == "120"
