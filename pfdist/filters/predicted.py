"""Measurements as quantities of interest: a filter that predicts what would be measured."""

from collections.abc import Callable
from typing import Any

import numpy as np

from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.checks import ARGUMENTS

_Formula = Callable[..., Any]


def circular_measurements(model: StateSpaceModel) -> tuple[int, ...]:
    """The components of y that are angles: those with the name of a circular component of z."""
    quantities = zip(model.named("z"), model.is_angle, strict=True)
    angles = {each.name for each, is_angle in quantities if is_angle and each.name}
    return tuple(k for k, each in enumerate(model.named("y")) if each.name in angles)


def predicted(
    model: StateSpaceModel, delays: tuple[int, ...] = (), horizon: int = 0
) -> StateSpaceModel:
    """The model whose quantity of interest is a measurement of its state, with noise.

    The measurement noise of an instant becomes a part of the state. So each particle has a possible
    measurement, the mean of the particles is the predictive mean of y, and z of a simulated draw is
    a measurement that no filter receives. Draws have the same x and y as those of the given model.

    Parameters
    ----------
    model : StateSpaceModel
    delays : tuple of int
        For each sensor of `pfdist.models.sensed`, the number of instants after which a value
        arrives. The quantity of interest is what it measures now, and would arrive later.
    horizon : int
        The last instant, if there are delays.

    Returns
    -------
    StateSpaceModel
        Its z has the components of y; `circular_measurements` says which are angles.
    """
    n, noise = model.components[0], model.noise_of_measurements
    initial, process = len(model.initial_noise), len(model.process_noise)
    delays = delays or (0,) * len(model.parts)
    remembered = 1 + max(delays)  # states of so many instants

    def quantity_of_interest(x: Any, t: Any, p: Any) -> Any:
        now, z = x[: n // remembered] * remembered, list[Any]()
        for part, delay in zip(model.parts, delays, strict=True):
            at = np.minimum(t + delay, horizon) if delay else t
            z += part.model.measurement(now, at, x[n:][part.v], p)
        return tuple(z)

    return model.with_formulas(
        lambda owner, name: _of_first(getattr(owner, name), ARGUMENTS[name].index("x"), n),
        initial=lambda w, p: (*model.initial(w[:initial], p), *w[initial:]),
        transition=lambda x, t, w, p: (*model.transition(x[:n], t, w[:process], p), *w[process:]),
        quantity_of_interest=quantity_of_interest,
        error=squared_error,
        initial_noise=(*model.initial_noise, *noise),
        process_noise=(*model.process_noise, *noise),
        x_names=(),
        z_names=() if model.sensors else model.y_names,
        circular=circular_measurements(model),
    )


def _of_first(formula: _Formula, place: int, n: int) -> _Formula:
    """The formula of the first n components of x, its argument at this place."""

    def function(*arguments: Any) -> Any:
        return formula(*arguments[:place], arguments[place][:n], *arguments[place + 1 :])

    return function
