"""A problem in Python: a model, and constraints on its measurements.

Public functions take a problem, a job, or a path; `as_job` makes a job of each.
"""

import inspect
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from pydantic import ValidationError

from pfdist.common import parts
from pfdist.common.arguments import listed_argument, texts_argument
from pfdist.common.nearest import allowed_names, did_you_mean
from pfdist.common.parsing import as_text
from pfdist.common.section import JobSection, explained, keys_of_section
from pfdist.common.shown import Shown
from pfdist.errors import JobError, ModelError, shown
from pfdist.models import (
    PYTHON,
    NamedModel,
    StateSpaceModel,
    check_name,
    installed_name,
    load_model,
)
from pfdist.problem.job import Job, Origin, load_job
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.sections import FilterSection

_SECTIONS: dict[str, type[JobSection]] = {"problem": ProblemSection, "filter": FilterSection}
_OWN = ("seed", "model", *_SECTIONS)
_STRANGE = re.compile(r"[^\w.-]+")


class Problem(Shown):
    """A model, and how often and when it may be measured: the Python form of a job file.

    The keys are those of the sections [problem] and [filter] of a job file. All are checked at
    once. The formulas of a model from a notebook or script are recorded at each computation.

    Parameters
    ----------
    model : StateSpaceModel or str
        The model; or a name as in a job file: "ungm", or "path/file.py:object".
    filter_model : StateSpaceModel or str, optional
        The model that the filter uses, if it differs from the truth.
    scenarios : mapping of str to object, optional
        Parameters that the truth may have, as in the section [scenarios] of a job file, for
        instance ``{"parameters": [{"k": 0.8}, {"k": 1.2}], "criterion": "worst"}``.
    horizon : int or float
        T: the instants are 0..T. With a clock, the time of the last instant.
    time_step, time_unit, times : float, str and sequence of float, optional
        The clock: the time from an instant to the next, the name of the unit, or, instead of the
        horizon, the time of every instant. With a clock, all times are times on the clock.
    clock : mapping, optional
        Start, step and time zone, if times are dates: ``{"start": "2026-04-01", "step": "1 d"}``.
    instant_weights : {"first", "last"}, sequence of float, or mapping of str to float, optional
        Weight of the error of each instant, or of ranges, in the MSE: ``{"0:7": 0, "8:24": 1}``.
    lag : int or float, optional
        The estimate of z at a time uses measurements until so much later.
    estimate : {"filtered", "smoothed"}, optional
        With "smoothed", the estimate of z at a time uses all measurements.
    measurement_budget : int, optional
        The number of measurements.
    forbidden, allowed, required : sequence of int, float, str and range, optional
        Times without a measurement, the only times that may have one, and times with one:
        ``range(20, 31)`` or ``[0, "20:30"]``. A range of Python lists whole numbers; a text means
        all instants from the first to the last.
    minimum_spacing : int or float, optional
        Smallest difference of two measurement times.
    price : sequence of float, or mapping of str to float, optional
        Price of a measurement at each instant, or in each range, as in ``{"0:30": 1, "31:60": 2}``.
        Decimals are exact.
    total_price : float, optional
        Largest sum of prices, instead of the measurement budget.
    sensors : mapping of str to mapping, optional
        For each sensor of the model its price, forbidden times, the largest number of its
        measurements (most) and their minimum_spacing. By default, the prices of the model.
    given : mapping of str to str, optional
        Parameters that come with each reading, and the column of each in measured tables.
    visits : mapping, optional
        Measurements that share a price: ``{"price": 100, "within": 4}``.
    store : mapping, optional
        A store that measurements draw from: ``{"capacity": 6, "start": 2, "income": 0.5}``.
    most_within : mapping, optional
        The most measurements in any stretch of time: ``{"number": 3, "time": 1}``.
    measurements : mapping, optional
        Codes in tables: ``{"failed": ["Ice"], "missing": ["Eqp", "***"]}``.
    particles : int or "auto"
        "auto" finds a sufficient number when something is computed.
    resampling, resample, engine, proposal : str
        The filter, as in the section [filter] of a job file. `resample` is "always" by default.
    moved_particles : int, optional
        Number of particles where the proposal is "moving".

    Raises
    ------
    JobError
        A value is wrong, values contradict each other, or a key is unknown.
    ModelError
        The model cannot be found.

    Examples
    --------
    >>> import pfdist
    >>> problem = pfdist.Problem("ungm", horizon=60, measurement_budget=21)
    >>> problem
    <problem ungm: horizon 60, measurement_budget 21>
    >>> problem.with_changes(forbidden=range(20, 31)).job(seed=3).problem.forbidden
    ('20-30',)
    >>> pfdist.Problem("ungm", horizon=0, measurement_budget=21)
    Traceback (most recent call last):
        ...
    pfdist.errors.JobError: horizon must be at least 1, got 0
    """

    __signature__: ClassVar[inspect.Signature]

    def __init__(
        self,
        model: StateSpaceModel | str,
        *,
        filter_model: StateSpaceModel | str | None = None,
        scenarios: Mapping[str, Any] | None = None,
        **keys: Any,
    ) -> None:
        self._model, believed = _given(model, "model"), None
        if filter_model is not None:
            believed = (
                self._model if filter_model is model else _given(filter_model, "filter_model")
            )
        self._filter_model = None if believed is self._model else believed
        if keys.get("sensors") is None and isinstance(model, StateSpaceModel) and model.sensors:
            keys["sensors"] = {
                name: {} if sensor.price is None else {"price": sensor.price}
                for name, sensor in model.sensors.items()
            }
        self._arguments = {
            "model": self._model,
            "filter_model": believed,
            "scenarios": scenarios,
            **keys,
        }
        self._scenarios = {} if scenarios is None else {"scenarios": _plain(scenarios)}
        self._keys = _by_section(_plain_keys(keys))
        self.job()

    @property
    def name(self) -> str:
        """The model's name, which is also the name of the folder of the problem's run."""
        name = _name_of(self._model).removeprefix(PYTHON)
        if ".py:" in name:
            name = Path(name.rpartition(":")[0]).stem
        return _STRANGE.sub("-", name).strip("-.") or "model"

    def with_changes(self, **arguments: Any) -> "Problem":
        """The problem with some arguments changed; parameters and errors as in the class.

        An unchanged model stays as it was when this problem was made.
        """
        return Problem(**{**self._arguments, **arguments})

    def job(self, seed: int = 0, **sections: Any) -> Job:
        """The job of this problem.

        Parameters
        ----------
        seed : int
        **sections
            Other sections of a job file, for instance ``search=[{"method": "genetic"}]`` and
            ``comparison={"draws": 4000}``.

        Raises
        ------
        JobError
            A value is wrong, or a section is unknown or belongs to the problem.
        """
        allowed = [name for name in Job.model_fields if name not in _OWN]
        for name in sections:
            if name not in allowed:
                listed = allowed_names(allowed, did_you_mean(name, allowed))
                other = "all other keys are arguments of pfdist.Problem"
                raise JobError(f"unknown section {shown(name)}{listed}; {other}")
        given = {"model": self._model, "filter_model": self._filter_model}
        models = {part: each for part, each in given.items() if isinstance(each, NamedModel)}
        origin = Origin(Path(f"{self.name}.toml"), frozenset(sections), models, False)
        filled = {name: section for name, section in sections.items() if section is not None}
        section = _section_of(self._model)
        if self._filter_model is not None and self._filter_model != self._model:
            section["filter"] = _section_of(self._filter_model)
        own = {"seed": _plain(seed), "model": section, **self._scenarios, **self._keys}
        return Job(origin, **own | filled)

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, "_keys"):
            raise AttributeError(f"a problem is frozen: use with_changes({name}=...)")
        super().__setattr__(name, value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Problem) and self.job() == other.job()

    __hash__ = None  # type: ignore[assignment]

    def _page(self) -> parts.Page:
        keys = {**self._keys["problem"], **self._keys["filter"], **self._scenarios}
        first = ("horizon", "measurement_budget", "total_price")
        about = ", ".join(f"{key} {keys[key]}" for key in first if key in keys)
        models = {"model": self._model, "filter_model": self._filter_model}
        rows = {key: _name_of(each) for key, each in models.items() if each} | keys
        texts = [
            (key, each if isinstance(each, str) else shown(each)) for key, each in rows.items()
        ]
        section = parts.Section("", [parts.Facts(texts)])
        return parts.Page("", f"problem {self.name}: {about}", [section])


