"""The key of a run: a hash of what the run is, which each file of its tables carries.

``manifest/run/<key>`` keeps the key. It also follows from job.toml and run.json. Where the two
contradict each other, or several keys are kept, the files of several runs lie in one folder.
"""

import json
import os
import stat
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pfdist.common.streams import stream_key
from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.manifest import FOLDER, Manifest
from pfdist.store.tables import signed_by

ABOUT = ("job.toml", "run.json")
SIGNED_SINCE = 3
"""The first version of the schema whose files carry a key."""
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

    It is None if the files are missing or damaged, or if the run's files carry no key.
    """
    run, job = _about(path)
    if run is None or job is None or _version(run) < SIGNED_SINCE:
        return None
    try:
        return key_of({k: v for k, v in run.items() if k != "provenance"}, job)
    except (KeyError, TypeError, AttributeError):
        return None


def run_key(path: Path) -> str | None:
    """Key of the run in a folder, which each of its tables' files carries.

    None where there is no run yet, where its start was cut short, or where the run is of schema
    version 2 or 1, whose files carry no key.

    Raises
    ------
    StoreError
        The folder keeps the keys of several runs, that of another run, or none where its files
        carry one.
    """
    if any((path / folder).is_symlink() for folder in (FOLDER, _KEY)):
        return None  # as of every strange entry: it is named before any file is read
    keys, own = kept_keys(path), own_key(path)
    if len(keys) == 1 and own in (None, keys[0]):
        return keys[0]
    if own is None and not keys and (_is_older(path) or not _is_signed(path)):
        return None
    if own is None and not (path / "run.json").exists() and not any(_tables(path)):
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


def _about(path: Path) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
    """The contents of run.json and job.toml; None for a file that is not as committed."""
    return (
        _committed(path / "run.json", json.loads),
        _committed(path / "job.toml", tomllib.loads),
    )


def _committed(path: Path, read: Any) -> dict[str, Any] | None:
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


def _version(run: Mapping[str, Any]) -> int:
    version = run.get("schema_version")
    return version if isinstance(version, int) else SIGNED_SINCE


def _is_older(path: Path) -> bool:
    """Whether the run is of a version whose files carry no key."""
    run, _ = _about(path)
    return run is not None and _version(run) < SIGNED_SINCE


def _is_signed(path: Path) -> bool:
    """Whether any file of a table carries a key."""
    for file in _tables(path):
        try:
            if signed_by(file) is not None:
                return True
        except (StoreError, FileNotFoundError):  # damaged, or published meanwhile
            continue
    return False


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
