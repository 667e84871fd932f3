"""Jobs that judge the times found at each point of a sweep at every point."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfdist.common.streams import stream_key
from pfdist.errors import JobError
from pfdist.job.job import Job
from pfdist.job.sweep import SweepJob
from pfdist.times.clock import Time

MOST_JUDGED = 64
_DIGITS = 8  # of the name

TimesByPoint = Mapping[str, Mapping[str, tuple[Time, ...]]]
"""The times that each search has found at each point, by the names of point and search."""


def judging(sweep: SweepJob, times_by_point: TimesByPoint) -> SweepJob:
    """The sweep that compares, at every point, the times found at all points.

    Its jobs have no search. They compare the sets of `judged_sets`. The sets give the sweep its
    name, so other sets give another name. Raises `JobError` if there are too many sets, or if a
    point's times are no times of another point.
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

    Times of a point would mean nothing at another.
    """
    first, *others = sweep.jobs.items()
    for name, job in others:
        if job.problem.clock != first[1].problem.clock:
            raise JobError(
                "a sweep that judges must have the same horizon and clock at all points, but "
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
