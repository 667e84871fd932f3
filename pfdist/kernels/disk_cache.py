"""A cache of compiled code on disk. The name of a file is a hash of all that its code depends on.

Numba's own cache identifies a function by its source file. Our functions are closures over a
model's formulas, so their source file says too little. Here the name is a hash of the fingerprint
of the formulas, of the kernel's own source, of the versions and of the processor. A formula that
has no fingerprint is compiled in each process.

A function is saved only if everything it calls is inlined into it. Numba numbers its symbols, and
two processes may give the same number to two functions.

The folder is local to a node and belongs to one user, because the files in it are code. It may
belong to root, who installed the program: an image holds kernels for all its users, who only read
them. Each file begins with the hash of its content. A damaged file is ignored, and its function is
compiled again.
"""

import contextlib
import hashlib
import os
import pickle
import platform
import re
import tempfile
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from pfdist.errors import EngineWarning
from pfdist.models.fingerprint import formulas_key

FOLDER_VARIABLE = "PFDIST_CACHE_DIR"
_DIGEST_BYTES = 16
_PACKAGE = Path(__file__).parents[1]


def cached_on_disk(
    compiled: Any, formulas: Sequence[Callable[..., Any]], *settings: Any
) -> Callable[..., None]:
    """Connect a compiled function, which was not called yet, to the cache on disk, and return it.

    When it is first called, it is loaded from disk, or compiled and saved. `formulas` are those
    from which it is compiled. `settings` are all else on which its code depends, except the
    package's own source: names and numbers.
    """
    key = formulas_key("", {str(number): each for number, each in enumerate(formulas)})
    if key is None:
        return compiled
    content = _hash(compiled.__name__, key, _OWN_SOURCE, _versions(), settings)
    # Two kernels in one process must not share a symbol: the second would run the first one's code.
    compiled.py_func.__qualname__ += f"_{content}"
    compiled._cache = _DiskCache(content)
    return compiled


def modules_of(compiled: Any) -> list[Any]:
    """The LLVM modules of a compiled function that was called.

    Numba shows no text of a function that was loaded from disk, but its module is available.
    """
    return [result.library._get_module_for_linking() for result in compiled.overloads.values()]


class _DiskCache:
    """The cache that a Numba dispatcher asks before it compiles, and informs afterwards."""

    def __init__(self, content: str) -> None:
        self._content = content

    def load_overload(self, signature: Any, target: Any) -> Any:
        target.refresh()
        path = self._path(signature, target.codegen())
        try:
            data = path.read_bytes() if path else b""
            digest, payload = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
            if digest != _digest(payload):
                return None
            return CompileResult._rebuild(target, *pickle.loads(payload))  # noqa: S301  our own file
        except Exception:  # whatever is wrong with the file, the function can be compiled
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        if result.library.has_dynamic_globals or not self._is_closed(result.library):
            return
        path = self._path(signature, result.codegen)
        if path is None:
            return
        with contextlib.suppress(Exception):  # without the file, the next process compiles
            # Other processes may load or save the same file now. A rename is atomic, so they see a
            # whole file or none. A killed process leaves a file with a dot, which nobody reads.
            payload = dumps(result._reduce())
            unfinished = path.with_name(f".{path.name}-{platform.node()}-{os.getpid()}")
            try:
                unfinished.write_bytes(_digest(payload) + payload)
                unfinished.replace(path)
            finally:
                unfinished.unlink(missing_ok=True)

    def _is_closed(self, library: Any) -> bool:
        """Whether no function in the library has a name that another process might use."""
        defined = re.findall(r"^define [^@\n]*@(\S+?)\(", library.get_llvm_str(), re.MULTILINE)
        return all(self._content in name or name.startswith("NRT_") for name in defined)

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        key = _hash(self._content, str(signature), codegen.magic_tuple())
        folder = _folder()
        return folder / key if folder else None


def _hash(*parts: Any) -> str:
    return hashlib.blake2b(repr(parts).encode(), digest_size=_DIGEST_BYTES).hexdigest()


def _digest(payload: bytes) -> bytes:
    return hashlib.blake2b(payload, digest_size=_DIGEST_BYTES).digest()


@cache
def _folder() -> Path | None:
    """The folder, which is made if necessary; None, with a warning, if it cannot be used."""
    given = os.environ.get(FOLDER_VARIABLE)
    usual = Path(tempfile.gettempdir()) / f"pfdist-{os.getuid()}"
    folder = Path(given).resolve() if given else usual
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
        if status.st_uid not in {os.getuid(), 0} or status.st_mode & 0o022:
            raise PermissionError(
                "it must be this user's or root's, and writable by its owner alone"
            )
    except OSError as error:
        warnings.warn(
            f"compiled code is not kept, so each process compiles for some seconds: {error} "
            f"({FOLDER_VARIABLE}: {folder})",
            EngineWarning,
            stacklevel=2,
        )
        return None
    return folder


def _hash_of_own_source() -> str:
    """Hash of the package's source from which compiled code is made."""
    files = sorted(
        path for room in ("densities", "kernels") for path in (_PACKAGE / room).glob("*.py")
    )
    names = ("elementwise.py", "models/seeing.py", "filters/simulation.py")
    files += [_PACKAGE / name for name in names]
    return _hash(*(file.read_bytes() for file in files))


def _versions() -> tuple[str, ...]:
    libraries = (numba.__version__, llvmlite.__version__, np.__version__)
    options = (str(numba.config.OPT), str(numba.config.BOUNDSCHECK))
    return (platform.python_version(), *libraries, *options)


_OWN_SOURCE = _hash_of_own_source()  # at import, because the source may be edited later