def _given(model: StateSpaceModel | str | NamedModel, argument: str) -> str | NamedModel:
    """The name of a model that was handed over in Python, or the object with its name."""
    if isinstance(model, NamedModel):  # of a problem that is changed
        return model
    try:
        if isinstance(model, str):
            check_name(model)
            return model
        if isinstance(model, StateSpaceModel):
            return NamedModel(installed_name(model) or f"{PYTHON}{model.name}", model)
    except ModelError as error:
        raise ModelError(f"{argument}: {error}", argument=argument) from error
    raise ModelError(
        f"{argument}: a model must be a StateSpaceModel or the name of a model, for instance "
        f"'ungm' or 'path/file.py:object', got {shown(model)}",
        argument=argument,
    )


def _name_of(model: str | NamedModel) -> str:
    return model if isinstance(model, str) else model.name


def _section_of(model: str | NamedModel) -> dict[str, Any]:
    """The keys by which a job names a model, with the parameters that differ from its own."""
    if isinstance(model, str):
        return {"name": model, "parameters": {}}
    parameters = {
        name: value if isinstance(value, tuple) else float(value)  # type: ignore[arg-type]
        for name, value in model.model.parameters.items()
    }
    if not model.name.startswith(PYTHON):
        own = load_model(model.name).parameters
        parameters = {key: value for key, value in parameters.items() if value != own[key]}
    return {"name": model.name, "parameters": parameters}


