"""The key of a run: a hash of what the run is, which each file of its tables carries.

``manifest/run/<key>`` keeps the key. It also follows from job.toml and run.json. Where the two
contradict each other, or several keys are kept, the files of several runs lie in one folder.
"""

import contextlib
import json
import os
import stat
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pfdist.common.parsing import parse_json, read_text
from pfdist.common.streams import stream_key
from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.manifest import FOLDER, Manifest
from pfdist.store.schema import check_schema_version

ABOUT = ("job.toml", "run.json")
_KEY = f"{FOLDER}/run"
_GROWS = {"comparison": ("draws", "until"), "online": ("draws",)}  # keys that may change


def key_of(identity: Mapping[str, Any], job: Mapping[str, Any]) -> str:
    """Hash everything that must not change between two starts of a run.

    Parameters
    ----------
    identity : mapping
        The content of run.json, without the provenance.
    job : mapping
        The content of job.toml.
    """
    kept = {
        name: {key: value for key, value in job[name].items() if key not in grown}
        for name, grown in _GROWS.items()
        if name in job
    }
    return f"{stream_key(identity, {**job, **kept}):016x}"


def kept_keys(path: Path) -> list[str]:
    """Keys that the manifest of a run's folder keeps."""
    return sorted(entry.name for entry in (path / _KEY).glob("*"))


def has_key(path: Path, key: str) -> bool:
    """Whether the run in a folder was started with this key."""
    return (path / _KEY / key).exists()


def keep_key(path: Path, key: str) -> None:
    """Record the key of a run, and remove other keys."""
    files.touch(path / _KEY / key)
    for other in (path / _KEY).glob("*"):
        if other.name != key:
            files.remove(other)


def own_key(path: Path) -> str | None:
    """Compute the key of a run from job.toml and run.json.

    It is None if the files are missing or damaged.
    """
    run = _committed(path / "run.json", json.loads)
    job = _committed(path / "job.toml", tomllib.loads)
    if run is None or job is None:
        return None
    try:
        return key_of({k: v for k, v in run.items() if k != "provenance"}, job)
    except (KeyError, TypeError, AttributeError):
        return None


def run_key(path: Path) -> str | None:
    """Key of the run in a folder, which each of its tables' files carries.

    None where there is no run yet, or where its start was cut short.

    Raises
    ------
    StoreError
        The run is of another schema version; or the folder keeps the keys of several runs, that of
        another run, or none.
    """
    if any((path / folder).is_symlink() for folder in (FOLDER, _KEY)):
        return None  # as of every strange entry: it is named before any file is read
    keys, own = kept_keys(path), own_key(path)
    if len(keys) == 1 and own in (None, keys[0]):
        return keys[0]
    if not keys:
        check_version_of(path)
    begun = (path / "run.json").exists() or (keys and any(_tables(path)))
    if own is None and not begun:
        return None
    if not (path / FOLDER).exists():
        raise StoreError(
            f"{path} has lost its folder manifest, which says what its files must hold: put it "
            "back, or choose another folder for the results"
        )
    got = f"{len(keys)} keys" if len(keys) > 1 else keys[0] if keys else "none"
    given = f"the key {own}, which job.toml and run.json give" if own else "one run's key"
    raise StoreError(
        f"{path / _KEY} must hold {given}, got {got}: files of another run may lie here; "
        f"`pfdist repair {path}` moves them to quarantine"
    )


def check_version_of(path: Path) -> None:
    """Raise a `StoreError` if run.json says that the run is of another schema version."""
    run: Any = None
    with contextlib.suppress(OSError, ValueError):  # `read_run` reports such a file
        if _is_file(path / "run.json"):
            run = parse_json(read_text(path / "run.json"))
    if isinstance(run, dict):
        check_schema_version(path, run.get("schema_version"))


def _committed(path: Path, read: Any) -> dict[str, Any] | None:
    """Content of run.json or job.toml; None if the file is not as committed."""
    try:
        if not _is_file(path):
            return None
        expected = Manifest(path.parent).stamps_of(path)
        if files.digest(path) not in {stamp.partition("-")[2] for stamp in expected}:
            return None
        found = read(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):  # `read_run` reports such a file
        return None
    return found if isinstance(found, dict) else None


def _tables(path: Path) -> Iterator[Path]:
    for folder in ("tables", "parts"):
        if not (path / folder).is_symlink():
            yield from filter(_is_file, (path / folder).glob("*/[!.]*.parquet"))


def _is_file(path: Path) -> bool:
    """Whether a path is a plain file; nothing else is opened."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except OSError:
        return False
