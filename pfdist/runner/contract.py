"""Checks that every formula must pass before a run starts."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import ModelError
from pfdist.filters.draws import Draws, are_possible, not_finite
from pfdist.models import StateSpaceModel

Array = NDArray[np.float64]
_Look = Callable[[StateSpaceModel, Draws], tuple[str, str]]
_INSTANTS = 500
_DRAWS = 10


def few_draws(model: StateSpaceModel, horizon: int) -> Draws:
    """A few NumPy draws of a recorded model; each formula is called at each instant.

    If the horizon is above 500, the draws end at instant 500, and formulas are called at 500 later
    instants. Raises `ModelError` if a formula failed, or gave a value that is not finite.
    """
    last, rng = min(horizon, _INSTANTS), np.random.default_rng(0)
    later = sorted({round(t) for t in np.linspace(last, horizon, _INSTANTS)} - {last})
    instants = [*range(last + 1), *later]
    parts: tuple[list[Array], ...] = ([], [], [])
    with np.errstate(all="ignore"):
        x = _finite(model, "initial", "x", 0, _noise(model.initial_noise, rng))
        for t in instants:
            v, w = _noise(model.measurement_noise, rng), _noise(model.process_noise, rng)
            y = _finite(model, "measurement", "y", t, x, t, v)
            z = _finite(model, "quantity_of_interest", "z", t, x, t)
            model.log_likelihood(y, x, t, model.p)
            model.error(z, z, t, model.p)
            for part, values in zip(parts, (x, y, z), strict=True):
                part.append(np.stack(values, axis=1))
            if t < horizon:
                x = _finite(model, "transition", "x", t + 1, x, t, w)
    states, measured, wanted = (np.stack(part[: last + 1], axis=1) for part in parts)
    return Draws(model, range(_DRAWS), states, measured, wanted)


def _noise(kinds: tuple[str, ...], rng: np.random.Generator) -> tuple[Array, ...]:
    """Noise of the same distribution as the kernel's, in a hundredth of the time."""
    return tuple(
        rng.normal(size=_DRAWS) if kind == "normal" else rng.uniform(size=_DRAWS) for kind in kinds
    )


def _finite(
    model: StateSpaceModel, formula: str, name: str, t: int, *arguments: Any
) -> tuple[Array, ...]:
    """The values of a formula for all draws, which must be finite."""
    function = getattr(model, formula)
    values = tuple(
        np.array(np.broadcast_to(np.asarray(value, float), (_DRAWS,)))
        for value in function(*arguments, model.p)
    )
    for component, value in enumerate(values):
        possible = are_possible(model, name, value)
        if not possible.all():
            got = value[~possible][0]
            what = f"{name}[{component}] = {got}"
            raise ModelError(not_finite(model, formula, (*arguments, model.p), what, t))
    return values


def looked(look: _Look, model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text of one check; an error in a formula gives the state "wrong"."""
    try:
        with np.errstate(all="ignore"):
            return look(model, draws)
    except ModelError as error:
        return "wrong", str(error)
