"""Results beside a user's own files: they replace earlier results, and no other file."""

import os
from collections.abc import Callable
from pathlib import Path

from pfdist.errors import StoreError


def check_replaceable(path: Path, is_earlier: Callable[[Path], bool]) -> None:
    """Raise an error unless a file is missing, or is an earlier result of this kind.

    Parameters
    ----------
    path : Path
    is_earlier : callable
        Says whether a plain file is an earlier result.

    Raises
    ------
    StoreError
        Another file, or a link, has this name.
    """
    if not os.path.lexists(path):
        return
    try:
        known = path.is_file() and not path.is_symlink() and is_earlier(path)
    except OSError:
        known = False  # nobody can tell
    if not known:
        raise StoreError(f"{path} exists and is no earlier result: move it out of the way")
