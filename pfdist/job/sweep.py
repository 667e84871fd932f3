"""A sweep: a job, and the points at which it is run."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from pfdist.common.arguments import path_argument, texts_argument
from pfdist.common.explained import explained
from pfdist.common.section import Section
from pfdist.errors import JobError, shown_text
from pfdist.job.asked import Asked, as_job
from pfdist.job.job import Job, toml_of_file
from pfdist.job.points import Point, Values, dotted, points_of
from pfdist.job.sections import Execution
from pfdist.store import folder_of_run


class SweepFile(Section):
    """The content of a sweep file.

    Parameters
    ----------
    job : str
        Path of the job file, relative to the folder of the sweep file.
    change : mapping, optional
        Values of keys of the job that all points share.
    over : mapping, optional
        Values of each key. Every combination is a point.
    parallel : sequence of mappings, optional
        Groups of keys that change together.
    point : sequence of mappings, optional
        Further points.
    judge : bool
        Whether the times found at each point are judged at every point.
    """

    job: str
    change: dict[str, Any] = Field(default_factory=dict)
    over: dict[str, Any] = Field(default_factory=dict)
    parallel: list[dict[str, Any]] = Field(default_factory=list)
    point: list[dict[str, Any]] = Field(default_factory=list)
    judge: bool = False


@dataclass(frozen=True)
class SweepJob:
    """A job, and the points at which it is run.

    Parameters
    ----------
    name : str
        Name of the sweep's folder.
    points : tuple of Point
        In the order in which they are computed.
    jobs : mapping of str to Job
        The job of each point, by the point's name.
    judge : bool
        Whether the times found at each point are judged at every point.
    """

    name: str
    points: tuple[Point, ...]
    jobs: Mapping[str, Job]
    judge: bool = False

    @property
    def execution(self) -> Execution:
        """How all points are computed: they share the workers."""
        return next(iter(self.jobs.values())).execution


def read_sweep(
    asked: Asked,
    over: Values,
    parallel: Sequence[Values],
    points: Sequence[Values],
    changes: Iterable[str],
    settings: Mapping[str, Any],
) -> SweepJob:
    """Give the sweep of a sweep file, or of a job.

    Parameters
    ----------
    asked : Problem, Job, str or Path
        A sweep file, or a job as for `pfdist.job.asked.as_job`.
    over, parallel, points
        As for `pfdist.job.points.points_of`; those of a sweep file come first.
    changes : iterable of str
        Changes ``key=value`` of the job at all points.
    settings : mapping
        Values of keys of the job at all points, as for `pfdist.load_job`.

    Raises
    ------
    JobError
        A file cannot be read, a key or a value is wrong, or the job of a point is wrong; the error
        names the point.
    """
    changes = texts_argument("changes", changes)
    name, file = None, _sweep_file(asked)
    if file is not None:
        name, asked = Path(str(asked)).stem, Path(str(asked)).parent / file.job
        changes = [*Point("", dotted(file.change)).changes, *changes]
        over = {**dotted(file.over), **dotted(over)}
        parallel, points = [*file.parallel, *parallel], [*file.point, *points]
    job = as_job(asked, changes, settings=settings)
    found = points_of(over, parallel, points)
    given = {change.partition("=")[0].strip() for change in changes}
    for key in dict.fromkeys(key for point in found for key in point.chosen):
        if key in given:
            raise JobError(
                f"a key of a sweep must not be changed at all points, too, got {shown_text(key)}",
                argument="changes",
            )
    jobs = {}
    for point in found:
        try:
            jobs[point.name] = as_job(asked, [*changes, *point.changes], settings=settings)
        except JobError as error:
            raise JobError(f"the point {point.name} of the sweep: {error}") from error
    judge = file is not None and file.judge
    return SweepJob(name or f"{folder_of_run(job.path).name}-sweep", found, jobs, judge)


def _sweep_file(asked: Any) -> SweepFile | None:
    """The content of a sweep file; None for anything else."""
    if not isinstance(asked, str | Path):
        return None
    path = path_argument("job", asked)
    data = toml_of_file(path)
    if "job" not in data:
        return None
    try:
        return SweepFile(**data)
    except ValidationError as error:
        raise JobError(f"{explained(error, SweepFile)} ({path})") from error
