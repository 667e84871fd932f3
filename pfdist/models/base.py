"""The state-space model: a handful of pure formulas (paper, equations 1 to 4)."""

import copy
import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from pfdist.common.component_names import Component, named_components
from pfdist.common.measurement_times import CLOCK
from pfdist.common.nearest import allowed_names, did_you_mean, must_be
from pfdist.common.points import PointNumbers
from pfdist.errors import ModelError
from pfdist.models.checks import (
    MEASURING,
    check_parameters,
    checked_fields,
    count_components,
    formula_of_each_sensor,
    own_formulas,
)
from pfdist.models.parameters import (
    Parameter,
    fixed_parameter,
    named_parameters,
    trial_parameters,
)
from pfdist.models.programs import Programs

_MOST_KEPT = 1000  # results that are derived from a model, such as traced formulas
_NAMES = {"x": "x_names", "y": "y_names", "z": "z_names"}


def squared_error(z: Any, estimate: Any, t: Any, p: Any) -> Any:
    """The squared Euclidean norm of z minus its estimate: the error of equation 5."""
    total = 0.0
    for value, estimated in zip(z, estimate, strict=True):
        total += (value - estimated) ** 2
    return total


def angular_error(value: Any, estimated: Any) -> Any:
    """1 - cos(value - estimated), accurate for small differences."""
    return 2.0 * np.sin(0.5 * (value - estimated)) ** 2


def within_half_turn(values: Any, centre: Any, is_angle: Sequence[bool]) -> Any:
    """The values, (..., q), with angles shifted to at most half a turn from a centre.

    Other components are unchanged.
    """
    turns = np.round((centre - values) / (2 * np.pi))
    return np.where(is_angle, values + 2 * np.pi * turns, values)


@cache
def error_with_angles(is_angle: tuple[bool, ...]) -> Callable[..., Any]:
    """The default error of a model with circular components.

    It is the sum of `angular_error` of the components of z that are angles, and of the squared
    differences of the others.
    """

    def error(z, estimate, t, p):
        total = 0.0
        for value, estimated, angle in zip(z, estimate, is_angle, strict=True):
            total += angular_error(value, estimated) if angle else (value - estimated) ** 2
        return total

    return error


@dataclass(frozen=True)
class Sensor:
    """One of several ways to measure a system.

    The noises of sensors are independent of each other, given x.

    Parameters
    ----------
    measurement, log_likelihood : callable
        As for `StateSpaceModel`; y and v are those of this sensor alone.
    measurement_noise : tuple of {"normal", "uniform", "centred"}
        Distribution of each component of v.
    price : float, optional
        Price of a measurement, which a `Problem` uses unless it sets a price.
    log_tails, works : callable, optional
        As for `StateSpaceModel`.
    """

    measurement: Callable[..., Any]
    log_likelihood: Callable[..., Any]
    measurement_noise: tuple[str, ...]
    price: float | None = None
    log_tails: Callable[..., Any] | None = None
    works: Callable[..., Any] | bool = False


def _measuring(each: "Sensor | StateSpaceModel") -> dict[str, Any]:
    """The fields by which a sensor, or a model without sensors, measures."""
    names = *MEASURING, "measurement_noise", "log_tails", "works"
    return {name: getattr(each, name) for name in names}


class Way(NamedTuple):
    """A sensor, and its place in y and v; a model without sensors has one unnamed way."""

    name: str
    model: "StateSpaceModel"  # the system with this sensor alone
    y: slice  # components of y
    v: slice  # variates of the measurement noise


def repeated(model: "StateSpaceModel", repeats: int) -> "StateSpaceModel":
    """The model whose y may have several rows of each sensor: the components of all, in turn."""
    if repeats == 1:
        return model
    plain = Sensor(**_measuring(model))
    each = [*model.sensors.values()] or [plain]
    sensors = {f"row-{k}": each[k % len(each)] for k in range(repeats * len(each))}
    return dataclasses.replace(
        model,
        measurement=formula_of_each_sensor,
        log_likelihood=formula_of_each_sensor,
        measurement_noise=(),
        works=False,
        y_names=(),
        sensors=sensors,
    )


