"""The sections of a job file other than [problem] and [[search]], with bounds and defaults."""

from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from pfdist.common.measurement_times import EVEN, REGULAR
from pfdist.common.section import JobSection, Listed
from pfdist.errors import shown
from pfdist.filters.criterion import criteria_in_words, criterion_named
from pfdist.filters.engines import AUTO, EngineName
from pfdist.filters.proposals import PROPOSALS, ProposalName
from pfdist.kernels.schemes import ALWAYS, Resampling, threshold_of
from pfdist.pools.kinds import AUTO as AUTO_POOL
from pfdist.pools.kinds import POOLS
from pfdist.problem.clock import Time, plain_time
from pfdist.problem.methods import any_section
from pfdist.problem.search_section import Degenerate, SearchSection, is_name

DEFAULT_METHOD: Final = "relaxation"  # of a search; the name of its set, too
EVENLY_SPACED: Final = "evenly spaced"  # a reference: the best evenly spaced times
REFERENCE: Final = "reference"  # name of a reference that the job gives, in tables and figures
MOST_SETS: Final = 100
"""Largest number of sets that a job may give by name; they form almost 5,000 pairs."""
LONGEST_SET_NAME = 64  # characters, as a name of a table's column may have
RESERVED: Final = (REGULAR, REFERENCE, "comparison")
"""Names that no search may have, and no given set; only regular times may be called "regular"."""
MOVED_PARTICLES: Final = 100  # by default
_LONGEST_TEXT = 4096  # characters of a path
if TYPE_CHECKING:
    Particles = int  # where something is computed
    PoolName = str
    Search = SearchSection
else:
    Particles = Annotated[int, Field(ge=1, le=10_000_000)] | Literal[AUTO]
    PoolName = Literal[(AUTO_POOL, *POOLS)]
    Search = any_section()


def is_list_of(value: Any, *kinds: type) -> bool:
    """Whether a value is a list whose entries have exactly one of these types."""
    return isinstance(value, list | tuple) and all(type(entry) in kinds for entry in value)


def _plain_parameter(given: Any) -> Any:
    value = given.tolist() if hasattr(given, "tolist") else given
    return tuple(value) if isinstance(value, list) else value


def _listed_times(written: Any) -> Any:
    return (written,) if isinstance(written, str) and written != REGULAR else written


Moment = Annotated[Time, AfterValidator(plain_time)]
"""A number as a job stores it, such as a time."""
_NUMBER_OR_TEXT: Final = {"type": ["number", "string"]}
Written = WithJsonSchema(_NUMBER_OR_TEXT)
"""How a job file has a date, or a span of time such as "2 h"."""
ListWritten = WithJsonSchema({"type": "array", "items": _NUMBER_OR_TEXT})
"""How a job file has dates."""
OF_TABLE: Final = {
    "type": "object",
    "properties": {"file": {"type": "string"}, "column": {"type": "string"}},
    "required": ["file"],
    "additionalProperties": False,
}
"""How a job file names a column of a table, which `pfdist.problem.covariates` reads."""


def ranges_or_column(**number: float) -> WithJsonSchema:
    """How a job file has a number for each range of times, or a column of a table."""
    of_range = {"type": "number", **number}
    return WithJsonSchema(
        {"anyOf": [{"type": "object", "additionalProperties": of_range}, OF_TABLE]}
    )


MomentsAndRanges = Listed[Annotated[Time | str, AfterValidator(plain_time)]]
"""Times and ranges as a job stores them."""
Parameter = Annotated[
    float | Annotated[tuple[float, ...], Field(min_length=1)],
    BeforeValidator(_plain_parameter),
    WithJsonSchema(
        {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}, OF_TABLE]}
    ),
]
"""A number, or a number for each instant; `covariates.with_columns` reads a column of a table."""
_Text = Annotated[str, Field(max_length=_LONGEST_TEXT, pattern=r"^[^\x00]*$")]


def _criterion_name(written: str) -> str:
    try:
        criterion_named(written)
    except ValueError as error:
        raise PydanticCustomError("criterion", criteria_in_words()) from error
    return written


CriterionName = Annotated[_Text, AfterValidator(_criterion_name)]
"""A name of `pfdist.filters.criterion.criterion_named`."""
_SetName = Annotated[str, Field(max_length=LONGEST_SET_NAME), AfterValidator(is_name)]
_SetTimes = Annotated[
    Literal["regular"] | MomentsAndRanges,
    BeforeValidator(_listed_times),
    WithJsonSchema({"type": ["string", "array"], "items": _NUMBER_OR_TEXT}),
]


