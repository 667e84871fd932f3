"""Files that are there whole or not at all."""

import contextlib
import os
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pfdist.errors import StoreError


def write_table(path: Path, table: pa.Table, replace: bool = False) -> None:
    """Write a table as one Parquet file.

    Parameters
    ----------
    path : Path
    table : pyarrow.Table
    replace : bool
        Whether a file already there gives way; else it stays, and this is a no-op.
    """
    _write(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"), replace)


def write_text(path: Path, text: str) -> None:
    """Write a text file, in the place of one already there."""
    _write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"), replace=True)


def remove(path: Path) -> None:
    """Remove a file that is no longer needed; that it is gone already is no error."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise _store_error("remove", path, error) from error


def sweep(folder: Path) -> None:
    """Remove what a killed process left half written below a folder."""
    for temporary in folder.rglob(".*.tmp"):
        remove(temporary)


def _write(path: Path, write: Callable[[Path], Any], replace: bool) -> None:
    """Write to a temporary file, flush it to disk, then give it its name in one step."""
    # The dot keeps readers of the folder away; no other process writes under this name.
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        _flush(temporary, os.O_RDWR)
        if replace:
            temporary.replace(path)
        else:
            _put_if_absent(temporary, path)
        _flush(path.parent, os.O_RDONLY)
        temporary.unlink(missing_ok=True)
    except OSError as error:
        with contextlib.suppress(OSError):  # what cannot be removed now is swept at the next start
            temporary.unlink(missing_ok=True)
        raise _store_error("write", path, error) from error


def _put_if_absent(temporary: Path, path: Path) -> None:
    try:
        os.link(temporary, path)
    except FileExistsError:
        return  # the name says what is in it: whoever was first wrote the same


def _flush(path: Path, mode: int) -> None:
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _store_error(action: str, path: Path, error: OSError) -> StoreError:
    return StoreError(
        f"cannot {action} {path}: {error.strerror or error}; what was committed is kept, "
        "run the same command again once this is mended"
    )
