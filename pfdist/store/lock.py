"""One driver at a time."""

import contextlib
import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from pfdist.errors import StoreError

_LOCK = ".lock"
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP}


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a run's folder as its one driver; when this process dies, however, it is free again.

    Where the file system has no locks nobody is refused: two drivers commit the same bytes under
    the same names, and only do everything twice.

    Raises
    ------
    StoreError
        Another driver holds it; the error says who, and since when. Or it cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise _cannot_lock(folder, error) from error
    try:
        _take(lock, fcntl.LOCK_EX, folder)
        _sign(lock, folder)
        yield
    finally:
        os.close(lock)  # and with it goes the lock


def check_not_held(folder: Path) -> None:
    """Raise the `StoreError` of `held` if a driver holds a run's folder, and take nothing."""
    try:
        lock = os.open(folder / _LOCK, os.O_RDONLY)
    except OSError:  # no driver was ever here, or it is somebody else's run
        return
    try:
        _take(lock, fcntl.LOCK_SH, folder)
    finally:
        os.close(lock)


def _take(lock: int, kind: int, folder: Path) -> None:
    try:
        fcntl.flock(lock, kind | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise StoreError(
            f"{folder} is being computed by {_holder(folder)}: wait for it, end it, or give "
            "--results another folder"
        ) from error
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise _cannot_lock(folder, error) from error


def _cannot_lock(folder: Path, error: OSError) -> StoreError:
    return StoreError(
        f"cannot lock {folder}: {error.strerror}; what was committed is kept, run the same command "
        "again once this is mended"
    )


def _sign(lock: int, folder: Path) -> None:
    holder = {
        "process": os.getpid(),
        "host": socket.gethostname(),
        "since": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    try:
        os.ftruncate(lock, 0)
        os.pwrite(lock, json.dumps(holder).encode(), 0)
    except OSError as error:
        raise _cannot_lock(folder, error) from error


def _holder(folder: Path) -> str:
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        holder = json.loads((folder / _LOCK).read_text(encoding="utf-8"))
        return f"process {holder['process']} on {holder['host']} since {holder['since']}"
    return "another process"
