"""Checks of a new model: of its fields, and of its formulas.

Each formula is recorded once, at t = 0; a function of a batched model is called on arrays of two
particles. This gives the numbers of components, and finds mistakes such as a missing `return`.
"""

import contextlib
import inspect
import keyword
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal, TypeVar

import numpy as np
from pydantic import Field

from pfdist.common.section import Arguments, Listed, Number
from pfdist.densities import DENSITIES
from pfdist.errors import ModelError, shown
from pfdist.models.mistakes import (
    density_named,
    error_line,
    is_interrupt,
    place_of,
    place_of_function,
    refusal,
    remedy,
)
from pfdist.models.parameters import Parameter, named_parameters, values_of_parameter
from pfdist.models.program import evaluate_program
from pfdist.models.symbols import RefusedError
from pfdist.models.tracing import MODES, Formula, untraceable

NoiseKind = Literal["normal", "uniform", "centred"]

ARGUMENTS = {
    "initial": ("w", "p"),
    "transition": ("x", "t", "w", "p"),
    "measurement": ("x", "t", "v", "p"),
    "log_likelihood": ("y", "x", "t", "p"),
    "quantity_of_interest": ("x", "t", "p"),
    "error": ("z", "estimate", "t", "p"),
}
"""Names of a model's formulas, and of their arguments."""
_TAKES = ARGUMENTS | {"works": ("x", "t", "p")}
MEASURING = ("measurement", "log_likelihood")
"""Names of the formulas that each sensor of a model has for itself."""
MOST_SENSORS = 64  # a set of the sensors that measure at an instant has 64 bits
_SENSOR_NAME = re.compile(r"[A-Za-z][\w-]{0,39}")
MOST_COMPONENTS: Final = 1000
T = TypeVar("T")
_Tuple = Annotated[Listed[T], Field(max_length=MOST_COMPONENTS)]
_Noise = _Tuple[NoiseKind]
_PARTICLES = 2
ONE_NUMBER = {
    "log_likelihood": "one number a particle",
    "error": "one number for z and its estimate",
    "works": "one number a particle",
}


# --- fields ---------------------------------------------------------------------------------------


class _Fields(Arguments):
    """The fields of a model that are plain data, and what they may be."""

    error: ClassVar = ModelError

    name: str
    initial_noise: _Noise
    process_noise: _Noise
    measurement_noise: _Noise
    parameters: Mapping[str, Any]
    parameter_ranges: Mapping[str, Annotated[_Tuple[Number], Field(min_length=2, max_length=2)]]
    linear_gaussian: bool
    normalised: bool
    missing_components: bool | Literal["together"]
    x_names: _Tuple[str]
    y_names: _Tuple[str]
    z_names: _Tuple[str]
    circular: _Tuple[str | int]


def checked_fields(model: Any) -> dict[str, Any]:
    """The checked fields of a model that are plain data; all fields are checked.

    Raises `ModelError` before any formula is called, if a value has a wrong type, a formula does
    not take its arguments, or a parameter has a wrong name or value.
    """
    try:
        fields = dict(_Fields(**{name: getattr(model, name) for name in _Fields.model_fields}))
        _check_sensors(model)
        for name in own_formulas(model):
            _check_signature(getattr(model, name), name, ARGUMENTS[name])
        if not isinstance(model.works, bool):
            _check_signature(model.works, "works", _TAKES["works"])
    except ModelError as error:
        advice = _advice_on_noise(error.argument, getattr(model, error.argument or "name"))
        raise ModelError(f"model {model.name}: {error}{advice}") from error
    check_parameters(model)
    return fields


def check_parameters(model: Any) -> None:
    """Raise `ModelError` if a parameter has a wrong name or value."""
    for name in model.parameter_ranges:
        if name not in model.parameters:
            known = ", ".join(model.parameters) or "none"
            raise ModelError(
                f"model {model.name}: parameter_ranges must name parameters, got {name!r}; "
                f"parameters: {known}"
            )
    for name, value in model.parameters.items():
        try:
            _check_parameter(name, value, *model.parameter_ranges.get(name, (-math.inf, math.inf)))
        except ModelError as error:
            raise ModelError(f"model {model.name}: {error}") from error


def formula_of_each_sensor(*_: Any) -> Any:
    """A placeholder for `measurement` and `log_likelihood` of a model with sensors."""
    raise ModelError("a model with sensors has this formula for each sensor")


def own_formulas(model: Any) -> list[str]:
    """Names of the formulas that a model itself has; those of its sensors are left out."""
    return [name for name in ARGUMENTS if name not in MEASURING or not model.sensors]


