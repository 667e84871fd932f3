"""The files that identify a run, job.toml, model.json and run.json, its answers, and its key.

files.json has their hashes, which are checked when a run is read. Without files.json, the key and
the version of a run are read without this check, for error messages.
"""

import contextlib
import hashlib
import json
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from pfdist.common.parsing import (
    MOST_BYTES,
    MOST_BYTES_OF_MODELS,
    parse_json,
    parse_toml,
    text_of,
)
from pfdist.common.plugins import hooked
from pfdist.common.section import explained
from pfdist.common.streams import stream_key
from pfdist.errors import StoreError, shown
from pfdist.store import files
from pfdist.store.folder import ANSWERS, FILES, MODELS, holds_run, no_run
from pfdist.store.listing import change_listing, read_listing
from pfdist.store.schema import check_schema_version
from pfdist.store.tables import REMEDY

if TYPE_CHECKING:
    from pfdist.models import StateSpaceModel

_GROWS = dict.fromkeys(("comparison", *hooked("sections")), ("draws",))  # keys that may change


class _Recorded(BaseModel):
    """Base class of the parts of run.json, which other versions may extend."""

    model_config = ConfigDict(extra="allow", strict=True)


class _Processor(_Recorded):
    compiled_for: str
    model: str


class _Machine(_Recorded):
    node: str
    system: str
    cores: int


class _Names(_Recorded):
    z: list[Annotated[str, Field(min_length=1)]]
    y: list[Annotated[str, Field(min_length=1)]]


def _instant(text: str) -> str:
    try:
        datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"provenance.started must be a date, got {shown(text)}") from error
    return text


class _Computed(_Recorded):
    """The machine and the versions that computed a run."""

    python: str
    libraries: dict[str, str]
    machine: _Machine
    processor: _Processor


class _Provenance(_Computed):
    """The values that pages show; those without a default are in every run."""

    started: Annotated[str, AfterValidator(_instant)]
    command: list[str]
    execution: dict[str, str | int]
    name_of_model: str
    names: _Names
    angles: list[bool]
    continued_on: list[_Computed] = []
    declared: dict[str, str] = {}
    unproved: str = ""
    few_lines: str = ""
    lost_constants: dict[str, float] = {}
    on_the_way: str = ""
    taken: str = ""


class _Run(_Recorded):
    schema_version: int
    pfdist: str
    kernel: int
    engine: str
    model: str
    filter_model: str
    estimations: dict[str, dict[str, Any]]
    provenance: _Provenance


def _checked(path: Path, text: str) -> dict[str, Any]:
    """The content of a run.json, in which every value that is shown has its type."""
    try:
        run: dict[str, Any] = parse_json(text)
        _Run.model_validate(run)
    except ValidationError as error:
        raise unusable(path, "run.json", explained(error, _Run)) from error
    except ValueError as error:
        raise unreadable(path, "run.json", str(error)) from error
    return run


