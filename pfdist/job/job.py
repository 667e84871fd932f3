"""The job file: TOML in, frozen and validated data out. Data only: nothing is built here."""

from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self

import tomli_w
from pydantic import (
    AfterValidator,
    Field,
    PrivateAttr,
    ValidationError,
    field_validator,
    model_validator,
)

from pfdist.common.explained import explained
from pfdist.common.parsing import parse_toml, read_text
from pfdist.common.section import Section
from pfdist.errors import JobError, MeasurementTimesError, shown, shown_text
from pfdist.evaluation.engines import AUTO, ENGINES
from pfdist.job.overrides import override, set_values
from pfdist.job.problem_section import ProblemSection
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.pools.kinds import POOLS
from pfdist.search.methods import DEFAULT_METHOD, METHODS, any_section
from pfdist.search.section import Estimator, Resampling, SearchSection
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import REGULAR, Times, validated

GIVEN: Final = "reference"
RESERVED: Final = (REGULAR, GIVEN, "comparison")  # names that no search may have
MOST_SEARCHES: Final = 100  # of which a figure can still be made
_LONGEST_TEXT = 4096  # of a path
_NOTHING: Mapping[str, Any] = {}
if TYPE_CHECKING:
    Search = SearchSection
    EngineName = str
    PoolName = str
else:
    Search = any_section()
    EngineName = Literal[(AUTO, *ENGINES)]
    PoolName = Literal[tuple(POOLS)]


def _has_no_nul(text: str) -> str:
    if "\0" in text or len(text) > _LONGEST_TEXT:
        raise ValueError(
            f"names must have at most {_LONGEST_TEXT:,} characters, and none that is NUL, got "
            f"{shown(text)}"
        )
    return text


Text = Annotated[str, AfterValidator(_has_no_nul)]


class FilterModel(Section):
    """What the filter takes for the truth: another model, or the same with other parameters."""

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
    """How the expected MSE of a set of times is estimated during a search."""

    draws: Annotated[int, Field(ge=2, le=10_000_000)] = 1000
    noise: Literal["fresh", "common"] = "fresh"
    degenerate_draws: Literal["kill", "leave_out"] = "kill"
    estimator: Estimator = SQUARED_ERROR.name


class Until(Section):
    """When a comparison has draws enough."""

    half_width: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0


class Comparison(Section):
    """The found times against the reference, on the same fresh draws.

    The reference is the regular times, or whatever set is nearest to them, or a set of any times
    in 0..T, feasible or not.
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
    """For which numbers of measurements times are wanted, which `pfdist budget` asks."""

    least: Annotated[int, Field(ge=2, lt=2**63)]
    most: Annotated[int, Field(ge=2, lt=2**63)]


class Execution(Section):
    """Where a run is computed; never part of what it is."""

    pool: PoolName = "ray"
    workers: Annotated[int, Field(ge=0, lt=2**63)] = 0
    address: Text = ""
    failures: Annotated[int, Field(ge=0, lt=2**63)] = 3


class Job(Section):
    """Everything a run is, and where to compute it. Made by `load_job`."""

    seed: Annotated[int, Field(ge=0, lt=2**63)]
    model: Model = Model()
    problem: ProblemSection
    filter: Filter = Filter()
    evaluation: EvaluationSection = EvaluationSection()
    search: tuple[Search, ...] = Field(
        default=(METHODS[DEFAULT_METHOD].section(),),
        min_length=1,
        max_length=MOST_SEARCHES,
        strict=False,
    )
    comparison: Comparison = Comparison()
    budget: Budget | None = None
    execution: Execution = Execution()
    _path: Path = PrivateAttr(default=Path("job.toml"))
    _names_its_searches: bool = PrivateAttr(default=False)

    def __init__(self, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise JobError(explained(error, Job)) from error

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [search.name for search in self.search]
        for name in names:
            if name in RESERVED:
                raise ValueError(
                    f"search names must not be {', '.join(map(repr, RESERVED))}, got {name!r}"
                )
            if names.count(name) > 1:
                raise ValueError(
                    f"search names must be unique, got {name!r} twice: give one of these searches "
                    'name = "..."'
                )
        return self

    @model_validator(mode="after")
    def _has_sets_of_every_number(self) -> Self:
        if self.budget is None:
            return self
        least, most = self.budget.least, self.budget.most
        if self.comparison.reference != REGULAR:
            raise ValueError(
                f"budget needs comparison.reference = {REGULAR!r}, got a single set of times"
            )
        if least > most:
            raise ValueError(f"budget.least must be at most budget.most = {most}, got {least}")
        if not self.problem.feasible.counted:
            raise ValueError("budget needs problem.measurement_budget, got problem.total_cost")
        if any(search.method != DEFAULT_METHOD for search in self.search) or len(self.search) > 1:
            methods = ", ".join(search.method for search in self.search)
            raise ValueError(f"budget needs one search of method {DEFAULT_METHOD!r}, got {methods}")
        if self.search[0].polish:
            raise ValueError("budget needs a search with polish = false, got true")
        for number in (least, most):
            try:
                self.feasible(number)
            except MeasurementTimesError as error:
                raise ValueError(f"budget of {number} measurements: {error}") from error
        return self

    @model_validator(mode="after")
    def _reference_is_of_this_horizon(self) -> Self:
        reference = self.comparison.reference
        if not isinstance(reference, str):
            try:
                validated(reference, self.problem.horizon, "comparison.reference")
            except MeasurementTimesError as error:
                raise ValueError(str(error)) from error
        return self

    def feasible(self, measurement_budget: int) -> Feasible:
        """The sets of so many measurements that may be chosen."""
        return replace(self.problem.feasible, measurement_budget=measurement_budget)

    @property
    def path(self) -> Path:
        """The job file: a model's path is relative to its folder, a run is named after it."""
        return self._path

    def with_changes(
        self,
        overrides: Iterable[str] = (),
        sections: Mapping[str, Any] = _NOTHING,
        settings: Mapping[str, Any] = _NOTHING,
    ) -> "Job":
        """Give the job with some keys changed; parameters and errors as of `load_job`."""
        data = self.model_dump(mode="json", exclude_none=True) | dict(sections)
        return _validated(data, self.path, overrides, settings, self.names_its_searches)

    @property
    def names_its_searches(self) -> bool:
        """Whether the job file has a [[search]], or the default is taken."""
        return self._names_its_searches

    def identity(self) -> dict[str, Any]:
        """What a run of this job is: everything but [execution]."""
        return self.model_dump(mode="json", exclude={"execution"}, exclude_none=True)