def _as_event(row: Any) -> Any:
    if not isinstance(row, list | tuple) or len(row) != 3:
        raise ValueError(f"rows of model.events must be [time, amount, state], got {shown(row)}")
    return tuple(row)


_Finite = Annotated[float, Field(allow_inf_nan=False)]
_OfEvents = WithJsonSchema({"anyOf": [{"type": "array", "items": {"type": "array"}}, OF_TABLE]})
_Event = Annotated[
    tuple[_Finite, _Finite | str, Annotated[int, Field(ge=0)]],
    BeforeValidator(_as_event),
]


class FilterModel(JobSection):
    """The filter's model, if it differs from the truth: another model, or other parameters.

    Parameters
    ----------
    name : str
        The model of the filter, named like the truth. Its default parameters are its own.
    parameters : dict of str to float
        Values that replace parameters of the filter's model.
    """

    name: _Text = ""
    parameters: dict[str, Parameter] = Field(default_factory=dict)


class Model(JobSection):
    """The system: a built-in model, an entry point, or ``path/file.py:object``.

    Parameters
    ----------
    name : str
        A model that ships, an entry point of ``pfdist.models``, or ``path/file.py:object``.
    parameters : dict of str to float, the model's unit
        Values that replace those of the model: a number, a number for each instant, or a column of
        a table, as ``{file = "weather.csv", column = "rain"}``.
    filter : section
        The model of the filter, if it differs from the truth.
    events : dict of str to list
        Tables of doses and other jumps: rows ``[time, amount, state]``, or ``{file = "doses.csv"}``
        with these columns.
    """

    name: _Text = "ungm"
    parameters: dict[str, Parameter] = Field(default_factory=dict)
    filter: FilterModel = FilterModel()
    events: dict[str, Annotated[Listed[_Event], _OfEvents]] | None = None


class FilterSection(JobSection):
    """The particle filter.

    `pfdist.runner.build.build` replaces ``particles = "auto"`` by a number, so particles are an
    integer wherever something is computed.

    Parameters
    ----------
    particles : int or "auto"
        Number of particles; "auto" finds a sufficient number. Exact engines have none.
    resampling : str
        The resampling scheme.
    resample : str
        "always" (by default), or "below 0.5": only if the effective sample size falls below this
        share of the particles.
    engine : str
        The engine that computes the filter.
    proposal : str
        "guided" redraws the noise since the last measurement when the next one is known. "moving"
        moves whole lines of particles at each measurement, so that constants are learned. "auto"
        takes the one with the least particle loss in the same time.
    moved_particles : int
        Number of particles where the proposal is "moving"; a moved particle takes the time of 50 to
        300 others. By default 100, or 20 for each constant if that is more; a search has half of
        them.
    """

    particles: Particles = 500
    resampling: Resampling = "multinomial"
    resample: str | None = None  # None stands for "always", which is not written into a job
    engine: EngineName = AUTO
    proposal: ProposalName = AUTO
    moved_particles: Annotated[int, Field(ge=20, lt=2**31)] | None = None

    _steps_a_particle: float = PrivateAttr(1.0)

    @property
    def steps_a_particle(self) -> float:
        """Particle-steps of a particle at an instant, about; `build` finds them."""
        return self._steps_a_particle

    def chosen(self, proposal: str, particles: int, moved: int | None, steps: float) -> Self:
        """The section with a proposal and numbers of particles, which are valid."""
        update = {"proposal": proposal, "particles": particles, "moved_particles": moved}
        section = self.model_copy(update=update)
        section._steps_a_particle = steps
        return section

    @property
    def moves(self) -> bool:
        """Whether lines of particles move; False while the proposal is still "auto"."""
        return self.proposal in PROPOSALS and PROPOSALS[self.proposal].moves

    @property
    def compared_particles(self) -> int:
        """Number of particles of the filter that comparisons judge."""
        if self.moves:
            return self.moved_particles or MOVED_PARTICLES
        return self.particles

    @property
    def is_automatic(self) -> bool:
        """Whether the number of particles is still "auto"."""
        return isinstance(self.particles, str)

    @field_validator("resample", mode="before")
    @classmethod
    def _is_always_or_below(cls, value: Any) -> Any:
        try:
            return None if value is None or threshold_of(value) == ALWAYS else value
        except ValueError as error:
            raise ValueError(f"filter.{error}") from error

    @property
    def threshold(self) -> float:
        """The share of the particles; below it, an effective sample size leads to resampling."""
        return threshold_of(self.resample or "always")


