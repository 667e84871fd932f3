"""Simulated annealing and the cross-entropy method: how they draw sets, and what they learn."""

import math
from collections import Counter

import numpy as np
import pytest
from scipy import stats

from oracles.searched import EvenTimes, last, states
from pfdist.common.measurement_times import Times
from pfdist.problem.feasible import Feasible
from pfdist.search import Annealing, CrossEntropy
from pfdist.search.annealing import accepted
from pfdist.search.cross_entropy import conditional_bernoulli

# --- simulated annealing --------------------------------------------------------------------------


def test_a_rise_is_accepted_with_metropolis_probability() -> None:
    rng, tries = np.random.default_rng(1), 20_000
    for rise, temperature in ((0.1, 1.0), (1.0, 1.0), (1.0, 0.5)):
        share = np.mean([accepted(rise, temperature, rng) for _ in range(tries)])
        expected = math.exp(-rise / temperature)
        assert abs(share - expected) < 4 * math.sqrt(expected * (1 - expected) / tries)


def test_a_fall_is_accepted_always_and_a_rise_never_when_it_is_cold() -> None:
    rng = np.random.default_rng(1)
    assert all(accepted(-1.0, temperature, rng) for temperature in (0.0, 1.0) for _ in range(99))
    assert accepted(0.0, 0.0, rng)
    assert not any(accepted(1e-9, 0.0, rng) for _ in range(99))
    assert not accepted(math.inf, 1.0, rng)


def test_at_a_constant_temperature_sets_are_visited_as_boltzmann_says() -> None:
    """Neighbours are drawn evenly, so the stationary distribution is exp(-cost / temperature)."""
    feasible, every = Feasible(4, 2), 25  # after so many steps a chain has forgotten
    costs = dict(zip(feasible.every(), np.random.default_rng(1).random(10), strict=True))
    search = Annealing(feasible, chains=4, steps=8000, coldest=1.0)
    seen: Counter[Times] = Counter()
    for step, state in enumerate(states(search, costs.__getitem__)):
        if step % every == 0 and step > 0:
            seen.update(present.measurement_times for present, _ in state.chains)
    weights = {times: math.exp(-cost / state.temperature) for times, cost in costs.items()}
    expected = [seen.total() * weight / sum(weights.values()) for weight in weights.values()]
    assert min(expected) > 5
    assert stats.chisquare([seen[times] for times in costs], expected).pvalue > 1e-4


def test_it_cools_geometrically_from_the_spread_of_the_costs_over_root_n() -> None:
    search = Annealing(Feasible(20, 4), chains=100, steps=10, coldest=0.1)
    temperatures = [state.temperature for state in states(search, lambda times: float(sum(times)))]
    ratios = np.divide(temperatures[1:], temperatures[:-1])
    np.testing.assert_allclose(ratios, 0.1 ** (1 / 9))
    spread = math.sqrt(4 * (21**2 - 1) / 12 * (21 - 4) / 20)  # of a sum drawn without replacement
    error = 1 / math.sqrt(2 * 400)  # of a standard deviation, from 4 sets a chain
    assert temperatures[0] == pytest.approx(spread / 2, rel=4 * error)


def test_where_few_exchanges_are_allowed_annealing_makes_those() -> None:
    feasible = EvenTimes(60, 3)
    search = Annealing(feasible, chains=2, steps=400, coldest=0.03)
    state = last(search, lambda times: float(sum(times)))
    assert state.best[0].measurement_times == (0, 2, 4)
    assert all(
        feasible.accepts(evaluation.measurement_times)
        for pair in state.chains
        for evaluation in pair
    )


@pytest.mark.parametrize("cost", [1.0, math.inf])
def test_costs_without_spread_are_no_harm(cost: float) -> None:
    search = Annealing(Feasible(6, 2), chains=2, steps=5, coldest=0.03)
    assert last(search, lambda times: cost).step == 5


# --- the cross-entropy method ---------------------------------------------------------------------


def test_sets_are_drawn_with_the_odds_of_their_times() -> None:
    """Chen, Dempster, Liu 1994: a set's probability is as the product of its times' odds."""
    feasible, p = Feasible(4, 2), np.array([0.1, 0.3, 0.4, 0.5, 0.7])
    drawn = Counter(conditional_bernoulli(feasible, p, 5000, np.random.default_rng(1)))
    odds = np.array([np.prod((p / (1 - p))[list(times)]) for times in feasible.every()])
    expected = drawn.total() * odds / odds.sum()
    assert stats.chisquare([drawn[times] for times in feasible.every()], expected).pvalue > 1e-4


def test_probabilities_become_those_of_the_best_set() -> None:
    shares = np.random.default_rng(1).random(21)
    search = CrossEntropy(Feasible(20, 5), 100, 50, elite=0.1, smoothing=0.4)
    state = last(search, lambda times: -float(shares[list(times)].sum()))
    best = np.sort(np.argsort(shares)[-5:])
    assert tuple(np.flatnonzero(np.array(state.probabilities) > 0.9)) == tuple(best)
    assert state.best[0].measurement_times == tuple(best)
    assert state.generation < search.generations  # it ends when it has learnt all


def test_probabilities_are_shares_smoothed_from_the_first_sets_on() -> None:
    search = CrossEntropy(Feasible(20, 5), 40, 30, elite=0.1, smoothing=0.4)
    found = list(states(search, lambda times: float(sum(times))))
    assert all(np.isclose(sum(state.probabilities), 5) for state in found)
    first, second = (np.array(state.probabilities) for state in found[:2])
    assert np.all(second >= 0.6 * first - 1e-12)  # what was learnt before has still its share


def test_where_hardly_any_set_is_allowed_those_are_drawn() -> None:
    feasible, rng = EvenTimes(60, 21), np.random.default_rng(1)
    sets = conditional_bernoulli(feasible, np.full(61, 21 / 61), 50, rng)
    assert len(sets) == 50
    assert all(map(feasible.accepts, sets))
    counts = np.bincount(np.concatenate(sets), minlength=61)[::2]
    sd = np.sqrt(50 * 21 / 31 * 10 / 31)
    assert np.all(np.abs(counts - 50 * 21 / 31) < 4 * sd)
