"""What a run's folder says the run is: run.json and job.toml, both checked."""

from pathlib import Path
from typing import Any

from pfdist.errors import JobError
from pfdist.job.job import Job
from pfdist.store import read_run, unreadable


def read_recorded(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read run.json, and the job of job.toml, which is held to the rules of every job.

    Raises
    ------
    StoreError
        The folder holds no run, or one that cannot be read; the error names the file.
    """
    run, job = read_run(path)
    try:
        return run, Job(**job).identity()  # with every key, whatever was taken out of the file
    except JobError as error:
        raise unreadable(path, "job.toml", str(error)) from error
