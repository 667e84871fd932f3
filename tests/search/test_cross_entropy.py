"""The cross-entropy method: how it draws sets, and that it learns."""

from collections import Counter

import numpy as np
from scipy import stats

from oracles.searched import EvenTimes, last, states
from pfdist.search import CrossEntropy
from pfdist.search.cross_entropy import conditional_bernoulli
from pfdist.times.feasible import Feasible


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


def test_where_hardly_any_set_is_allowed_it_draws_those() -> None:
    feasible, rng = EvenTimes(60, 21), np.random.default_rng(1)
    sets = conditional_bernoulli(feasible, np.full(61, 21 / 61), 50, rng)
    assert len(sets) == 50
    assert all(map(feasible.accepts, sets))
    counts = np.bincount(np.concatenate(sets), minlength=61)[::2]
    sd = np.sqrt(50 * 21 / 31 * 10 / 31)
    assert np.all(np.abs(counts - 50 * 21 / 31) < 4 * sd)
