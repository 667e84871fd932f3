"""The contract of every optimiser."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pfdist.evaluation.estimate import Evaluation
from pfdist.search import Candidate
from pfdist.search.base import FINALISTS, Optimiser
from pfdist.search.methods import METHODS
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

FEASIBLE = Feasible(horizon=15, measurement_budget=4)
DRAWS = 20

# Every method that a job can name, with its default settings.
OPTIMISERS: dict[str, Optimiser] = {
    name: method.make(FEASIBLE, DRAWS, method.section().settings)
    for name, method in METHODS.items()
}
# How much they ask for does not depend on what they are told.
FORESEEN = ("exhaustive", "genetic", "greedy_backward", "greedy_forward", "random")
AT_RANDOM = ("annealing", "cross_entropy", "genetic", "random")
FINDS_THE_BEST = (
    "cross_entropy",
    "exchange",
    "exhaustive",
    "greedy_backward",
    "relaxation",
    "survivors",
)
BEST = (2, 4, 6, 8)

every = pytest.mark.parametrize("name", OPTIMISERS)


def _errors(times: Times) -> NDArray[np.float64]:
    """Errors of all instants, (T+1,): a measurement's distance to the nearest of the best times.

    The error depends on the last measurement alone, so every window has the error of a set.
    """
    errors = np.zeros(FEASIBLE.horizon + 1)
    for time in times:
        errors[time] = min(abs(time - best) for best in BEST)
    return errors


def _cost(times: Times) -> float:
    """Least for the best times."""
    return float(np.sum(_errors(times)))


def _told(asked: list[Candidate]) -> list[Evaluation]:
    """Evaluations under common noise: the same in all sets, at all instants."""
    return [_evaluation(candidate) for candidate in asked]


def _evaluation(candidate: Candidate) -> Evaluation:
    times, end = candidate.measurement_times, candidate.end
    counted = np.arange(FEASIBLE.horizon + 1) <= (FEASIBLE.horizon if end is None else end)
    noise = np.random.default_rng(0).exponential(size=DRAWS)[: candidate.draws]
    errors = np.where(counted, _errors(times) + noise[:, None], 0.0)
    if candidate.since is None:
        return Evaluation(times, np.mean(errors, axis=1), end=end)
    errors[:, : candidate.since] = 0.0
    asked_for = np.mean(errors, axis=0)
    cost = float(np.mean(asked_for))
    return Evaluation(times, np.empty(0), exact=cost, end=end, errors=asked_for)


def _search(optimiser: Optimiser, seed: int) -> tuple[list[list[Candidate]], list[Evaluation]]:
    state, asked = optimiser.init(), []
    while not optimiser.done(state):
        rng = np.random.Generator(np.random.Philox([seed, len(asked)]))
        asked.append(list(optimiser.ask(state, rng)))
        state = optimiser.tell(state, _told(asked[-1]))
    return asked, list(optimiser.finalists(state))


@every
def test_it_asks_for_sorted_sets_of_distinct_times_within_the_horizon(name: str) -> None:
    asked, found = _search(OPTIMISERS[name], 1)
    for times, end, draws, _, squared, since in itertools.chain(*asked):
        last = FEASIBLE.horizon if end is None else end
        assert not squared  # a search estimates in one way
        assert all(a < b for a, b in itertools.pairwise(times))
        assert all(0 <= time <= last for time in times)
        fewest = 2 if since is None else 1  # the mean of one draw is an expected error
        assert draws is None or fewest <= draws <= DRAWS
        assert since is None or 0 <= since <= last
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
        if candidate.end is None and candidate.since is None
    }
    assert {evaluation.measurement_times for evaluation in found} <= whole
    assert 1 <= len(found) <= FINALISTS
    assert [evaluation.cost for evaluation in found] == sorted(
        evaluation.cost for evaluation in found
    )
    for evaluation in found:
        told = _evaluation(Candidate(evaluation.measurement_times, draws=evaluation.draws))
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


def test_only_a_search_that_may_not_plan_online_asks_for_errors() -> None:
    """Online planning gives the cost of each draw, and no errors."""
    for name, optimiser in OPTIMISERS.items():
        asked, _ = _search(optimiser, 1)
        asks = any(candidate.since is not None for candidate in itertools.chain(*asked))
        assert asks != METHODS[name].online


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
