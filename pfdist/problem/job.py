"""The job: all sections of a job file, checked together, and the functions that read it."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cached_property, partial
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, Self

import tomli_w
from pydantic import Field, PrivateAttr, ValidationError, model_validator

from pfdist.common.arguments import path_argument, texts_argument
from pfdist.common.measurement_times import EVEN, LINEARIZED, REGULAR, Times
from pfdist.common.nearest import allowed_names, did_you_mean, did_you_mean_path
from pfdist.common.parsing import MOST_LEVELS, parse_toml, read_text, with_texts
from pfdist.common.section import JobSection, checked, explained
from pfdist.errors import JobError, MeasurementTimesError, PfdistWarning, shown, shown_text
from pfdist.filters.criterion import (
    MEAN,
    Criterion,
    OtherCriterion,
    criterion_named,
    other_criteria_of,
)
from pfdist.filters.engines import is_exact
from pfdist.problem.added_sections import AddedSection, added_sections, with_added_sections
from pfdist.problem.covariates import times_of_file, with_columns, with_columns_by_time
from pfdist.problem.even_sets import has_even_sets
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import METHODS
from pfdist.problem.needs import CONTROL, fault_of
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.scenarios_section import Scenarios
from pfdist.problem.sections import (
    DEFAULT_METHOD,
    EVENLY_SPACED,
    RESERVED,
    Comparison,
    EvaluationSection,
    Execution,
    FilterSection,
    Model,
    Search,
    is_list_of,
)

if TYPE_CHECKING:  # a job is read without Numba
    from pfdist.models import NamedModel


def _needs(what: str, *needed: tuple[bool, str]) -> None:
    """Raise a `ValueError` about the first need that is not met."""
    for is_met, text in needed:
        if not is_met:
            raise ValueError(f"{what} needs {text}")


def override(data: dict[str, Any], change: str) -> None:
    """Change a value in the data of a job file, in place.

    The change is ``key=value``, with a dotted key and a TOML value; see `load_job`. Raises
    `JobError` if the text has another form, or if the job has no such section or search.
    """
    key, equals, text = change.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not equals or not all(path) or "\n" in change:
        raise JobError(
            f"changes must be key=value, for instance seed=3, got {shown(change)}", argument="set"
        )
    if len(path) > MOST_LEVELS:
        raise JobError(
            f"keys of changes must have at most {MOST_LEVELS} parts, got {len(path):,}",
            argument="set",
        )
    value = _value(text.strip(), change)
    section: Any = data
    if path[0] == "search" and len(path) > 1:
        section, path = _search_named(data, path[1], change), path[2:]
    for part in path[:-1]:
        own = section.get(part)
        if own and is_list_of(own, str):  # names of sections without keys, as of sensors
            section[part] = {name: {} for name in own}
        section = section.setdefault(part, {})
        if not isinstance(section, dict):
            raise _wrong(change, f"{shown_text(part)} is not a section and has no keys")
    if not path:
        raise _wrong(change, "name a key of the search, search.NAME.KEY=value")
    section[path[-1]] = value


def _wrong(change: str, why: str) -> JobError:
    return JobError(f"change {shown_text(change)}: {why}", argument="set")


def set_values(data: dict[str, Any], settings: Mapping[str, Any]) -> list[str]:
    """Set typed values in the data of a job file, in place, and return the changes as text.

    `settings` has a value for each key, or a mapping of keys to values for each section. An empty
    mapping makes a section. None leaves the value unchanged. The texts are for error messages.
    """
    changes = []
    for name, value in settings.items():
        if isinstance(value, Mapping):
            section = data.get(name, {})
            given = {key: each for key, each in value.items() if each is not None}
            if isinstance(section, dict) and (given or not value):  # others are refused later
                section = data[name] = dict(section)
                changes += [f"{name}.{change}" for change in set_values(section, given)]
        elif value is not None:
            is_index = isinstance(value, Integral) and not isinstance(value, bool)
            data[name] = int(value) if is_index else value  # a section takes no NumPy integer
            changes.append(f"{name}={value if isinstance(value, str) else shown(data[name])}")
    return changes


def _value(text: str, change: str) -> Any:
    """The TOML value that a text spells, or the text itself if it spells none."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise JobError(f"changes must be UTF-8 text, got {shown(change)}") from error
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError as error:
        if text[:1] in ("[", "{") or text.strip("+-").isdecimal():
            raise JobError(f"change {shown_text(change)}: {error}") from error
    return text  # a bare word: filter.resampling=systematic


def _search_named(data: dict[str, Any], name: str, change: str) -> dict[str, Any]:
    searches = data.get("search")
    searches = searches if isinstance(searches, list) else []
    searches = [search for search in searches if isinstance(search, dict)]
    names = [str(search.get("name", search.get("method"))) for search in searches]
    if name not in names:
        allowed = allowed_names(
            names or ["none, there is no [[search]]"], did_you_mean(name, names)
        )
        raise _wrong(change, f"the job has no search {shown(name)}{allowed}")
    section: dict[str, Any] = searches[names.index(name)]
    return section


