"""Elementwise functions for a model's formulas, for scalars in compiled code and for arrays.

A formula runs in two ways: on scalars, for each particle, in the compiled filter, and on whole
NumPy arrays in the plain filter. `numpy.where` makes an array even of scalars, which costs 140 ns
for each particle in compiled code. `numpy.clip` does not compile on scalars. The functions `where`
and `clip` work in both ways.
"""

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """The first value where the condition holds, and the second elsewhere.

    Parameters
    ----------
    condition : bool or array of bool
    if_true, if_false : float or array
        Both are evaluated, whether the condition holds or not.

    Returns
    -------
    float or array

    Examples
    --------
    >>> import numpy as np
    >>> where(np.array([True, False]), 1.0, 2.0)
    array([1., 2.])
    """
    return np.where(condition, if_true, if_false)


def clip(x: Any, low: Any, high: Any) -> Any:
    """The value limited elementwise to the interval from low to high.

    Parameters
    ----------
    x : float or array
    low, high : float or array

    Returns
    -------
    float or array

    Examples
    --------
    >>> import numpy as np
    >>> clip(np.array([-1.0, 0.5, 3.0]), 0.0, 1.0)
    array([0. , 0.5, 1. ])
    """
    return np.minimum(np.maximum(x, low), high)


# These functions have no type hints, because Numba compares their signatures with those of the
# functions that they give.


@overload(where, jit_options={"forceinline": True})
def _where_compiled(condition, if_true, if_false):
    if any(isinstance(kind, types.Array) for kind in (condition, if_true, if_false)):
        return lambda condition, if_true, if_false: np.where(condition, if_true, if_false)  # noqa: PLW0108
    return lambda condition, if_true, if_false: if_true if condition else if_false


@overload(clip, jit_options={"forceinline": True})
def _clip_compiled(x, low, high):
    return lambda x, low, high: np.minimum(np.maximum(x, low), high)
