"""The sets that a run finds and compares, and the optimiser that finds them."""

from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pkgutil import resolve_name
from typing import Any, ClassVar

from pfdist.common.measurement_times import EVEN, Times
from pfdist.errors import JobError
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.job import Job
from pfdist.problem.methods import METHODS
from pfdist.problem.search_section import SearchSection
from pfdist.search import Optimiser
from pfdist.search.relaxation import Relaxation


@dataclass(frozen=True)
class Study:
    """The sets that a run with one number of measurements finds and compares."""

    job: Job
    feasible: Feasible

    has_details: ClassVar[bool] = True
    """Whether the comparison also keeps trajectories and errors over time."""

    @property
    def purpose(self) -> str:
        """The purpose of the comparison's draws."""
        return "comparison"

    @cached_property
    def unsearched(self) -> dict[str, Times]:
        """The references, then the sets that comparison.sets names, by name.

        Regular times stand for evenly spaced times until the race has found these.
        """
        return {
            name: self.feasible.regular() if times is None else times
            for name, times in self.job.given_sets.items()
        }

    @cached_property
    def even(self) -> dict[str, Feasible]:
        """The feasible sets whose best evenly spaced set is a reference, by its name."""
        if not self.job.comparison.is_even:
            return {}
        return dict(zip(self.names(EVEN), self.each, strict=True))

    @property
    def each(self) -> Sequence[Feasible]:
        """The feasible sets of each number of measurements."""
        return (self.feasible,)

    @property
    def references(self) -> dict[str, Times]:
        """Times with which the sets of each number of measurements are compared, by name."""
        return {
            name: self.unsearched[name] for name in self.names(self.job.comparison.reference_name)
        }

    @property
    def widest(self) -> Feasible:
        """The feasible sets of the largest number of measurements."""
        return self.feasible

    @property
    def usual(self) -> int:
        """The number of measurements for which a relaxation is chosen.

        With prices, it is that of regular times.
        """
        return self.feasible.measurements

    def spent(self, relaxation: Relaxation, name: str, times: Times) -> int:
        """The sum, in units of a relaxation, of the bound for a set."""
        return relaxation.spent(times)

    def proved(self, sets: dict[str, Times]) -> dict[str, Times]:
        """The compared sets whose gaps are proved."""
        return sets

    def names(self, origin: str) -> list[str]:
        """Names of the sets of a search or a reference, one for each number."""
        return [origin]

    def raced(
        self, session: Any, given: dict[str, Times], tried: dict[str, int]
    ) -> Generator[Any, None, dict[str, Evaluation]]:
        """Search in another way than usual: the plan of each number, by name; none if not.

        A driver for a `pfdist.runner.door.RunSession`; evenly spaced sets go into what is given.
        """
        yield from ()
        return {}

    def raced_steps(self, built: Any) -> float:
        """The particle-steps that this takes beside the search of a `pfdist.runner.build.Built`."""
        return 0.0

    def optimiser(self, section: SearchSection, draws: int) -> Optimiser:
        """The optimiser of a section [[search]], whose evaluations have so many draws.

        Raises `JobError` if the optimiser cannot search this problem.
        """
        lag = self.job.problem.instants_of_lag
        try:
            made: Optimiser = METHODS[section.method].make(
                self.feasible, draws, section.settings, lag=lag
            )
        except JobError as error:
            raise JobError(f"search.{section.name}: {error} ({self.job.path})") from error
        return made

    def racing(self, finalists: Iterable[Times]) -> tuple[Times, ...]:
        """The sets that race on fresh draws: all, if there are more than needed; else none."""
        sets = tuple(finalists)
        return sets if len(sets) > len(self.names("")) else ()

    def winners(self, search: str, ranked: Sequence[Times]) -> dict[str, Times]:
        """The best set of each number of measurements, by name, from sets ranked best first."""
        return dict(zip(self.names(search), ranked, strict=False))


def study_of(job: Job, feasible: Feasible) -> Study:
    """The study of a job, which a section of a plugin may give."""
    names = (each.study for each in job.added if each.study)
    kind: type[Study] = next(map(resolve_name, names), Study)
    return kind(job, feasible)
