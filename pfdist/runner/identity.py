"""What a run is, and whether the folder at hand holds that run."""

import os
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pfdist.errors import RunMismatchError, StoreError
from pfdist.job import Job, job_toml
from pfdist.particle_filter import KERNEL_VERSION
from pfdist.runner.build import Built
from pfdist.store import SCHEMA_VERSION, Store, holds_run, read_run, write_job, write_run

_LIBRARIES = ("numpy", "scipy", "numba", "ray", "pandas", "pyarrow", "matplotlib")


def open_store(path: Path, built: Built) -> Store:
    """Open a run's folder for computing: make it, or check that it holds this run.

    Parameters
    ----------
    path : Path
    built : Built

    Raises
    ------
    RunMismatchError
        It holds a run of something else.
    StoreError
        It cannot be read or written, or holds other things than a run.
    """
    identity, store = _identity(built), Store(path)
    if not holds_run(path):
        _check_free(path)
        write_job(path, job_toml(built.job.identity()))
        write_run(path, {**identity, "provenance": _provenance(built.job)})
    else:
        run, job = read_run(path)
        before = {"job": job} | {key: run.get(key) for key in identity}
        now = {"job": built.job.identity(), **identity}
        committed = int(store.column("comparison", "draw").max(initial=-1)) + 1
        _check_same(path, before, now, committed)
        if job != built.job.identity():  # comparison.draws is another
            write_job(path, job_toml(built.job.identity()))
    store.sweep()
    return store


def _identity(built: Built) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "pfdist": version("pfdist"),
        "kernel": KERNEL_VERSION,
        "engine": built.source.engine,
        "model_sha256": built.source.model.source.sha256,
        "filter_model_sha256": built.source.filter_model.source.sha256,
    }


def _check_free(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise StoreError(f"--results must be a folder, got the file {path}")
    # job.toml alone is what a start leaves that was killed before it wrote run.json.
    strange = {entry.name for entry in path.glob("[!.]*")} - {"job.toml"}
    if strange:
        raise StoreError(
            f"--results must be a new folder, an empty one or a run's, got {path} "
            f"with {', '.join(sorted(strange)[:3])} in it"
        )


def _check_same(path: Path, before: dict[str, Any], now: dict[str, Any], committed: int) -> None:
    old, new = dict(_flat(before)), dict(_flat(now))
    differences = []
    for key in sorted(old.keys() | new.keys()):
        was, is_ = old.get(key, "nothing"), new.get(key, "nothing")
        if was == is_ or (key == "job.comparison.draws" and is_ >= committed):
            continue
        if key == "job.comparison.draws":
            was = f"{committed} committed"
        differences.append(f"{key.removeprefix('job.')}: {was} -> {is_}")
    if differences:
        raise RunMismatchError(
            f"{path} holds another run (give --results another folder): the run's -> this one's",
            tuple(differences),
        )


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Leaves of nested mappings and lists, each under its dotted key."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        names = [inner.get("name") for inner in value if isinstance(inner, Mapping)]
        yield f"{key}.order", ", ".join(map(str, names))
        for index, inner in enumerate(value):
            name = inner.get("name", index) if isinstance(inner, Mapping) else index
            yield from _flat(inner, f"{key}.{name}")
    else:
        yield key, value


def _provenance(job: Job) -> dict[str, Any]:
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in _LIBRARIES},
        "machine": {
            "node": platform.node(),
            "system": platform.platform(),
            "cores": len(os.sched_getaffinity(0)),
        },
        "git": _git(job.path.parent),
        "execution": job.execution.model_dump(mode="json"),
    }


def _git(folder: Path) -> dict[str, Any] | None:
    """Commit of the repository that holds the job file, and whether it has changes."""
    try:
        commit, changes = (
            subprocess.run(  # noqa: S603
                ["git", *arguments],  # noqa: S607  the user's own
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=10,
                check=True,
            ).stdout.strip()
            for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain"])
        )
    except (OSError, subprocess.SubprocessError):
        return None  # no git, or no repository: provenance says so
    return {"commit": commit, "dirty": bool(changes)}
