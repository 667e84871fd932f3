"""The lock of a run's folder, so that one driver at a time computes the run.

The lock is our own, because it does more than libraries' locks: its file says who holds it, a link
or a pipe in its place is never opened, and a file system without locks refuses nobody.
"""

import contextlib
import errno
import fcntl
import json
import os
import socket
import stat
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from pfdist.errors import BusyError, StoreError
from pfdist.store import files

_LOCK = ".lock"
_NO_FILE = {errno.ELOOP, errno.EISDIR, errno.ENXIO}
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP}


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold the lock of a run's folder; the lock ends with this process, however it ends.

    If the file system has no locks, every driver may go on. Two drivers then commit the same bytes
    under the same names, and only do everything twice. Raises `BusyError` if another driver holds
    the lock; the error says who, and since when.
    """
    files.make_folder(folder)
    with files.writing("lock", folder):
        lock = _opened(folder, os.O_RDWR | os.O_CREAT)
    try:
        _take(lock, fcntl.LOCK_EX, folder)
        _sign(lock, folder)
        yield
    finally:
        os.close(lock)  # this unlocks it


def check_not_held(folder: Path) -> None:
    """Raise the `BusyError` of `held` if a driver holds a run's folder; lock nothing."""
    try:
        lock = _opened(folder, os.O_RDONLY)
    except OSError:  # there was no driver yet, or the run belongs to another user
        return
    try:
        _take(lock, fcntl.LOCK_SH, folder)
    finally:
        os.close(lock)


def is_held(folder: Path) -> bool:
    """Whether a driver holds a run's folder, or something else lies in the place of its lock."""
    try:
        check_not_held(folder)
    except StoreError:
        return True
    return False


def try_lock(path: Path) -> None:
    """Lock a file as a driver locks its run, and unlock it; raise an `OSError` if it fails."""
    with path.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _opened(folder: Path, mode: int) -> int:
    """Descriptor of the lock's file; neither a link's target nor a pipe is opened.

    Raises `StoreError` if it is not a plain file, and `OSError` if it cannot be opened.
    """
    path = folder / _LOCK
    try:
        lock = os.open(path, mode | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno in _NO_FILE:
            raise _no_file(path) from error
        raise
    if not stat.S_ISREG(os.fstat(lock).st_mode):
        os.close(lock)
        raise _no_file(path)
    return lock


def _no_file(path: Path) -> StoreError:
    return StoreError(
        f"{path} must be a plain file of this folder, got a link, a pipe or a folder: remove it"
    )


def _take(lock: int, kind: int, folder: Path) -> None:
    with files.writing("lock", folder):
        try:
            fcntl.flock(lock, kind | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BusyError(
                f"{folder} is being computed by {_holder(folder)}: wait for it, end it, or "
                "give results another folder"
            ) from error
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise


def _sign(lock: int, folder: Path) -> None:
    holder = {
        "process": os.getpid(),
        "host": socket.gethostname(),
        "since": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    with files.writing("lock", folder):
        os.ftruncate(lock, 0)
        os.pwrite(lock, json.dumps(holder).encode(), 0)


def _holder(folder: Path) -> str:
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        holder = json.loads((folder / _LOCK).read_text(encoding="utf-8"))
        return f"process {holder['process']} on {holder['host']} since {holder['since']}"
    return "another process"