@dataclass(frozen=True, repr=False)
class StateSpaceModel:
    """A system that can be simulated and measured.

    A formula describes one particle; it is called with symbols. x, w, v, y and z are tuples of
    components, even if there is a single component. Formulas use operators and NumPy's functions. t
    is an integer. p holds the parameters, read as ``p.sigma``; a parameter that varies with t is
    read as ``p.rate[t]``. If the job has a clock, ``p.time[t]`` is the time of the instant t, and
    ``p.dt[t]`` the time from t to t + 1, both in the clock's unit.

    A model, and objects whose methods are its formulas, must not change after the model is made.

    Parameters
    ----------
    name : str
    initial : callable
        ``(w, p) -> x(0)``, with w one variate for each entry of `initial_noise`.
    transition : callable
        ``(x, t, w, p) -> x(t+1)``, the paper's f_t; t is the time of x.
    measurement : callable
        ``(x, t, v, p) -> y(t)``, the paper's g_t.
    log_likelihood : callable
        ``(y, x, t, p) -> log p(y | x)``, a number for each particle, up to a constant that does
        not depend on x.
    quantity_of_interest : callable
        ``(x, t, p) -> z(t)``, the paper's h_t.
    initial_noise, process_noise, measurement_noise : tuple of {"normal", "uniform", "centred"}
        Distribution of each component of w and v: standard normal, uniform on (0, 1), or uniform on
        (-1/2, 1/2) and as fine as 2^-64 near 0. Every other distribution is a transform of these
        within the formula: see `pfdist.densities`.
    parameters : mapping of str to float or sequence of float
        Values of the parameters p; a job may override them. A sequence has a value for each instant
        0..T.
    parameter_ranges : mapping of str to (float, float)
        Lowest and highest allowed value. A parameter without a range may have any finite value.
    error : callable
        ``(z, estimate, t, p) -> number``, the error of an estimate of z. An MSE is its mean over t.
        By default the sum over the components of z of the squared difference, and of 1 - cos of the
        difference for those that are `circular`.
    log_tails : callable, optional
        ``(y, x, t, p)``: the logarithms of the probabilities that the measurement is at most y[0],
        and above it, for y of one component. A job whose sensor has limits needs it; see
        `pfdist.densities.normal_log_tails`.
    works : callable, optional
        ``(x, t, p)``: the probability that a measurement gives a value in the state x; a comparison
        is 0 or 1. That it gives none then says something about x. True: the formulas have it
        already, and y is inf in a measurement that failed.
    circular : tuple of str or int
        Components of z that are angles, in radians, by their names without the unit or by their
        numbers. Such a component is estimated by the mean direction of the particles, in -pi..pi,
        and its variance is the circular variance (1 - R).
    linear_gaussian : bool
        Whether every formula is linear in x and noise, and every noise is normal. The engine
        "kalman" then computes the expected MSE exactly, and checks this declaration.
    normalised : bool
        Whether `log_likelihood` is the logarithm of a density or probability of y, with all
        constants. A filter of real measurements then gives their log evidence.
    missing_components : bool or "together"
        Whether `log_likelihood` takes NaN for a component of y that was not measured, and then
        gives the log-likelihood of the other components. "together": only if all components of a
        sensor are NaN, as of a measurement that failed.
    x_names, y_names, z_names : tuple of str
        A name for each component of x, y or z, with the unit in brackets at the end:
        ``("concentration [mg/l]",)``. Columns, figures and reports use them; without names the
        components have numbers.
    sensors : mapping of str to Sensor
        Up to 64 sensors by name, instead of `measurement`, `log_likelihood` and
        `measurement_noise`. y has the components of all sensors, in their order; their names begin
        with the sensor's.

    Raises
    ------
    ModelError
        A formula does not take its arguments, does not give a tuple of components, or cannot be
        traced (a `TraceError`); a kind of noise is unknown; a parameter lies outside its range;
        names do not fit the components; a circular component is unknown or in degrees, or the model
        declares itself linear and Gaussian.

    References
    ----------
    Mardia, Jupp, "Directional statistics", 2000, chapter 2 (mean direction, circular variance).
    """

    name: str
    initial: Callable[..., Any]
    transition: Callable[..., Any]
    measurement: Callable[..., Any] = field(default=formula_of_each_sensor, kw_only=True)
    log_likelihood: Callable[..., Any] = field(default=formula_of_each_sensor, kw_only=True)
    quantity_of_interest: Callable[..., Any] = field(kw_only=True)
    initial_noise: tuple[str, ...] = field(kw_only=True)
    process_noise: tuple[str, ...] = field(kw_only=True)
    measurement_noise: tuple[str, ...] = field(default=(), kw_only=True)
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    parameter_ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    error: Callable[..., Any] = squared_error
    linear_gaussian: bool = False
    normalised: bool = False
    missing_components: bool | Literal["together"] = False
    x_names: tuple[str, ...] = ()
    y_names: tuple[str, ...] = ()
    z_names: tuple[str, ...] = ()
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    circular: tuple[str | int, ...] = ()
    log_tails: Callable[..., Any] | None = None
    works: Callable[..., Any] | bool = False

    def __post_init__(self) -> None:
        self._check_fields()
        self.components  # noqa: B018  evaluated here, because it finds wrong formulas
        for kind in _NAMES:
            self.named(kind)
        self.is_angle  # noqa: B018  evaluated here, because it refuses unknown components

    def _check_fields(self) -> None:
        """Check the fields that are plain data, and give the parameters to recorded formulas."""
        for name, value in checked_fields(self).items():
            object.__setattr__(self, name, value)
        self._give_parameters()

    def _give_parameters(self) -> None:
        fixed = {name: fixed_parameter(value) for name, value in self.parameters.items()}
        object.__setattr__(self, "parameters", fixed)
        for name in own_formulas(self):
            formula = getattr(self, name)
            if isinstance(formula, Programs):
                object.__setattr__(self, name, formula.with_parameters(self.parameters))

    def __repr__(self) -> str:
        values = vars(self) | {"sensors": [*self.sensors]}
        given = ((each.name, values[each.name], each.default) for each in dataclasses.fields(self))
        texts = (
            f"{name}={getattr(value, '__name__', name if callable(value) else repr(value))}"
            for name, value, default in given
            if name != "parameter_ranges" and value not in (default, (), {}, [])
        )
        return f"{type(self).__name__}({', '.join(texts)})"

    def __getstate__(self) -> dict[str, Any]:
        """The fields, without the values that are cached beside them."""
        return {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}

    @cached_property
    def p(self) -> Any:
        """The parameters as formulas read them: a named tuple of floats, and of arrays (T+1,)."""
        return named_parameters(self.parameters)

    @cached_property
    def derived(self) -> dict[Hashable, Any]:
        """The most recent results that were derived from this model; see `kept`."""
        return {}

    def kept(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The result that this model keeps under a key; it is made if it is missing.

        A filter without a horizon needs new instants at each step, so only the last results are
        kept.
        """
        made = self.derived.get(key)
        if made is None:
            made = self.derived[key] = make()
            for oldest in [*self.derived][:-_MOST_KEPT]:
                self.derived.pop(oldest, None)  # another thread may have done so
        return made

    @property
    def reads_clock(self) -> bool:
        """Whether a formula reads ``p.time`` or ``p.dt`` and the model is not yet on a clock."""
        try:
            for _, model, _, _ in self.ways:
                count_components(model, self.parameters)
        except ModelError:
            return True  # with a clock the formulas did not fail when the model was made
        return False

    def on_clock(
        self, time: Sequence[float], dates: Mapping[str, Sequence[float]] = MappingProxyType({})
    ) -> "StateSpaceModel":
        """The model with the parameters ``time`` and ``dt``, a value for each instant.

        Parameters
        ----------
        time : sequence of float, (T+1,)
            The time of each instant. dt[t] is the time from t to t + 1; the last is that before it.
        dates : mapping of str to sequence of float, optional
            Values of ``day_of_year``, ``hour`` and ``weekday`` for each instant. A parameter of the
            model with such a name stays.

        Raises
        ------
        ModelError
            There are fewer than two times, or the model already has a parameter of these names.
        """
        if len(time) < 2:
            raise ModelError(f"model {self.name}: a clock needs two times or more, got {[*time]}")
        for name in CLOCK:
            if name in self.parameters:
                raise ModelError(
                    f"model {self.name}: with a clock, p.{name} is the clock's, so no parameter "
                    f"may have the name {name!r}: give it another name"
                )
        times = tuple(map(float, time))
        steps = [after - before for before, after in pairwise(times)]
        clock = {"time": times, "dt": (*steps, steps[-1])}
        return dataclasses.replace(self, parameters={**dates, **self.parameters, **clock})

    @cached_property
    def components(self) -> tuple[int, int, int]:
        """Numbers of components of x, y and z."""
        if not self.sensors:
            return count_components(self, trial_parameters(self.parameters))
        _, last, y, _ = self.ways[-1]
        return last.components[0], y.stop, last.components[2]

    @cached_property
    def ways(self) -> tuple[Way, ...]:
        """The sensors in their order; without sensors, the model itself as one way."""
        if not self.sensors:
            every_y, every_v = slice(0, self.components[1]), slice(0, len(self.measurement_noise))
            return (Way("", self, every_y, every_v),)
        ways, y, v = list[Way](), 0, 0
        for name, sensor in self.sensors.items():
            model = dataclasses.replace(
                self,
                name=f"{self.name}, sensor {name}",
                **_measuring(sensor),
                y_names=(),
                sensors={},
            )
            until = y + model.components[1], v + len(sensor.measurement_noise)
            ways.append(Way(name, model, slice(y, until[0]), slice(v, until[1])))
            y, v = until
        return tuple(ways)

    @property
    def points(self) -> PointNumbers:
        """The numbers of possible measurements."""
        return PointNumbers(len(self.ways))

    @property
    def noise_of_measurements(self) -> tuple[str, ...]:
        """Distribution of each component of v, over all sensors."""
        return sum((way.model.measurement_noise for way in self.ways), ())

    def named(self, kind: str) -> tuple[Component, ...]:
        """The components of x, y or z with their names, units and suffixes of columns.

        Parameters
        ----------
        kind : {"x", "y", "z"}

        Raises
        ------
        ModelError
            The names do not fit the components.
        """
        count = dict(zip(_NAMES, self.components, strict=True))[kind]
        names = getattr(self, _NAMES[kind])
        if kind == "y" and self.sensors and not names:
            names = tuple(
                name if y.stop - y.start == 1 else f"{name} {component}"
                for name, _, y, _ in self.ways
                for component in range(y.stop - y.start)
            )
        try:
            return named_components(names, count)
        except ValueError as error:
            raise ModelError(f"model {self.name}: {_NAMES[kind]}: {error}") from error

    @cached_property
    def is_angle(self) -> tuple[bool, ...]:
        """Whether each component of z is circular."""
        components = self.named("z")
        names = {str(number): number for number in range(len(components))}
        names |= {each.name: number for number, each in enumerate(components) if each.name}
        for name in self.circular:
            if str(name) not in names:
                rule = f"names of components of z: {', '.join(map(repr, names))}"
                raise ModelError(must_be(f"model {self.name}: circular", rule, name, names))
        if self.circular and self.linear_gaussian:
            raise ModelError(
                f"model {self.name}: circular must be empty in a linear-Gaussian model, got "
                f"{self.circular!r}: the Kalman filter has no mean direction"
            )
        angles = {names[str(name)] for name in self.circular}
        called = {components[number].name for number in angles} - {""}
        measured = [each for each in self.named("y") if each.name in called]
        for each in (*(components[number] for number in angles), *measured):
            if each.is_in_degrees:
                raise ModelError(
                    f"model {self.name}: a circular component must be in radians, got "
                    f"{each.label!r}: convert it by np.radians, and name the unit rad"
                )
        return tuple(number in angles for number in range(len(components)))

    def named_as(self, truth: "StateSpaceModel") -> "StateSpaceModel":
        """The model with another model's names of y and z, and with its angles."""
        names = {key: getattr(truth, key) for key in ("y_names", "z_names", "circular")}
        if names == {key: getattr(self, key) for key in names}:
            return self
        return dataclasses.replace(self, **names)

    @cached_property
    def formulas(self) -> dict[str, Callable[..., Any]]:
        """The formulas by their names, without those that the model lacks.

        Angles have another default error. Names of a sensor's formulas begin with its name and a
        dot.
        """
        formulas = {name: getattr(self, name) for name in own_formulas(self)}
        if any(self.is_angle) and self.error is squared_error:
            formulas["error"] = error_with_angles(self.is_angle)
        sensors = self.ways if self.sensors else ()
        return formulas | {
            f"{way.name}.{key}": getattr(way.model, key) for way in sensors for key in MEASURING
        }

    def with_formulas(self, change: Callable[[Any, str], Any], **fields: Any) -> "StateSpaceModel":
        """The model with other fields, and with each other formula changed, those of sensors, too.

        `change` makes a formula of the model, or of a sensor, and the formula's name.
        """
        own = {name: change(self, name) for name in own_formulas(self) if name not in fields}
        sensors = {
            name: dataclasses.replace(each, **{key: change(each, key) for key in MEASURING})
            for name, each in self.sensors.items()
        }
        return dataclasses.replace(self, sensors=sensors, **own, **fields)

    def with_parameters(self, overrides: Mapping[str, Parameter]) -> "StateSpaceModel":
        """The model with some parameters changed.

        Raises
        ------
        ModelError
            A parameter is unknown, or its value lies outside its range. The attribute `argument`
            of the error is "parameters".
        """
        for name in overrides:
            if name not in self.parameters:
                allowed = allowed_names(
                    sorted(self.parameters), did_you_mean(name, self.parameters)
                )
                raise ModelError(
                    f"model {self.name}: unknown parameter {name!r}{allowed}", argument="parameters"
                )
        given = {**self.parameters, **overrides}
        try:
            formulas = self.formulas.values()
            if not all(isinstance(each, Programs) or each is squared_error for each in formulas):
                return dataclasses.replace(self, parameters=given)
            changed = copy.copy(self)  # programs have as many components with all values
            changed.__dict__.update(parameters=given, components=self.components)
            check_parameters(changed)
            changed._give_parameters()
            return changed
        except ModelError as error:
            error.argument = "parameters"
            raise