def read_run(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The contents of run.json and of job.toml.

    Raises `StoreError` if the folder does not hold a run, or if the run has another schema version
    or is damaged.
    """
    check_version_of(path)
    # A driver may replace a file between the readings: then the second attempt sees the new ones.
    for _ in range(2):
        texts = {name: _read(path, name) for name in ("run.json", "job.toml")}
        listing = read_listing(path)
        if listing is None:
            raise StoreError(
                f"{path / FILES} is missing, which lists the files of the run: run the same "
                "command again, which makes it from the files that are there"
            )
        damaged = [
            name for name in texts if _hash_of(texts[name]) not in listing.about.get(name, ())
        ]
        if not damaged:
            return _checked(path, texts["run.json"]), parse_toml(texts["job.toml"])
    name = FILES if len(damaged) == len(texts) else damaged[0]  # a list of another run fits neither
    raise unreadable(path, name, "its content has another hash")


def has_models(path: Path) -> bool:
    """Whether a folder holds a run with model.json and the list of its files."""
    return holds_run(path) and all((path / name).is_file() for name in (MODELS, FILES))


def read_models(path: Path) -> tuple["StateSpaceModel", "StateSpaceModel"]:
    """The truth and the filter's model of a run; they may be the same object.

    Raises `StoreError` if model.json is missing, damaged or too large.
    """
    # Imported here, so that commands that only read need no Numba.
    from pfdist.models.written import models_of  # noqa: PLC0415

    try:
        return models_of(check_models(path))
    except ValueError as error:
        raise unusable(path, MODELS, str(error)) from error


def read_listed(path: Path, name: str, most: int = MOST_BYTES) -> bytes:
    """The undamaged content of a run's model.json, or of an answer.

    Raises `StoreError` if it is missing, damaged, too large or not listed.
    """
    content: bytes = _read(path, name, most, bytes)
    listing = read_listing(path)
    if listing is not None and _hash_of(content) not in listing.about.get(name, ()):
        raise unreadable(path, name, "its content has another hash")
    return content


def check_models(path: Path) -> bytes:
    """The undamaged content of a run's model.json."""
    return read_listed(path, MODELS, MOST_BYTES_OF_MODELS)


def unreadable(path: Path, name: str, reason: str) -> StoreError:
    """The error for a run with a damaged job.toml, model.json or run.json, or a damaged answer."""
    remedies = {name: f"`{command} {path}` writes it again" for name, command in ANSWERS.items()}
    remedies[MODELS] = "remove it, and resume the run by its job"
    return StoreError(f"{path / name} is damaged: {reason}; {remedies.get(name, REMEDY)}")


def unusable(path: Path, name: str, reason: str) -> StoreError:
    """The error for a file with the right hash that this version or machine cannot use."""
    return StoreError(
        f"{path / name} is undamaged, but pfdist {version('pfdist')} on this machine cannot use "
        f"it: {reason} (run.json names the version that wrote it)"
    )


def _read(
    path: Path, name: str, most: int = MOST_BYTES, read: Callable[[bytes], Any] = text_of
) -> Any:
    with files.reading(path / name):
        try:
            return read(files.read_plain(path / name, most))
        except (FileNotFoundError, NotADirectoryError) as error:
            raise no_run(path, name) from error
        except ValueError as error:
            raise unreadable(path, name, str(error)) from error


def _hash_of(text: str | bytes) -> str:
    content = text.encode() if isinstance(text, str) else text
    return hashlib.sha256(content).hexdigest()


def write_about(path: Path, key: str, texts: Mapping[str, str]) -> None:
    """Write some of these files; run.json comes last, because it makes the folder a run."""
    change_listing(path, key, about={name: (_hash_of(text),) for name, text in texts.items()})
    for name in sorted(texts):
        files.write_file(path / name, partial(Path.write_text, data=texts[name], encoding="utf-8"))


def run_text(run: Mapping[str, Any]) -> str:
    """The text of run.json, from identity and provenance."""
    return json.dumps(run, indent=2) + "\n"


def add_to_provenance(path: Path, facts: Mapping[str, Any]) -> None:
    """Add facts to the provenance of a run whose lock is held."""
    run, _ = read_run(path)
    run["provenance"] |= facts
    write_about(path, run_key(path) or "", {"run.json": run_text(run)})


def key_of(identity: Mapping[str, Any], job: Mapping[str, Any]) -> str:
    """A hash of everything that must stay the same between two starts of a run.

    Every file of the run's tables has this key. `identity` is the content of run.json without the
    provenance, and `job` that of job.toml. Numbers of draws may grow, so they are left out.
    """
    without_growth = {
        name: {key: value for key, value in job[name].items() if key not in grown}
        for name, grown in _GROWS.items()
        if name in job
    }
    return f"{stream_key(identity, {**job, **without_growth}):016x}"


def run_key(path: Path) -> str | None:
    """The key of the run in a folder, which all files of its tables have; None without a run."""
    listing = read_listing(path)
    return None if listing is None else listing.run or None


def recorded_key(path: Path) -> str | None:
    """The key from run.json and job.toml, used if files.json is lost."""
    try:
        run, job = parse_json(_read(path, "run.json")), parse_toml(_read(path, "job.toml"))
        return key_of({k: v for k, v in run.items() if k != "provenance"}, job)
    except (KeyError, TypeError, AttributeError, ValueError):
        return None


def check_version_of(path: Path) -> None:
    """Raise `StoreError` if the schema version in run.json is another."""
    run: Any = None
    with contextlib.suppress(StoreError, OSError, ValueError):  # `read_run` reports such a file
        run = parse_json(text_of(files.read_plain(path / "run.json", MOST_BYTES)))
    if isinstance(run, dict):
        check_schema_version(path, run.get("schema_version"), run.get("pfdist"))
