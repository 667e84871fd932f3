"""The files that say what a run is, run.json and job.toml, and the key of the run.

They may have been edited or damaged, so everything that is read is checked.
"""

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from pfdist.common.parsing import parse_json, parse_toml, read_text
from pfdist.common.section import explained
from pfdist.common.streams import stream_key
from pfdist.errors import StoreError, shown
from pfdist.store import files
from pfdist.store.folder import ABOUT, MANIFEST, is_plain_file, no_run
from pfdist.store.manifest import Manifest
from pfdist.store.schema import check_schema_version

_GROWS = {"comparison": ("draws", "until"), "online": ("draws",)}  # keys that may change


class _Part(BaseModel):
    """Keys that pfdist reads; run.json may have others."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)


def _is_path_text(value: Any) -> Any:
    if not isinstance(value, str) or "\0" in value:
        raise ValueError(f"provenance.folder must be a path, got {shown(value)}")
    return value


# A path need not be UTF-8, which pydantic's own strings must be.
_PathText = Annotated[Any, AfterValidator(_is_path_text)]


class _Processor(_Part):
    """The processor on which a run was computed."""

    model: str
    compiled_for: str


class _Estimation(_Part):
    """The estimation with which a search began."""

    particles: int
    resampling: str
    estimator: str
    threshold: float | None = None


class _Provenance(_Part):
    """Where and when a run was started."""

    started: str
    folder: _PathText
    python: str
    libraries: dict[str, str]
    name_of_model: str = ""  # as the model calls itself; older runs have none
    processor: _Processor
    continued_on: list[_Processor] = []
    unproved: str = ""  # why there is no lower bound, although one was asked for


class _RunFile(_Part):
    """The part of run.json that pfdist reads."""

    schema_version: Annotated[int, Field(ge=1)]
    pfdist: str
    kernel: int
    engine: str
    model: dict[str, Any]
    filter_model: dict[str, Any]
    estimations: dict[str, _Estimation]
    provenance: _Provenance


def read_run(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The contents of run.json, which is checked, and of job.toml, which the caller checks.

    Raises `StoreError` if the folder holds no run, or one that cannot be read.
    """
    run, job = (
        _read(path, name, parse)
        for name, parse in (("run.json", parse_json), ("job.toml", parse_toml))
    )
    if not isinstance(run, dict):
        raise unreadable(path, "run.json", "it must be one JSON object")
    check_schema_version(path, run.get("schema_version"))
    try:
        _RunFile.model_validate(run)
    except ValidationError as error:
        raise unreadable(path, "run.json", explained(error, _RunFile)) from error
    return run, job


def unreadable(path: Path, name: str, reason: str) -> StoreError:
    """The error for a run whose run.json or job.toml pfdist did not write."""
    return StoreError(
        f"cannot read {path / name}: {reason}; `pfdist verify {path}` says which files are not "
        "what was committed, and the job, run again, makes them anew"
    )


def _read(path: Path, name: str, parse: Any) -> Any:
    with files.reading(path / name):
        try:
            return parse(read_text(path / name))
        except (FileNotFoundError, NotADirectoryError) as error:
            raise no_run(path, name) from error
        except ValueError as error:
            raise unreadable(path, name, str(error)) from error


def write_job(path: Path, toml: str) -> None:
    """Write the resolved job."""
    _write(path / "job.toml", toml)


def write_run(path: Path, run: dict[str, Any], key: str) -> None:
    """Write identity and provenance, and the run's key, which outlives the file.

    The key goes into the manifest first. If the process dies in between, the key stands there
    without a run.json, and the next start of the same job finds its own key.
    """
    Manifest(path).record_key(key)
    _write(path / "run.json", json.dumps(run, indent=2) + "\n")


def add_to_provenance(path: Path, facts: dict[str, Any]) -> None:
    """Add facts to the provenance of a run whose lock is held."""
    run, _ = read_run(path)
    run["provenance"] |= facts
    _write(path / "run.json", json.dumps(run, indent=2) + "\n")