# --- the job --------------------------------------------------------------------------------------

MOST_SEARCHES: Final = 100  # a figure of more searches could not be read
_NOTHING: Mapping[str, Any] = {}


class Origin(NamedTuple):
    """The source of a job."""

    path: Path = Path("job.toml")  # paths of models are relative to its folder; a run has its name
    sections: frozenset[str] = frozenset()  # that the file has; the job has more, by default
    # Models that were given as objects, for the parts "model" and "filter_model".
    models: Mapping[str, "NamedModel"] = _NOTHING
    is_file: bool = True  # a problem in Python has no job file

    @property
    def names_searches(self) -> bool:
        """Whether the file has a [[search]]."""
        return "search" in self.sections


_NO_FILE = Origin()
_EXACT_DRAWS = 2000  # by default beside exact errors, for shares of draws and for pictures


def _with_times(value: Any, key: str, data: Mapping[str, Any], folder: Path) -> Any:
    """A value of [comparison] with the times of a table instead of the name of its file."""
    if isinstance(value, dict) and key in ("comparison", "comparison.sets"):
        keys = {name: f"{key}.{name}" for name in value}
        return {name: _with_times(value[name], keys[name], data, folder) for name in value}
    if not (isinstance(value, str) and value.startswith("@")):
        return value
    try:
        points = ProblemSection.model_validate(data.get("problem")).points
    except (ValidationError, MeasurementTimesError):
        return value  # the check of the job says what is wrong
    return times_of_file(value, points, folder, partial(warnings.warn, category=PfdistWarning), key)


