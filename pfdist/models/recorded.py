"""Recorded models: each formula is a program, plain data that does not need user code.

A run computes with recorded models. They are written to its folder and sent to its workers.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pfdist.errors import ModelError
from pfdist.models.base import StateSpaceModel, squared_error
from pfdist.models.checks import ARGUMENTS, MEASURING, own_formulas
from pfdist.models.mistakes import place_of_function
from pfdist.models.parameters import Parameter
from pfdist.models.program import Array
from pfdist.models.programs import Declared, Programs
from pfdist.models.tracing import MODES, Traced
from pfdist.models.twin import formula_of, instants_of_twin, traced

_NUMBERS = np.modf(np.outer(np.arange(1, 65), np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0])))[0] * 4.0 - 2.0


def is_recorded(model: StateSpaceModel) -> bool:
    """Whether every formula of a model is recorded."""
    return all(
        isinstance(formula, Programs | Declared) or formula is squared_error
        for formula in _own(model).values()
    )


def declared(model: StateSpaceModel) -> dict[str, Declared]:
    """The formulas of a model that are functions of a batched model, by name."""
    return {name: each for name, each in _own(model).items() if isinstance(each, Declared)}


def declarations(*models: StateSpaceModel) -> dict[str, str]:
    """The declared identity of each batched model in one line, by the model's name."""
    return {each.model: each.declaration for model in models for each in declared(model).values()}


def _own(model: StateSpaceModel) -> dict[str, Any]:
    """The formulas of a model as they were given; those of sensors have the sensor before them."""
    return {name: getattr(model, name) for name in own_formulas(model)} | {
        f"{name}.{key}": getattr(sensor, key)
        for name, sensor in model.sensors.items()
        for key in MEASURING
    }


def recorded(
    model: StateSpaceModel, instants: range, others: Iterable[Mapping[str, Parameter]] = ()
) -> StateSpaceModel:
    """The model with its formulas recorded at instants.

    Parameters
    ----------
    model : StateSpaceModel
    instants : range
    others : iterable of mapping
        Further values of parameters, for instance of scenarios, that are also recorded.

    Raises
    ------
    ModelError
        A formula fails, or the model was recorded for other instants.
    """
    if is_recorded(model):
        for way in model.ways:
            for name in own_formulas(way.model):
                if isinstance(getattr(way.model, name), Programs):
                    traced(way.model, name, instants)
        return model
    models = [model, *map(model.with_parameters, others)]
    changes = {name: _recorded(models, name, instants) for name in own_formulas(model)}
    sensors = {}
    for way, *of_others in zip(*(each.ways for each in models), strict=True):
        if model.sensors:
            measuring = [way.model, *(each.model for each in of_others)]
            formulas = {key: _recorded(measuring, key, instants) for key in MEASURING}
            sensors[way.name] = replace(model.sensors[way.name], log_tails=None, **formulas)
    return dataclasses.replace(model, sensors=sensors, log_tails=None, **changes)


def recorded_if_it_holds(
    model: StateSpaceModel, instants: range, changed: Iterable[str]
) -> StateSpaceModel:
    """The recorded model; the model itself if its programs hold for present values alone."""
    found = recorded(model, instants)
    programs = (each for each in _own(found).values() if isinstance(each, Programs))
    fixed = {name for each in programs for name in each.traced.read}
    return model if fixed & {*changed} else found


def with_functions(kept: StateSpaceModel, now: StateSpaceModel) -> StateSpaceModel:
    """A model read from model.json, with the functions of the current model if it is batched."""
    sensors = {
        name: replace(each, **_functions(each, now.sensors[name], MEASURING))
        for name, each in kept.sensors.items()
    }
    changes = _functions(kept, now, own_formulas(kept))
    return dataclasses.replace(kept, sensors=sensors, **changes) if declared(kept) else kept


def _functions(kept: Any, now: Any, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(now, name) for name in names if isinstance(getattr(kept, name), Declared)}


