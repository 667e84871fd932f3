"""Write the two files that say what a run is, job.toml and run.json, and find a run by them."""

import json
from pathlib import Path
from typing import Any

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.about import read_run
from pfdist.store.manifest import FOLDER, Manifest

ABOUT = ("job.toml", "run.json")
_KEY = f"{FOLDER}/run"


def holds_run(path: Path) -> bool:
    """Whether a folder holds a run: run.json is the file that is written last."""
    try:
        return (path / "run.json").exists()
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from error


def write_job(path: Path, toml: str) -> None:
    """Write the resolved job."""
    _write(path / "job.toml", toml)


def write_run(path: Path, run: dict[str, Any], key: str) -> None:
    """Write identity and provenance, and the run's key, which outlives the file."""
    _keep_key(path, key)
    _write(path / "run.json", json.dumps(run, indent=2) + "\n")


def run_key(path: Path) -> str | None:
    """Key of the run in a folder, which each of its tables' files carries.

    The key is a hash of the run's identity. None where there is no run yet, where its start was cut
    short, or where the run is of schema version 2 or 1, whose files carry no key.
    """
    keys = [entry.name for entry in (path / _KEY).glob("*")]
    return keys[0] if len(keys) == 1 else None


def add_to_provenance(path: Path, facts: dict[str, Any]) -> None:
    """Write more facts into the provenance of a run, which is held."""
    run, _ = read_run(path)
    run["provenance"] = {**run.get("provenance", {}), **facts}
    _write(path / "run.json", json.dumps(run, indent=2) + "\n")


def has_key(path: Path, key: str) -> bool:
    """Whether the run in a folder was started with this key."""
    return (path / _KEY / key).exists()


def confirm(path: Path, key: str) -> None:
    """Say that job.toml and run.json are what they are to be: a kill may have come in between."""
    _keep_key(path, key)
    manifest = Manifest(path)
    for name in ABOUT:
        try:
            stamp = f"0-{files.digest(path / name)}"
        except OSError as error:
            raise StoreError(f"cannot read {path / name}: {error.strerror}") from error
        manifest.settle(path / name, stamp, manifest.expect(path / name, stamp))


def _keep_key(path: Path, key: str) -> None:
    files.touch(path / _KEY / key)
    for other in (path / _KEY).glob("*"):  # of a start that was cut short
        if other.name != key:
            files.remove(other)


def _write(path: Path, text: str) -> None:
    manifest, prepared = Manifest(path.parent), files.prepare_text(path.parent, text)
    before = manifest.expect(path, prepared.stamp)
    files.give_name(prepared, path, replace=True)
    manifest.settle(path, prepared.stamp, before)
