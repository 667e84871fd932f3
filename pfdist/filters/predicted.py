"""Measurements as quantities of interest: a filter that predicts what would be measured."""

from collections.abc import Callable
from itertools import chain
from typing import Any

import numpy as np

from pfdist.common.streams import stream_of
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import noise_of
from pfdist.filters.one_filter import circular_components
from pfdist.kernels.variates import FILTER_INITIAL, TRUTH_MEASUREMENT
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.checks import ARGUMENTS
from pfdist.models.twin import twin_of

_FEW = 64
_Formula = Callable[..., Any]


def circular_measurements(model: StateSpaceModel) -> tuple[int, ...]:
    """The components of y that are angles, of a model on its clock.

    They have the name of a circular component of z, or a likelihood that is the same a turn later.
    """
    quantities = zip(model.named("z"), model.is_angle, strict=True)
    named = {each.name for each, is_angle in quantities if is_angle and each.name}
    found = {k for k, each in enumerate(model.named("y")) if each.name in named}
    stream, draws, twin = stream_of("backtest", 0, "angles"), range(1), twin_of(model, range(1))
    with np.errstate(all="ignore"):
        w = noise_of(model.initial_noise, _FEW, stream, draws, 0, FILTER_INITIAL)
        v = noise_of(model.noise_of_measurements, _FEW, stream, draws, 0, TRUTH_MEASUREMENT)
        x = twin.initial(tuple(each.ravel() for each in w), model.p)
        x = tuple(np.broadcast_to(each, _FEW) for each in x)
        made = [
            way.model.measurement(x, 0, tuple(each.ravel() for each in v[way.v]), model.p)
            for way in twin.ways
        ]
    y = np.array([np.broadcast_to(each, _FEW)[0] for each in chain(*made)], np.float64)
    return tuple(sorted(found.union(circular_components(model, Cloud(0, np.stack(x)), y))))


def predicted(
    model: StateSpaceModel,
    delays: tuple[int, ...] = (),
    horizon: int = 0,
    circular: tuple[int, ...] | None = None,
    always: StateSpaceModel | None = None,
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
    circular : tuple of int, optional
        The components of y that are angles; by default those of `circular_measurements`.
    always : StateSpaceModel, optional
        The model whose measurements give a value always, if those of the model may fail.

    Returns
    -------
    StateSpaceModel
        Its z has the components of y.
    """
    n, noise = model.components[0], model.noise_of_measurements
    initial, process = len(model.initial_noise), len(model.process_noise)
    delays = delays or (0,) * len(model.ways)
    remembered = 1 + max(delays)  # states of so many instants

    def quantity_of_interest(x: Any, t: Any, p: Any) -> Any:
        now, z = x[: n // remembered] * remembered, list[Any]()
        for way, delay in zip((always or model).ways, delays, strict=True):
            at = np.minimum(t + delay, horizon) if delay else t
            z += way.model.measurement(now, at, x[n:][way.v], p)
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
        circular=circular_measurements(model) if circular is None else circular,
    )


def _of_first(formula: _Formula, place: int, n: int) -> _Formula:
    """The formula of the first n components of x, its argument at this place."""

    def function(*arguments: Any) -> Any:
        return formula(*arguments[:place], arguments[place][:n], *arguments[place + 1 :])

    return function
