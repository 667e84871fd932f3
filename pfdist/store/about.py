"""Reads run.json and job.toml of a run, which may have been edited or damaged."""

import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from pfdist.common.explained import explained
from pfdist.common.nearest import did_you_mean_path
from pfdist.common.parsing import parse_json, parse_toml, read_text
from pfdist.errors import StoreError, shown
from pfdist.store.schema import check_schema_version


class _Part(BaseModel):
    """Keys that are read; run.json may have others."""

    model_config = ConfigDict(frozen=True, extra="allow", strict=True)


def _is_path_text(value: Any) -> Any:
    if not isinstance(value, str) or "\0" in value:
        raise ValueError(f"provenance.folder must be a path, got {shown(value)}")
    return value


# A path need not be UTF-8, which pydantic's own strings must be.
_PathText = Annotated[Any, AfterValidator(_is_path_text)]


class _Processor(_Part):
    """The versions and the machine with which a run was computed."""

    model: str
    compiled_for: str


class _Estimation(_Part):
    """The estimator with which a search began."""

    particles: int
    resampling: str
    estimator: str


class _Provenance(_Part):
    """Where and when a run was started."""

    started: str
    folder: _PathText
    python: str
    libraries: dict[str, str]
    processor: _Processor
    continued_on: list[_Processor] = []


class _RunFile(_Part):
    """The part of run.json that is read."""

    schema_version: Annotated[int, Field(ge=1)]
    pfdist: str
    kernel: int
    engine: str
    model: dict[str, Any]
    filter_model: dict[str, Any]
    estimations: dict[str, _Estimation]
    provenance: _Provenance


def read_run(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read run.json, which is checked, and job.toml, whose meaning the caller checks.

    Raises
    ------
    StoreError
        The folder holds no run, or one that cannot be read.
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
    """Make the error of a run whose run.json or job.toml pfdist did not write."""
    return StoreError(
        f"cannot read {path / name}: {reason}; `pfdist verify {path}` says which files are not "
        "what was committed, and the job, run again, makes them anew"
    )


def is_kept_job(job_file: Path) -> bool:
    """Whether a job file is the job.toml that a run keeps in its folder."""
    return job_file.name == "job.toml" and _has_run_json(job_file.parent)


def folder_of_run(job_file: Path) -> Path:
    """Give the folder of a job's run: results/NAME for NAME.toml.

    The run of a kept job.toml is the run that keeps it.
    """
    if not is_kept_job(job_file):
        return Path("results") / job_file.stem
    folder = job_file.parent
    return folder if folder.name not in ("", "..") else Path(os.path.abspath(folder))


def no_run(path: Path, lacking: str = "run.json") -> StoreError:
    """Make the error of a folder that lacks a file of a run; it names a run that may be meant."""
    if path.suffix == ".toml" and path.is_file():
        run = folder_of_run(path)
        return StoreError(f"a run must be a folder, got the job file {path}: its run is {run}")
    meant = did_you_mean_path(path, (path.parent, Path("results")), _has_run_json)
    return StoreError(f"{path} holds no run: there is no {lacking} in it{meant}")


def _has_run_json(path: Path) -> bool:
    return (path / "run.json").is_file()


def _read(path: Path, name: str, parse: Any) -> Any:
    try:
        return parse(read_text(path / name))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise no_run(path, name) from error
    except OSError as error:
        raise StoreError(f"cannot read {path / name}: {error.strerror}") from error
    except ValueError as error:
        raise unreadable(path, name, str(error)) from error
