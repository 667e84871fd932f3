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

Found = Mapping[str, Mapping[str, tuple[Time, ...]]]
"""The times that the searches of each point have found: by the point's name and the search's."""


def judging(asked: SweepJob, found: Found) -> SweepJob:
    """Give the sweep that compares, at every point, the times found at all points.

    Parameters
    ----------
    asked : SweepJob
        The sweep whose points have found times.
    found : mapping

    Returns
    -------
    SweepJob
        Its jobs have no search. They compare the sets of `judged_sets`, and other sets give it
        another name.

    Raises
    ------
    JobError
        There are too many sets, or a point's times are no times of another point.
    """
    sets = judged_sets(found)
    if len(sets) > MOST_JUDGED:
        raise JobError(
            f"a sweep can judge at most {MOST_JUDGED} sets of times, got {len(sets)}: sweep over "
            "fewer points"
        )
    jobs = {}
    for name, job in asked.jobs.items():
        try:
            jobs[name] = _comparing(job, sets)
        except JobError as error:
            raise JobError(
                f"times found at other points cannot be judged at {name}: {error}"
            ) from error
    key = stream_key([[name, list(times)] for name, times in sets.items()])
    return SweepJob(f"{key:016x}"[:_DIGITS], asked.points, jobs)


def check_comparable(asked: SweepJob) -> None:
    """Refuse a sweep whose points have different clocks: times of a point mean nothing elsewhere.

    Raises
    ------
    JobError
        Two points have different horizons or clocks.
    """
    first, *others = asked.jobs.items()
    for name, job in others:
        if job.problem.clock != first[1].problem.clock:
            raise JobError(
                "a sweep that judges must have the same horizon and clock at all points, but "
                f"{first[0]} and {name} differ",
                argument="judge",
            )


def judged_sets(found: Found) -> dict[str, tuple[Time, ...]]:
    """Give different times, named after the first point where they were found.

    Examples
    --------
    >>> found = {"seed=1": {"race": (1, 2)}, "seed=2": {"race": (1, 2)}, "seed=3": {"race": (2, 3)}}
    >>> judged_sets(found)
    {'point_1': (1, 2), 'point_3': (2, 3)}
    """
    several = any(len(sets) > 1 for sets in found.values())
    names = dict[tuple[Time, ...], str]()
    for number, sets in enumerate(found.values(), 1):
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
