"""Lines that one filter hands to another, so that both together are one filter."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from inspect import signature
from typing import ParamSpec, cast

import numpy as np
from numpy.typing import NDArray

from pfdist.filters.cloud import CarriedLines, Cloud
from pfdist.filters.draws import Draws
from pfdist.filters.proposals import MOST_INSTANTS
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import FilterArrays
from pfdist.models import StateSpaceModel

Given = ParamSpec("Given")
_OF_INSTANTS = ("estimate", "variance", "sizes", "lines", "line_z", "line_weight")


def carried_by(settings: Estimation, model: StateSpaceModel) -> CarriedLines | None:
    """The lines that a filter continues; None if it begins them, or moves none."""
    if not settings.moves or not isinstance(settings.prior, Cloud):
        return None
    return settings.prior.lines_for(model)


def continuing(filtering: Callable[Given, FilterArrays]) -> Callable[Given, FilterArrays]:
    """The function of an engine, which gets the draws from the start of lines that it continues."""
    names = [*signature(filtering).parameters]

    @wraps(filtering)
    def filtered(*given: Given.args, **named: Given.kwargs) -> FilterArrays:
        arguments = {**dict(zip(names, given, strict=False)), **named}
        draws, settings = cast(Draws, arguments["draws"]), cast(Estimation, arguments["settings"])
        lines = carried_by(settings, cast(StateSpaceModel, arguments["model"]))
        if lines is None:
            return filtering(*given, **named)
        function: Callable[..., FilterArrays] = filtering
        found = function(**{**arguments, "draws": _since(lines, draws)})
        return _without_earlier(found, draws.start - lines.start, len(draws.instants))

    return filtered


def _since(lines: CarriedLines, draws: Draws) -> Draws:
    """Draws of which earlier instants are known only by the measurements of lines.

    Errors at these instants do not count, and the others count for them.
    """
    before = draws.start - lines.start
    count, instants, quantities = draws.z.shape
    weights = np.r_[np.zeros(before), draws.instant_weights * ((before + instants) / instants)]
    x = draws.x
    if x.size:
        x = np.concatenate([np.zeros((count, before, x.shape[2])), x], axis=1)
    return replace(
        draws,
        x=x,
        y=_measurements(lines, draws),
        z=np.concatenate([np.zeros((count, before, quantities)), draws.z], axis=1),
        start=lines.start,
        weights=weights,
    )


def _measurements(lines: CarriedLines, draws: Draws) -> NDArray[np.float64]:
    """The measurements of lines, and those of draws, which begin where the lines end."""
    before = draws.start - lines.start
    shared = slice(before + bool(lines.counts[before].any()))
    y = np.concatenate([np.zeros((len(draws.y), before, draws.y.shape[2])), draws.y], axis=1)
    y[:, shared] = lines.y[shared]
    return y


def _without_earlier(found: FilterArrays, before: int, instants: int) -> FilterArrays:
    """The results without those of instants before a filter began."""
    cut = {name: array[:, before:] for name in _OF_INSTANTS if (array := getattr(found, name)).size}
    if found.log_likelihoods.size:
        cut["log_likelihoods"] = found.log_likelihoods[:, :, before:]
    if found.errors.size:
        cut["errors"] = found.errors[..., before:]
    if found.measured.size:
        sensors = found.measured.shape[1] // (before + instants)
        cut["measured"] = found.measured[:, before * sensors :]
    return found._replace(**cut)


def carried_lines(
    found: FilterArrays, draws: Draws, model: StateSpaceModel, settings: Estimation
) -> CarriedLines | None:
    """The lines behind the particles of a filter of one system.

    None if these do not move, or have too many steps: from then on components stay.
    """
    if not found.noise.size or found.noise.shape[1] > MOST_INSTANTS + 1:
        return None
    lines, y, start = carried_by(settings, model), draws.y[0], draws.start
    begins = settings.prior is None
    if lines is not None:
        start, begins = lines.start, lines.begins
        y = _measurements(lines, draws)[0]
    noise, states, counts = found.noise[0], found.first_states[0], found.counts[0]
    return CarriedLines(start, noise, states, y, counts, begins, model)