def confirm(path: Path, key: str) -> None:
    """Record job.toml, run.json and the key in the manifest.

    A kill between the renaming of a file and the line ``now`` may have prevented this before.
    """
    manifest = Manifest(path)
    manifest.record_key(key)
    for name in ABOUT:
        manifest.confirm(path / name)


def _write(path: Path, text: str) -> None:
    prepared = files.prepare(path.parent, lambda file: file.write_text(text, encoding="utf-8"))
    Manifest(path.parent).give_name(prepared, path)


def key_of(identity: Mapping[str, Any], job: Mapping[str, Any]) -> str:
    """Hash of everything that must not change between two starts of a run.

    Every file of the run's tables carries this key. `identity` is the content of run.json without
    the provenance, and `job` that of job.toml. Numbers of draws may grow, so they are left out.
    """
    without_growth = {
        name: {key: value for key, value in job[name].items() if key not in grown}
        for name, grown in _GROWS.items()
        if name in job
    }
    return f"{stream_key(identity, {**job, **without_growth}):016x}"


def has_key(path: Path, key: str) -> bool:
    """Whether the run in a folder was started with this key."""
    return key in (Manifest(path).recorded_key(), own_key(path))


def own_key(path: Path) -> str | None:
    """The key that job.toml and run.json give; None if they are missing or damaged."""
    expected = Manifest(path).expected()
    try:
        for name in ABOUT:
            file = path / name
            if not is_plain_file(file) or files.digest(file) not in expected.get(Path(name), ()):
                return None
        return _key_of_content(*read_run(path))
    except (OSError, StoreError):  # `read_run` reports such a file
        return None


def check_key(path: Path, run: dict[str, Any], job: dict[str, Any]) -> None:
    """Raise a `StoreError` if run.json and job.toml are another run's.

    They are if the manifest has other contents for them, and another key: then these two files came
    here from another run.
    """
    key = Manifest(path).recorded_key()
    if key and _key_of_content(run, job) not in (None, key) and own_key(path) is None:
        raise StoreError(
            f"{path}: job.toml and run.json are not those of the run whose key {MANIFEST} holds; "
            f"`pfdist repair {path}` moves to quarantine what is not this run's"
        )


def _key_of_content(run: dict[str, Any], job: dict[str, Any]) -> str | None:
    try:
        return key_of({k: v for k, v in run.items() if k != "provenance"}, job)
    except (KeyError, TypeError, AttributeError):
        return None


def run_key(path: Path) -> str | None:
    """Key of the run in a folder, which each of its tables' files carries.

    It stands in the manifest and follows from job.toml and run.json. If the two contradict each
    other, the files of several runs lie in one folder. The key is None if there is no run yet, or
    if its start was cut short. Raises `StoreError` if the run has another schema version, or if the
    manifest has the key of another run, or none.
    """
    manifest = Manifest(path)
    if manifest.exists() and not is_plain_file(path / MANIFEST):
        check_version_of(path)  # up to version 2 the manifest was a folder
        return None  # a strange entry, which `check_entries` names before any file is read
    key, own = manifest.recorded_key(), own_key(path)
    if key is not None and own in (None, key):
        return key
    if key is None:
        check_version_of(path)
        if own is None and not (path / "run.json").exists():
            return None
        if not manifest.exists():
            raise StoreError(
                f"{path} has lost its manifest, which says what its files must hold: put it back, "
                "or choose another folder for the results"
            )
    given = f"the key {own}, which job.toml and run.json give" if own else "the run's key"
    raise StoreError(
        f"{path / MANIFEST} must hold {given}, got {key or 'none'}: files of another run may lie "
        f"here; `pfdist repair {path}` moves them to quarantine"
    )


def check_version_of(path: Path) -> None:
    """Raise a `StoreError` if run.json says that the run is of another schema version."""
    run: Any = None
    with contextlib.suppress(OSError, ValueError):  # `read_run` reports such a file
        if is_plain_file(path / "run.json"):
            run = parse_json(read_text(path / "run.json"))
    if isinstance(run, dict):
        check_schema_version(path, run.get("schema_version"))
