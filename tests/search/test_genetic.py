"""The genetic algorithm does what the paper's section 2.4 says."""

import itertools
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.search import GeneticAlgorithm
from pfdist.search.base import Candidate
from pfdist.search.genetic import (
    GeneticState,
    count_preserving_crossover,
    expected_offspring,
    stochastic_universal_sampling,
)


def _genetic(**changes: Any) -> GeneticAlgorithm:
    settings = {
        "feasible": Feasible(20, 5),
        "population": 10,
        "generations": 3,
        "crossover_probability": 1.0,
        "mutation_probability": 0.003,
        "sigma_scaling": 1.0,
    }
    return GeneticAlgorithm(**{**settings, **changes})


def _evaluation(times: tuple[int, ...], cost: float) -> Evaluation:
    return Evaluation(times, np.array([np.nan] if np.isinf(cost) else [cost]))


def _rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_sigma_scaling_expects_one_offspring_more_a_standard_deviation_below_the_mean() -> None:
    costs = np.array([1.0, 2.0, 3.0])  # mean 2, population sd sqrt(2/3)
    excess = 1 / np.sqrt(2 / 3)
    np.testing.assert_allclose(expected_offspring(costs, 1.0), [1 + excess, 1, 0])
    np.testing.assert_allclose(expected_offspring(costs, 2.0), [1 + excess / 2, 1, 1 - excess / 2])


def test_killed_individuals_have_no_offspring_and_no_say_in_the_mean() -> None:
    costs = np.array([1.0, np.inf, 2.0, 3.0, np.inf])
    living = np.isfinite(costs)
    offspring = expected_offspring(costs, 1.0)
    np.testing.assert_array_equal(offspring[~living], 0)
    np.testing.assert_allclose(offspring[living], expected_offspring(costs[living], 1.0))


def test_of_equal_costs_each_living_individual_expects_one_offspring() -> None:
    # Whatever the rounding of their mean: that of six numbers often differs from each of them.
    for cost in np.random.default_rng(1).random(1000) * 50:
        costs = np.array([cost, np.inf, *[cost] * 5])
        np.testing.assert_array_equal(expected_offspring(costs, 1.0), np.isfinite(costs))


def test_universal_sampling_selects_floor_or_ceil_of_what_is_expected() -> None:
    expected = np.array([0.0, 2.3, 0.7, 0.0, 4.0, 1.0])
    for seed in range(50):
        counts = np.bincount(stochastic_universal_sampling(expected, 8, _rng(seed)), minlength=6)
        assert (np.floor(expected) <= counts).all()
        assert (counts <= np.ceil(expected)).all()


def test_universal_sampling_is_unbiased() -> None:
    expected, spins = np.array([2.3, 0.7, 3.0]), 4000
    counts = sum(
        np.bincount(stochastic_universal_sampling(expected, 6, _rng(seed)), minlength=3)
        for seed in range(spins)
    )
    # each count is Bernoulli around its floor: sd at most 1/2 a spin
    assert (np.abs(counts / spins - expected) < 4 * 0.5 / np.sqrt(spins)).all()


def test_crossover_keeps_the_number_and_swaps_only_where_the_parents_differ() -> None:
    a, b = {1, 2, 3, 4, 9}, {3, 4, 5, 6, 7}
    swapped = []
    for seed in range(600):
        child_a, child_b = count_preserving_crossover(a, b, _rng(seed))
        assert len(child_a) == len(child_b) == 5
        assert a & b <= child_a & child_b
        assert sorted([*child_a, *child_b]) == sorted([*a, *b])
        swapped.append(len(child_a - a))
    # the number of swapped elements is uniform on 1..3
    assert stats.chisquare(np.bincount(swapped, minlength=4)[1:]).pvalue > 1e-3
    assert min(swapped) == 1


def test_crossover_of_parents_of_different_sizes_keeps_the_size_of_each() -> None:
    a, b = {1, 2, 3, 4, 9}, {4, 6}
    for seed in range(50):
        child_a, child_b = count_preserving_crossover(a, b, _rng(seed))
        assert (len(child_a), len(child_b)) == (5, 2)
        assert sorted([*child_a, *child_b]) == sorted([*a, *b])
        assert child_a != a
    assert count_preserving_crossover(a, a, _rng()) == (a, a)


@pytest.mark.parametrize(
    "given", [{}, {"crossover_probability": 0.3}, {"crossover_probability": 0}]
)
def test_a_pair_is_crossed_with_its_probability_and_by_default_always(
    given: dict[str, Any],
) -> None:
    """The paper, section 2.4: "Crossover probability is 1".

    Half of 1,000 pairs have different parents. They share no time, so one to five elements are
    swapped, and only a swap of all five looks like none.
    """
    genetic = GeneticAlgorithm(Feasible(20, 5), population=2000, mutation_probability=0.0, **given)
    parents = (0, 1, 2, 3, 4), (10, 11, 12, 13, 14)
    told = [_evaluation(parents[number % 2], 1.0) for number in range(2000)]
    asked = genetic.ask(genetic.tell(genetic.init(), told), _rng())
    new = sum(candidate.measurement_times not in parents for candidate in asked)
    pairs, share = 1000, given.get("crossover_probability", 1.0) * 0.5 * 0.8
    assert new % 2 == 0
    assert abs(new / 2 - pairs * share) <= 4 * np.sqrt(pairs * share * (1 - share))


