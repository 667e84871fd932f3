"""Functions that Numba compiles once a machine; it keeps their machine code in a folder.

The folder belongs to this user alone, because the files in it are code. Its name holds a hash of
the sources from which the code is made, and of the versions. Numba itself compares only the file in
which a function is defined, and not those of the functions that it calls.
"""

import hashlib
import os
import platform
import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final

import llvmlite
import numba
import numpy as np

from pfdist.errors import EngineWarning

FOLDER_VARIABLE: Final = "PFDIST_CACHE_DIR"
"""Environment variable that names another place for the folder."""


_IN_COMPILED_CODE = {
    "nogil": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
"""Numba's options for functions that only compiled functions call."""


def compiled(function: Callable[..., Any]) -> Any:
    """The function for compiled code, compiled together with what Python calls."""
    return numba.njit(function, **_IN_COMPILED_CODE)


def entry(function: Callable[..., Any]) -> Any:
    """The function that Python calls; its machine code is kept. It runs without Python's lock.

    Numba's setting of the folder holds for a whole process. It is read when a function is declared,
    so it is changed for this moment only, and cached functions of the user do not move.
    """
    folder, before = _folder(), numba.config.CACHE_DIR
    numba.config.CACHE_DIR = folder or before
    try:
        return numba.njit(
            function, cache=bool(folder), nogil=True, error_model="numpy", no_cfunc_wrapper=True
        )
    finally:
        numba.config.CACHE_DIR = before


@cache
def _folder() -> str:
    """The folder, which is made if necessary; empty, with a warning, if it cannot be used."""
    place = os.environ.get(FOLDER_VARIABLE)
    usual = Path(tempfile.gettempdir()) / f"pfdist-{os.getuid()}"
    parent = Path(place).resolve() if place else usual
    folder = parent / _hash_of_sources()
    try:
        for each in (parent, folder):
            each.mkdir(mode=0o700, parents=True, exist_ok=True)
            status = each.lstat()
            if status.st_uid != os.getuid() or status.st_mode & 0o022:
                raise PermissionError(
                    "it must belong to this user, and be writable by its owner alone"
                )
    except OSError as error:
        warnings.warn(
            f"compiled code is not kept, so each process compiles for some seconds: {error} "
            f"({FOLDER_VARIABLE}: {parent})",
            EngineWarning,
            stacklevel=2,
        )
        return ""
    return str(folder)


def _hash_of_sources() -> str:
    """Hash of the sources of this room, and of all versions on which machine code depends."""
    content = hashlib.blake2b(digest_size=8)
    for file in sorted(Path(__file__).parent.glob("*.py")):
        content.update(file.read_bytes())
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    content.update(repr(versions).encode())
    return content.hexdigest()
