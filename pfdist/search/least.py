"""A bound for every strategy: the least relaxed error in each draw, and then the mean.

For fixed sets, the errors of windows are averaged, and the programme takes the least sum. If the
least sum is taken in each draw and then averaged, no strategy that sees the measurements does
better, whatever it computes: whether its set is s depends on y at s and on independent noise alone,
so given these, further measurements keep their law, and the relaxed error of s is at most its own
on the draws that choose s. The minimum of a draw knows its future, so each measurement has a
penalty, of mean 0 for every strategy. See ``docs/bound.md``.

Source: Brown, Smith, Sun, "Information relaxations and duality in stochastic dynamic programs",
Operations Research 58, 2010.
"""

import numpy as np
from numpy.typing import NDArray

from pfdist.search.programme import Programme
from pfdist.search.relaxation import Relaxation

Array = NDArray[np.float64]

_PRICES = 400  # that are tried for the largest bound


def least_of_draw(relaxation: Relaxation, errors: Array, most: int) -> Array:
    """The least relaxed MSE of a draw with 0..most measurements, or units of money, (most+1,).

    `errors` (E,) are those of the draw, window by window; with a NaN, nothing is known.
    """
    if np.isnan(errors).any():  # the programme would leave out the sets of a window
        return np.full(most + 1, np.nan)
    return Programme(relaxation, errors, most).mse


def best_price(least: Array, number: float) -> float:
    """The price of a measurement for which the bound of some draws is largest.

    `least` (D, most+1) is that of `least_of_draw` for each draw: infinite for numbers that the
    constraints forbid.
    """
    fewest = int(np.isfinite(least).any(axis=0).argmax())
    gains = least[:, fewest] - least.min(axis=1)
    steepest = float(np.max(gains, initial=0.0, where=np.isfinite(gains)))
    prices = np.concatenate([[0.0], np.geomspace(1e-4 * steepest or 1.0, steepest or 1.0, _PRICES)])
    return float(max(prices, key=lambda price: bounds_of_draws(least, number, price).mean()))


def bounds_of_draws(least: Array, number: float, price: float) -> Array:
    """Numbers whose mean no strategy is below, (D,): with so many measurements on average.

    Any price gives a bound. With the price infinite, no draw may have more measurements.

    >>> least = np.array([[4.0, 1.0, 0.5], [3.0, 2.5, 2.4]])
    >>> bounds_of_draws(least, 1, 1.0), bounds_of_draws(least, 1, np.inf)
    (array([1., 2.]), array([1. , 2.5]))
    """
    numbers = np.arange(least.shape[1])
    if price == np.inf:
        least_within: Array = least[:, numbers <= number].min(axis=1)
        return least_within
    sums: Array = (least + price * numbers).min(axis=1) - price * number
    return sums