def load_job(
    path: str | Path,
    overrides: Iterable[str] = (),
    sections: Mapping[str, Any] = _NOTHING,
    settings: Mapping[str, Any] = _NOTHING,
) -> Job:
    """Read and validate a job file.

    Parameters
    ----------
    path : str or Path
        A TOML file.
    overrides : iterable of str
        ``key=value`` each, with a dotted key and a TOML value, for instance ``seed=3`` or
        ``search.genetic.generations=5`` (a search goes by its name).
    sections : mapping of str to object, optional
        Whole sections that replace those of the file, before the overrides.
    settings : mapping of str to object, optional
        Values that replace those of the file, after the overrides: by section and key, as in
        ``{"filter": {"particles": 100}, "seed": 3}``.

    Returns
    -------
    Job

    Raises
    ------
    JobError
        The file cannot be read, is no TOML, or says something impossible.
    """
    path = Path(path)
    try:
        data = parse_toml(read_text(path))
    except OSError as error:
        raise JobError(f"cannot read the job file {path}: {error.strerror}") from error
    except ValueError as error:
        raise JobError(f"the job file must be TOML, got an error: {error} ({path})") from error
    return _validated(data | dict(sections), path, overrides, settings, "search" in data)


def as_job(
    job: Job | str | Path,
    overrides: Iterable[str] = (),
    sections: Mapping[str, Any] = _NOTHING,
    settings: Mapping[str, Any] = _NOTHING,
) -> Job:
    """Give a job, or the job of a file, with changes; parameters and errors as of `load_job`."""
    if not isinstance(job, Job):
        return load_job(job, overrides, sections, settings)
    overrides = list(overrides)
    changed = overrides or sections or settings
    return job.with_changes(overrides, sections, settings) if changed else job


def job_toml(identity: Mapping[str, Any]) -> str:
    """Write what a run is as TOML; the same text for the same identity."""
    return tomli_w.dumps(identity)


def _validated(
    data: dict[str, Any],
    path: Path,
    overrides: Iterable[str],
    settings: Mapping[str, Any],
    names_its_searches: bool,
) -> Job:
    given, data = list(overrides), deepcopy(data)
    for change in given:
        override(data, change)
    given += set_values(data, settings)
    try:
        job = Job(**data)
    except JobError as error:
        where = f"{path} with {shown_text(' '.join(given))}" if given else str(path)
        raise JobError(f"{error} ({where})") from error
    job._path, job._names_its_searches = path, names_its_searches
    return job
