"""A sweep: a job, the points at which it is run, and jobs that compare all found times there."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError

from pfdist.common.arguments import address_fault, path_argument, texts_argument
from pfdist.common.clock import Time
from pfdist.common.section import Listed, Section, Whole, explained
from pfdist.common.streams import stream_key
from pfdist.errors import ArgumentError, JobError, shown, shown_text
from pfdist.problem.job import Job, toml_of_file
from pfdist.problem.points import Point, Values, dotted, points_of
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.sections import Execution
from pfdist.store import folder_of_run

START_SECONDS = 10.0
"""Rough time that a process on a new node needs to load and compile everything."""


Part = Annotated[Listed[Whole], Field(min_length=2, max_length=2)]
"""Part K of N of a sweep, as (K, N)."""


class SweepFile(Section):
    """The content of a sweep file.

    Parameters
    ----------
    job : str
        Path of the job file, relative to the folder of the sweep file.
    change : dict of str to value
        Values of job keys that all points share.
    over : dict of str to list
        Values of each key; every combination is a point, and the last key changes fastest.
    parallel : list of dict
        Groups of keys whose values change together. Each group is combined with the other keys.
    point : list of dict
        Further points.
    judge : bool
        Whether the times found at each point are compared at every point.
    """

    job: str
    change: dict[str, Any] = Field(default_factory=dict)
    over: dict[str, Any] = Field(default_factory=dict)
    parallel: list[dict[str, Any]] = Field(default_factory=list)
    point: list[dict[str, Any]] = Field(default_factory=list)
    judge: bool = False


@dataclass(frozen=True)
class SweepJob:
    """A job, and the points at which it is run."""

    name: str  # of the sweep's folder
    points: tuple[Point, ...]  # in the order in which they are computed
    jobs: Mapping[str, Job]  # of each point, by its name
    judge: bool = False  # whether the times found at each point are judged at every point

    @property
    def execution(self) -> Execution:
        """How all points are computed: they share the workers."""
        return next(iter(self.jobs.values())).execution

    def part(self, part: Part | None) -> "SweepJob":
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
    parallel: Sequence[Values],
    points: Sequence[Values],
    changes: Iterable[str],
    settings: Mapping[str, Any],
) -> SweepJob:
    """The sweep of a sweep file, or of a job as for `pfdist.problem.problem.as_job`.

    `over`, `parallel` and `points` are as for `points_of`; those of a sweep file come first.
    Changes ``key=value`` and settings, as for `pfdist.load_job`, apply at all points. Raises
    `JobError` if a file cannot be read, if a key or a value is wrong, or if the job of a point is
    wrong; then it names the point.
    """
    changes = texts_argument("changes", changes)
    name, file = None, _sweep_file(source)
    if file is not None:
        if fault := address_fault(file.job):
            raise JobError(f"job {fault} ({source})")
        name, source = Path(str(source)).stem, Path(str(source)).parent / file.job
        changes = [*Point("", dotted(file.change)).changes, *changes]
        over = {**dotted(file.over), **dotted(over)}
        parallel, points = [*file.parallel, *parallel], [*file.point, *points]
    job = as_job(source, changes, settings=settings)
    sweep_points = points_of(over, parallel, points)
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
    judge = file is not None and file.judge
    return SweepJob(name or f"{folder_of_run(job.path).name}-sweep", sweep_points, jobs, judge)


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


# --- the times found at each point, judged at every point -----------------------------------------

MOST_JUDGED = 64
_DIGITS = 8  # of the name

TimesByPoint = Mapping[str, Mapping[str, tuple[Time, ...]]]
"""The times that each search has found at each point, by the names of point and search."""


def judging(sweep: SweepJob, times_by_point: TimesByPoint) -> SweepJob:
    """The sweep that compares, at every point, the times found at all points.

    Its jobs have no search; they compare the sets of `judged_sets`. The sweep's name depends on the
    sets. Raises `JobError` if there are too many sets, or if times of one point are not on the
    clock of another.
    """
    sets = judged_sets(times_by_point)
    if len(sets) > MOST_JUDGED:
        raise JobError(
            f"a sweep can judge at most {MOST_JUDGED} sets of times, got {len(sets)}: sweep over "
            "fewer points"
        )
    jobs = {}
    for name, job in sweep.jobs.items():
        try:
            jobs[name] = _comparing(job, sets)
        except JobError as error:
            raise JobError(
                f"times found at other points cannot be judged at {name}: {error}"
            ) from error
    key = stream_key([[name, list(times)] for name, times in sets.items()])
    return SweepJob(f"{key:016x}"[:_DIGITS], sweep.points, jobs)


def check_comparable(sweep: SweepJob) -> None:
    """Raise a `JobError` if the points of a sweep have different horizons or clocks.

    Otherwise, times of one point would be meaningless at another.
    """
    first, *others = sweep.jobs.items()
    for name, job in others:
        if job.problem.clock != first[1].problem.clock:
            raise JobError(
                "judge needs the same horizon and clock at all points, but "
                f"{first[0]} and {name} differ",
                argument="judge",
            )


def judged_sets(times_by_point: TimesByPoint) -> dict[str, tuple[Time, ...]]:
    """Different sets of times, named after the first point where they were found.

    >>> found = {"seed=1": {"race": (1, 2)}, "seed=2": {"race": (1, 2)}, "seed=3": {"race": (2, 3)}}
    >>> judged_sets(found)
    {'point_1': (1, 2), 'point_3': (2, 3)}
    """
    several = any(len(sets) > 1 for sets in times_by_point.values())
    names = dict[tuple[Time, ...], str]()
    for number, sets in enumerate(times_by_point.values(), 1):
        for search, times in sets.items():
            names.setdefault(times, f"point_{number}_{search}" if several else f"point_{number}")
    return {name: times for times, name in names.items()}


def _comparing(job: Job, sets: Mapping[str, Sequence[Time]]) -> Job:
    comparison: dict[str, Any] = job.comparison.model_dump(mode="json")
    named = {
        name: times
        for name, times in job.comparison.named.items()
        if name == job.comparison.reference
    }
    return job.with_changes(
        sections={
            "search": [],
            "budget": None,
            "online": None,
            "comparison": comparison | {"sets": named | {name: list(sets[name]) for name in sets}},
        }
    )
