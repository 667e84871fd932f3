"""Matplotlib, imported such that no setting of the machine fails a run or changes a figure."""

import contextlib
import logging
import os
import sys
from contextlib import AbstractContextManager
from typing import Any

from pfdist.plots.style import PRINT

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
    with contextlib.suppress(ValueError):  # an unknown backend is as good as none
        mpl.rcParams["backend"] = _backend


def styled(name: str = PRINT) -> AbstractContextManager[Any]:
    """Give the context in which files are drawn: Matplotlib's defaults, and a style of pfdist."""
    return style.context(["default", name])
