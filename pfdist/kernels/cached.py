"""Functions that Numba compiles once per machine; their machine code is kept in a folder.

The folder belongs to this user alone, because the files in it are code. Its name contains a hash of
the sources of the code, the versions and the processor. Numba itself checks only the file in which
a function is defined, not those of the functions that it calls. Whatever is wrong with the folder,
a warning says so, and functions are compiled again.
"""

import contextlib
import ctypes
import hashlib
import os
import platform
import re
import shutil
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
from llvmlite import binding
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


Files = dict[str, bytes]
"""The contents of files, by their paths below a folder."""


def _with_code_kept(function: Callable[..., Any], place: Place) -> Any:
    """The compiled function, loaded from the folder if its code is there, else kept there.

    ``<function>-<hash>/`` has what Numba keeps of a function. It gets this name in one step, when
    it is whole, and never changes. So a process that dies leaves nothing half.
    """
    signature = types.void(place)
    folder = _folder(Path(function.__code__.co_filename).parent)
    start = f"{function.__module__}.{function.__qualname__}-"
    if folder is None:
        return numba.cfunc(signature, error_model="numpy")(function)
    for files in (_kept(folder, start), Files()):
        try:
            code, after = _compiled(function, signature, files)
        except OSError as error:
            _warn(folder, _NOT_KEPT, error)
            break
        except Exception as error:  # unpickling and LLVM raise errors of many types
            if not files:
                raise
            _empty(folder, error)
            continue
        if after != files:
            _keep(folder, start, after)
        return code
    return numba.cfunc(signature, error_model="numpy")(function)


def _compiled(function: Callable[..., Any], signature: Any, files: Files) -> tuple[Any, Files]:
    """The function, which Numba loads from some files or compiles, and the files for the next time.

    Numba gets a private copy of the files, so it loads nothing but what was compared with its hash.
    Its setting of the folder holds for a whole process. It is read when a function is declared, so
    it is changed for this time only, and cached functions of the user do not move.
    """
    with tempfile.TemporaryDirectory(prefix="pfdist-compiling-") as name:
        private, before = Path(name), numba.config.CACHE_DIR
        # If Numba cannot make such a folder with a file, it looks elsewhere.
        _write(private, files | {"probe/file": b""})
        shutil.rmtree(private / "probe")
        numba.config.CACHE_DIR = name
        try:
            code = numba.cfunc(signature, cache=True, error_model="numpy")(function)
        finally:
            numba.config.CACHE_DIR = before
        return code, _read(private)


def _kept(folder: Path, start: str) -> Files:
    """The files that are kept of a function; none if there are none, or if they are damaged."""
    try:
        for each in folder.glob(f"{start}*"):
            files = _read(each)
            if each.name != start + _hash_of_files(files):
                raise ValueError(f"{each.name} has another hash")
            return files
    except (OSError, ValueError) as error:
        _empty(folder, error)
    return Files()


def _keep(folder: Path, start: str, files: Files) -> None:
    """Keep the files of a function, unless the folder cannot be written."""
    try:
        with tempfile.TemporaryDirectory(
            prefix=".", dir=folder, ignore_cleanup_errors=True
        ) as unfinished:  # it gets another name
            _write(Path(unfinished), files)
            whole = folder / f"{start}{_hash_of_files(files)}"
            if not whole.exists():  # another process may have been quicker
                Path(unfinished).rename(whole)
    except OSError as error:
        _warn(folder, _NOT_KEPT, error)


def _empty(folder: Path, error: Exception) -> None:
    """Remove all that is kept in a folder, after a warning."""
    _warn(folder, "code that was kept is damaged, and is compiled again", error)
    with contextlib.suppress(OSError):
        for each in folder.iterdir():
            if each.is_dir() and not each.is_symlink():
                shutil.rmtree(each, ignore_errors=True)
            else:
                each.unlink()


def _read(folder: Path) -> Files:
    """The contents of all files below a folder."""
    files = sorted(file for file in folder.rglob("*") if not file.is_dir())
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def _write(folder: Path, files: Files) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def _hash_of_files(files: Files) -> str:
    content = hashlib.blake2b(digest_size=8)
    for name, own in files.items():
        content.update(f"{name}:{len(own)}:".encode() + own)
    return content.hexdigest()


@cache
def _folder(sources: Path) -> Path | None:
    """The folder for functions in a folder of sources; None, with a warning, if it is not usable.

    It is made if necessary.
    """
    place = os.environ.get(FOLDER_VARIABLE)
    usual = Path(tempfile.gettempdir()) / f"pfdist-{os.getuid()}"
    parent = Path(place).resolve() if place else usual
    folder = parent / _hash_of_sources(sources)
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
        is_empty = not any(folder.iterdir())
    except OSError as error:
        _warn(parent, _NOT_KEPT, error)
        return None
    if is_empty:
        tell("Compiling the filter, once on this machine (about 10 s)...")
    return folder


_NOT_KEPT = "compiled code is not kept, so each process compiles for some seconds"
_warned = set[Path]()  # each folder once


def _warn(folder: Path, what: str, error: Exception) -> None:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    if folder not in _warned:
        _warned.add(folder)
        text = f"{what}: {reason or type(error).__name__} ({FOLDER_VARIABLE}: {folder})"
        warnings.warn(text, EngineWarning, stacklevel=3)


_IMPORTS_THIS = re.compile(rb"pfdist\.kernels(\.| import .*\b)cached\b")


def _hash_of_sources(folder: Path) -> str:
    """Hash of the sources of compiled code, and of all else on which machine code depends.

    These are all files of each folder of the package in which one imports this module, of
    `pfdist.constraints`, whose steps are compiled, and of the given folder. Compiled code reads no
    constant of any other. Some versions of Numba compare the time of the file that has the
    function.
    """
    package = Path(__file__).parents[1]
    files = [*package.rglob("*.py"), *folder.glob("*.py")]
    texts = {file: file.read_bytes() for file in files}
    folders = {file.parent for file, text in texts.items() if _IMPORTS_THIS.search(text)}
    folders |= {folder, Path(__file__).parent, package / "constraints"}
    content = hashlib.blake2b(digest_size=8)
    for file in sorted(file for file in texts if file.parent in folders):
        content.update(f"{file}:{file.stat().st_mtime_ns}:".encode() + texts[file])
    processor = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    chosen = numba.config.CPU_NAME, numba.config.CPU_FEATURES
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    content.update(repr((processor, chosen, versions)).encode())
    return content.hexdigest()
