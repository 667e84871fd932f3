"""Matplotlib, imported such that no setting of the machine fails a run or changes a figure."""

import logging
import os
from contextlib import AbstractContextManager
from typing import Any

from pfdist.plots.style import STYLE

# Matplotlib warns if it cannot write a folder for settings; a run needs no such folder.
logging.getLogger("matplotlib").addHandler(logging.NullHandler())

# A backend shows windows, which pfdist never opens. An unknown backend would fail the import.
_backend = os.environ.pop("MPLBACKEND", None)
try:
    from matplotlib import style
finally:
    if _backend is not None:
        os.environ["MPLBACKEND"] = _backend


def styled() -> AbstractContextManager[Any]:
    """Give the context in which figures are drawn: Matplotlib's defaults, and `STYLE`."""
    return style.context(["default", STYLE])
