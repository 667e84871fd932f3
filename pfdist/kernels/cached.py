"""Functions that Numba compiles once per machine; their machine code is kept in a folder.

The folder belongs to this user alone, because the files in it are code. Its name contains a hash of
the sources of the code, and of the versions. Numba itself checks only the file in which a function
is defined, not those of the functions that it calls.
"""

import ctypes
import hashlib
import os
import platform
import tempfile
import threading
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final

import llvmlite
import numba
import numpy as np
from numba import types

from pfdist.common.arguments import address_fault
from pfdist.common.telling import tell
from pfdist.errors import EngineWarning
from pfdist.kernels.memory import Place, in_memory

FOLDER_VARIABLE: Final = "PFDIST_CACHE_DIR"
"""Environment variable with another place for the folder."""


_IN_COMPILED_CODE = {
    "nogil": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
"""Numba's options for functions that only compiled functions call."""


def compiled(function: Callable[..., Any]) -> Any:
    """The function for compiled code; it is compiled together with its callers."""
    return numba.njit(function, **_IN_COMPILED_CODE)


class Entry:
    """A function that Python calls with a named tuple, and compiled code by its address.

    It is compiled when it is first needed, and its machine code is kept. It runs without Python's
    lock. LLVM optimises it alone. A function that is called by name would be optimised again in
    each caller, so the first compilation would take three times as long.
    """

    def __init__(self, function: Callable[..., Any], kind: type) -> None:
        self._function, self._kind = function, kind
        self._code: Any = None  # must live as long as the address is used

    @property
    def address(self) -> int:
        """The address of the machine code."""
        if self._code is None:
            with _ONE_AT_A_TIME:
                if self._code is None:
                    self._code = _with_code_kept(self._function, Place(self._kind))
        return int(self._code.address)

    def __call__(self, values: Any) -> None:
        """Call the function with a named tuple."""
        memory = in_memory(values)
        _CALL(self.address)(memory.ctypes.data)


_ONE_AT_A_TIME = threading.Lock()
_CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


def entry(kind: type) -> Callable[[Callable[..., Any]], Entry]:
    """A decorator for a function that receives the address of such a named tuple."""
    return lambda function: Entry(function, kind)


def _with_code_kept(function: Callable[..., Any], place: Place) -> Any:
    """The compiled function, from the folder if it is there.

    Numba's setting of the folder holds for a whole process. It is read when a function is declared,
    so it is changed for this time only, and cached functions of the user do not move.
    """
    folder, before = _folder(), numba.config.CACHE_DIR
    numba.config.CACHE_DIR = folder or before
    try:
        signature = types.void(place)
        return numba.cfunc(signature, cache=bool(folder), error_model="numpy")(function)
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
        if place and (fault := address_fault(place)):
            raise OSError(fault)
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
    if not any(folder.iterdir()):
        tell("Compiling the filter, once on this machine (about 10 s)...")
    return str(folder)


def _hash_of_sources() -> str:
    """Hash of the sources of this room, and of all versions on which machine code depends."""
    content = hashlib.blake2b(digest_size=8)
    for file in sorted(Path(__file__).parent.glob("*.py")):
        content.update(file.read_bytes())
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    content.update(repr(versions).encode())
    return content.hexdigest()