def _by_section(keys: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The keys of each section of a job; each section is checked for itself."""
    allowed = [key for section in _SECTIONS.values() for key in keys_of_section(section)]
    for key in keys:
        if key not in allowed:
            names = ["filter_model", "scenarios", *allowed]
            allowed_here = allowed_names(names, did_you_mean(key, names))
            raise JobError(f"unknown argument {shown(key)} of Problem{allowed_here}")
    sections = {}
    for name, section in _SECTIONS.items():
        sections[name] = {
            key: keys[key] for key in keys_of_section(section) if keys.get(key) is not None
        }
        try:
            section(**sections[name])
        except ValidationError as error:
            text = explained(error, section)  # an argument in Python has no section before it
            raise JobError(text.replace(f"{name}.", "")) from error
    return sections


def _plain_keys(keys: Mapping[str, Any]) -> dict[str, Any]:
    """All arguments in the form in which a job file could have them.

    Without a clock, a range of forbidden or required times is the text that a person would write.
    On a clock, such a text would name the instants between whole numbers, too.
    """
    counts = all(keys.get(name) is None for name in ("time_step", "time_unit", "times", "clock"))
    texts = ("forbidden", "allowed", "required") if counts else ()
    return {
        key: _plain(_with_texts(value) if key in texts else value) for key, value in keys.items()
    }


def _with_texts(value: Any) -> Any:
    """Times with texts such as "20-30" in place of ranges in steps of 1."""
    if not isinstance(value, range | tuple | list):
        return value
    entries = [value] if isinstance(value, range) else value
    return [
        f"{each[0]}-{each[-1]}"
        if isinstance(each, range) and each.step == 1 and len(each) > 1 and each[0] >= 0
        else each
        for each in entries
    ]


def _plain(value: Any) -> Any:
    """A value in the form of a job file, from NumPy's numbers and arrays, ranges and sets."""
    if isinstance(value, np.generic | np.ndarray) or hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, range):
        return listed_argument("ranges", value)
    if isinstance(value, Mapping):
        return {str(_plain(key)): _plain(each) for key, each in value.items()}
    if isinstance(value, set | frozenset):
        return sorted(_plain(list(value)), key=_order)
    if isinstance(value, tuple | list):
        entries = [_plain(each) for each in value]
        ranges = [isinstance(each, range) for each in value]
        return [
            each
            for entry, is_range in zip(entries, ranges, strict=True)
            for each in (entry if is_range else [entry])
        ]
    return as_text(value)


def _order(entry: Any) -> tuple[bool, Any, str]:
    """Key that sorts the entries of a set: numbers first."""
    is_number = isinstance(entry, int | float)
    return not is_number, entry if is_number else 0, str(entry)


def _signature() -> inspect.Signature:
    """The arguments with the defaults that the sections declare, for help and completion."""
    own = list(inspect.signature(Problem.__init__).parameters.values())[1:-1]
    keys = [
        inspect.Parameter(
            key,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if about.is_required() else about.default,
        )
        for section in _SECTIONS.values()
        for key, about in keys_of_section(section).items()
    ]
    return inspect.Signature([*own, *keys])


Problem.__signature__ = _signature()


# --- a problem, a job, or a path of one -----------------------------------------------------------

JobSource = Problem | Job | str | Path
"""A problem, a job, or the path of a job file or of a run's folder."""
_NOTHING: Mapping[str, Any] = MappingProxyType({})


def as_job(
    source: JobSource,
    overrides: Iterable[str] = (),
    sections: Mapping[str, Any] = _NOTHING,
    settings: Mapping[str, Any] = _NOTHING,
) -> Job:
    """The job of a problem or a file, or a given job, with changes.

    The arguments and errors are those of `pfdist.load_job`.
    """
    overrides = texts_argument("changes", overrides)
    if isinstance(source, str | Path):
        return load_job(source, overrides, sections, settings)
    if not isinstance(source, Problem | Job):
        raise JobError(
            "a job must be a pfdist.Problem, a pfdist.Job or the path of a job file, got "
            f"{shown(source)}",
            argument="job",
        )
    job = source.job() if isinstance(source, Problem) else source
    changed = overrides or sections or settings
    return job.with_changes(overrides, sections, settings) if changed else job
