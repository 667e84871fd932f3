"""Exchange ends where no exchange is better: on exact costs, and on the mean over its draws."""

import math
from functools import cache

import numpy as np
import pytest

from oracles.kalman import SCALAR, THREE, TRACKING, LinearGaussian, riccati_cost
from oracles.searched import last
from pfdist.common.measurement_times import Times, regular
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.search import Candidate, Exchange

FEASIBLE = Feasible(horizon=14, measurement_budget=4)
DRAWS = 400


@pytest.mark.parametrize("system", [SCALAR, TRACKING, THREE])
def test_it_ends_in_a_local_optimum_no_worse_than_regular_times(system: LinearGaussian) -> None:
    @cache
    def cost(times: Times) -> float:
        return riccati_cost(system, 14, times)

    state = last(Exchange(FEASIBLE, DRAWS), cost)
    assert cost(state.best) == min(map(cost, [state.best, *FEASIBLE.exchanges(state.best)]))
    assert cost(state.best) <= cost(regular(14, 4))


def _noisy(candidate: Candidate, noise: float) -> Evaluation:
    """Best at 3, 4, 5, 6, by a cost whose noise is partly each set's own."""
    times = candidate.measurement_times
    own = np.random.default_rng(times).normal(0, noise, DRAWS)
    common = np.random.default_rng(0).normal(0, 10, DRAWS)
    return Evaluation(
        times, (sum(map(abs, np.subtract(times, (3, 4, 5, 6)))) + own + common)[: candidate.draws]
    )


def test_under_noise_it_ends_in_a_local_optimum_of_the_mean_over_its_draws() -> None:
    search, rng = Exchange(FEASIBLE, DRAWS), np.random.default_rng(1)
    state, spent = search.init(), 0
    while not search.done(state):
        asked = search.ask(state, rng)
        spent += sum(candidate.draws or DRAWS for candidate in asked)
        state = search.tell(state, [_noisy(candidate, 1.0) for candidate in asked])
    found = search.finalists(state)[0].measurement_times
    assert found == state.best == (3, 4, 5, 6)
    costs = [_noisy(Candidate(times), 1.0).expected_mse for times in FEASIBLE.exchanges(found)]
    assert min(costs) > _noisy(Candidate(found), 1.0).expected_mse
    whole = (len(state.left) + 1) * (len(FEASIBLE.exchanges(found)) + 1) * DRAWS
    assert spent < whole / 4  # few draws decide where the decision is plain


def test_it_does_not_go_round_where_few_draws_mislead() -> None:
    """Six sets in a ring, each with two others for neighbours, and all the rest far worse.

    From the first of them on each is better than the last, on all draws; but on the first draws the
    second is better than the first by three standard errors.
    """
    ring = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 5)]
    few = 32
    error = math.sqrt(2 / few)  # of a difference, on the first draws

    def told(candidate: Candidate) -> Evaluation:
        times = candidate.measurement_times
        place = ring.index(times) if times in ring else -1
        # Noise of mean 0 and variance 1, of no correlation between sets.
        mse = math.sqrt(2) * np.cos(2 * math.pi * (place + 2) / few * np.arange(DRAWS))
        early, whole = (
            (0.0, 0.0) if place == 0 else (0.64 * (place - 6) * error, 0.12 * (7 - place))
        )
        mse[:few] += early
        mse[few:] += (DRAWS * whole - few * early) / (DRAWS - few)
        return Evaluation(times, (mse + 99 * (place < 0))[: candidate.draws])

    search, rng = Exchange(Feasible(5, 2), DRAWS, start=ring[0]), np.random.default_rng(1)
    state = search.init()
    while not search.done(state):
        state = search.tell(state, [told(candidate) for candidate in search.ask(state, rng)])
    assert state.left == tuple(ring)
    assert state.best == ring[0]


def test_it_starts_from_regular_times_or_near_them() -> None:
    for feasible in (FEASIBLE, Feasible(14, 4, forbidden=(0, 5))):
        start = Exchange(feasible, DRAWS).init().best
        assert start == feasible.regular()
        assert feasible.accepts(start)


def test_it_makes_no_more_moves_than_it_may() -> None:
    search = Exchange(FEASIBLE, DRAWS, start=(11, 12, 13, 14), moves=2)
    state = last(search, lambda times: float(sum(times)))
    assert (len(state.left), state.best) == (2, (0, 1, 11, 12))
