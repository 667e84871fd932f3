"""A problem, a job, or a path of one: a public function takes each of them."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pfdist.common.arguments import texts_argument
from pfdist.errors import JobError, shown
from pfdist.problem.job import Job, load_job
from pfdist.problem.problem import Problem

JobSource = Problem | Job | str | Path
"""A problem, a job, or the path of a job file or of a run's folder."""
_NOTHING: Mapping[str, Any] = MappingProxyType({})


def as_job(
    source: JobSource,
    overrides: Iterable[str] = (),
    sections: Mapping[str, Any] = _NOTHING,
    settings: Mapping[str, Any] = _NOTHING,
) -> Job:
    """The job of a problem or of a file, or a job itself, with changes.

    The arguments and errors are those of `pfdist.load_job`.
    """
    overrides = texts_argument("changes", overrides)
    if isinstance(source, str | Path):
        return load_job(source, overrides, sections, settings)
    if not isinstance(source, Problem | Job):
        raise JobError(
            "a job must be a pfdist.Problem, a pfdist.Job or the path of a job file, got "
            f"{shown(source)}",
            argument="job",
        )
    job = source.job() if isinstance(source, Problem) else source
    changed = overrides or sections or settings
    return job.with_changes(overrides, sections, settings) if changed else job
