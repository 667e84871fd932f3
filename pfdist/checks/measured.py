"""Checks of what a model declares for real measurements: its density, and missing components."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.checks.formulas import formatted_state, instants_of, likelihood, measured, values_of
from pfdist.checks.integrals import MOST_ON_A_GRID, NoIntegralError, integral, whole
from pfdist.filters.draws import Draws
from pfdist.models import StateSpaceModel

Array = NDArray[np.float64]

_STATES = 3  # at each of a few instants
_LARGEST_Z = 5.0  # standard errors; 1 in 10^6 of right models is blamed for each state
_INTEGRATION = 1e-4  # error of the integration, which is not in the standard error


def normalised(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: exp(log_likelihood) must have the integral 1 at a few simulated states."""
    rng, summed, states = np.random.default_rng(0), False, 0
    for t in instants_of(draws):
        for number, x in enumerate(rng.choice(draws.x[:, t], size=_STATES, replace=False)):
            y = np.stack(measured(model, x, t, number))

            def density(points: Array, x: Array = x, t: int = t) -> Array:
                arguments = tuple(points), tuple(x.tolist()), t, model.p
                (log,) = values_of(model, "log_likelihood", arguments, points.shape[1])
                values: Array = np.exp(log)
                return values

            try:
                total = integral(density, y)
            except NoIntegralError as reason:
                return "note", f"it cannot be checked: {reason}"
            states, summed = states + 1, summed or bool(whole(y).all())
            if not abs(total.value - 1) < _LARGEST_Z * total.standard_error + _INTEGRATION:
                return "wrong", (
                    "exp(log_likelihood) must have the integral 1 over y, as normalised=True "
                    f"declares, got {total.text} at x = {formatted_state(x)}, "
                    f"t = {t} (a constant left out, such as -log(sd) - log(2 pi) / 2?)"
                )
    if summed:
        return "ok", f"as it declares: the probabilities of whole y add up to 1 at {states} states"
    how = "" if len(y) <= MOST_ON_A_GRID else ", by importance sampling"
    return "ok", f"as it declares: the integral over y is 1 at {states} states{how}"


def missing_components(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: the log-likelihood must be right with each component of y missing."""
    count = model.components[1]
    if count == 1:
        return "note", "y has one component: a time without it is not measured"
    for component in range(count):
        looks = [likelihood(_without(model, component), draws)]
        if model.normalised:
            looks.append(normalised(_rest(model, component), draws))
        for state, text in looks:
            if state == "wrong":
                return "wrong", f"where y[{component}] is missing (NaN): {text}"
    return "ok", f"as it declares: each of {count} components of y may be NaN"


def _without(model: StateSpaceModel, component: int) -> StateSpaceModel:
    """The model whose measurements lack a component."""

    def measurement(x: Any, t: Any, v: Any, p: Any) -> Any:
        y = model.measurement(x, t, v, p)
        return tuple(part * np.nan if k == component else part for k, part in enumerate(y))

    return replace(model, measurement=measurement)


def _rest(model: StateSpaceModel, component: int) -> StateSpaceModel:
    """The model that measures only the other components."""

    def measurement(x: Any, t: Any, v: Any, p: Any) -> Any:
        y = model.measurement(x, t, v, p)
        return (*y[:component], *y[component + 1 :])

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        missing = y[0] * np.nan
        return model.log_likelihood((*y[:component], missing, *y[component:]), x, t, p)

    return replace(model, measurement=measurement, log_likelihood=log_likelihood, y_names=())
