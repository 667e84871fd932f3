"""Jobs that judge the times found at each point of a sweep at every point."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfdist.errors import JobError
from pfdist.job.job import Job
from pfdist.job.sweep import SweepJob
from pfdist.times.clock import Time

MOST_JUDGED = 64

Found = Mapping[str, Mapping[str, Sequence[Time]]]
"""The times that the searches of each point have found: by the point's name and the set's."""


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
        Its jobs have no search. Their sets have the names of `judged_sets`.

    Raises
    ------
    JobError
        There are too many sets, or a point's times are no times of another point.
    """
    names = judged_sets(found)
    if len(names) > MOST_JUDGED:
        raise JobError(
            f"a sweep can judge at most {MOST_JUDGED} sets of times, got {len(names)}: sweep over "
            "fewer points"
        )
    sets = {name: list(found[point][own]) for name, (point, own) in names.items()}
    jobs = {}
    for name, job in asked.jobs.items():
        try:
            jobs[name] = _comparing(job, sets)
        except JobError as error:
            raise JobError(
                f"times found at other points cannot be judged at {name}: {error}"
            ) from error
    return SweepJob(asked.name, asked.points, jobs)


def judged_sets(found: Found) -> dict[str, tuple[str, str]]:
    """Give each name of a judged set, with its point and its name there.

    Examples
    --------
    >>> judged_sets({"seed=1": {"relaxation": [1, 2]}, "seed=2": {"relaxation": [1, 3]}})
    {'point_1': ('seed=1', 'relaxation'), 'point_2': ('seed=2', 'relaxation')}
    """
    several = any(len(sets) > 1 for sets in found.values())
    return {
        f"point_{number}_{own}" if several else f"point_{number}": (point, own)
        for number, (point, sets) in enumerate(found.items(), 1)
        for own in sets
    }


def _comparing(job: Job, sets: Mapping[str, Sequence[Time]]) -> Job:
    comparison: dict[str, Any] = job.comparison.model_dump(mode="json")
    return job.with_changes(
        sections={
            "search": [],
            "budget": None,
            "online": None,
            "comparison": comparison | {"sets": dict(sets)},
        }
    )
