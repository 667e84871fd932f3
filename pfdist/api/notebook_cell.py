"""A line below a notebook's cell that is written anew while the cell runs."""

import sys
from html import escape
from typing import Any


class NotebookCell:
    """A line below the cell that runs now.

    Parameters
    ----------
    display : callable
        As of `IPython.display.display`.
    """

    def __init__(self, display: Any) -> None:
        self._handle = display(_Line(""), display_id=True)

    def show(self, line: str) -> None:
        """Write the line anew."""
        self._handle.update(_Line(line))

    def close(self) -> None:
        """Remove the line."""
        self._handle.update(_Line(""))


class _Line:
    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text

    def _repr_html_(self) -> str:
        return f"<code>{escape(self._text)}</code>" if self._text else ""


def notebook_cell() -> NotebookCell | None:
    """The cell that runs now; None outside a notebook."""
    ipython = sys.modules.get("IPython")  # a notebook has loaded it
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython.display import display  # noqa: PLC0415

    return NotebookCell(display)
