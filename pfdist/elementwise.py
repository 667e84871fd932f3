"""Elementwise functions for a model's formulas: the same on scalars, compiled, and on arrays.

A formula runs twice: one particle at a time inside the compiled filter, and on whole NumPy
arrays in the plain one. `numpy.where` makes an array even of scalars (140 ns a particle in
compiled code) and `numpy.clip` does not compile on scalars at all; these two do both.
"""

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """Choose elementwise between two values.

    Parameters
    ----------
    condition : bool or array of bool
    if_true, if_false : float or array
        Both are evaluated, wherever the condition holds or not.

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
    """Limit elementwise to the interval from low to high.

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


# The signatures are bare: Numba compares them with those of what they give, name by name.


@overload(where, jit_options={"forceinline": True})
def _where_compiled(condition, if_true, if_false):
    if any(isinstance(kind, types.Array) for kind in (condition, if_true, if_false)):
        return lambda condition, if_true, if_false: np.where(condition, if_true, if_false)  # noqa: PLW0108
    return lambda condition, if_true, if_false: if_true if condition else if_false


@overload(clip, jit_options={"forceinline": True})
def _clip_compiled(x, low, high):
    return lambda x, low, high: np.minimum(np.maximum(x, low), high)
