"""The axis of a figure of many runs: the values of a key, as numbers or as categories."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, MaxNLocator, NullFormatter, NullLocator

from pfdist.analysis.studies import is_numeric
from pfdist.analysis.table_cells import told_value
from pfdist.plots.panel import clipped, verbatim

_LONGEST_TICK = 16
_MOST_TICKS = 8  # values of a key that all have a tick
_CLOSEST = 0.08  # of the axis between two ticks
_BESIDE = {False: 0.5, True: 0.16}  # of the least distance of two values: room of all lines
_MARGIN = 0.05  # beside the first and the last value, over the length of the axis


def places_of(values: Sequence[Any]) -> dict[Any, float]:
    """Give the place of each value on the axis: the number, or the position of the category."""
    if is_numeric(values):
        return {value: float(value) for value in values}
    return {value: float(position) for position, value in enumerate(values)}


def label_key(ax: Axes, places: dict[Any, float], name: str, is_axis: bool) -> None:
    """Label the horizontal axis; a few values have a tick each."""
    ax.set_xlabel(name)
    ax.margins(x=_MARGIN)
    at = list(places.values())
    if not is_axis:
        told = [told_value(value) or "none" for value in places]
        ax.set_xticks(at, [verbatim(clipped(text, _LONGEST_TICK)) for text in told])
        ax.set_xlim(-0.5, len(at) - 0.5)
        return
    if _is_logarithmic(at):
        ax.set_xscale("log")
        at = [math.log(place) for place in at]
    gaps = np.diff(at)
    if len(places) <= _MOST_TICKS and (not gaps.size or gaps.min() >= _CLOSEST * (at[-1] - at[0])):
        ax.xaxis.set_major_locator(FixedLocator(list(places.values())))
        ax.set_xticks(list(places.values()), [told_value(value) for value in places])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_minor_formatter(NullFormatter())
    elif ax.get_xscale() == "linear":
        whole = all(isinstance(value, int) for value in places)
        ax.xaxis.set_major_locator(MaxNLocator(integer=whole, steps=[1, 2, 5, 10]))


def place_beside(place: float, share: float, places: dict[Any, float], is_axis: bool) -> float:
    """Give the place of a line that stands beside others by a share of their room."""
    values = list(places.values())
    room = share * _BESIDE[is_axis]
    if len(values) < 2:
        return place + (0.0 if is_axis else room)
    if is_axis and _is_logarithmic(values):
        return place * math.exp(room * float(np.diff(np.log(values)).min()))
    return place + room * float(np.diff(values).min())


def _is_logarithmic(places: Sequence[float]) -> bool:
    """Whether values lie more evenly on a logarithmic axis, and span a factor of 10."""
    if len(places) < 3 or places[0] <= 0 or places[-1] < 10 * places[0]:
        return False
    plain, logarithmic = np.diff(places), np.diff(np.log(places))
    return bool(logarithmic.min() / logarithmic.sum() > plain.min() / plain.sum())
