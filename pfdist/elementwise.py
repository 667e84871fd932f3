"""Functions of NumPy that formulas often need, under short names."""

from typing import Any

import numpy as np


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