def _recorded(models: Sequence[StateSpaceModel], name: str, instants: range) -> Any:
    model, function = models[0], getattr(models[0], name)
    if function is squared_error or isinstance(function, Declared):
        return function
    first = traced(model, name, instants)
    variants = [traced(each, name, instants) for each in models[1:] if first.read]
    by_read = {tuple(each.read.items()): each for each in (*reversed(variants), first)}
    kept = tuple(each for each in by_read.values() if each is not first)
    return Programs(name, model.name, first, (first, *kept), place_of_function(function))


def check_same_functions(model: StateSpaceModel, other: StateSpaceModel, instants: range) -> None:
    """Raise `ModelError` if functions with the same declared identity give different values.

    The models have equal identities, and are called at the first and the last instant.
    """
    for way, of_other in zip(model.ways, other.ways, strict=True):
        for name in own_formulas(way.model):
            first, second = (getattr(each.model, name) for each in (way, of_other))
            if not isinstance(first, Declared) or first.function == second.function:
                continue
            of_formula = instants_of_twin(name, instants)
            for t in (of_formula[0], of_formula[-1]):
                try:
                    values, others = (_values(each.model, name, t) for each in (way, of_other))
                except ModelError:  # these numbers may be impossible
                    break
                if not np.array_equal(values, others, equal_nan=True):
                    raise ModelError(
                        f"model {model.name}: the filter's model must have another version, "
                        f"because its {name} gives other values, got version "
                        f"{first.identity['version']!r} for both{second.place}"
                    )


