"""Measurements as quantities of interest: a filter that predicts what would be measured."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.checks import ARGUMENTS, MEASURING, own_formulas

_Formula = Callable[..., Any]


def circular_measurements(model: StateSpaceModel) -> tuple[int, ...]:
    """The components of y that are angles: those with the name of a circular component of z."""
    quantities = zip(model.named("z"), model.is_angle, strict=True)
    angles = {each.name for each, is_angle in quantities if is_angle and each.name}
    return tuple(k for k, each in enumerate(model.named("y")) if each.name in angles)


def predicted(model: StateSpaceModel) -> StateSpaceModel:
    """The model whose quantity of interest is a measurement of its state, with noise.

    The measurement noise of an instant becomes a part of the state. So each particle has a possible
    measurement, the mean of the particles is the predictive mean of y, and z of a simulated draw is
    a measurement that no filter receives. Draws have the same x and y as those of the given model.

    Parameters
    ----------
    model : StateSpaceModel

    Returns
    -------
    StateSpaceModel
        Its z has the components of y; `circular_measurements` says which are angles.
    """
    n, noise = model.components[0], model.noise_of_measurements
    initial, process = len(model.initial_noise), len(model.process_noise)
    before: dict[str, _Formula] = {name: getattr(model, name) for name in own_formulas(model)}
    changed: dict[str, Any] = {
        name: _of_first(formula, ARGUMENTS[name].index("x"), n)
        for name, formula in before.items()
        if "x" in ARGUMENTS[name]
    }
    changed["initial"] = lambda w, p: (*before["initial"](w[:initial], p), *w[initial:])
    changed["transition"] = lambda x, t, w, p: (
        *before["transition"](x[:n], t, w[:process], p), *w[process:]
    )  # fmt: skip
    changed["quantity_of_interest"] = lambda x, t, p: sum(
        (tuple(part.model.measurement(x[:n], t, x[n:][part.v], p)) for part in model.parts), ()
    )
    measuring: dict[str, dict[str, Any]] = {
        name: {
            key: _of_first(getattr(sensor, key), ARGUMENTS[key].index("x"), n) for key in MEASURING
        }
        for name, sensor in model.sensors.items()
    }
    return replace(
        model,
        **changed,
        error=squared_error,
        initial_noise=(*model.initial_noise, *noise),
        process_noise=(*model.process_noise, *noise),
        x_names=(),
        z_names=() if model.sensors else model.y_names,
        circular=circular_measurements(model),
        sensors={name: replace(model.sensors[name], **each) for name, each in measuring.items()},
    )


def _of_first(formula: _Formula, place: int, n: int) -> _Formula:
    """The formula of the first n components of x, its argument at this place."""

    def function(*arguments: Any) -> Any:
        return formula(*arguments[:place], arguments[place][:n], *arguments[place + 1 :])

    return function
