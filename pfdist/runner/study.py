"""Studies: the best times of one problem, or of each of several measurement budgets.

This module holds everything that differs between the two. Only `study_of` asks which study a job
wants.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

from pfdist.bounds.first_windows import relaxation_within
from pfdist.errors import JobError
from pfdist.evaluation.estimate import Evaluation
from pfdist.job.job import Job
from pfdist.runner.progress import Found
from pfdist.search import Optimiser, StateSpaceRelaxation
from pfdist.search.methods import METHODS
from pfdist.search.section import SearchSection
from pfdist.search.state_space_relaxation import MOST_CELLS
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times


class Study(Protocol):
    """The questions that a run asks about its searches and its comparison."""

    @property
    def purpose(self) -> str:
        """The purpose of the comparison's draws."""

    @property
    def first_draws(self) -> tuple[str, ...]:
        """Tables that keep the first draws of the comparison; see `pfdist.runner.first_draws`."""

    @property
    def references(self) -> dict[str, Times]:
        """Measurement times with which the found times are compared, by name."""

    @property
    def unsearched(self) -> dict[str, Times]:
        """All compared sets that no search finds, by name: the references first."""

    @property
    def widest(self) -> Feasible:
        """The feasible sets of the largest number of measurements that is sought."""

    @property
    def usual(self) -> int:
        """A number of measurements in the middle of those that are sought."""

    def proved(self, sets: dict[str, Times]) -> dict[str, Times]:
        """Those of the compared sets whose gaps are proved."""

    def names(self, search: str) -> list[str]:
        """Names of the sets that a search finds."""

    def optimiser(self, section: SearchSection, draws: int) -> Optimiser:
        """Optimiser of a section [[search]] whose evaluations have so many draws.

        Raises
        ------
        JobError
            The optimiser cannot search this problem.
        """

    def probed(
        self, leaders: Sequence[Evaluation], found: Sequence[Evaluation]
    ) -> list[Evaluation]:
        """Evaluations on which the estimator of a search is checked.

        Parameters
        ----------
        leaders : sequence of Evaluation
            The evaluations that led the search.
        found : sequence of Evaluation
            The evaluations with which the search ended.
        """

    def racing(self, found: Iterable[Times]) -> tuple[Times, ...]:
        """The found sets that race on fresh draws; empty for no race."""

    def winners(self, search: str, ranked: Sequence[Times]) -> dict[str, Times]:
        """Compared sets by name, chosen from the found sets, the best of which is the first."""

    def shown(self, gains: Callable[[], tuple[Found, ...]]) -> tuple[Found, ...]:
        """Gains that the progress of the comparison shows."""


@dataclass(frozen=True)
class TimesStudy:
    """Find the best times of one problem; each search finds one set.

    Parameters
    ----------
    job : Job
    widest : Feasible
        The feasible sets of the problem.
    """

    job: Job
    widest: Feasible
    purpose: ClassVar[str] = "comparison"
    first_draws: ClassVar[tuple[str, ...]] = (
        "trajectories",
        "repeated",
        "filter_distance",
        "filter_variance",
    )

    @cached_property
    def references(self) -> dict[str, Times]:
        """The reference of the job, under its name."""
        name = self.job.comparison.reference_name
        return {name: self.unsearched[name]}

    @cached_property
    def unsearched(self) -> dict[str, Times]:
        """The reference, and the sets that comparison.sets names."""
        regular = self.widest.regular
        sets = self.job.given_sets
        return {name: regular() if times is None else times for name, times in sets.items()}

    @property
    def usual(self) -> int:
        """N; with costs, the number of measurements of regular times."""
        return self.widest.measurements

    def proved(self, sets: dict[str, Times]) -> dict[str, Times]:
        """All compared sets."""
        return sets

    def names(self, search: str) -> list[str]:
        """The name of the search."""
        return [search]

    def optimiser(self, section: SearchSection, draws: int) -> Optimiser:
        """Optimiser of the method that the section names."""
        try:
            return METHODS[section.method].make(self.widest, draws, section.settings)
        except JobError as error:
            raise JobError(f"search.{section.name}: {error} ({self.job.path})") from error

    def probed(
        self, leaders: Sequence[Evaluation], found: Sequence[Evaluation]
    ) -> list[Evaluation]:
        """The leaders; the finalists race by the squared error anyway."""
        return [*leaders]

    def racing(self, found: Iterable[Times]) -> tuple[Times, ...]:
        """All sets that were found, unless there is a single set."""
        sets = tuple(found)
        return sets if len(sets) > 1 else ()

    def winners(self, search: str, ranked: Sequence[Times]) -> dict[str, Times]:
        """The best set."""
        return {search: ranked[0]} if ranked else {}

    def shown(self, gains: Callable[[], tuple[Found, ...]]) -> tuple[Found, ...]:
        """All gains: there is one reference for all of them."""
        return gains()


