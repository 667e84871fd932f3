"""Searches run to their ends where the cost is a function of the times."""

from collections.abc import Callable, Iterator, Sequence
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
    sets, t, told = [candidate.measurement_times for candidate in asked], np.arange(horizon + 1), []
    for candidate, row in zip(asked, expected_errors(model, horizon, sets), strict=True):
        times, end, _, _, since = candidate
        counts = (t >= (since or 0)) & (t <= (horizon if end is None else end))
        errors = np.where(counts, row, 0.0)
        told.append(
            Evaluation.exactly(
                times,
                float(errors.mean()),
                end=end,
                errors=None if since is None else row[counts],
            )
        )
    return told