def test_where_smaller_sets_are_feasible_a_gene_is_replaced_removed_or_added() -> None:
    """Each with a probability of a third, for the one gene of each individual."""
    feasible = Feasible(20, price=(1,) * 21, total_price=20, smaller=True)
    genetic = _genetic(feasible=feasible, population=6000, mutation_probability=0.6)
    state = genetic.tell(genetic.init(), [_evaluation((8,), 1.0)] * 6000)
    population = [each.measurement_times for each in genetic.ask(state, _rng())]
    removed, added = population.count(()), sum(len(times) == 2 for times in population)
    replaced = sum(len(times) == 1 and times != (8,) for times in population)
    assert removed + added + replaced + population.count((8,)) == 6000
    sd = np.sqrt(6000 * 0.2 * 0.8)
    assert (np.abs(np.array([removed, added, replaced]) - 1200) < 4 * sd).all()


def test_mutation_replaces_each_gene_with_its_probability_by_an_absent_time() -> None:
    genetic = _genetic(mutation_probability=0.1, crossover_probability=0.0, population=2000)
    times = (2, 5, 8, 11, 20)
    state = genetic.tell(genetic.init(), [_evaluation(times, 1.0)] * 2000)
    population = np.array([candidate.measurement_times for candidate in genetic.ask(state, _rng())])
    assert all(len(set(row)) == 5 for row in population.tolist())
    genes = population.size
    replaced = genes - np.isin(population, times).sum()
    # A replaced time may come back by a second mutation of the same set: 1/17 of 10 % at most.
    sd = np.sqrt(genes * 0.1 * 0.9)
    assert 0.1 * genes * (1 - 0.1 / 17 * 4) - 4 * sd < replaced < 0.1 * genes + 4 * sd
    new = population[~np.isin(population, times)]
    absent = sorted(set(range(21)) - set(times))
    assert set(new.tolist()) == set(absent)
    assert stats.chisquare(np.bincount(new, minlength=21)[absent]).pvalue > 1e-3


def test_a_set_of_all_times_has_nothing_to_mutate_into() -> None:
    genetic = _genetic(feasible=Feasible(4, 5), mutation_probability=1.0)
    times = (0, 1, 2, 3, 4)
    state = genetic.tell(genetic.init(), [_evaluation(times, 1.0)] * 10)
    assert {candidate.measurement_times for candidate in genetic.ask(state, _rng())} == {times}


def test_it_returns_the_best_of_the_last_generation_with_the_cost_it_got() -> None:
    genetic, state = _genetic(), _genetic().init()
    costs = itertools.count(1.0)  # every generation is worse than the one before
    for generation in range(3):
        assert not genetic.done(state)
        population = genetic.ask(state, _rng(generation))
        told = [_evaluation(candidate.measurement_times, next(costs)) for candidate in population]
        state = genetic.tell(state, told)
    assert genetic.done(state)
    (best,) = genetic.finalists(state)
    assert best is told[0]
    assert best.expected_mse == 21.0


def test_if_all_are_killed_the_next_population_is_random() -> None:
    genetic = _genetic()
    state = genetic.tell(genetic.init(), [_evaluation((0, 1, 2, 3, 4), np.inf)] * 10)
    population = genetic.ask(state, _rng())
    assert population == genetic.ask(genetic.init(), _rng())


@pytest.mark.parametrize("killed", [1, 5, 9])
def test_the_killed_are_never_parents(killed: int) -> None:
    genetic = _genetic(mutation_probability=0.0)
    dead, alive = (0, 1, 2, 3, 4), (10, 11, 12, 13, 14)
    told = [_evaluation(dead, np.inf)] * killed + [_evaluation(alive, 1.0)] * (10 - killed)
    population = genetic.ask(genetic.tell(genetic.init(), told), _rng())
    assert {candidate.measurement_times for candidate in population} == {alive}


def test_every_individual_is_asked_for_on_its_own_also_copies_of_one_set() -> None:
    genetic = _genetic()
    alike = tuple(_evaluation((1, 2, 3, 4, 5), cost) for cost in np.linspace(1.0, 2.0, 10))
    state = GeneticState(1, alike)
    asked = genetic.ask(state, _rng())
    assert len(set(asked)) == len(asked) == 10
    assert [candidate.individual for candidate in asked] == list(range(10))
    shared = _genetic(share_copies=True, mutation_probability=0.0).ask(state, _rng())
    assert set(shared) == {Candidate((1, 2, 3, 4, 5))}
    first = genetic.ask(genetic.init(), _rng())
    assert [candidate.individual for candidate in first] == list(range(10))
