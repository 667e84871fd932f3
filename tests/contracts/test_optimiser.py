"""The contract of every optimiser."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from pfdist.evaluation.estimate import SearchEvaluation
from pfdist.search import Candidate, EveryBudget
from pfdist.search.base import FINALISTS, SearchOptimiser
from pfdist.search.methods import METHODS
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

FEASIBLE = Feasible(horizon=15, measurement_budget=4)
DRAWS = 20

# Every method that a job can name, with its default settings, and the programme for several N.
OPTIMISERS: dict[str, SearchOptimiser] = {
    name: method.make(FEASIBLE, DRAWS, method.section().settings)
    for name, method in METHODS.items()
} | {"every_budget": EveryBudget(FEASIBLE, least=4)}
# How much they ask for does not depend on what they are told.
FORESEEN = ("exhaustive", "genetic", "greedy_backward", "greedy_forward", "random")
AT_RANDOM = ("annealing", "cross_entropy", "genetic", "random")
FINDS_THE_BEST = (
    "every_budget",
    "cross_entropy",
    "exchange",
    "exhaustive",
    "greedy_backward",
    "survivors",
)

every = pytest.mark.parametrize("name", OPTIMISERS)


def _cost(times: Times, end: int | None = None) -> float:
    """Least for the even times 2, 4, 6, 8; what comes after the end has no share in it."""
    here = [time for time in times if end is None or time <= end]
    return float(sum(abs(time - 2 * (k + 1)) for k, time in enumerate(here)))


def _told(asked: list[Candidate]) -> list[SearchEvaluation]:
    """Costs under common noise: the same in all sets."""
    noise = np.random.default_rng(0).normal(size=DRAWS)
    return [
        SearchEvaluation(
            candidate.measurement_times,
            (_cost(candidate.measurement_times, candidate.end) + noise)[: candidate.draws],
            end=candidate.end,
        )
        for candidate in asked
    ]


def _search(
    optimiser: SearchOptimiser, seed: int
) -> tuple[list[list[Candidate]], list[SearchEvaluation]]:
    state, asked = optimiser.init(), []
    while not optimiser.done(state):
        rng = np.random.Generator(np.random.Philox([seed, len(asked)]))
        asked.append(list(optimiser.ask(state, rng)))
        state = optimiser.tell(state, _told(asked[-1]))
    return asked, list(optimiser.finalists(state))


@every
def test_it_asks_for_sorted_sets_of_distinct_times_within_the_horizon(name: str) -> None:
    asked, found = _search(OPTIMISERS[name], 1)
    for times, end, draws, _, squared in (
        candidate for generation in asked for candidate in generation
    ):
        assert not squared  # a search estimates in one way
        assert all(a < b for a, b in itertools.pairwise(times))
        assert all(0 <= time <= (FEASIBLE.horizon if end is None else end) for time in times)
        assert draws is None or 2 <= draws <= DRAWS
    assert all(FEASIBLE.accepts(evaluation.measurement_times) for evaluation in found)


@pytest.mark.parametrize("name", FORESEEN)
def test_it_asks_as_often_and_for_as_many_as_it_says(name: str) -> None:
    optimiser = OPTIMISERS[name]
    asked, _ = _search(optimiser, 1)
    assert len(asked) == optimiser.generations
    assert sum(map(len, asked)) == optimiser.evaluations


@every
def test_the_same_keys_give_the_same_search(name: str) -> None:
    assert _search(OPTIMISERS[name], 1)[0] == _search(OPTIMISERS[name], 1)[0]


@pytest.mark.parametrize("name", AT_RANDOM)
def test_other_keys_give_another_search(name: str) -> None:
    assert _search(OPTIMISERS[name], 1)[0] != _search(OPTIMISERS[name], 2)[0]


@every
def test_it_returns_whole_sets_it_asked_for_with_what_it_was_told(name: str) -> None:
    asked, found = _search(OPTIMISERS[name], 1)
    whole = {
        candidate.measurement_times
        for generation in asked
        for candidate in generation
        if candidate.end is None
    }
    assert {evaluation.measurement_times for evaluation in found} <= whole
    assert 1 <= len(found) <= FINALISTS
    assert [evaluation.cost for evaluation in found] == sorted(
        evaluation.cost for evaluation in found
    )
    for evaluation in found:
        (told,) = _told([Candidate(evaluation.measurement_times, draws=evaluation.draws)])
        assert evaluation.cost == told.cost


@pytest.mark.parametrize("name", FINDS_THE_BEST)
def test_it_finds_the_best_set_of_an_easy_problem(name: str) -> None:
    _, found = _search(OPTIMISERS[name], 1)
    assert _cost(found[0].measurement_times) == 0.0


@every
def test_what_it_finds_is_of_the_best_twentieth_of_all_sets(name: str) -> None:
    _, found = _search(OPTIMISERS[name], 1)
    costs = [_cost(times) for times in FEASIBLE.every()]
    assert _cost(found[0].measurement_times) <= np.quantile(costs, 0.05)


def _content(value: Any) -> Any:
    """A state or evaluations as plain lists, so that two of them can be compared."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if dataclasses.is_dataclass(value):
        return [_content(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, dict):
        return [(key, _content(content)) for key, content in value.items()]
    if isinstance(value, list | tuple):
        return [_content(content) for content in value]
    return value


@every
def test_no_generation_changes_the_state_or_the_evaluations_it_is_given(name: str) -> None:
    optimiser, rng = OPTIMISERS[name], np.random.default_rng(1)
    state, generations = optimiser.init(), 0
    while not optimiser.done(state):
        state_before = _content(state)
        told = _told(list(optimiser.ask(state, rng)))
        told_before = _content(told)
        following = optimiser.tell(state, told)
        assert _content(state) == state_before
        assert _content(told) == told_before
        assert _content(following) != state_before
        state, generations = following, generations + 1
    assert generations
