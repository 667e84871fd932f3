"""The section [scenarios] of a job file: parameters that the truth may have."""

import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from pfdist.common.scenario import Scenario
from pfdist.common.section import JobSection, Listed
from pfdist.common.streams import stream_key
from pfdist.errors import shown
from pfdist.filters.criterion import MEAN, Criterion, WorstScenario
from pfdist.problem.sections import Parameter, is_list_of

MOST_SCENARIOS = 100
_DISTRIBUTIONS = (
    "{ normal = [mean, sd] }, { lognormal = [median, sd of the log] } or { uniform = [low, high] }"
)
_KINDS = ("normal", "lognormal", "uniform")
_Pair = tuple[float, float]
_Above0 = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_Numbers = Listed[_Above0]


class Scenarios(JobSection):
    """Possible parameters of the truth; each draw has those of one scenario.

    Scenarios are a list of parameters, or a distribution for each parameter. A distribution is cut
    into ``count`` equally likely parts, and each scenario has the median of one. The parts of the
    first parameter are in order; the order of every other parameter depends on its name (a Latin
    hypercube).

    Parameters
    ----------
    parameters : list of sections or section of sections
        The parameters of each scenario, or a distribution for each parameter: ``normal`` (mean and
        sd), ``lognormal`` (median and sd of the logarithm) or ``uniform`` (ends).
    weights : list of float
        Above 0, for each scenario of a list; only ratios matter. By default all are equal.
    scales : list of float
        A number above 0 for each scenario, by which its squared errors are divided: by default 1.
    count : int
        Number of scenarios, of distributions alone.
    motion : float, standard deviations
        The size of the random step that a learning filter adds to each parameter; for
        distributions.
    criterion : str
        Whether the mean of the scenarios' expected MSEs decides, or the largest.
    filter : str
        Whether the filter uses the parameters of the job, is given those of the draw's scenario, or
        learns them from measurements.
    """

    parameters: (
        Annotated[tuple[dict[str, Parameter], ...], Field(min_length=1, max_length=MOST_SCENARIOS)]
        | dict[str, dict[str, _Pair]]
    )
    weights: _Numbers | None = None
    scales: _Numbers | None = None
    count: Annotated[int, Field(ge=2, le=MOST_SCENARIOS)] | None = None
    criterion: Literal["mean", "worst"] = "mean"
    filter: Literal["nominal", "told", "learned"] = "nominal"
    motion: Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)] = 0.0

    @field_validator("parameters", mode="before")
    @classmethod
    def _are_scenarios(cls, value: Any) -> Any:
        if isinstance(value, dict):
            return {name: _distribution(name, given) for name, given in value.items()}
        if not (isinstance(value, list | tuple) and all(isinstance(each, dict) for each in value)):
            raise ValueError(
                "scenarios.parameters must be a list with the parameters of each scenario, as "
                f"[{{ k = 1.0 }}, {{ k = 1.5 }}], or distributions, as k = {_DISTRIBUTIONS}, got "
                f"{shown(value)}"
            )
        return tuple(value)

    @model_validator(mode="after")
    def _fit(self) -> Self:
        count = self.count if isinstance(self.parameters, dict) else len(self.parameters)
        for key in ("weights", "scales"):
            given = getattr(self, key)
            if None not in (given, count) and len(given) != count:
                raise ValueError(
                    f"scenarios.{key} must have a number for each of {count} scenarios, got "
                    f"{len(given)}"
                )
        self._check_learned()
        if isinstance(self.parameters, dict) and not self.is_learned:
            if self.count is None or self.weights is not None:
                got = "no count" if self.count is None else "weights"
                raise ValueError(
                    "scenarios of distributions need scenarios.count, as count = 8, and no "
                    f"scenarios.weights, got {got}"
                )
            return self
        if isinstance(self.parameters, dict):
            return self
        if self.count is not None:
            raise ValueError(f"a list of scenarios has no scenarios.count, got {self.count}")
        if any(each.keys() != self.parameters[0].keys() for each in self.parameters):
            names = ", ".join(sorted({name for each in self.parameters for name in each}))
            raise ValueError(f"every scenario must have the same parameters, got some of {names}")
        return self

    def _check_learned(self) -> None:
        """Raise a `ValueError` if a key does not fit a filter that learns."""
        has_distributions = isinstance(self.parameters, dict)
        if self.is_learned:
            for key, got, needed in (
                ("criterion", self.criterion, "mean"), ("scales", self.scales, None),
                ("count", self.count, None),
                ("weights", self.weights, None if has_distributions else self.weights),
            ):  # fmt: skip
                if got != needed:
                    instead = "no" if needed is None else f"{needed!r} as"
                    raise ValueError(
                        f"scenarios.filter = 'learned' takes {instead} scenarios.{key}, got "
                        f"{shown(got)}"
                    )
        if self.motion and not (self.is_learned and has_distributions):
            raise ValueError(
                "scenarios.motion needs scenarios.filter = 'learned' and distributions, got "
                f"{self.motion}"
            )

    @property
    def is_learned(self) -> bool:
        """Whether the parameters are components of the state, and no draw has a scenario."""
        return self.filter == "learned"

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that differ between systems."""
        given = self.parameters
        return (*(given if isinstance(given, dict) else given[0]),)

    @property
    def form(self) -> Criterion:
        """The number that is minimised: the mean, or the error in the worst scenario."""
        return MEAN if self.criterion == "mean" else WorstScenario(scenario_count=len(self.each))

    @property
    def of_draws(self) -> tuple[Scenario, ...]:
        """The scenarios that draws have; none if the parameters are learned."""
        return () if self.is_learned else self.each

    @property
    def prior(self) -> Mapping[str, Mapping[str, _Pair]] | tuple[Scenario, ...]:
        """The distributions of the parameters, or the scenarios of a list."""
        return self.parameters if isinstance(self.parameters, dict) else self.each

    @property
    def each(self) -> tuple[Scenario, ...]:
        """The scenarios; their shares sum to 1."""
        parameters = self._listed
        ones = (1.0,) * len(parameters)
        weights = np.array(self.weights or ones)
        shares = (weights / weights.sum()).tolist()
        return tuple(map(Scenario, shares, parameters, self.scales or ones))

    @property
    def _listed(self) -> Sequence[Mapping[str, Any]]:
        if not isinstance(self.parameters, dict):
            return self.parameters
        columns = [
            _quantiles(kind, numbers, _parts(name if number else "", self.count or 0))
            for number, (name, distribution) in enumerate(self.parameters.items())
            for kind, numbers in distribution.items()
        ]
        return [
            dict(zip(self.parameters, values, strict=True)) for values in zip(*columns, strict=True)
        ]


def _distribution(name: str, given: Any) -> dict[str, tuple[float, float]]:
    """A checked distribution: its kind, and two numbers."""
    if isinstance(given, dict) and len(given) == 1:
        ((kind, numbers),) = given.items()
        are_numbers = is_list_of(numbers, int, float) and np.isfinite(numbers).all()
        if kind in _KINDS and are_numbers and len(numbers) == 2:
            first, second = map(float, numbers)
            above = first if kind == "uniform" else 0.0
            if second > above and (kind != "lognormal" or first > 0.0):
                return {kind: (first, second)}
    raise ValueError(
        f"scenarios.parameters.{name} must be {_DISTRIBUTIONS}, with an sd and a median above 0, "
        f"and low below high, got {shown(given)}"
    )


def _parts(name: str, count: int) -> list[float]:
    """The middles of so many parts of 0..1, in an order that the name gives; ascending without."""
    order = sorted(
        range(count), key=lambda part: stream_key("scenarios", name, part) if name else part
    )
    return [(part + 0.5) / count for part in order]


def _quantiles(kind: str, numbers: tuple[float, float], shares: Sequence[float]) -> list[float]:
    first, second = numbers
    if kind == "uniform":
        return [first + share * (second - first) for share in shares]
    scores = [second * NormalDist().inv_cdf(share) for share in shares]
    return [first * math.exp(score) if kind == "lognormal" else first + score for score in scores]
