"""A job and the objects that are made of it."""

from collections.abc import Collection
from dataclasses import dataclass, field

from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation
from pfdist.problem.feasible import Feasible
from pfdist.problem.job import Job
from pfdist.runner.searches import (
    RANKING,
    NamedSearch,
    coarse_of,
    comparing_of,
    polish_of,
    shortlist_of,
)
from pfdist.runner.study import Study


@dataclass(frozen=True)
class Built:
    """A job and the objects made of it; see `pfdist.runner.build.build`.

    `feasible` has smaller sets, too, if there are prices and the filter's model is not the truth.
    """

    job: Job
    feasible: Feasible
    study: Study
    evaluator: Evaluator
    searches: tuple[NamedSearch, ...] = field(repr=False)
    taken: str = ""  # the proposal that "auto" takes, and why; empty for a plain filter

    @property
    def phases(self) -> list[str]:
        """Names of all phases that choose sets."""
        references = (name(each) for each in self.study.even for name in (coarse_of, shortlist_of))
        found = [name for each in self.searches for name in self.study.names(each.name)]
        searched = (phase for search in self.searches for phase in search.phases)
        return [*dict.fromkeys((RANKING, *references, *searched, *map(polish_of, found)))]

    @property
    def comparing(self) -> Estimation:
        """The estimation of the comparison: the squared error of the job's own filter."""
        return comparing_of(self.job)

    @property
    def names(self) -> list[str]:
        """Names of the compared sets: those that the job gives, then those that searches find."""
        searched = [name for search in self.searches for name in self.study.names(search.name)]
        return [*self.study.unsearched, *searched]

    @property
    def unjudged(self) -> Collection[str]:
        """Sets that a required gap ignores: with searches all given sets, else the references."""
        return self.study.unsearched if self.searches else self.study.references