@dataclass(frozen=True)
class BudgetStudy:
    """Find the best times for each of several measurement budgets; a search finds all of them.

    Parameters
    ----------
    job : Job
    budgets : sequence of int
        Measurement budgets N, from the least to the largest.
    """

    job: Job
    budgets: Sequence[int]
    purpose: ClassVar[str] = "budget"
    first_draws: ClassVar[tuple[str, ...]] = ()

    @cached_property
    def references(self) -> dict[str, Times]:
        """Regular times of each measurement budget, under the reference's name and the budget."""
        name = self.job.comparison.reference_name
        return {
            self._name(name, budget): self.job.feasible(budget).regular() for budget in self.budgets
        }

    @property
    def unsearched(self) -> dict[str, Times]:
        """The references: a job of several budgets names no sets."""
        return self.references

    @property
    def widest(self) -> Feasible:
        """The feasible sets of the largest budget."""
        return self.job.feasible(self.budgets[-1])

    @property
    def usual(self) -> int:
        """The geometric mean of the least and the largest budget."""
        return round(math.sqrt(self.budgets[0] * self.budgets[-1]))

    def proved(self, sets: dict[str, Times]) -> dict[str, Times]:
        """The found sets."""
        return {name: times for name, times in sets.items() if name not in self.references}

    def names(self, search: str) -> list[str]:
        """The search's name with each measurement budget."""
        return [self._name(search, budget) for budget in self.budgets]

    def optimiser(self, section: SearchSection, draws: int) -> Optimiser:
        """State-space relaxation for all measurement budgets at once."""
        start = relaxation_within(self.widest, self.usual, MOST_CELLS)
        sought = tuple(self.budgets)
        return StateSpaceRelaxation(
            self.widest, draws, sought=sought, start=start, **section.settings
        )

    def probed(
        self, leaders: Sequence[Evaluation], found: Sequence[Evaluation]
    ) -> list[Evaluation]:
        """The leaders and all that was found: no race compares the finalists."""
        return [*leaders, *found]

    def racing(self, found: Iterable[Times]) -> tuple[Times, ...]:
        """No sets: there is one set for each measurement budget."""
        return ()

    def winners(self, search: str, ranked: Sequence[Times]) -> dict[str, Times]:
        """The set of each measurement budget."""
        by_budget = sorted((len(times), times) for times in ranked)
        return {self._name(search, budget): times for budget, times in by_budget}

    def shown(self, gains: Callable[[], tuple[Found, ...]]) -> tuple[Found, ...]:
        """No gains: each set has a reference of its own."""
        return ()

    def _name(self, name: str, budget: int) -> str:
        digits = len(str(self.job.problem.feasible.horizon + 1))
        return f"{name}_{budget:0{digits}}"


def study_of(job: Job, feasible: Feasible) -> Study:
    """The study that a job asks for, with the feasible sets of its problem."""
    if job.budget is None:
        return TimesStudy(job, feasible)
    return BudgetStudy(job, job.budget.each)
