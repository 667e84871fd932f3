"""The section [problem] of a job file: the horizon, and the feasible sets of measurement times.

The keys have the names of the parameters of `Constraints`. An error about such a value begins with
its name, and this module puts ``problem.`` before it.
"""

import re
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Annotated, Any, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from pfdist.common.number_list import whole_numbers
from pfdist.common.section import Section
from pfdist.errors import MeasurementTimesError, shown
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

_WITH_HYPHEN = re.compile(r"(\d{1,6})-(\d{1,6})")
_RANGES = "'20:30', '0:60:3' or '20-30'"


class ProblemSection(Section):
    """The horizon, and constraints on the measurement times: how many, at what cost, and when."""

    horizon: Annotated[int, Field(ge=1, le=32_000)]
    measurement_budget: Annotated[int, Field(ge=2, lt=2**63)] | None = None
    forbidden: tuple[int | str, ...] | None = None
    required: tuple[int | str, ...] | None = None
    minimum_spacing: Annotated[int, Field(ge=1, lt=2**63)] | None = None
    cost: tuple[int, ...] | dict[str, int] | None = None
    total_cost: Annotated[int, Field(ge=1, lt=2**63)] | None = None

    @field_validator("forbidden", "required", mode="before")
    @classmethod
    def _times(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and not isinstance(value, (list, tuple)):
            raise ValueError(
                f"problem.{info.field_name} must be a list of times and of ranges as "
                f"{_RANGES}, got {shown(value)}"
            )
        for entry in value or ():
            _times_in(entry, f"problem.{info.field_name}")
        return None if value is None else tuple(value)

    @field_validator("cost", mode="before")
    @classmethod
    def _costs(cls, value: Any) -> Any:
        if isinstance(value, dict):
            for key in value:
                _times_in(key, "problem.cost")
        elif value is not None and not isinstance(value, (list, tuple)):
            raise ValueError(
                "problem.cost must be a list of horizon + 1 numbers, or a section of ranges as "
                f'"20:30" = 2, got {shown(value)}'
            )
        for cost in value.values() if isinstance(value, dict) else value or ():
            if not isinstance(cost, int) or isinstance(cost, bool):
                raise ValueError(f"problem.cost must be whole numbers, got {shown(cost)}")
        return tuple(value) if isinstance(value, list) else value

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        try:
            self.feasible  # noqa: B018  made here, because it checks the values together
        except MeasurementTimesError as error:
            raise ValueError(f"problem.{error}") from error
        return self

    @cached_property
    def feasible(self) -> Feasible:
        """The feasible sets of measurement times."""
        return Feasible(
            horizon=self.horizon,
            measurement_budget=self.measurement_budget,
            forbidden=_union(self.forbidden or ()),
            required=_union(self.required or ()),
            minimum_spacing=self.minimum_spacing or 1,
            cost=self._costs_of_times,
            total_cost=self.total_cost,
        )

    @property
    def is_constrained(self) -> bool:
        """Whether some times are excluded that have as many measurements, or cost no more."""
        return bool(self.forbidden or self.required) or (self.minimum_spacing or 1) > 1

    def broken(self, times: Iterable[int]) -> list[str]:
        """Give the constraints that a set of times in 0..T breaks, one sentence each.

        Each sentence begins with the key, for instance ``problem.forbidden: 4 is measured``.
        """
        return [f"problem.{sentence}" for sentence in self.feasible.broken(times)]

    @property
    def _costs_of_times(self) -> tuple[int, ...] | None:
        if not isinstance(self.cost, dict):
            return self.cost
        costs: dict[int, int] = {}
        for key, cost in self.cost.items():
            for time in _times_in(key, "problem.cost"):
                if time in costs or time > self.horizon:
                    what = "twice" if time in costs else f"for a horizon of {self.horizon}"
                    raise MeasurementTimesError(
                        f"cost must name every time in 0..{self.horizon} once, got {time} {what}"
                    )
                costs[time] = cost
        lacking = [time for time in range(self.horizon + 1) if time not in costs]
        if lacking:
            raise MeasurementTimesError(
                f"cost must name every time in 0..{self.horizon} once, got none for {lacking[0]}"
            )
        return tuple(costs[time] for time in range(self.horizon + 1))


def _times_in(value: Any, key: str) -> Sequence[int]:
    """Give the times that an integer, or a text such as '20:30', '0:60:3' or '20-30', stands for.

    Lists and ranges with colons are those of the command line; a hyphen is another spelling of the
    colon between two times.
    """
    if isinstance(value, int) and not isinstance(value, bool):
        return [value]
    if not isinstance(value, str):
        raise ValueError(
            f"{key} must name times, as 20, and ranges, as {_RANGES}, got {shown(value)}"
        )
    with_hyphen = _WITH_HYPHEN.fullmatch(value)
    try:
        return whole_numbers(f"{with_hyphen[1]}:{with_hyphen[2]}" if with_hyphen else value)
    except ValueError as error:
        if ":" in value:
            raise ValueError(f"{key} {error}") from error
        what = (
            "have ranges from a time to a later one"
            if with_hyphen
            else (f"name times, as 20, and ranges, as {_RANGES}")
        )
        raise ValueError(f"{key} must {what}, got {shown(value)}") from error


def _union(entries: Iterable[int | str]) -> Times:
    return tuple(sorted({time for entry in entries for time in _times_in(entry, "problem")}))
