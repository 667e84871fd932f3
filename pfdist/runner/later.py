"""Work of a run after its comparison, which plugins add."""

from collections.abc import Callable, Generator, Mapping
from pkgutil import resolve_name
from typing import Any, NamedTuple

from pfdist.common.measurement_times import Times
from pfdist.common.plugins import hooked
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation
from pfdist.problem.job import Job
from pfdist.runner.built import Built
from pfdist.runner.parts import Part


class LaterWork(NamedTuple):
    """Work after the comparison, for jobs with a section of a plugin."""

    part: Part  # what it is for; the estimates of its draws have this name, too
    phase: str  # of its timings
    # the estimations by filters that it takes; raises an error if the job cannot have it
    estimations: Callable[[Job, Evaluator], list[Estimation]]
    steps: Callable[[Built], float]  # particle-steps, about
    # the driver for a `pfdist.runner.door.RunSession` and its compared sets
    drive: Callable[[Any, Mapping[str, Times]], Generator[Any, None, None]]


def later_of(job: Job) -> list[LaterWork]:
    """The work that the sections of a job ask for."""
    works = hooked("later").items()
    return [resolve_name(name) for key, name in works if job.section(key) is not None]
