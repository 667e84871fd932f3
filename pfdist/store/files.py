"""Files that are there whole or not at all."""

import contextlib
import hashlib
import os
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import pyarrow as pa

from pfdist.errors import StoreError
from pfdist.store.arrow_files import write_table

_TEMPORARY = re.compile(r"\.(?P<host>.+)-(?P<process>\d+)\.[0-9a-f]{32}\.tmp")


@dataclass(frozen=True)
class Prepared:
    """A file that is written and flushed to disk, and has no name yet.

    Parameters
    ----------
    temporary : Path
    stamp : str
        What is in it: ``<rows>-<SHA-256>``.
    """

    temporary: Path
    stamp: str


def prepare_table(folder: Path, table: pa.Table) -> Prepared:
    """Write a table as a Parquet file that is to lie in a folder."""

    def write(path: Path) -> None:
        write_table(table, path)
        pa.default_memory_pool().release_unused()  # else memory grows with what was written

    return _prepare(folder, write, table.num_rows)


def prepare_text(folder: Path, text: str) -> Prepared:
    """Write a text file that is to lie in a folder."""
    return _prepare(folder, lambda path: path.write_text(text, encoding="utf-8"), 0)


def give_name(prepared: Prepared, path: Path, *, replace: bool) -> None:
    """Give a file its name, in one step.

    Parameters
    ----------
    prepared : Prepared
    path : Path
    replace : bool
        Whether a file already there gives way; else it stays, and this is a no-op.
    """
    temporary = prepared.temporary
    with _errors("write", path, temporary):
        if replace:
            temporary.replace(path)
        else:
            with contextlib.suppress(FileExistsError):  # whoever was first wrote the same
                os.link(temporary, path)
            temporary.unlink()
        _flush(path.parent, os.O_RDONLY)


def write_file(path: Path, write: Callable[[Path], Any]) -> None:
    """Have a file written, which is then there whole; what was there gives way."""
    give_name(_prepare(path.parent, write, 0), path, replace=True)


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, each flushed to disk in the folder that holds it."""
    with _errors("make", folder):
        _make_folder(folder)


def touch(path: Path) -> None:
    """Make an empty file, whose name says it all."""
    with _errors("write", path):
        if not path.exists():
            _make_folder(path.parent)
            path.touch()
            _flush(path.parent, os.O_RDONLY)


def remove(path: Path) -> None:
    """Remove a file that is no longer needed; that it is gone already is no error."""
    with _errors("remove", path):
        path.unlink(missing_ok=True)


def move(path: Path, other: Path) -> None:
    """Move a file out of the way."""
    with _errors("move", path):
        _make_folder(other.parent)
        path.replace(other)


def digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises
    ------
    OSError
        It is not there, or cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_temporary(path: Path) -> bool:
    """Whether a file is being written, or was when its process was killed."""
    return _TEMPORARY.fullmatch(path.name) is not None


def sweep(folder: Path) -> None:
    """Remove what killed processes of this machine left half written below a folder."""
    for temporary in folder.rglob(".*.tmp"):
        owner = _TEMPORARY.fullmatch(temporary.name)
        if owner and owner["host"] == _host() and not _alive(int(owner["process"])):
            remove(temporary)


def _prepare(folder: Path, write: Callable[[Path], Any], rows: int) -> Prepared:
    # The dot keeps readers of the folder away; the name says whose it is.
    temporary = folder / f".{_host()}-{os.getpid()}.{uuid4().hex}.tmp"
    with _errors("write", folder, temporary):
        _make_folder(folder)
        write(temporary)
        _flush(temporary, os.O_RDWR)
        return Prepared(temporary, f"{rows}-{digest(temporary)}")


def _make_folder(folder: Path) -> None:
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        _flush(folder.parent, os.O_RDONLY)


def _host() -> str:
    return socket.gethostname().replace(".", "_")


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def _flush(path: Path, mode: int) -> None:
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def _errors(action: str, path: Path, temporary: Path | None = None) -> Any:
    try:
        yield
    except OSError as error:
        if temporary is not None:
            with contextlib.suppress(OSError):  # else it is swept at the next start
                temporary.unlink(missing_ok=True)
        raise StoreError(
            f"cannot {action} {path}: {error.strerror or error}; what was committed is kept, "
            "run the same command again once this is mended"
        ) from error
