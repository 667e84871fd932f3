"""A sweep: a job, and the points at which it is run."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from pfdist.common.arguments import address_fault, path_argument, texts_argument
from pfdist.common.section import JobSection, Listed, Whole, explained
from pfdist.errors import ArgumentError, JobError, shown, shown_text
from pfdist.plugins.sweep.sweep_points import Point, Values, dotted, points_of, values_by_key
from pfdist.problem.job import Job, toml_of_file
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.sections import Execution
from pfdist.store import folder_of_run

START_SECONDS = 10.0
"""Rough time that a process on a new node needs to load and compile everything."""


SweepPart = Annotated[Listed[Whole], Field(min_length=2, max_length=2)]
"""Part K of N of a sweep, as (K, N)."""


class SweepFile(JobSection):
    """The content of a sweep file.

    Parameters
    ----------
    job : str
        Path of the job file, relative to the folder of the sweep file.
    change : dict of str to value
        Values of job keys that all points share.
    over : dict of str to list
        Values of each key; every combination is a point, and the last key changes fastest.
    point : list of dict
        Further points, for instance where values of two keys belong together.
    """

    job: str
    change: dict[str, Any] = Field(default_factory=dict)
    over: dict[str, Any] = Field(default_factory=dict)
    point: list[dict[str, Any]] = Field(default_factory=list)


@dataclass(frozen=True)
class SweepJob:
    """A job, and the points at which it is run."""

    name: str  # of the sweep's folder
    points: tuple[Point, ...]  # in the order in which they are computed
    jobs: Mapping[str, Job]  # of each point, by its name

    @property
    def execution(self) -> Execution:
        """How all points are computed: they share the workers."""
        return next(iter(self.jobs.values())).execution

    def part(self, part: SweepPart | None) -> "SweepJob":
        """Part k of n: every n-th point, from the k-th; None is the whole sweep.

        Raises
        ------
        ArgumentError
            There is no such part, or it has no point.
        """
        if part is None:
            return self
        number, parts = part
        if not 1 <= number <= parts <= len(self.points):
            raise ArgumentError(
                f"part must be K/N with 1 <= K <= N <= {len(self.points)}, the number of points, "
                f"got {shown(number)}/{shown(parts)}",
                argument="part",
            )
        points = self.points[number - 1 :: parts]
        return replace(
            self, points=points, jobs={each.name: self.jobs[each.name] for each in points}
        )


def parts_that_pay(seconds: Sequence[float]) -> int:
    """The largest number of parts of a sweep that are busy for at least half of their time.

    Parts begin together. Each needs some time to start, and then all wait for the longest.

    Parameters
    ----------
    seconds : sequence of float
        How long each point takes a worker; 0 if it is finished.

    Examples
    --------
    >>> parts_that_pay([600.0] * 12), parts_that_pay([1.0] * 12), parts_that_pay([600.0, 1.0, 1.0])
    (12, 1, 1)
    """
    work = np.asarray(seconds, float)
    for parts in range(len(work), 1, -1):
        longest = np.bincount(np.arange(len(work)) % parts, work).max() + START_SECONDS
        if work.sum() >= parts * longest / 2:
            return parts
    return 1


def read_sweep(
    source: JobSource,
    over: Values,
    points: Sequence[Values],
    changes: Iterable[str],
    settings: Mapping[str, Any],
) -> SweepJob:
    """The sweep of a sweep file, or of a job as for `pfdist.problem.problem.as_job`.

    `over` and `points` are as for `points_of`; those of a sweep file come first.
    Changes ``key=value`` and settings, as for `pfdist.load_job`, apply at all points. Raises
    `JobError` if a file cannot be read, if a key or a value is wrong, or if the job of a point is
    wrong; then it names the point.
    """
    changes = texts_argument("changes", changes)
    if isinstance(over, str | list):
        over = values_by_key(texts_argument("over", over))
    name, file = None, _sweep_file(source)
    if file is not None:
        if fault := address_fault(file.job):
            raise JobError(f"job {fault} ({source})")
        name, source = Path(str(source)).stem, Path(str(source)).parent / file.job
        changes = [*Point("", dotted(file.change)).changes, *changes]
        over = {**dotted(file.over), **dotted(over)}
        points = [*file.point, *points]
    job = as_job(source, changes, settings=settings)
    sweep_points = points_of(over, points)
    given = {change.partition("=")[0].strip() for change in changes}
    for key in dict.fromkeys(key for point in sweep_points for key in point.chosen):
        if key in given:
            raise JobError(
                f"a key of the sweep must not also be changed at all points, got {shown_text(key)}",
                argument="set",
            )
    jobs = {}
    for point in sweep_points:
        try:
            jobs[point.name] = as_job(source, [*changes, *point.changes], settings=settings)
        except JobError as error:
            raise JobError(f"the point {point.name} of the sweep: {error}") from error
    return SweepJob(name or f"{folder_of_run(job.path).name}-sweep", sweep_points, jobs)


def _sweep_file(source: Any) -> SweepFile | None:
    """The content of a sweep file; None for anything else."""
    if not isinstance(source, str | Path):
        return None
    path = path_argument("job", source)
    data = toml_of_file(path)
    if "job" not in data:
        return None
    try:
        return SweepFile(**data)
    except ValidationError as error:
        raise JobError(f"{explained(error, SweepFile)} ({path})") from error