@with_added_sections
class Job(JobSection):
    """A validated job: everything that identifies a run, and where it is computed.

    Use `load_job` to read a job file.

    Parameters
    ----------
    origin : Origin
        Where the job comes from.
    seed : int
        The seed of all random numbers.
    **data
        The sections, as in a job file.

    Raises
    ------
    JobError
        A value is wrong, or values contradict each other.
    """

    seed: Annotated[int, Field(ge=0, lt=2**63)]
    model: Model = Model()
    problem: ProblemSection
    filter: FilterSection = FilterSection()
    evaluation: EvaluationSection = EvaluationSection()
    scenarios: Scenarios | None = None
    search: tuple[Search, ...] = Field(
        default=(METHODS[DEFAULT_METHOD].section(),),
        max_length=MOST_SEARCHES,
        strict=False,
    )
    comparison: Comparison = Comparison()
    execution: Execution = Execution()
    _origin: Origin = PrivateAttr()

    def __init__(self, origin: Origin = _NO_FILE, /, **data: Any) -> None:
        data = with_texts(data)
        if "model" in data:
            data["model"] = with_columns(data["model"], origin.path.parent)
        if "problem" in data:
            data["problem"] = with_columns_by_time(data["problem"], origin.path.parent)
        if "comparison" in data:
            given = _with_times(data["comparison"], "comparison", data, origin.path.parent)
            data["comparison"] = given
        try:
            super().__init__(**data)
        except ValidationError as error:
            why, keys = explained(error, Job), Job.model_fields.keys()
            added = [key for key, value in data.items() if key not in keys and type(value) is dict]
            if added and why.startswith(f"unknown key {added[0]!r}, "):  # it is like no other
                why += f"; [{added[0]}] needs a plugin that adds it"
            raise JobError(why) from error
        self._origin = origin._replace(path=origin.path.absolute())  # a model may move the process

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        """Check the names of searches and of given sets, and that the reference is one of these."""
        named, names = self.comparison.named, [search.name for search in self.search]
        for name in names:
            if name in (*RESERVED, EVEN):
                raise ValueError(
                    f"search names must not be {', '.join(map(repr, (*RESERVED, EVEN)))}, got "
                    f"{name!r}"
                )
            if [*names, *named].count(name) > 1:
                raise ValueError(
                    "names of searches and of comparison.sets must differ from each other, got "
                    f'{name!r} twice: give a search another name with name = "..."'
                )
        reference = self.comparison.reference
        if EVEN in named and (self.comparison.is_even or self.search):
            raise ValueError(
                f"comparison.sets must not name a set {EVEN!r}: the best evenly spaced times have "
                "this name in tables"
            )
        if isinstance(reference, str) and reference not in (
            EVENLY_SPACED, REGULAR, LINEARIZED, *named
        ):  # fmt: skip
            sets = ", ".join(map(repr, named)) or "which names none"
            raise ValueError(
                f"comparison.reference must be {EVENLY_SPACED!r}, {REGULAR!r}, {LINEARIZED!r}, a "
                "list of times, for instance [0, 3, 6], or the name of a set of comparison.sets "
                f"({sets}), got {reference!r}"
            )
        _needs("a job", (bool(names or named), "a search, or comparison.sets with sets to compare"))
        return self

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        if why := fault_of(self):
            raise ValueError(why)
        return self

    def section(self, key: str) -> Any:
        """The section that a plugin adds; None without it."""
        return getattr(self, key, None)

    @property
    def added(self) -> list[AddedSection]:
        """The sections of plugins that the job has."""
        return [each for key in added_sections() if (each := getattr(self, key)) is not None]

    @property
    def amounts(self) -> Sequence[int]:
        """The numbers of measurements, or prices, with sets of their own; none if there is one."""
        return next((each.amounts for each in self.added if each.amounts), ())

    @model_validator(mode="after")
    def _goes_with_sections(self) -> Self:
        for each in self.added:
            each.check(self)
        return self

    @model_validator(mode="after")
    def _has_evenly_spaced_sets(self) -> Self:
        """Take regular times as the reference where no evenly spaced set has the required ones."""
        each = [*map(self.feasible, self.amounts)] or [self.problem.feasible]
        if self.comparison.is_even and not all(map(has_even_sets, each)):
            regular = self.comparison.model_copy(update={"reference": REGULAR})
            object.__setattr__(self, "comparison", regular)  # frozen from now on
        return self

    @property
    def is_controlled(self) -> bool:
        """Whether questions about the job use a control: if it can have one and allows it."""
        return self.comparison.control is not False and not CONTROL.lacks(self)

    def with_control(self) -> "Job":
        """The job whose comparison has a control, if it can have one and allows it."""
        if not self.is_controlled:
            return self
        return self.with_changes(settings={"comparison": {"control": True}})

    @model_validator(mode="after")
    def _simulates_few_draws_beside_exact_errors(self) -> Self:
        """Compare few draws by default, if neither errors nor the criteria come from them."""
        needs_draws = any(each.needs_draws for each in self.other_criteria.values())
        is_given = "draws" in self.comparison.model_fields_set
        if is_exact(self.filter.engine) and not (is_given or needs_draws or self.scenarios):
            comparison = self.comparison.model_copy(update={"draws": _EXACT_DRAWS})
            object.__setattr__(self, "comparison", comparison)
        return self

    @model_validator(mode="after")
    def _compares_references(self) -> Self:
        """Compare with all references of the problem, unless the job names its own sets.

        The times of all given sets must be those of the clock.
        """
        feasible = self.problem.feasible
        if feasible.references and self.comparison.sets is None and not self.amounts:
            sets = {
                name: (name,)
                for name, times in feasible.references.items()
                if times != feasible.regular()
            }
            comparison = self.comparison.model_copy(update={"sets": sets or None})
            object.__setattr__(self, "comparison", comparison)
        try:
            self.given_sets  # noqa: B018  made here, because it checks the times
        except MeasurementTimesError as error:
            raise ValueError(str(error)) from error
        return self

    @cached_property
    def given_sets(self) -> dict[str, Times | None]:
        """Instants of the sets that the job gives, the reference first.

        None means regular times, the best evenly spaced times as the reference, or the linearized
        design, which `pfdist.runner.build.with_design` finds.

        Raises `MeasurementTimesError`, which names the key, if a time lies outside the horizon, is
        not on the clock, or is given twice.
        """
        comparison, references = self.comparison, self.problem.feasible.references
        first, named = comparison.reference_name, comparison.named
        written = {name: (f"comparison.sets.{name}", times) for name, times in named.items()}
        own = written.pop(first, ("comparison.reference", comparison.reference))
        return {
            name: None if times in (EVENLY_SPACED, REGULAR, LINEARIZED, (LINEARIZED,))
            else references[times[0]] if len(times) == 1 and times[0] in references
            else self.problem.points.checked(times, key, key)
            for name, (key, times) in {first: own, **written}.items()
        }  # fmt: skip

    def feasible(self, amount: int) -> Feasible:
        """The feasible sets for another number of measurements, or for at most another price."""
        feasible = self.problem.feasible
        if feasible.total_price is not None:
            return replace(feasible, total_price=amount, smaller=True)
        return replace(feasible, measurement_budget=amount)

    @property
    def origin(self) -> Origin:
        """Where the job comes from."""
        return self._origin

    @property
    def path(self) -> Path:
        """The job file. Paths of models are relative to its folder, and a run has its name."""
        return self._origin.path

    @cached_property
    def criterion(self) -> Criterion:
        """The number that is minimised."""
        if self.problem.criterion is not None:
            return criterion_named(self.problem.criterion)
        return MEAN if self.scenarios is None else self.scenarios.form

    @cached_property
    def other_criteria(self) -> dict[str, OtherCriterion]:
        """The criteria by which compared sets are judged besides the expected MSE, by their names.

        One of scenarios is judged by their errors.
        """
        return other_criteria_of(self.problem.criterion, self.comparison.also)

    def with_changes(
        self,
        overrides: Iterable[str] = (),
        sections: Mapping[str, Any] = _NOTHING,
        settings: Mapping[str, Any] = _NOTHING,
    ) -> "Job":
        """The job with some keys changed; parameters and errors as in `load_job`."""
        data = self.model_dump(mode="json", exclude_none=True, by_alias=True)
        return _validated(data, self._origin, overrides, sections, settings)

    def without_delays(self) -> "Job":
        """The job whose sensors give their values at once."""
        if not self.problem.points.delays:
            return self
        problem = self.model_dump(mode="json", exclude_none=True, by_alias=True)["problem"]
        for sensor in (problem.get("sensor", {}), *problem.get("sensors", {}).values()):
            sensor.pop("delay", None)
        return self.with_changes(sections={"problem": problem})

    def identity(self) -> dict[str, Any]:
        """Everything that identifies a run of this job, without [execution] and codes of tables."""
        others: Any = {"execution": True, "problem": {"measurements"}}
        return self.model_dump(mode="json", exclude=others, exclude_none=True, by_alias=True)


