"""Colours, and how sets of times differ in figures: apart for colour-blind readers and in grey.

The styles ``print.mplstyle`` and ``screen.mplstyle`` hold fonts and sizes. Figures take their sizes
from the style in use, so these two and any other style of Matplotlib apply.
"""

from typing import Any

BLUE, RED, ORANGE, GREEN, PURPLE = "#0077bb", "#bb2211", "#dd8800", "#228833", "#cc79a7"
GREY = "#666666"
SERIES = (RED, BLUE, ORANGE, GREEN, PURPLE)

COLUMN_INCHES = 3.5  # width of a printed figure
PRINT, SCREEN = "pfdist.plots.print", "pfdist.plots.screen"

_SETS: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "ls": (0, (4, 1.5)), "marker": "o", "mfc": "white"},
    {"color": RED, "ls": "-", "marker": "o", "mfc": RED},
    {"color": ORANGE, "ls": (0, (6, 1.5, 1, 1.5)), "marker": "s", "mfc": ORANGE},
    {"color": GREEN, "ls": (0, (1, 1)), "marker": "^", "mfc": GREEN},
    {"color": PURPLE, "ls": (0, (7, 1)), "marker": "D", "mfc": "white"},
)


def set_style(position: int) -> dict[str, Any]:
    """Colour, dashes and marker of a set of times; position 0 is the reference, hollow and blue."""
    return dict(_SETS[position % len(_SETS)])
