"""Limits, failures, repeats and delays of sensors, as a transformation of the model.

Everything else sees the result as any other model. A failed measurement is NaN, and tells nothing.
That of a sensor with `works` is inf in all components, and its likelihood is the probability of no
value; so NaN always means that nothing is known.
A sensor with a delay measures, when the value arrives, a state that the model remembers; a point of
the job then is the instant of arrival.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pfdist.common.sensing import PLAIN, Sensing, names_of_repeats
from pfdist.elementwise import where
from pfdist.errors import ModelError
from pfdist.models.base import Sensor, StateSpaceModel
from pfdist.models.checks import MEASURING

Array = NDArray[np.float64]


def sensed(
    model: StateSpaceModel, sensings: Mapping[str, Sensing] = MappingProxyType({})
) -> StateSpaceModel:
    """The model whose sensors have limits, fail, repeat, or are late, and work or not.

    Parameters
    ----------
    model : StateSpaceModel
    sensings : mapping of str to Sensing
        One for each name of a sensor, or for ``""`` if the model has no sensors; by default plain.

    Raises
    ------
    ModelError
        A sensor with limits has several components, or lacks `log_tails`.
    """
    may_work = any(callable(way.model.works) for way in model.ways)
    if all(each == PLAIN for each in sensings.values()) and not may_work:
        return model
    # Kept, because lines that a filter hands to another need the same formulas.
    result: StateSpaceModel = model.kept(
        ("sensed", tuple(sensings.items())), lambda: _sensed_model(model, sensings, may_work)
    )
    return result


def _sensed_model(
    model: StateSpaceModel, sensings: Mapping[str, Sensing], may_work: bool
) -> StateSpaceModel:
    remembered = max((each.delay for each in sensings.values()), default=0)
    model = _with_failures(model, sensings)
    parts = {
        way.name: _sensed(
            way.model, way.name, sensings.get(way.name, PLAIN), remembers=remembered > 0
        )
        for way in model.ways
    }
    missing: Any = model.missing_components
    if any(each.fails for each in sensings.values()) and not missing:
        is_one = all(way.model.components[1] == 1 for way in model.ways)
        missing = is_one or "together"
    changes: dict[str, Any] = {
        "linear_gaussian": model.linear_gaussian
        and all(each.is_linear for each in sensings.values())
        and not may_work,
        "missing_components": missing,
        "log_tails": None,
        **(_remembering(model, remembered) if remembered else {}),
    }
    own_fields = *MEASURING, "measurement_noise", "works"
    if not model.sensors and sensings.get("", PLAIN).repeats == 1:
        own = {name: getattr(parts[""], name) for name in own_fields}
        return dataclasses.replace(model, **own, **changes)
    sensors = {
        repeat: dataclasses.replace(parts[name], price=_price(model, name))
        for name in parts
        for repeat in names_of_repeats(name, sensings.get(name, PLAIN).repeats)
    }
    fields = StateSpaceModel.__dataclass_fields__
    changes |= {name: fields[name].default for name in own_fields}
    return dataclasses.replace(model, sensors=sensors, y_names=(), **changes)


def late(model: StateSpaceModel, delays: Sequence[int]) -> StateSpaceModel:
    """The model of which each sensor measures, so many instants later, the state of before."""
    each = zip(model.ways, delays, strict=True)
    return sensed(model, {way.name: Sensing(delay=delay) for way, delay in each})


def without_failures(
    model: StateSpaceModel, fails: Sequence[bool], *, none: bool = False
) -> StateSpaceModel:
    """The model of `sensed` if no measurement of some sensors, which may fail, does.

    Those of sensors with `works` still do, unless there are to be `none`.
    """

    def made(sensor: Any, may_fail: bool) -> Any:
        if not (none if sensor.works else may_fail):
            return sensor
        measurement, never = sensor.measurement, 0.0 if sensor.works else 1.0
        return dataclasses.replace(  # the last variate is the chance
            sensor, measurement=lambda x, t, v, p: measurement(x, t, (*v[:-1], never), p)
        )

    if not model.sensors:
        return cast(StateSpaceModel, made(model, any(fails)))
    each = zip_longest(model.sensors.items(), fails)
    sensors = {name: made(sensor, bool(may_fail)) for (name, sensor), may_fail in each}
    return dataclasses.replace(model, sensors=sensors)


def known_values(y: Array) -> Array:
    """Measurements with NaN where a sensor gave no value."""
    return np.where(np.isposinf(y), np.nan, y)


def when_made(y: Array, model: StateSpaceModel, delays: tuple[int, ...]) -> Array:
    """Values, (..., T+1, m), at the instants at which they are made, not those of arrival."""
    made = y.copy()
    for way, delay in zip(model.ways, delays, strict=False):
        stop = y.shape[-2] - delay
        made[..., :stop, way.y], made[..., stop:, way.y] = y[..., delay:, way.y], np.nan
    return made


def _remembering(model: StateSpaceModel, instants: int) -> dict[str, Any]:
    """The formulas and names of a model whose state has those of so many instants before."""
    n = model.components[0]

    def initial(w: Any, p: Any) -> Any:
        return tuple(model.initial(w, p)) * (instants + 1)

    def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
        return (*model.transition(x[:n], t, w, p), *x[: n * instants])

    def quantity_of_interest(x: Any, t: Any, p: Any) -> Any:
        return model.quantity_of_interest(x[:n], t, p)

    return {
        "initial": initial,
        "transition": transition,
        "quantity_of_interest": quantity_of_interest,
        "x_names": (),
    }


def _late(measurement: Any, log_likelihood: Any, n: int, delay: int) -> Any:
    """The formulas of a sensor for the state of some instants before, among those remembered."""

    def late(x: Any, t: Any, v: Any, p: Any) -> Any:
        return measurement(x[n * delay : n * (delay + 1)], np.maximum(t - delay, 0), v, p)

    def likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        return log_likelihood(y, x[n * delay : n * (delay + 1)], np.maximum(t - delay, 0), p)

    return late, likelihood


def _price(model: StateSpaceModel, name: str) -> float | None:
    return model.sensors[name].price if name else None


def _name_of_fails(sensor: str) -> str:
    return f"fails_{sensor}".replace("-", "_") if sensor else "fails"


def _with_failures(model: StateSpaceModel, sensings: Mapping[str, Sensing]) -> StateSpaceModel:
    """The model with a parameter for each sensor whose probability to fail varies with time."""
    fails = {
        _name_of_fails(name): each.fails
        for name, each in sensings.items()
        if isinstance(each.fails, tuple)
    }
    for name in {*fails} & {*model.parameters}:
        raise ModelError(f"fails of each instant needs the name {name}, which is a parameter's")
    return dataclasses.replace(model, parameters={**model.parameters, **fails}) if fails else model


def _sensed(model: StateSpaceModel, name: str, sensing: Sensing, *, remembers: bool) -> Sensor:
    measurement, log_likelihood = model.measurement, model.log_likelihood
    noise, tails = model.measurement_noise, model.log_tails
    sensor = f"sensor {name} of " * bool(name)
    if math.isfinite(sensing.low) or math.isfinite(sensing.high):
        if model.components[1] != 1 or tails is None:
            got = f"{model.components[1]} components" if tails is not None else "no log_tails"
            raise ModelError(
                f"a limit needs one component of y, and log_tails (y, x, t, p), the logarithms of "
                f"the probabilities of values up to y and above it; {sensor}model {model.name} "
                f"has {got}" + "; give the model a sensor for each component" * (tails is not None)
            )
        measurement, log_likelihood = _limited(measurement, log_likelihood, tails, sensing)
    fails = _name_of_fails(name) if isinstance(sensing.fails, tuple) else sensing.fails
    if callable(model.works):
        measurement, log_likelihood = _working(measurement, log_likelihood, model.works, fails)
        noise = (*noise, "centred")
    elif fails:
        measurement, log_likelihood = _failing(measurement, log_likelihood, fails)
        noise = (*noise, "uniform")
    if remembers:
        n = model.components[0]
        measurement, log_likelihood = _late(measurement, log_likelihood, n, sensing.delay)
    return Sensor(measurement, log_likelihood, noise, works=bool(model.works))


def _limited(measurement: Any, log_likelihood: Any, tails: Any, sensing: Sensing) -> Any:
    low, high = sensing.low, sensing.high

    def limited(x: Any, t: Any, v: Any, p: Any) -> Any:
        (y,) = measurement(x, t, v, p)
        return (np.minimum(np.maximum(y, low), high),)

    def likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        total = log_likelihood(y, x, t, p)
        if math.isfinite(low):
            total = where(y[0] <= low, tails((low,), x, t, p)[0], total)
        if math.isfinite(high):
            total = where(y[0] >= high, tails((high,), x, t, p)[1], total)
        return total

    return limited, likelihood


def _failing(measurement: Any, log_likelihood: Any, fails: float | str) -> Any:
    """The formulas of a sensor that fails with a probability: a number, or a parameter's name."""

    def failing(x: Any, t: Any, v: Any, p: Any) -> Any:
        *own, chance = v
        values = measurement(x, t, tuple(own), p)
        return tuple(where(chance < _at(fails, t, p), math.nan, value) for value in values)

    def likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        is_made = y[0] == y[0]
        for value in y[1:]:
            is_made = is_made | (value == value)  # noqa: PLR0124
        return where(is_made, log_likelihood(y, x, t, p), 0.0)

    return failing, likelihood


def _working(measurement: Any, log_likelihood: Any, works: Any, fails: float | str) -> Any:
    """The formulas of a sensor that gives a value with a probability that depends on the state.

    Noise 0 of the chance always gives one: guided particles linearise the measurement there.
    """

    def gives(x: Any, t: Any, p: Any) -> Any:
        chance = 1.0 * works(x, t, p)  # of a comparison, 0 or 1
        return np.minimum(np.maximum(chance, 0.0), 1.0) * (1.0 - _at(fails, t, p))

    def working(x: Any, t: Any, v: Any, p: Any) -> Any:
        *own, chance = v
        is_made = 2.0 * np.abs(chance) <= gives(x, t, p)
        return tuple(where(is_made, y, math.inf) for y in measurement(x, t, tuple(own), p))

    def likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        chance = gives(x, t, p)
        value = log_likelihood(y, x, t, p) + np.log(chance)
        return where(y[0] == math.inf, np.log1p(-chance), value)

    return working, likelihood


def _at(fails: float | str, t: Any, p: Any) -> Any:
    return getattr(p, fails)[t] if isinstance(fails, str) else fails
