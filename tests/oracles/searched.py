"""Searches run to their ends where the cost is a function of the times."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pfdist import StateSpaceModel
from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.filters.kalman import expected_errors
from pfdist.search import Candidate, Optimiser


def states(optimiser: Optimiser, cost: Callable[[Times], float], seed: int = 1) -> Iterator[Any]:
    """Give the state after each asking."""
    state, rng = optimiser.init(), np.random.default_rng(seed)
    while not optimiser.done(state):
        asked = optimiser.ask(state, rng)
        told = [
            Evaluation.exactly(candidate.measurement_times, cost(candidate.measurement_times))
            for candidate in asked
        ]
        state = optimiser.tell(state, told)
        yield state


def last(optimiser: Optimiser, cost: Callable[[Times], float], seed: int = 1) -> Any:
    """Give the last state."""
    *_, state = states(optimiser, cost, seed)
    return state


def exactly(model: StateSpaceModel, horizon: int, asked: Sequence[Candidate]) -> list[Evaluation]:
    """Evaluate candidates by the Kalman filter: whole sets, prefixes, and errors of instants."""
    sets, t, told = [each.measurement_times for each in asked], np.arange(horizon + 1), []
    whole = expected_errors(model, horizon, sets)
    for (times, end, _, _, counted), row in zip(asked, whole, strict=True):
        until = np.where(t <= (horizon if end is None else end), row, 0.0)
        found = Evaluation.exactly(times, float(until.mean()), end=end)
        if counted is not None:
            errors = expected_errors(model, horizon, counted.sets)
            found = replace(found, errors=counted.of_instants(errors))
        told.append(found)
    return told
