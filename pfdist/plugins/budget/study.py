"""The sets of a run with several numbers of measurements: a job with a section [budget]."""

import math
from collections.abc import Generator, Sequence
from functools import cached_property
from typing import ClassVar

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.plugins.budget.smoothed import budget_of_smoothed, budget_steps, is_smoothed_budget
from pfdist.problem.feasible import Feasible
from pfdist.problem.search_section import SearchSection
from pfdist.problem.set_key import SetKey, set_key_of
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.study import Study
from pfdist.search import Optimiser, StateSpaceRelaxation
from pfdist.search.relaxation import Relaxation
from pfdist.search.state_space_relaxation import first_relaxation


class BudgetStudy(Study):
    """A study that has every set once for each number of measurements.

    State-space relaxation finds the sets of all numbers at once.
    """

    has_details: ClassVar[bool] = False

    @cached_property
    def _each(self) -> dict[int, Feasible]:
        """Feasible sets by number of measurements or total price, the smallest first."""
        return {number: self.job.feasible(number) for number in self.job.amounts}

    @property
    def each(self) -> Sequence[Feasible]:
        """The feasible sets of each number of measurements, the smallest number first."""
        return tuple(self._each.values())

    @property
    def purpose(self) -> str:
        """A separate purpose: the draws of a later comparison of one set are independent."""
        return "budget"

    @cached_property
    def unsearched(self) -> dict[str, Times]:
        """Regular times for each number, by name; such a job gives no other sets."""
        regular = (feasible.regular() for feasible in self._each.values())
        return dict(zip(self.names(self.job.comparison.reference_name), regular, strict=True))

    @property
    def widest(self) -> Feasible:
        """The feasible sets of the largest number of measurements."""
        return self._each[max(self._each)]

    @property
    def usual(self) -> int:
        """The geometric mean of the smallest and the largest number of measurements.

        If the estimate uses later measurements, the smallest, whose gaps are the longest: errors in
        longer gaps than those that are known count as less than they are.
        """
        least, most = (self._each[end].measurements for end in (min(self._each), max(self._each)))
        return least if self.job.problem.instants_of_lag else round(math.sqrt(least * most))

    def spent(self, relaxation: Relaxation, name: str, times: Times) -> int:
        """The sum of the bound for a set: that of its number, or of its total price."""
        return self._sum(relaxation, int(set_key_of(name, {"budget": {}}).number))

    def _sum(self, relaxation: Relaxation, number: int) -> int:
        return self._each[number].total // relaxation.unit

    def proved(self, sets: dict[str, Times]) -> dict[str, Times]:
        """The compared sets without the references."""
        return {name: times for name, times in sets.items() if name not in self.references}

    def names(self, origin: str) -> list[str]:
        """The origin with each number, padded to the same number of digits."""
        digits = len(str(max(self.feasible.horizon + 1, *self._each)))
        return [SetKey(origin, f"{number:0{digits}}").column for number in self._each]

    def raced(
        self, session: RunSession, given: dict[str, Times], tried: dict[str, int]
    ) -> Generator[WorkBatch, None, dict[str, Evaluation]]:
        """Race the plans of a smoothed estimate, whose programme has errors that are too low."""
        if not is_smoothed_budget(session.built):
            return {}
        return (yield from budget_of_smoothed(session, given, tried))

    def raced_steps(self, built: Built) -> float:
        """The exchanges of these plans."""
        return budget_steps(built)

    def optimiser(self, section: SearchSection, draws: int) -> Optimiser:
        """State-space relaxation, which finds a set for each number."""
        lag = self.job.problem.instants_of_lag
        start = first_relaxation(self.widest, self.usual, lag)
        sought = tuple(dict.fromkeys(self._sum(start, number) for number in self._each))
        return StateSpaceRelaxation(
            self.widest, draws, sought=sought, start=start, lag=lag, **section.settings
        )

    def winners(self, search: str, ranked: Sequence[Times]) -> dict[str, Times]:
        """The first of the ranked sets that has each number, by name."""
        names = zip(self.names(search), self.each, strict=True)
        best = {name: next(filter(each.accepts, ranked), None) for name, each in names}
        return {name: times for name, times in best.items() if times is not None}
