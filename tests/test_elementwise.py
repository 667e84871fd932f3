import math

import numpy as np
import pytest

from oracles.computed import formula
from oracles.in_turn import in_turn
from pfdist import clip, where

INF, NAN = math.inf, math.nan


compiled_where, compiled_clip = formula(where), formula(clip)


def arrays(arguments):
    return tuple(np.array([argument, argument]) for argument in arguments)


@in_turn("function", [where, compiled_where])
@in_turn(
    ("condition", "if_true", "if_false", "chosen"),
    [
        (True, 1.5, 2.5, 1.5),
        (False, 1.5, 2.5, 2.5),
        (True, 1, 2.5, 1.0),  # an integer among floats is a float
        (False, 1, 2.5, 2.5),
        (True, 1.5, NAN, 1.5),  # what is not chosen does not spread
        (False, INF, 0.0, 0.0),
    ],
)
def test_where_chooses_alike_on_scalars_and_arrays(function, condition, if_true, if_false, chosen):
    arguments = (condition, if_true, if_false)
    assert function(*arguments) == chosen
    assert function(*arrays(arguments)).tolist() == [chosen, chosen]


@in_turn("function", [clip, compiled_clip])
@in_turn(
    ("x", "low", "high", "limited"),
    [
        (-1.0, 0.0, 1.0, 0.0),
        (0.5, 0.0, 1.0, 0.5),
        (3.0, 0.0, 1.0, 1.0),
        (1.0, 0.0, 1.0, 1.0),
        (-7.0, -INF, 1.0, -7.0),
        (INF, 0.0, 1.0, 1.0),
        (NAN, 0.0, 1.0, NAN),  # as np.clip
    ],
)
def test_clip_limits_alike_on_scalars_and_arrays(function, x, low, high, limited):
    np.testing.assert_equal(float(function(x, low, high)), limited)
    np.testing.assert_equal(function(*arrays((x, low, high))), np.full(2, limited))


@pytest.mark.parametrize("function", [where, compiled_where], ids=["plain", "compiled"])
def test_where_chooses_element_by_element(function):
    condition = np.array([True, False, True])
    assert function(condition, np.arange(3.0), -1.0).tolist() == [0.0, -1.0, 2.0]
    assert function(condition, 5.0, np.arange(3.0)).tolist() == [5.0, 1.0, 5.0]
    assert function(condition, 5.0, -1.0).tolist() == [5.0, -1.0, 5.0]


@pytest.mark.parametrize("function", [clip, compiled_clip], ids=["plain", "compiled"])
def test_clip_limits_element_by_element(function):
    x = np.array([-1.0, 0.5, 3.0])
    assert function(x, 0.0, 1.0).tolist() == [0.0, 0.5, 1.0]
    assert function(x, np.array([0.0, 1.0, 0.0]), 2.0).tolist() == [0.0, 1.0, 2.0]
