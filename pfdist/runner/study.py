"""The sets that a run seeks and compares, for each number of measurements on an axis.

The axis has one number, unless the job has a section [budget].
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from pfdist.bounds.first_windows import relaxation_within
from pfdist.errors import JobError
from pfdist.filters.estimate import Evaluation
from pfdist.job.job import Job
from pfdist.runner.progress import SetGain
from pfdist.search import Optimiser, StateSpaceRelaxation
from pfdist.search.methods import METHODS
from pfdist.search.section import SearchSection
from pfdist.search.state_space_relaxation import MOST_CELLS
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class Study:
    """The sets that a run seeks and compares."""

    job: Job
    feasible: Feasible

    @cached_property
    def axis(self) -> dict[int, Feasible]:
        """Feasible sets by number of measurements, the smallest number first.

        If measurements have costs, the number is that of regular times.
        """
        if self.job.budget is None:
            return {self.feasible.measurements: self.feasible}
        return {number: self.job.feasible(number) for number in self.job.budget.each}

    @property
    def purpose(self) -> str:
        """The purpose of the comparison's draws."""
        return "comparison" if self.job.budget is None else "budget"

    @property
    def first_draws(self) -> tuple[str, ...]:
        """Tables that keep the first draws of the comparison; see `pfdist.runner.first_draws`."""
        tables = ("trajectories", "repeated", "filter_distance", "filter_variance")
        return tables if self.job.budget is None else ()

    @property
    def references(self) -> dict[str, Times]:
        """Times with which the sets of each number of measurements are compared, by name."""
        names = self.names(self.job.comparison.reference_name)
        return {name: self.unsearched[name] for name in names}

    @cached_property
    def unsearched(self) -> dict[str, Times]:
        """The references, then the sets that comparison.sets names."""
        return {
            self._name(name, number): feasible.regular() if times is None else times
            for name, times in self.job.given_sets.items()
            for number, feasible in self.axis.items()
        }

    @property
    def widest(self) -> Feasible:
        """The feasible sets of the largest number of measurements."""
        return self.axis[max(self.axis)]

    @property
    def usual(self) -> int:
        """The geometric mean of the least and the largest number of measurements."""
        return round(math.sqrt(min(self.axis) * max(self.axis)))

    def proved(self, sets: dict[str, Times]) -> dict[str, Times]:
        """The compared sets whose gaps are proved; a budget curve leaves out the references."""
        if self.job.budget is None:
            return sets
        return {name: times for name, times in sets.items() if name not in self.references}

    def names(self, search: str) -> list[str]:
        """Names of the sets that a search finds, one for each number of measurements."""
        return [self._name(search, number) for number in self.axis]

    def optimiser(self, section: SearchSection, draws: int) -> Optimiser:
        """Optimiser of a section [[search]] whose evaluations have so many draws.

        For a budget curve, state-space relaxation finds the sets of all numbers at once. Raises
        `JobError` if the optimiser cannot search this problem.
        """
        if self.job.budget is not None:
            start, sought = relaxation_within(self.widest, self.usual, MOST_CELLS), (*self.axis,)
            return StateSpaceRelaxation(
                self.widest, draws, sought=sought, start=start, **section.settings
            )
        try:
            return METHODS[section.method].make(self.widest, draws, section.settings)
        except JobError as error:
            raise JobError(f"search.{section.name}: {error} ({self.job.path})") from error

    def probed(
        self, leaders: Sequence[Evaluation], finalists: Sequence[Evaluation]
    ) -> list[Evaluation]:
        """Evaluations on which the estimator of a search is checked.

        They are those that led the search, and those with which it ended, unless a race compares
        the latter by the squared error anyway.
        """
        races = self.racing(dict.fromkeys(each.measurement_times for each in finalists))
        return [*leaders] if races else [*leaders, *finalists]

    def racing(self, finalists: Iterable[Times]) -> tuple[Times, ...]:
        """The sets that race on fresh draws: all, if there are more of them than are sought."""
        sets = tuple(finalists)
        return sets if len(sets) > len(self.axis) else ()

    def winners(self, search: str, ranked: Sequence[Times]) -> dict[str, Times]:
        """The best set of each number of measurements, by name, from sets ranked best first."""
        best = dict[str, Times]()
        for times in ranked:
            best.setdefault(self._name(search, len(times)), times)
        return {name: best[name] for name in self.names(search) if name in best}

    def shown(self, gains: Callable[[], tuple[SetGain, ...]]) -> tuple[SetGain, ...]:
        """Gains that the progress of the comparison shows; none with several references."""
        return gains() if len(self.references) == 1 else ()

    def _name(self, name: str, number: int) -> str:
        """Name of a set of so many measurements; a budget curve adds the number."""
        if self.job.budget is None:
            return name
        digits = len(str(self.job.problem.feasible.horizon + 1))
        return f"{name}_{number:0{digits}}"
