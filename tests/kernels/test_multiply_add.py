"""What is fused in a formula follows from its text, and is rounded once."""

import re
from fractions import Fraction

import numpy as np
import pytest
from numba import njit

from pfdist.kernels.arithmetic import LANES, row_sum
from pfdist.kernels.formulas import formula

# The product of 1 + 2^-30 and 1 - 2^-30 is 1 - 2^-60: rounded by itself, it is 1.
A, B = 1 + 2.0**-30, 1 - 2.0**-30
LOST = -(2.0**-60)


def added(a, b, c):
    return a * b + c


def added_before(a, b, c):
    return c + a * b


def subtracted(a, b, c):
    return a * b - (-c)


def subtracted_from(a, b, c):
    return -(-c - a * b)


def added_in_place(a, b, c):
    c += a * b
    return c


@pytest.mark.parametrize(
    "function", [added, added_before, subtracted, subtracted_from, added_in_place]
)
def test_a_sum_with_a_product_is_rounded_once(function):
    assert formula(function)(A, B, -1.0) == LOST
    assert function(A, B, -1.0) == 0.0


def test_a_square_is_a_product():
    exact = Fraction(A) ** 2 - 1
    assert formula(lambda x: x**2 - 1.0)(A) == float(exact)


def test_the_first_of_two_products_is_fused():
    assert formula(lambda a, b: a * b - 1.0 * a * (1.0 / a))(A, B) == LOST


def shared(a, b):
    product = a * b
    return product - 1.0, product


def test_a_product_that_is_used_twice_is_rounded_by_itself():
    assert formula(shared)(A, B) == (0.0, 1.0)


def integers(a, b, c):
    return a * b + c


def test_integers_stay_integers():
    result = formula(integers)(3, 5, 7)
    assert (result, type(result)) == (22, int)


def test_arrays_are_added_as_they_were():
    total = formula(lambda a: np.array([1.0, 2.0]) * a + np.array([1.0, 1.0]))(3.0)
    assert total.tolist() == [4.0, 7.0]


def of_p(x, p):
    return x / p


def of_a_particle(x, y):
    return x / y


def test_a_divisor_that_all_particles_share_becomes_its_reciprocal():
    assert 49.0 * (1 / 49.0) != 1.0
    assert formula(of_p)(49.0, 49.0) == 49.0 * (1 / 49.0)
    assert formula(of_a_particle)(49.0, 49.0) == 1.0
    assert formula(lambda x: x / 49)(49.0) == 49.0 * (1 / 49.0)


@pytest.mark.parametrize("function", [added, of_a_particle, of_p, lambda x, p: x / 3 + p * x])
def test_llvm_is_given_no_liberty(function):
    compiled = formula(function)
    compiled(*(0.5,) * function.__code__.co_argcount)
    (module,) = compiled._standing.inspect_llvm().values()
    assert not re.search(r"\bf(add|sub|mul|div) (fast|reassoc|arcp|contract|afn)\b", module)


@njit
def compiled_sum(values, row):
    return row_sum(values, np.uintp(row))


@pytest.mark.parametrize("blocks", range(1, 11))
def test_a_row_is_added_in_64_partial_sums(blocks):
    rng = np.random.default_rng(blocks)
    values = rng.normal(size=(2, blocks * LANES)) * 10.0 ** rng.integers(-8, 8, blocks * LANES)
    for row in (0, 1):
        assert compiled_sum(values, row) == in_64_partial_sums(values[row])


def in_64_partial_sums(values):
    whole = values.size // 64 * 64
    sums = np.zeros(64)
    for begin in range(0, whole, 64):
        sums += values[begin : begin + 64]
    for begin in range(whole, values.size, LANES):
        sums[:LANES] += values[begin : begin + LANES]
    while sums.size > 1:
        half = sums.size // 2
        sums = sums[:half] + sums[half:]
    return sums[0]
