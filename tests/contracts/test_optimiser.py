"""What every optimiser keeps to: one contract, one test."""

import numpy as np
import pytest

from pfdist.monte_carlo import Evaluation
from pfdist.search import GeneticAlgorithm, Optimiser, RandomTrials

HORIZON, BUDGET = 15, 4

OPTIMISERS = {
    "genetic": GeneticAlgorithm(HORIZON, BUDGET, 12, 15, 1.0, 0.02, 1.0),
    "random": RandomTrials(HORIZON, BUDGET, 700),
}

pytestmark = pytest.mark.parametrize("optimiser", OPTIMISERS.values(), ids=OPTIMISERS.keys())


def _cost(times: tuple[int, ...]) -> float:
    """Least for the even times 2, 4, 6, 8."""
    return sum(abs(time - 2 * (k + 1)) for k, time in enumerate(times))


def _search(optimiser: Optimiser, seed: int) -> tuple[list[np.ndarray], Evaluation]:
    state, asked = optimiser.init(), []
    while not optimiser.done(state):
        rng = np.random.Generator(np.random.Philox([seed, len(asked)]))
        population = optimiser.ask(state, rng)
        asked.append(population)
        rows = map(tuple, population.tolist())
        state = optimiser.tell(state, [Evaluation(row, np.array([_cost(row)])) for row in rows])
    return asked, optimiser.best(state)


def test_it_asks_for_sorted_sets_of_distinct_times_within_the_horizon(
    optimiser: Optimiser,
) -> None:
    asked, _ = _search(optimiser, 1)
    sets = np.concatenate(asked)
    assert sets.shape[1] == BUDGET
    assert (np.diff(sets, axis=1) > 0).all()
    assert sets.min() >= 0
    assert sets.max() <= HORIZON


def test_it_asks_as_often_and_for_as_many_as_it_says(optimiser: Optimiser) -> None:
    asked, _ = _search(optimiser, 1)
    assert len(asked) == optimiser.generations
    assert sum(map(len, asked)) == optimiser.evaluations


def test_the_same_keys_give_the_same_search_and_others_another(optimiser: Optimiser) -> None:
    first, again, other = (_search(optimiser, seed)[0] for seed in (1, 1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert any(not np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_it_returns_something_it_asked_for_with_the_cost_it_was_told(optimiser: Optimiser) -> None:
    asked, best = _search(optimiser, 1)
    assert best.measurement_times in set(map(tuple, np.concatenate(asked).tolist()))
    assert best.cost == _cost(best.measurement_times)


def test_it_finds_better_than_the_average_of_its_first_asking(optimiser: Optimiser) -> None:
    asked, best = _search(optimiser, 1)
    assert best.cost < np.mean([_cost(tuple(row)) for row in asked[0].tolist()])


def test_state_and_evaluations_are_not_changed(optimiser: Optimiser) -> None:
    rng = np.random.default_rng(1)
    state = optimiser.init()
    rows = list(map(tuple, optimiser.ask(state, rng).tolist()))
    told = [Evaluation(row, np.array([_cost(row)])) for row in rows]
    following = optimiser.tell(state, told)
    assert following is not state
    assert state == optimiser.init()
    assert [evaluation.measurement_times for evaluation in told] == rows
