"""NumPy's functions that choose: in a compiled formula the same figures, and no array is made."""

import math

import numpy as np
import pytest
from numba import njit
from numpy import where as numpy_where

from pfdist.kernels.formulas import formula

GRID = np.array([-2.0, -1.0, -0.5, 0.0, 1.0, 1.0, 4.0])
VALUES = np.array([3.0, -1.0, math.inf, math.inf, 2.0, 5.0, 7.0])
WHOLE = np.array([1, 4, 9])
ONE = np.array([2.5])
POINTS = [*GRID.tolist(), -3.0, -0.75, -0.25, 0.3, 3.9, 5.0, -math.inf, math.inf, math.nan, -0.0]


CHOICES = {
    "where": lambda x: np.where(x > 0, x, 0.5),
    "where of integers": lambda x: np.where(x > 0, 1, 2),
    "from numpy import where": lambda x: numpy_where(x > 0, 1, x),
    "where with &": lambda x: np.where((x > 0) & (x < 2), x, -x),
    "clip": lambda x: np.clip(x, -1, 0.5),
    "clip above": lambda x: np.clip(x, None, 0.5),
    "clip below": lambda x: np.clip(x, a_min=-1.0, a_max=None),
    "heaviside": lambda x: np.heaviside(x, 0.5),
    "interp": lambda x: np.interp(x, GRID, VALUES),
    "interp with ends": lambda x: np.interp(x, GRID, VALUES, -9.0, 9.0),
    "interp with an end": lambda x: np.interp(x, GRID, VALUES, right=0),
    "interp of integers": lambda x: np.interp(x, WHOLE, WHOLE),
    "interp at one point": lambda x: np.interp(x, ONE, ONE),
    "select of lists": lambda x: np.select([x > 1, x > 0], [x, 2.0], -1.0),
    "select of tuples": lambda x: np.select((x > 1, x > 0), (x, 2 * x)),
}
choices = pytest.mark.parametrize("function", CHOICES.values(), ids=CHOICES)


@choices
def test_a_choice_is_numpys_bit_for_bit(function):
    compiled = formula(function)
    for x in POINTS:
        with np.errstate(all="ignore"):
            expected = float(function(x))
        np.testing.assert_equal(float(compiled(x)), expected, err_msg=str(x))


def test_interpolation_is_numpys_on_any_increasing_grid():
    rng = np.random.default_rng(0)

    for size in (1, 2, 3, 8, 50):
        grid, heights = np.sort(rng.normal(size=size)), rng.normal(size=size)
        compiled = formula(lambda x, xp, fp: np.interp(x, xp, fp))  # noqa: PLW0108
        x = np.concatenate([grid, rng.normal(size=200)])
        found = [compiled(value, grid, heights) for value in x.tolist()]
        np.testing.assert_array_equal(found, np.interp(x, grid, heights))


def test_a_table_of_another_length_is_an_error_and_no_figure():
    compiled = formula(lambda x: np.interp(x, GRID, ONE), "transition")
    with pytest.raises(ValueError, match=r"np\.interp needs as many fp as xp"):
        compiled(0.3)


@choices
def test_a_choice_makes_no_array(function):
    compiled = formula(function)

    @njit
    def kernel(x):
        total = 0.0
        for i in range(x.size):
            total += compiled(x[i])
        return total

    kernel(np.ones(3))
    (code,) = kernel.inspect_llvm().values()
    assert "NRT_MemInfo_alloc" not in code.split("define linkonce_odr")[0]


def test_arrays_are_chosen_from_as_in_numpy():
    arrays = np.array([-1.0, 0.0, 2.0])
    compiled = formula(lambda x: np.clip(np.where(x > 0, x, -x), 0.5, 1.5).sum())
    assert compiled(arrays) == 3.0
