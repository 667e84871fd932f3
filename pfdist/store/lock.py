"""The lock of a run's folder, so that one driver at a time computes the run.

Libraries' locks do not suffice: this lock file names the holder, a link or a pipe instead of it is
never opened, and a file system without locks gives a warning.
"""

import contextlib
import errno
import fcntl
import json
import os
import socket
import time
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from pfdist.common.parsing import parse_json
from pfdist.errors import BusyError, PfdistWarning, StoreError
from pfdist.store import files

_LOCK = ".lock"
_MOST_BYTES = 4096  # of a lock that names its holder
_PAUSE_SECONDS = 0.05
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP}


@contextlib.contextmanager
def held(folder: Path, patience: float = 1.0) -> Iterator[bool]:
    """A context that holds the lock of a run's folder; the lock ends when this process ends.

    It yields whether the lock is held. Another command may hold it briefly to list the pages that
    it wrote; `patience` is the number of seconds to wait for this.

    If the file system has no locks, there is a warning, and the driver continues. Raises
    `BusyError`, with the holder and the time, if another driver holds the lock.
    """
    files.make_folder(folder)
    with files.writing("lock", folder):
        lock = files.open_plain(folder / _LOCK, os.O_RDWR | os.O_CREAT)
    try:
        is_locked = _take(lock, fcntl.LOCK_EX, folder, patience)
        _sign(lock, folder)
        yield is_locked
    finally:
        os.close(lock)  # this unlocks it


def check_not_held(folder: Path) -> None:
    """Raise the `BusyError` of `held` if a driver holds a run's folder, without locking it."""
    try:
        lock = files.open_plain(folder / _LOCK)
    except OSError:  # there was no driver yet, or the run belongs to another user
        return
    try:
        _take(lock, fcntl.LOCK_SH, folder)
    finally:
        os.close(lock)


def is_held(folder: Path) -> bool:
    """Whether a driver holds a run's folder, or its lock is not a plain file."""
    try:
        check_not_held(folder)
    except StoreError:
        return True
    return False


def _take(lock: int, kind: int, folder: Path, patience: float = 0.0) -> bool:
    """Take a lock; whether the file system has any."""
    deadline = time.monotonic() + patience
    with files.writing("lock", folder):
        while True:
            try:
                fcntl.flock(lock, kind | fcntl.LOCK_NB)
            except BlockingIOError as error:
                if time.monotonic() > deadline:
                    raise BusyError(
                        f"{folder} is being computed by {_holder(lock)}; wait for it, end it, or "
                        "use another results folder"
                    ) from error
                time.sleep(_PAUSE_SECONDS)
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
                if kind == fcntl.LOCK_EX:  # who only reads need not know
                    warnings.warn(
                        f"the file system of {folder} has no locks (flock: {error.strerror}): "
                        "only one command at a time may write to this run",
                        PfdistWarning,
                        stacklevel=2,
                    )
                return False
            else:
                return True


def _sign(lock: int, folder: Path) -> None:
    holder = {
        "process": os.getpid(),
        "host": socket.gethostname(),
        "since": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    with files.writing("lock", folder):
        os.ftruncate(lock, 0)
        os.pwrite(lock, json.dumps(holder).encode(), 0)


def _holder(lock: int) -> str:
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        holder = parse_json(os.pread(lock, _MOST_BYTES, 0))
        return f"process {holder['process']} on {holder['host']} since {holder['since']}"
    return "another process"