def load_job(
    path: str | Path,
    overrides: Iterable[str] = (),
    sections: Mapping[str, Any] = _NOTHING,
    settings: Mapping[str, Any] = _NOTHING,
) -> Job:
    """The job of a job file, read and validated.

    Parameters
    ----------
    path : str or Path
        A TOML file, or the folder of a run, which keeps its job and its models.
    overrides : iterable of str
        ``key=value`` each, with a dotted key and a TOML value, for instance ``seed=3`` or
        ``search.genetic.generations=5``, where ``genetic`` is the name of a search.
    sections : mapping of str to object, optional
        Whole sections that replace those of the file, before the overrides.
    settings : mapping of str to object, optional
        Values that replace those of the file, after the overrides: by section and key, as in
        ``{"filter": {"particles": 100}, "seed": 3}``. None leaves the value unchanged.

    Returns
    -------
    Job

    Raises
    ------
    JobError
        The file cannot be read or is not TOML, a value is wrong, or values contradict each other.
    """
    path = path_argument("job", path)
    if path.is_dir() or path.name == "job.toml":
        # Imported here, because most jobs are other files.
        from pfdist.store import check_entries, holds_run  # noqa: PLC0415

        if path.is_dir() and holds_run(path):
            check_entries(path)
            path /= "job.toml"
    data = toml_of_file(path)
    if "job" in data:
        raise JobError(f"{path} is a sweep file, not a job: run it by `pfdist sweep {path}`")
    origin = Origin(path, frozenset(data))
    try:
        return _validated(data, origin, overrides, sections, settings)
    except JobError:
        from pfdist.store import is_job_of_run  # noqa: PLC0415  as above
        from pfdist.store.about import check_version_of  # noqa: PLC0415

        if is_job_of_run(path):  # of another version, perhaps, with keys that are unknown today
            check_version_of(path.parent)
        raise


def toml_of_file(path: Path) -> dict[str, Any]:
    """The data of a job file or a sweep file.

    Raises `JobError` if the file cannot be read or is not TOML.
    """
    try:
        return parse_toml(read_text(path))
    except IsADirectoryError as error:
        raise JobError(f"a job must be a job file, got the folder {path}") from error
    except OSError as error:
        folders = path.parent, Path("jobs")
        meant = did_you_mean_path(path, folders, lambda other: other.suffix == ".toml")
        raise JobError(f"cannot read the job file {path}: {error.strerror}{meant}") from error
    except ValueError as error:
        raise JobError(f"the job file must be TOML, got an error: {error} ({path})") from error


def job_toml(identity: Mapping[str, Any]) -> str:
    """The identity of a run as TOML text; equal identities give equal texts."""
    return tomli_w.dumps(identity)


@checked
def _validated(
    data: dict[str, Any],
    origin: Origin,
    overrides: Iterable[str],
    sections: Annotated[Mapping[str, Any], Field()],
    settings: Annotated[Mapping[str, Any], Field()],
) -> Job:
    changes_as_text = texts_argument("changes", overrides)
    data = deepcopy({**data, **sections})
    for change in changes_as_text:
        override(data, change)
    changes_as_text += set_values(data, settings)
    try:
        return Job(origin, **data)
    except JobError as error:
        changes = f"with {shown_text(' '.join(changes_as_text))}" if changes_as_text else ""
        where = f"{origin.path} {changes}".strip() if origin.is_file else changes
        raise JobError(f"{error} ({where})" if where else str(error)) from error