class EvaluationSection(JobSection):
    """How a search estimates the expected MSE of a set of times.

    Parameters
    ----------
    draws : int
        K, the number of draws on which a set of times is evaluated.
    noise : str
        Whether each evaluation has fresh draws, or all share the same draws.
    degenerate_draws : str
        With "kill", a degenerate draw makes the error of a set infinite in genetic and random
        searches, and there is no plan if more than half of the draws are degenerate with it.
    """

    draws: Annotated[int, Field(ge=2, le=10_000_000)] = 1000
    noise: Literal["fresh", "common"] = "fresh"
    degenerate_draws: Degenerate = "kill"


class Comparison(JobSection):
    """The comparison of sets of times with the reference, on the same fresh draws.

    The compared sets are those of searches, and those that ``sets`` gives by name. The reference is
    "evenly spaced", the best of all evenly spaced sets and of the feasible given sets, chosen on
    separate draws; "regular", the feasible set nearest to the paper's regular times, from the first
    instant to the last; "linearized", the set of least linearized error; a set of times in 0..T or
    on the clock; or the name of a given set. A given set may break constraints.

    Parameters
    ----------
    draws : int
        Number of fresh draws on which all sets are compared. By default 2,000 with an exact engine,
        whose expected errors need none, unless there are scenarios or a quantile.
    reference : str or list of times, clock
        The set with which the others are compared.
    sets : dict of str to times, clock
        At most 100 sets by name; names are lower-case letters, digits and underscores. "@last.csv"
        takes the times in the column t of a table, "@last.csv:date" in another; "linearized" those
        of least linearized error.
    labels : dict of str to str
        The names of these sets in answers, as "30 min and 1 h after meals".
    control : bool
        Whether a second filter, with the truth among its particles, reduces the variance of means
        for twice the work. By default, `compare`, `budget` and `why` use it where the filter's
        model is the truth.
    also : list of str
        Other criteria by which sets are judged, too, named as `problem.criterion`.
    """

    draws: Annotated[int, Field(ge=2, le=100_000_000)] = 100_000
    reference: str | MomentsAndRanges = EVENLY_SPACED
    sets: Annotated[dict[_SetName, _SetTimes], Field(max_length=MOST_SETS)] | None = None
    labels: dict[_SetName, Annotated[str, Field(min_length=1, max_length=80)]] | None = None
    control: bool | None = None
    also: Listed[CriterionName] | None = None

    @field_validator("reference")
    @classmethod
    def _are_sorted(cls, value: Any) -> Any:
        is_text = isinstance(value, str) or any(isinstance(time, str) for time in value)
        return value if is_text else tuple(sorted(value))

    @field_validator("sets")
    @classmethod
    def _are_not_reserved(cls, sets: Any) -> Any:
        for name in {*(sets or {})} & {*RESERVED}:
            if not name == sets[name] == REGULAR:
                raise ValueError(
                    f"comparison.sets must not name a set {name!r}, because pfdist uses this name; "
                    f"got {shown(sets[name])}"
                )
        return sets or None

    @model_validator(mode="after")
    def _labels_name_sets(self) -> Self:
        for name in {*(self.labels or {})} - {*(self.sets or {})}:
            raise ValueError(
                f"comparison.labels must name sets of comparison.sets, got {name!r}; sets: "
                f"{', '.join(self.sets or {}) or 'none'}"
            )
        return self

    @property
    def named(self) -> dict[str, str | tuple[Time | str, ...]]:
        """The sets that the job gives by name, as written; "regular" means regular times."""
        return {**(self.sets or {})}

    @property
    def reference_name(self) -> str:
        """Name of the reference in tables and figures."""
        if not isinstance(self.reference, str):
            return REFERENCE
        return EVEN if self.is_even else self.reference

    @property
    def is_even(self) -> bool:
        """Whether the reference is the best of evenly spaced sets."""
        return self.reference == EVENLY_SPACED


class Execution(JobSection):
    """Where a run is computed; not part of the run's identity.

    Parameters
    ----------
    pool : str
        The pool that computes the tasks.
    workers : int
        Number of workers or threads, at most 1,000 on one machine; 0 means all cores that the
        process may use.
    address : str
        Address of a Ray cluster, as HOST:PORT, ``auto`` or ``local``.
    failures : int
        Number of tasks that may fail; each runs once more.
    """

    pool: PoolName = AUTO_POOL
    workers: Annotated[int, Field(ge=0, lt=2**63)] = 0
    address: _Text = ""
    failures: Annotated[int, Field(ge=0, lt=2**63)] = 3