def _check_sensors(model: Any) -> None:
    """Check the names of sensors; each sensor's formulas are checked with the system."""
    names = [*model.sensors]
    if len(names) > MOST_SENSORS:
        raise ModelError(f"sensors must be at most {MOST_SENSORS}, got {len(names)}")
    for name in names:
        if not (isinstance(name, str) and _SENSOR_NAME.fullmatch(name)):  # as in ``12 x-ray``
            raise ModelError(
                "sensors must have names of a letter and up to 39 letters, digits, hyphens and "
                f"underscores, got {shown(name)}"
            )
    given = [name for name in MEASURING if getattr(model, name) is not formula_of_each_sensor]
    given += ["works"] * bool(model.works)
    if names and (given or model.measurement_noise):
        own = (*given, "measurement_noise")[0]
        raise ModelError(f"each sensor must have its own {own}, and the model must have none")
    if not names and len(given) < len(MEASURING):
        raise ModelError("measurement and log_likelihood must be given, or sensors")


def _check_signature(function: Any, name: str, arguments: tuple[str, ...]) -> None:
    expected = f"{name} must be a function of ({', '.join(arguments)})"
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{expected}, got {shown(function)}") from error
    try:
        signature.bind(*arguments)
    except TypeError as error:
        raise ModelError(f"{expected}, got {signature}{place_of_function(function)}") from error


def _advice_on_noise(name: str, kinds: Any) -> str:
    """Advice how to draw noise of another kind, if a kind is the name of a density."""
    if not name.endswith("_noise"):
        return ""
    named = (density_named(str(kind)) for kind in (kinds if isinstance(kinds, tuple) else (kinds,)))
    densities = [DENSITIES[density] for density in named if density not in ("", "normal")]
    if not densities:
        return ""
    draw, noise = densities[0].draw.__name__, densities[0].noise
    w = "v" if name == "measurement_noise" else "w"
    variates = ", ".join(f"{w}[{i}]" for i in range(len(noise)))
    arguments = ", ".join((variates, *densities[0].parameters))
    return f"; declare {noise!r}, and write pfdist.densities.{draw}({arguments}) in the formula"


def _check_parameter(name: str, value: Parameter, low: float, high: float) -> None:
    if not name.isidentifier() or name.startswith("_") or keyword.iskeyword(name):
        raise ModelError(f"the name of a parameter must be that of a variable, got {name!r}")
    for t, number in enumerate(values_of_parameter(value)):
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise ModelError(
                f"parameter {name} must be a number, or a sequence of numbers, one for each "
                f"instant, got {shown(value)}"
            )
        if not (math.isfinite(number) and low <= number <= high):
            at = "" if number is value else f" for t = {t}"
            raise ModelError(
                f"parameter {name} must be a finite number in {low:g}..{high:g}, got {number!r}{at}"
            )


# --- formulas -------------------------------------------------------------------------------------


def count_components(model: Any, parameters: Mapping[str, Parameter]) -> tuple[int, int, int]:
    """The numbers of components of x, y and z, from a call of every formula.

    Raises `ModelError` if a formula fails, or gives values of a wrong type or number.
    """
    with np.errstate(all="ignore"):
        x = _call(model, "initial", _variates(model.initial_noise), parameters)
        following = _call(model, "transition", x, 0, _variates(model.process_noise), parameters)
        if len(following) != len(x):
            raise ModelError(
                f"model {model.name}: transition must give as many components as initial, "
                f"{len(x)}, got {len(following)}"
            )
        y = _call(model, "measurement", x, 0, _variates(model.measurement_noise), parameters)
        z = _call(model, "quantity_of_interest", x, 0, parameters)
        _call(model, "log_likelihood", y, x, 0, parameters)
        _call(model, "error", z, z, 0, parameters)
    if not isinstance(model.works, bool):
        chance = np.asarray(1.0 * _call(model, "works", x, 0, parameters))
        if (chance > 1.0).any() or (chance < 0.0).any():  # as 80 for 80 %
            raise ModelError(
                f"model {model.name}: works must give a probability, 0 to 1, got "
                f"{chance.flat[0]:g} at t = 0{place_of_function(model.works)}"
            )
    return len(x), len(y), len(z)


def _variates(kinds: tuple[str, ...]) -> tuple[Any, ...]:
    return tuple(np.full(_PARTICLES, 0.5) for _ in kinds)