def is_of_any_time(model: StateSpaceModel) -> bool:
    """Whether a model on a clock can have further instants.

    Its step depends on p.dt, and an instant later, with parameters that are an instant later, too,
    its formulas give the same values: so they read t only in ``p.NAME[t]``.
    """
    given = {name: each for name, each in model.parameters.items() if isinstance(each, tuple)}
    last = len(given["time"]) - 1
    later = {name: (each[0], *each[:-1]) for name, each in given.items()}
    longer = {"dt": tuple(2 * each for each in given["dt"])}
    own, moved, slow = (
        recorded(model.with_parameters(each), range(last + 1)) for each in ({}, later, longer)
    )

    def same(name: str, number: int, other: StateSpaceModel, at: int, shift: int) -> bool:
        parts = own.ways[number].model, other.ways[number].model
        here = _values(parts[0], name, at)
        return np.array_equal(here, _values(parts[1], name, at + shift), True)

    names = [name for name in ARGUMENTS if name not in ("initial", "error")]
    tried = {0, (last - 1) // 2, max(0, last - 2)} if last > 1 else set()
    return not same("transition", 0, slow, 0, 0) and all(
        same(name, number, moved, t, 1)
        for number in range(len(own.ways))
        for name in names
        for t in tried
    )


def _values(model: StateSpaceModel, name: str, t: int) -> Array:
    formula, column = formula_of(model, name), 0
    given: dict[str, Any] = {"t": t, "p": model.p}
    for argument, count in formula.arguments.items():
        if argument not in given:
            columns = _NUMBERS.T[np.arange(column, column + count) % _NUMBERS.shape[1]]
            given[argument] = tuple(np.roll(each, k) for k, each in enumerate(columns))
            column += count
    with np.errstate(all="ignore"):
        value = formula.function(*(given[each] for each in formula.arguments))
    parts = value if isinstance(value, tuple) else np.atleast_2d(value)
    return np.array([np.broadcast_to(np.asarray(each, float), len(_NUMBERS)) for each in parts])


# --- what differs ---------------------------------------------------------------------------------

_CLOSE = 1e-12
PLAIN = tuple(
    each.name
    for each in dataclasses.fields(StateSpaceModel)
    if each.name not in (*ARGUMENTS, "parameters", "sensors", "log_tails", "works")
)
"""The fields of a model that are plain data."""


def differences(kept: StateSpaceModel, now: StateSpaceModel) -> Iterator[tuple[str, str]]:
    """The parts in which two recorded models differ: the name, and a text ``was -> is``.

    Constants count as equal within 1e-12 of the largest finite one in their column: Python computed
    them with NumPy's functions, which differ in the last bit between processors.
    """
    for name in PLAIN:
        was, is_now = getattr(kept, name), getattr(now, name)
        if was != is_now:
            yield name, f"{_shown(was)} -> {_shown(is_now)}"
    before, after = kept.parameters, now.parameters
    for name in sorted(before.keys() | after.keys()):
        values: Any = (before.get(name), after.get(name))
        if None in values or not _close(np.atleast_1d(values[0]), np.atleast_1d(values[1])):
            are_rows = all(isinstance(each, tuple) for each in values)
            text = (
                _constants(*map(np.array, values)) if are_rows else " -> ".join(map(_shown, values))
            )
            yield f"parameters.{name}", text
    if [*kept.sensors] != [*now.sensors]:
        yield "sensors", f"{_shown((*kept.sensors,))} -> {_shown((*now.sensors,))}"
    for name in sorted(kept.sensors.keys() & now.sensors.keys()):
        noises = [model.sensors[name].measurement_noise for model in (kept, now)]
        if noises[0] != noises[1]:
            yield f"sensors.{name}", " -> ".join(map(_shown, noises))
    formulas = _own(kept), _own(now)
    for name in sorted(formulas[0].keys() | formulas[1].keys()):
        text = _difference(*(each.get(name) for each in formulas))
        if text:
            yield name, text


def _shown(value: Any) -> str:
    if value is None or (isinstance(value, tuple) and not value):
        return "nothing"
    if isinstance(value, tuple):
        numbers = any(isinstance(each, float) for each in value)
        return f"{len(value)} values" if numbers else ", ".join(map(str, value))
    return repr(value)


def _difference(kept: Any, now: Any) -> str:
    """How a formula differs; empty if it is the same."""
    if isinstance(kept, Declared) and isinstance(now, Declared):
        return "" if kept == now else f"declared as {kept.declaration} -> {now.declaration}"
    if not (isinstance(kept, Programs) and isinstance(now, Programs)):
        return "" if kept is now else "it is another formula"
    if [*map(_structure, kept.variants)] != [*map(_structure, now.variants)]:
        return "it computes something else"
    for was, is_now in zip(_columns(kept), _columns(now), strict=True):
        if not _close(was, is_now):
            return _constants(was, is_now)
    return ""


def _structure(traced: Traced) -> Any:
    """All but the constants of a traced formula, as a value that can be compared."""
    at = traced.mode if traced.mode == MODES[0] else (traced.instants, traced.which.tolist())
    programs = [
        (each.operations, each.outputs, each.constants.shape, len(each.tables))
        for each in traced.programs
    ]
    return at, programs


def _columns(formula: Programs) -> Iterator[Array]:
    """The columns of constants, and the tables."""
    for variant in formula.variants:
        for program in variant.programs:
            yield from program.constants.T
            yield from program.tables


def _close(was: Array, is_now: Array) -> bool:
    """Whether the numbers of a column are the same, but for the last bits."""
    was, is_now = np.asarray(was), np.asarray(is_now)
    if was.shape != is_now.shape:
        return False
    finite = np.isfinite(was)
    size = np.abs(was[finite]).max(initial=0.0)
    with np.errstate(invalid="ignore"):
        near = np.abs(was - is_now) <= _CLOSE * size
    same = (was == is_now) | (np.isnan(was) & np.isnan(is_now)) | (finite & near)
    return bool(same.all())


def _constants(was: Array, is_now: Array) -> str:
    """The first numbers of two columns that differ."""
    if was.shape != is_now.shape:
        return f"{was.size} -> {is_now.size} numbers"
    place = next(k for k in range(was.size) if not _close(was[k : k + 1], is_now[k : k + 1]))
    numbers = (repr(float(each[place])).removesuffix(".0") for each in (was, is_now))
    return f"the constant {' -> '.join(numbers)}"
