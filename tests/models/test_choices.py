"""NumPy's functions that choose: in a compiled formula the same figures."""

import math

import numpy as np
import pytest
from numpy import where as numpy_where

from oracles.computed import formula, libraries_of
from pfdist.errors import ModelError, TraceError

GRID = np.array([-2.0, -1.0, -0.5, 0.0, 1.0, 1.0, 4.0])
VALUES = np.array([3.0, -1.0, math.inf, math.inf, 2.0, 5.0, 7.0])
WHOLE = np.array([1, 4, 9])
ONE = np.array([2.5])
POINTS = [*GRID.tolist(), -3.0, -0.75, -0.25, 0.3, 3.9, 5.0, -math.inf, math.inf, math.nan, -0.0]


CHOICES = {
    "where": lambda x: np.where(x > 0, x, 0.5),
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
    "select of tuples": lambda x: np.select((x > 1, x > 0), (x, 2 * x)),
}
choices = pytest.mark.parametrize("function", CHOICES.values(), ids=CHOICES)


@choices
def test_a_choice_is_numpys_bit_for_bit(function):
    with np.errstate(all="ignore"):
        expected = [float(function(x)) for x in POINTS]
    np.testing.assert_array_equal(formula(function)(np.array(POINTS)), expected)
    assert not libraries_of(function, 1)


def test_clip_refuses_an_argument_that_would_change_nothing():
    with pytest.raises(TraceError, match=r"np\.clip with the argument dtype"):
        formula(lambda x: np.clip(x, 0.0, 1.0, dtype=np.float32))(0.3)


def test_interpolation_is_numpys_on_any_increasing_grid():
    rng = np.random.default_rng(0)
    for size in (1, 2, 3, 8, 50):
        grid, heights = np.sort(rng.normal(size=size)), rng.normal(size=size)
        x = np.concatenate([grid, rng.normal(size=200)])
        found = formula(lambda x, grid=grid, heights=heights: np.interp(x, grid, heights))(x)
        np.testing.assert_array_equal(found, np.interp(x, grid, heights))


def test_a_table_of_another_length_is_an_error_and_no_figure():
    with pytest.raises(ModelError, match="failed: ValueError: fp and xp are not of the same"):
        formula(lambda x: np.interp(x, GRID, ONE))(0.3)
