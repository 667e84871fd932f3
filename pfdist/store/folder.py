"""Write the two files that say what a run is, job.toml and run.json, and find a run by them."""

import json
from pathlib import Path
from typing import Any

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.about import read_run
from pfdist.store.keys import ABOUT, keep_key
from pfdist.store.manifest import Manifest


def holds_run(path: Path) -> bool:
    """Whether a folder holds a run, which has a run.json."""
    try:
        return (path / "run.json").exists()
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from error


def write_job(path: Path, toml: str) -> None:
    """Write the resolved job."""
    _write(path / "job.toml", toml)


def write_run(path: Path, run: dict[str, Any], key: str) -> None:
    """Write identity and provenance, and the run's key, which outlives the file."""
    keep_key(path, key)
    _write(path / "run.json", json.dumps(run, indent=2) + "\n")


def add_to_provenance(path: Path, facts: dict[str, Any]) -> None:
    """Add facts to the provenance of a run whose lock is held."""
    run, _ = read_run(path)
    run["provenance"] |= facts
    _write(path / "run.json", json.dumps(run, indent=2) + "\n")


def confirm(path: Path, key: str) -> None:
    """Record job.toml and run.json in the manifest, if a kill prevented it before."""
    keep_key(path, key)
    manifest = Manifest(path)
    for name in ABOUT:
        try:
            stamp = f"0-{files.digest(path / name)}"
        except OSError as error:
            raise StoreError(f"cannot read {path / name}: {error.strerror}") from error
        manifest.settle(path / name, stamp, manifest.expect(path / name, stamp))


def _write(path: Path, text: str) -> None:
    manifest, prepared = Manifest(path.parent), files.prepare_text(path.parent, text)
    before = manifest.expect(path, prepared.stamp)
    files.give_name(prepared, path, replace=True)
    manifest.settle(path, prepared.stamp, before)
