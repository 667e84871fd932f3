"""The section [online] of a job file."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from pydantic import Field, field_validator

from pfdist.problem.added_sections import AddedSection
from pfdist.problem.methods import METHODS, any_section
from pfdist.problem.search_section import CommonNoiseSettings, SearchSection

_QUICK: Mapping[str, Any] = {"rounds": 1, "reach": 2.0}
PLANNING: Final = METHODS["corridor"].section(
    evaluation=CommonNoiseSettings(draws=64, particles=64), **_QUICK
)
"""A quick search that plans the remaining measurements, unless a job names another search."""
ONLINE: Final = "online"
"""Name of the times that are chosen online; no search may have it."""
if TYPE_CHECKING:
    OnlineSearch = SearchSection
else:
    OnlineSearch = any_section(online=True)


class Online(AddedSection):
    """Online choice: each time is chosen after the measurement before it is known.

    The keys of ``online.search`` are those of a [[search]]. Its name and ``polish`` have no effect.
    Unless it names another method, the keys that are not given are those of a quick corridor
    search.

    Parameters
    ----------
    draws : int
        Number of draws, the first of the comparison, whose times are chosen online; at most
        ``comparison.draws``.
    judging_draws : int
        Number of fresh simulated systems that decide between the current plan and a new plan.
    search : section
        The search that plans the remaining measurements: the keys of a ``[[search]]``.
    """

    title: ClassVar[str] = "Fixed or online times"

    draws: Annotated[int, Field(ge=2, le=10_000_000)] = 1000
    judging_draws: Annotated[int, Field(ge=2, le=1_000_000)] = 1024
    search: OnlineSearch = PLANNING

    @field_validator("search", mode="before")
    @classmethod
    def _quick_unless_given(cls, value: Any) -> Any:
        if not isinstance(value, dict) or value.get("method", PLANNING.method) != PLANNING.method:
            return value
        quick = PLANNING.model_dump()
        evaluation = value.get("evaluation", {})
        if isinstance(evaluation, dict):
            value = {**value, "evaluation": {**quick["evaluation"], **evaluation}}
        return {**quick, **value}

    def check(self, job: Any) -> None:
        """Raise a `ValueError` unless the job has a plan, and enough draws."""
        draws, names = job.comparison.draws, {each.name for each in job.search}
        needed = ""
        if not job.search:
            needed = "a search for the first plan, got search = []"
        elif ONLINE in names or ONLINE in job.comparison.named:
            needed = f"searches and sets of other names, got {ONLINE!r}"
        elif self.draws > draws:
            needed = (
                f"online.draws of at most comparison.draws = {draws}, got {self.draws}: the same "
                "draws are compared"
            )
        if needed:
            raise ValueError(f"online needs {needed}")


def online_of(job: Any) -> Online | None:
    """The section of a `pfdist.Job`."""
    section: Online | None = job.section("online")
    return section
