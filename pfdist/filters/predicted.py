"""Measurements as quantities of interest: a filter that predicts what would be measured."""

from collections.abc import Callable
from typing import Any

from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.checks import ARGUMENTS

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
    return model.with_formulas(
        lambda owner, name: _of_first(getattr(owner, name), ARGUMENTS[name].index("x"), n),
        initial=lambda w, p: (*model.initial(w[:initial], p), *w[initial:]),
        transition=lambda x, t, w, p: (*model.transition(x[:n], t, w[:process], p), *w[process:]),
        quantity_of_interest=lambda x, t, p: sum(
            (tuple(part.model.measurement(x[:n], t, x[n:][part.v], p)) for part in model.parts), ()
        ),
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
