"""The section [budget] of a job file."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, model_validator

from pfdist.common.measurement_times import REGULAR
from pfdist.common.section import Listed
from pfdist.errors import MeasurementTimesError, shown
from pfdist.problem.added_sections import AddedSection
from pfdist.problem.sections import DEFAULT_METHOD, EVENLY_SPACED


class Budget(AddedSection):
    """The numbers of measurements of a budget study; `pfdist budget` writes this section.

    They are all numbers from ``least`` to ``most``, unless ``numbers`` lists them.

    Parameters
    ----------
    least : int
        Smallest number of measurements.
    most : int
        Largest number of measurements.
    numbers : list of int
        Only these numbers, in ascending order from ``least`` to ``most``; by default all.
    """

    title: ClassVar[str] = "How many measurements are enough"
    chapter: ClassVar[str] = "pfdist.plugins.budget.page:budget_section"
    study: ClassVar[str] = "pfdist.plugins.budget.study:BudgetStudy"
    has_amounts: ClassVar[bool] = True

    least: Annotated[int, Field(ge=1, lt=2**63)]
    most: Annotated[int, Field(ge=1, lt=2**63)]
    numbers: Listed[int] | None = None

    @property
    def amounts(self) -> Sequence[int]:
        """The numbers of measurements, from the least to the largest."""
        return range(self.least, self.most + 1) if self.numbers is None else self.numbers

    @model_validator(mode="after")
    def _are_in_order(self) -> Self:
        if self.least > self.most:
            raise ValueError(
                f"budget.least must be at most budget.most = {self.most}, got {self.least}"
            )
        numbers = self.numbers
        if numbers is None:
            return self
        ends = numbers[:1] + numbers[-1:]
        if ends != (self.least, self.most) or any(a >= b for a, b in pairwise(numbers)):
            raise ValueError(
                "budget.numbers must be in ascending order, from budget.least = "
                f"{self.least} to budget.most = {self.most}, got {shown(list(numbers))}"
            )
        return self

    def check(self, job: Any) -> None:
        """Raise a `ValueError` unless the job has one search, and sets of each number."""
        methods, comparison = [search.method for search in job.search], job.comparison
        is_one = comparison.reference in (EVENLY_SPACED, REGULAR) and not comparison.named
        got, needed = "comparison.sets" if comparison.named else "a single set of times", ""
        if not is_one:
            needed = f"comparison.reference = {EVENLY_SPACED!r} or {REGULAR!r}, got {got}"
        elif methods != [DEFAULT_METHOD]:
            needed = f"one search of method {DEFAULT_METHOD!r}, got {', '.join(methods)}"
        elif any(each.polish for each in job.search):
            needed = "a search with polish = false"
        if needed:
            raise ValueError(f"budget needs {needed}")
        for number in (self.least, self.most):
            try:
                job.feasible(number)
            except MeasurementTimesError as error:
                what = " measurements" * (job.problem.total_price is None)
                raise ValueError(f"budget of {number}{what}: {error}") from error
