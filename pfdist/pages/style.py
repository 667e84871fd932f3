"""Styles and colours; Matplotlib is imported so that no setting of the machine changes a figure.

The package imports this module first, and no module outside the package imports Matplotlib.

Colour-blind readers, and readers of a grey print, can distinguish the sets of times. The styles
``print.mplstyle`` and ``screen.mplstyle`` have fonts and sizes. Figures take their sizes from the
style in use, so any style of Matplotlib applies.
"""

import contextlib
import logging
import os
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import Any

# Matplotlib warns if it cannot write a folder for settings; a run needs no such folder.
logging.getLogger("matplotlib").addHandler(logging.NullHandler())

# A backend shows windows, which runs never open. An unknown backend would fail the import.
_backend = None if "matplotlib" in sys.modules else os.environ.pop("MPLBACKEND", None)
try:
    import matplotlib as mpl
    from matplotlib import style
finally:
    if _backend is not None:
        os.environ["MPLBACKEND"] = _backend
if _backend:
    with contextlib.suppress(ValueError):  # an unknown backend is ignored
        mpl.rcParams["backend"] = _backend

PALETTE = {
    "red": ("#df4d12", "#f05e39"),
    "blue": ("#00519d", "#87b6f2"),
    "ochre": ("#653700", "#f7c43e"),
    "green": ("#429b6b", "#8dffb0"),
    "purple": ("#b462f0", "#af4bff"),
    "grey": ("#535353", "#848484"),
}
"""Each colour on white paper and on a dark page. The plan is red, the reference blue; a bound and
the truth have the colour of the text."""
RED, BLUE, OCHRE, GREEN, PURPLE, GREY = (light for light, _ in PALETTE.values())
SENSORS = ("o", "s", "^", "D", "v", "P", "X", "*")  # markers of sensors, in turn
SERIES = (RED, BLUE, OCHRE, GREEN, PURPLE)

COLUMN_INCHES = 3.5  # width of a printed figure
PRINT, SCREEN = "pfdist.pages.print", "pfdist.pages.screen"

_SETS: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "ls": (0, (4, 1.5)), "marker": "o", "mfc": "white"},
    {"color": RED, "ls": "-", "marker": "o", "mfc": RED},
    {"color": OCHRE, "ls": (0, (6, 1.5, 1, 1.5)), "marker": "s", "mfc": OCHRE},
    {"color": GREEN, "ls": (0, (1, 1)), "marker": "^", "mfc": GREEN},
    {"color": PURPLE, "ls": (0, (7, 1)), "marker": "D", "mfc": "white"},
)


def set_style(position: int) -> dict[str, Any]:
    """Colour, dashes and marker of a set of times; position 0 is the reference, hollow and blue.

    No other set is blue: the style of position 1 follows that of the last.
    """
    return dict(_SETS[position and 1 + (position - 1) % (len(_SETS) - 1)])


def styled(
    name: str = PRINT, settings: Mapping[str, Any] = MappingProxyType({})
) -> AbstractContextManager[Any]:
    """The context in which files are drawn: the defaults of Matplotlib, and a style of pfdist.

    `settings` replace those of the style. No figure has a layout engine: `drawn` computes the
    layout.
    """
    once = {"figure.constrained_layout.use": False}
    return style.context(["default", name, once, dict(settings)])
