"""Axes that a few outliers do not flatten: arrows and numbers tell of the outliers."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from pfdist.plots.panel import (
    marker,
    minus,
    verbatim,
)

Array = NDArray[np.float64]
_SHARE = 0.1  # of all values that may be cut off; one value always may
_STRETCH = 4.0  # values are cut off only if the axis would be so many times longer with them
_MARGIN = 0.08  # room beyond the last value that is shown, over the length of the axis
_LABELLED = 2  # of more points beyond the axis, only the farthest has a number


class Points(NamedTuple):
    """The points of a curve, as arrows at the edge of the axes would show them.

    Parameters
    ----------
    x, y : array of float64, (n,)
    colour, name : str
    """

    x: Array
    y: Array
    colour: str
    name: str


def points(x: ArrayLike, y: ArrayLike, colour: str, name: str) -> Points:
    """Give the points of a curve that have a value; infinite values have one."""
    at, values = np.asarray(x, np.float64), np.asarray(y, np.float64)
    known = ~np.isnan(values)
    return Points(at[known], values[known], colour, name)


def cut_outliers(
    ax: Axes, curves: Sequence[Points], keep: Iterable[float] = (), *, zero: bool = False
) -> None:
    """Limit the vertical axis if outliers flatten it; arrows show where the outliers are.

    The arrows have labels with the numbers, so a legend must follow.

    Parameters
    ----------
    ax : matplotlib Axes
        Everything is drawn already.
    curves : sequence of Points
    keep : iterable of float
        Values that must be shown.
    zero : bool
        Whether the axis begins at 0.
    """
    limits = shown_range(np.concatenate([curve.y for curve in curves] or [np.zeros(0)]))
    if zero:
        ax.set_ylim(bottom=0)
    if limits is None:
        return
    must = [value for value in (*keep, *([0.0] if zero else [])) if math.isfinite(value)]
    low, high = min([limits[0], *must]), max([limits[1], *must])
    room = _MARGIN * (high - low or 1.0)
    ax.set_ylim(0.0 if zero else low - room, high + room)
    for curve in curves:
        _mark(ax, curve, curve.y > high, 1.0, "^")
        _mark(ax, curve, curve.y < low, 0.0, "v")


def shown_range(values: Array) -> tuple[float, float] | None:
    """Give the least and the largest value to show; None if no value need be cut off.

    Up to a tenth of the values, those farthest from the median, are cut off if the axis would
    otherwise be four times as long. As few are cut off as this takes. Infinite values are.

    Parameters
    ----------
    values : array of float64, (n,)

    Examples
    --------
    >>> shown_range(np.array([2.0, 3.0, 5.0, 400.0]))
    (2.0, 5.0)
    >>> shown_range(np.array([2.0, 3.0, 5.0, 12.0]))
    """
    finite = values[np.isfinite(values)]
    if finite.size < 2:
        return None
    infinite = finite.size < values.size
    ordered = finite[np.argsort(np.abs(finite - np.median(finite)), kind="stable")]
    whole = np.ptp(ordered)
    for count in range(1, max(1, int(_SHARE * finite.size)) + 1):
        rest = ordered[:-count]
        if 0 < np.ptp(rest) * _STRETCH < whole:
            return float(rest.min()), float(rest.max())
    return (float(finite.min()), float(finite.max())) if infinite else None


def number(value: float) -> str:
    r"""Give a number with three digits, as text in a figure.

    Examples
    --------
    >>> number(1234.5), number(0.01234), number(1.2e7), number(np.inf)
    ('1,234', '0.0123', '$1.2\\times 10^{7}$', '∞')
    """
    if math.isinf(value):
        return minus("-∞" if value < 0 else "∞")
    if 1e-3 <= abs(value) < 1e5 or value == 0.0:
        return minus(f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}")
    mantissa, _, exponent = f"{value:.2g}".partition("e")
    return minus(rf"${mantissa}\times 10^{{{int(exponent)}}}$")


def _mark(ax: Axes, curve: Points, beyond: NDArray[np.bool_], edge: float, shape: str) -> None:
    """Draw an arrow at the edge for each point beyond it; the legend has their numbers."""
    if not beyond.any():
        return
    farthest = sorted(curve.y[beyond].tolist(), key=abs, reverse=True)
    told = " and ".join(map(number, farthest))
    if len(farthest) > _LABELLED:
        told = f"{len(farthest)} {'up' if edge else 'down'} to {number(farthest[0])}"
    ax.plot(
        curve.x[beyond], np.full(len(farthest), edge), shape, color=curve.colour, ms=marker(),
        mfc=curve.colour, transform=ax.get_xaxis_transform(), clip_on=False, zorder=5,
        label=f"{verbatim(curve.name)}: {told}" if curve.name else told,
    )  # fmt: skip
