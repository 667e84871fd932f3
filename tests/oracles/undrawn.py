"""Figures that are saved without a picture, because drawing them takes the longest."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

EMPTY = '<svg xmlns="http://www.w3.org/2000/svg"/>'


def _save(to: Any, **_: Any) -> None:
    to.write(EMPTY) if hasattr(to, "write") else Path(to).write_text(EMPTY)


def undraw(patch: pytest.MonkeyPatch) -> None:
    """Save each figure as an empty picture."""
    for module in ("questions.pictures", "pages.figure"):  # the first imports from the second
        patch.setattr(f"pfdist.{module}.drawn", lambda _: SimpleNamespace(savefig=_save))