def _call(model: Any, name: str, *arguments: Any) -> Any:
    formula = getattr(model, name)
    if (example := getattr(formula, "example", None)) is not None:  # a run lacks the formula
        return example
    *values, parameters = arguments
    if hasattr(formula, "identity"):  # a function of a batched model, which checks what it gives
        return formula.tried(*values, named_parameters(parameters))
    recorded, error = _by_program(model, name, arguments)
    if error is None:
        return recorded
    try:  # on arrays, to say what is wrong
        value = formula(*values, named_parameters(parameters))
    except BaseException as failure:  # a formula may raise any exception
        if is_interrupt(failure):
            raise
        if isinstance(error, RefusedError):  # it says what to write instead
            failed = f"{refusal(error)}{place_of(error)}"
        else:
            advice = _advice(model, name, arguments, failure)
            failed = f"{error_line(failure)}{advice}{place_of(failure)}"
        raise ModelError(f"model {model.name}: {name} failed: {failed}") from failure
    wrong = _wrong_kind(name, value) or _wrong_shape(value)
    if wrong:
        place = place_of_function(formula)
        raise ModelError(f"model {model.name}: {name} must give {wrong}{place}")
    raise untraceable(model.name, name, error, 0) from error


def _by_program(
    model: Any, name: str, arguments: tuple[Any, ...]
) -> tuple[Any, BaseException | None]:
    """The value of a formula by its program at t = 0; None, and why it cannot be recorded."""
    groups = dict(zip(_TAKES[name], arguments, strict=True))

    def of_right_kind(*symbols: Any) -> Any:
        value = getattr(model, name)(*symbols)
        is_array = isinstance(value, np.ndarray) and value.ndim == 1
        if (isinstance(value, tuple) or is_array) == (name in ONE_NUMBER):
            raise TypeError  # the call on arrays says what is wrong
        return value

    sizes = {key: len(each) if type(each) is tuple else 0 for key, each in groups.items()}
    refused: BaseException | None = None
    parameters = groups["p"]
    formula = Formula(of_right_kind, name, sizes | {"p": 0}, parameters, model.name)
    for mode in MODES:
        try:
            # One step of a loop suffices: a model that somebody changed may have millions.
            values = evaluate_program(formula.recorded(mode, 0), groups, 0, parameters, most=1)
        except BaseException as error:  # a formula may raise any exception
            if is_interrupt(error):
                raise
            refused = error
        else:
            return (values[0] if name in ONE_NUMBER else values), None
    return None, refused


def _advice(model: Any, name: str, arguments: tuple[Any, ...], error: BaseException) -> str:
    """Advice what to write instead, with the sizes that only the model knows."""
    if "tuple index out of range" in str(error):
        sizes = [
            f"{argument} has {len(value)}"
            for argument, value in zip(_TAKES[name], arguments, strict=True)
            if argument != "p" and isinstance(value, tuple)
        ]
        return f"; numbers of components: {', '.join(sizes)}, and the first is [0]"
    if "'Parameters' object" in str(error):
        return f"; parameters: {', '.join(model.parameters) or 'none'}"
    return remedy(error)


def _wrong_kind(name: str, value: Any) -> str:
    """The kind of value that a formula must give, and what it gave; empty if the kind is right."""
    if name in ONE_NUMBER:
        right = _is_number(value)
        return "" if right else f"{ONE_NUMBER[name]}, got {_described(value)}"
    if isinstance(value, tuple) and value and all(map(_is_number, value)):
        return ""
    return f"a tuple of components, even of a single component: (a,), got {_described(value)}"


def _wrong_shape(value: Any) -> str:
    for number in value if isinstance(value, tuple) else (value,):
        if np.shape(number) not in ((), (_PARTICLES,)):
            return (
                f"a number or an array of {_PARTICLES} for {_PARTICLES} particles, got an array of "
                f"shape {np.shape(number)}: is a tuple used as a component, w instead of w[0]?"
            )
    return ""


def _is_number(value: Any) -> bool:
    return not isinstance(value, tuple | list) and np.asarray(value).dtype.kind in "fiub"


def _described(value: Any) -> str:
    """Description of a wrong value, and of what it lacks."""
    if value is None:
        return "None: is there no `return`?"
    if isinstance(value, list):
        return "a list: write (a, b) instead of [a, b]"
    if isinstance(value, tuple):
        wrong = next((entry for entry in value if not _is_number(entry)), None)
        if wrong is None:
            return f"{'an empty' if not value else 'a'} tuple"
        return f"a tuple that contains {_kind(wrong)}"
    return _kind(value)


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"a {type(value).__name__}"
    with contextlib.suppress(TypeError, ValueError):
        kind = np.asarray(value).dtype.kind
        if kind == "c":
            return "complex numbers"
        if kind in "fiub":
            return "an array" if np.ndim(value) else "a number"
    return type(value).__name__
