"""A problem, a job, or the path of a job file: a public function takes each of them."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pfdist.common.arguments import texts_argument
from pfdist.errors import JobError, shown
from pfdist.job.job import Job, load_job
from pfdist.job.problem import Problem

Asked = Problem | Job | str | Path
"""A problem, a job, or the path of a job file."""
_NOTHING: Mapping[str, Any] = MappingProxyType({})


def as_job(
    asked: Asked,
    overrides: Iterable[str] = (),
    sections: Mapping[str, Any] = _NOTHING,
    settings: Mapping[str, Any] = _NOTHING,
) -> Job:
    """Give the job of a problem or of a file, or a job, with changes.

    Parameters and errors are those of `pfdist.load_job`.
    """
    overrides = texts_argument("changes", overrides)
    if isinstance(asked, str | Path):
        return load_job(asked, overrides, sections, settings)
    if not isinstance(asked, Problem | Job):
        raise JobError(
            "a job must be a pfdist.Problem, a pfdist.Job or the path of a job file, got "
            f"{shown(asked)}",
            argument="job",
        )
    job = asked.job() if isinstance(asked, Problem) else asked
    changed = overrides or sections or settings
    return job.with_changes(overrides, sections, settings) if changed else job
