"""Matplotlib, imported so that no setting of the machine ends a run or changes a figure."""

import logging
import os
from contextlib import AbstractContextManager
from typing import Any

from pfdist.plots.style import STYLE

# That a folder for settings cannot be written is no matter of who runs a job.
logging.getLogger("matplotlib").addHandler(logging.NullHandler())

# A backend shows windows, and figures here are files; an unknown name would end the import.
_backend = os.environ.pop("MPLBACKEND", None)
try:
    from matplotlib import style
finally:
    if _backend is not None:
        os.environ["MPLBACKEND"] = _backend


def styled() -> AbstractContextManager[Any]:
    """Give the context in which figures are drawn: Matplotlib's defaults, and `STYLE`."""
    return style.context(["default", STYLE])
