"""The contract of every search where measurement times are constrained."""

from functools import cache

import numpy as np
import pytest

from oracles.kalman import TRACKING
from pfdist.evaluation.estimate import SearchEvaluation
from pfdist.filters import kalman
from pfdist.search import Candidate
from pfdist.search.base import SearchOptimiser
from pfdist.search.methods import METHODS
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

HORIZON, DRAWS = 12, 20
PRICES = (1, 3, 2) * 4 + (1,)
CONSTRAINTS = {
    "forbidden": Feasible(HORIZON, 4, forbidden=(0, 3, 4, 5, 9)),
    "required": Feasible(HORIZON, 4, required=(6, 7)),
    "spacing": Feasible(HORIZON, 4, minimum_spacing=3),
    "cost": Feasible(HORIZON, cost=PRICES, total_cost=8),
    "together": Feasible(
        HORIZON, None, forbidden=(2,), required=(8,), minimum_spacing=2, cost=PRICES, total_cost=7
    ),
    "one measurement": Feasible(HORIZON, 1),
    # The next three allow one set alone:
    "all times": Feasible(HORIZON, HORIZON + 1),
    "all required": Feasible(HORIZON, 3, required=(2, 5, 9)),
    "all paid for": Feasible(HORIZON, cost=PRICES, total_cost=100),
}
SMALL = {
    "evaluations": 60, "population": 20, "generations": 12, "mutation_probability": 0.1,
    "steps": 40,
}  # fmt: skip
EXACT = {
    "relaxation",
    "survivors",
    "exhaustive",
}  # here, that is: what a search finds is the best there is
ON_THE_WAY = {"greedy_forward", "greedy_backward"}  # they ask for smaller sets too, or for larger

MODEL = TRACKING.as_model()


def _optimiser(method: str, feasible: Feasible) -> SearchOptimiser:
    settings = METHODS[method].section().settings
    small = {key: SMALL.get(key, value) for key, value in settings.items()}
    return METHODS[method].make(feasible, DRAWS, small)


def _costs(asked: list[Candidate]) -> list[float]:
    ends = [HORIZON if candidate.end is None else candidate.end for candidate in asked]
    sets = [candidate.measurement_times for candidate in asked]
    costs: list[float] = kalman.expected_mse(MODEL, HORIZON, sets, ends).tolist()
    return costs


def _evaluation(candidate: Candidate, cost: float) -> SearchEvaluation:
    times, end, since = candidate.measurement_times, candidate.end, candidate.since
    if since is None:
        return SearchEvaluation(times, np.empty(0), exact=cost, end=end)
    errors = kalman.expected_errors(MODEL, HORIZON, [times])[0]
    errors[:since] = 0.0
    errors[(HORIZON if end is None else end) + 1 :] = 0.0
    cost = float(np.mean(errors))
    return SearchEvaluation(times, np.empty(0), exact=cost, end=end, errors=errors)


@cache
def _searched(method: str, constraint: str) -> tuple[list[Candidate], list[SearchEvaluation]]:
    optimiser = _optimiser(method, CONSTRAINTS[constraint])
    state, asked = optimiser.init(), []
    assert optimiser.generations > 0
    assert optimiser.evaluations > 0
    while not optimiser.done(state):
        rng = np.random.Generator(np.random.Philox([1, len(asked)]))
        now = list(optimiser.ask(state, rng))
        asked += now
        state = optimiser.tell(state, list(map(_evaluation, now, _costs(now))))
    return asked, list(optimiser.finalists(state))


@cache
def _every(constraint: str) -> dict[Times, float]:
    every = list(CONSTRAINTS[constraint].every())
    return dict(zip(every, _costs([Candidate(times) for times in every]), strict=True))


def _nested(first: Times, second: Times) -> bool:
    return set(first) <= set(second) or set(second) <= set(first)


both = pytest.mark.parametrize(
    ("method", "constraint"),
    [(method, constraint) for method in METHODS for constraint in CONSTRAINTS],
)


@both
def test_whole_sets_that_it_asks_for_are_feasible(method: str, constraint: str) -> None:
    asked, _ = _searched(method, constraint)
    every = _every(constraint)
    whole = {
        candidate.measurement_times
        for candidate in asked
        if candidate.end is None and candidate.since is None
    }
    for times in whole:
        if method in ON_THE_WAY:
            assert any(_nested(times, whole) for whole in every)
        else:
            assert times in every


@both
def test_a_feasible_set_begins_with_what_it_asks_for_up_to_an_end(
    method: str, constraint: str
) -> None:
    asked, _ = _searched(method, constraint)
    begun = {
        candidate.measurement_times
        for candidate in asked
        if candidate.end is not None and candidate.since is None
    }
    assert begun <= {whole[: k + 1] for whole in _every(constraint) for k in range(len(whole))}


@both
def test_where_errors_are_asked_for_some_feasible_set_has_the_last_of_the_measurements(
    method: str, constraint: str
) -> None:
    """Windows end as a beginning of a feasible set does; before them all allowed times may be."""
    feasible, asked = CONSTRAINTS[constraint], _searched(method, constraint)[0]
    windows = [candidate for candidate in asked if candidate.since is not None]
    assert bool(windows) != METHODS[method].online
    for times, end, _, _, _, since in windows:
        assert set(feasible.required) & set(range(max(times, default=0))) <= set(times)
        assert not set(times) & set(feasible.forbidden)
        assert since == max(times, default=0)
        assert end is not None


@both
def test_what_it_finds_is_feasible_and_good(method: str, constraint: str) -> None:
    _, found = _searched(method, constraint)
    every = _every(constraint)
    assert {evaluation.measurement_times for evaluation in found} <= every.keys()
    share = 0.5 if method in ON_THE_WAY else 0.1  # a step that is best by itself may lead astray
    assert found[0].cost <= np.quantile(list(every.values()), share)
    if method in EXACT:
        assert found[0].cost == pytest.approx(min(every.values()), rel=1e-12)
