"""The description of a run in its folder: run.json and job.toml, both checked."""

from pathlib import Path
from typing import Any

from pfdist.errors import JobError
from pfdist.job.job import Job
from pfdist.store import check_key, read_run, unreadable


def read_recorded(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Content of run.json, and the job of job.toml, which is validated as every job is.

    Raises
    ------
    StoreError
        The folder holds no run, a file cannot be read, or the files are another run's than the
        tables.
    """
    run, job = read_run(path)
    try:
        identity = Job(**job).identity()  # with every key, even if the file lacks some
    except JobError as error:
        raise unreadable(path, "job.toml", str(error)) from error
    check_key(path, run, job)
    return run, identity
