"""The sections of a job file, without [problem] and [[search]], with bounds and defaults."""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from pfdist.common.section import Section
from pfdist.errors import shown
from pfdist.evaluation.engines import AUTO, ENGINES
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.pools.kinds import POOLS
from pfdist.search.section import Estimator, Resampling
from pfdist.times.measurement_times import REGULAR, Times

GIVEN: Final = "reference"  # name of a reference that the job gives, in tables and figures
_LONGEST_TEXT = 4096  # characters of a path
if TYPE_CHECKING:
    EngineName = str
    PoolName = str
else:
    EngineName = Literal[(AUTO, *ENGINES)]
    PoolName = Literal[tuple(POOLS)]


def _checked_text(text: str) -> str:
    if "\0" in text or len(text) > _LONGEST_TEXT:
        raise ValueError(
            f"names must have at most {_LONGEST_TEXT:,} characters, and none that is NUL, got "
            f"{shown(text)}"
        )
    return text


Text = Annotated[str, AfterValidator(_checked_text)]


class FilterModel(Section):
    """The filter's model, if it differs from the truth: another model, or other parameters."""

    name: Text = ""
    parameters: dict[str, float] = Field(default_factory=dict)


class Model(Section):
    """The system: a model that ships, an entry point, or ``path/file.py:object``."""

    name: Text = "ungm"
    parameters: dict[str, float] = Field(default_factory=dict)
    filter: FilterModel = FilterModel()


class Filter(Section):
    """The particle filter."""

    particles: Annotated[int, Field(ge=1, le=10_000_000)] = 500
    resampling: Resampling = "multinomial"
    dtype: Literal["float64", "float32"] = "float64"
    engine: EngineName = AUTO


class EvaluationSection(Section):
    """How a search estimates the expected MSE of a set of times."""

    draws: Annotated[int, Field(ge=2, le=10_000_000)] = 1000
    noise: Literal["fresh", "common"] = "fresh"
    degenerate_draws: Literal["kill", "leave_out"] = "kill"
    estimator: Estimator = SQUARED_ERROR.name


class Until(Section):
    """The precision at which a comparison ends before it has all draws."""

    half_width: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0


class Comparison(Section):
    """The comparison of the found times with the reference, on the same fresh draws.

    The reference is "regular", which stands for the feasible set nearest to the regular times, or
    any set of times in 0..T. A given set may break constraints.
    """

    draws: Annotated[int, Field(ge=2, le=100_000_000)] = 100_000
    until: Until = Until()
    reference: Literal["regular"] | Times = REGULAR

    @field_validator("reference", mode="before")
    @classmethod
    def _is_regular_or_times(cls, value: Any) -> Any:
        if value == REGULAR:
            return value
        whole = isinstance(value, (list, tuple)) and all(type(time) is int for time in value)
        if not whole:
            raise ValueError(
                f"comparison.reference must be {REGULAR!r} or a list of times, for instance "
                f"[0, 3, 6], got {shown(value)}"
            )
        return tuple(sorted(value))

    @property
    def reference_name(self) -> str:
        """Name of the reference in tables and figures."""
        return REGULAR if self.reference == REGULAR else GIVEN


class Budget(Section):
    """The numbers of measurements of a budget study; `pfdist budget` writes them.

    They are all numbers from ``least`` to ``most``, unless ``numbers`` lists them.
    """

    least: Annotated[int, Field(ge=2, lt=2**63)]
    most: Annotated[int, Field(ge=2, lt=2**63)]
    numbers: Annotated[tuple[int, ...], Field(strict=False)] | None = None

    @property
    def each(self) -> Sequence[int]:
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


class Execution(Section):
    """Where a run is computed. It is no part of the identity of a run."""

    pool: PoolName = "ray"
    workers: Annotated[int, Field(ge=0, lt=2**63)] = 0
    address: Text = ""
    failures: Annotated[int, Field(ge=0, lt=2**63)] = 3
