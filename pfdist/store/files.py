"""Atomic writes of files: a reader sees the old file or the new one, never a part.

A file is written under a temporary name, flushed, and renamed; then the folder is flushed. A kill
before the renaming leaves a temporary file, which the next start removes. After a power cut, the
new name never leads to an empty file, because its content was flushed before.
"""

import contextlib
import errno
import hashlib
import math
import os
import re
import socket
import stat
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from pfdist.errors import PfdistWarning, StoreError

_NOT_PLAIN = {errno.ELOOP, errno.EISDIR, errno.ENXIO}
_UNSUPPORTED = {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTTY}  # of fsync
_TEMPORARY = re.compile(r"\.(?P<host>.+)-(?P<process>\d+)\.[0-9a-f]{32}\.tmp")


@contextlib.contextmanager
def reading(path: Path, action: str = "read") -> Iterator[None]:
    """A context that turns an `OSError` into a `StoreError` that names the file or folder."""
    try:
        yield
    except OSError as error:
        raise StoreError(f"cannot {action} {path}: {error.strerror or error}") from error


@contextlib.contextmanager
def writing(action: str, path: Path, temporary: Path | None = None) -> Iterator[None]:
    """A context that turns an `OSError` into a `StoreError` with a remedy.

    After an error, an existing temporary file is removed.
    """
    try:
        yield
    except OSError as error:
        if temporary is not None:
            with contextlib.suppress(OSError):  # the next start removes it in that case
                temporary.unlink(missing_ok=True)
        raise StoreError(
            f"cannot {action} {path}: {error.strerror or error}; finished work is saved, "
            "run the same command again once this is fixed"
        ) from error


@dataclass(frozen=True)
class Prepared:
    """A file that is written and flushed to disk, but still has a temporary name."""

    temporary: Path
    sha256: str


def prepare(folder: Path, write: Callable[[Path], Any]) -> Prepared:
    """Write a file to a folder under a temporary name; `give_name` makes it visible."""
    # Readers skip names with a dot. The name contains the machine and the process.
    temporary = folder / f".{_host()}-{os.getpid()}.{uuid4().hex}.tmp"
    with writing("write", folder, temporary):
        _make_folder(folder)
        write(temporary)
        _flush(temporary, os.O_RDWR)
        return Prepared(temporary, digest(temporary))


def give_name(prepared: Prepared, path: Path) -> None:
    """Rename a file to its final name in one atomic step; an existing file is replaced."""
    with writing("write", path, prepared.temporary):
        prepared.temporary.replace(path)
        _flush(path.parent, os.O_RDONLY)


def write_file(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file atomically; it replaces an earlier file of this name."""
    give_name(prepare(path.parent, write), path)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, and flush each entry to disk."""
    with writing("make", folder):
        _make_folder(folder)


def remove(path: Path) -> None:
    """Remove a file that is no longer needed and may already be gone."""
    with writing("remove", path):
        path.unlink(missing_ok=True)


def open_plain(path: Path, flags: int = os.O_RDONLY) -> int:
    """Descriptor of a plain file; a link, a pipe or a device is never opened.

    Raises `FileNotFoundError` if it does not exist, `StoreError` if it is not a plain file, and
    `OSError` if it cannot be opened.
    """
    try:
        handle = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno in _NOT_PLAIN:
            raise _not_plain(path) from error
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise _not_plain(path)
    return handle


def _not_plain(path: Path) -> StoreError:
    return StoreError(f"{path} must be a plain file, got a link, a pipe or a folder: remove it")


def read_plain(path: Path, most: int) -> bytes:
    """Content of a plain file, as of each file of a run.

    Raises as `open_plain`, and ValueError if it has more than `most` bytes.
    """
    with open(open_plain(path), "rb") as file:
        if (size := os.fstat(file.fileno()).st_size) > most:
            raise ValueError(f"must be a file of at most {most:,} bytes, got {size:,}")
        return file.read(most)


def read_if_hashed(path: Path, wanted: str, most: float = math.inf) -> bytes | None:
    """Content of a file if its hash begins like this and it is a plain file; else None.

    A file of more than `most` bytes counts as another. Nothing is kept in memory before the hash is
    compared. Raises as `open_plain`.
    """
    try:
        handle = open_plain(path)
    except StoreError:
        return None
    with open(handle, "rb") as file:
        if os.fstat(handle).st_size > most:
            return None
        if not hashlib.file_digest(file, "sha256").hexdigest().startswith(wanted):
            return None
        file.seek(0)
        return file.read()


def stamp_of(path: Path) -> tuple[int, ...]:
    """Numbers that differ between two versions of a file; raises `OSError` if there is none."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # else NFS has an old one
    try:
        about = os.fstat(handle)
    finally:
        os.close(handle)
    return about.st_dev, about.st_ino, about.st_mtime_ns, about.st_ctime_ns, about.st_size


def digest(path: Path) -> str:
    """SHA-256 of a plain file; raises as `open_plain`."""
    with open(open_plain(path), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove_unfinished(folder: Path) -> None:
    """Remove unfinished files below a folder that killed processes of this machine have left.

    A process of another machine may still be running, so its files stay.
    """
    for temporary in folder.rglob(".*.tmp"):
        owner = _TEMPORARY.fullmatch(temporary.name)
        if owner and owner["host"] == _host() and not _alive(int(owner["process"])):
            remove(temporary)


def begins_with(path: Path, mark: bytes, most: int) -> bool:
    """Whether the first bytes of a file, at most so many, contain a mark."""
    with path.open("rb") as file:
        return mark in file.read(most)


def check_replaceable(path: Path, is_earlier: Callable[[Path], bool]) -> None:
    """Raise `StoreError` if a file exists that a result must not replace.

    A result may replace an earlier result, but no other file of the user, and no link. `is_earlier`
    checks whether a plain file is an earlier result.
    """
    if not os.path.lexists(path):
        return
    try:
        is_result = path.is_file() and not path.is_symlink() and is_earlier(path)
    except OSError:
        is_result = False  # it cannot be read, so it may be anything
    if not is_result:
        raise StoreError(f"{path} exists and is not an earlier result: move it away")


def _make_folder(folder: Path) -> None:
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        if folder.stat().st_mode & 0o700 != 0o700:  # its files could not be read or removed
            folder.rmdir()
            raise PermissionError("the umask of this process denies its owner access")
        _flush(folder.parent, os.O_RDONLY)


def _host() -> str:
    return socket.gethostname().replace(".", "_")


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # a process of another user
        return True
    try:
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(") ")[2][:1]
    except OSError:  # another system
        return True
    return state != "Z"  # an ended process that nobody has waited for, as in many containers


def _flush(path: Path, mode: int) -> None:
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        _warn_of_no_flush(str(error.strerror))
    finally:
        os.close(handle)


@cache
def _warn_of_no_flush(reason: str) -> None:
    """Warn once: the content of the files is right, and only a power cut could lose it."""
    warnings.warn(
        f"the file system cannot flush files to disk (fsync: {reason}): "
        "a power cut may lose finished work",
        PfdistWarning,
        stacklevel=2,
    )
