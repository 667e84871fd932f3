"""The contract of every search method: what it asks for, what it finds, and from which keys."""

import dataclasses
import itertools
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.in_turn import in_turn
from oracles.kalman import TRACKING, believed_errors
from pfdist.common.measurement_times import Times
from pfdist.filters import kalman
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import METHODS
from pfdist.search import Candidate
from pfdist.search.base import FINALISTS, Optimiser
from pfdist.search.linearized import LinearizedDesign

HORIZON, DRAWS = 12, 20
PRICES = (1, 3, 2) * 4 + (1,)
NOISY = "noisy"
PROBLEMS = {
    NOISY: Feasible(11, 4),  # the evaluations of all others are exact
    "forbidden": Feasible(HORIZON, 4, forbidden=(0, 3, 4, 5, 9)),
    "required": Feasible(HORIZON, 4, required=(6, 7)),
    "spacing": Feasible(HORIZON, 4, minimum_spacing=3),
    "price": Feasible(HORIZON, price=PRICES, total_price=8),
    "together": Feasible(
        HORIZON, None, forbidden=(2,), required=(8,), minimum_spacing=2, price=PRICES, total_price=7
    ),
    "one measurement": Feasible(HORIZON, 1),
    # The next three allow one set alone:
    "all times": Feasible(HORIZON, HORIZON + 1),
    "all required": Feasible(HORIZON, 3, required=(2, 5, 9)),
    "all paid for": Feasible(HORIZON, price=PRICES, total_price=100),
    # The filter of the next three trusts its sensor too much:
    "smaller": Feasible(HORIZON, price=PRICES, total_price=8, smaller=True),
    "smaller with required": Feasible(
        HORIZON, required=(8,), minimum_spacing=2, price=PRICES, total_price=8, smaller=True
    ),
    "best without": Feasible(HORIZON, price=PRICES, total_price=8, smaller=True),
}
SMALL = {
    "evaluations": 60, "population": 20, "generations": 12, "mutation_probability": 0.1,
    "steps": 40,
}  # fmt: skip
# How much they ask for does not depend on what they are told.
FORESEEN = ("exhaustive", "genetic", "random")
AT_RANDOM = ("genetic", "random")
EXACT = ("exhaustive", "relaxation", "survivors")  # where evaluations are exact
BEST_UNDER_NOISE = (*EXACT, "exchange")
BEST = (2, 4, 6, 8)
NOISE = np.random.default_rng(0).exponential(size=(DRAWS, 1))

MODEL = TRACKING.as_model()
BELIEVED = replace(TRACKING, d=np.array([[0.1]]))
TRUTHS = {
    "smaller": replace(TRACKING, d=np.array([[2.0]])),
    "smaller with required": replace(TRACKING, d=np.array([[2.0]])),
    "best without": replace(TRACKING, d=np.array([[5.0]])),
}

every = pytest.mark.parametrize("method", METHODS)


def both(test: Callable[..., None]) -> Callable[..., None]:
    """A decorator: call a test with each method and each problem."""
    return every(in_turn("problem", PROBLEMS)(test))


def _optimiser(method: str, problem: str) -> Optimiser:
    settings = METHODS[method].section().settings
    small = {key: settings[key] if problem == NOISY else SMALL.get(key, settings[key])
             for key in settings}  # fmt: skip

    def errors(sets: Any) -> Any:  # linearized ones of a linear system are exact
        return np.array([_costs(problem)[times] for times in sets])

    made: Optimiser = METHODS[method].make(PROBLEMS[problem], DRAWS, small)
    return replace(made, errors=errors) if isinstance(made, LinearizedDesign) else made


@cache
def _errors(times: Times, problem: str) -> NDArray[np.float64]:
    """Expected errors of all instants, (T+1,).

    Under noise, each measurement has its distance to the nearest of the best times. This error
    depends on the last measurement alone, so every window has the error of a set.
    """
    if problem in TRUTHS:
        return believed_errors(TRUTHS[problem], BELIEVED, HORIZON, times)
    if problem != NOISY:
        if (known := _feasible_errors(problem).get(times)) is not None:
            return known
        errors: NDArray[np.float64] = kalman.expected_errors(MODEL, HORIZON, [times])[0]
        return errors
    distances = np.zeros(PROBLEMS[problem].horizon + 1)
    distances[list(times)] = [min(abs(time - best) for best in BEST) for time in times]
    return distances


@cache
def _feasible_errors(problem: str) -> dict[Times, NDArray[np.float64]]:
    """The errors of all feasible sets, at once."""
    every = list(PROBLEMS[problem].every())
    return dict(zip(every, kalman.expected_errors(MODEL, HORIZON, every), strict=True))


def _evaluation(candidate: Candidate, problem: str) -> Evaluation:
    """An evaluation, exact or under common noise: the same in all sets, at all instants."""
    times, end, counted = candidate.measurement_times, candidate.end, candidate.counted
    noise = NOISE[: candidate.draws] if problem == NOISY else np.zeros((1, 1))
    if counted is not None:
        each = np.array([(_errors(own, problem) + noise).mean(axis=0) for own in counted.sets])
        return Evaluation.exactly(times, np.nan, end=end, errors=counted.of_instants(each))
    instants = np.arange(PROBLEMS[problem].horizon + 1)
    counts = instants <= (instants[-1] if end is None else end)
    errors = np.where(counts, _errors(times, problem) + noise, 0.0)
    if problem == NOISY:
        return Evaluation(times, errors.mean(axis=1), end=end)
    return Evaluation.exactly(times, float(errors.mean()), end=end)


def _search(
    method: str, problem: str, seed: int = 1
) -> tuple[list[list[Candidate]], list[Evaluation]]:
    """The sets that a search asks for in each generation, and the set that it finds."""
    optimiser = _optimiser(method, problem)
    state, asked = optimiser.init(), []
    while not optimiser.done(state):
        rng = np.random.Generator(np.random.Philox([seed, len(asked)]))
        asked.append(list(optimiser.ask(state, rng)))
        state = optimiser.tell(state, [_evaluation(each, problem) for each in asked[-1]])
    return asked, list(optimiser.finalists(state))


_searched = cache(_search)


def _asked(method: str, problem: str) -> list[Candidate]:
    return list(itertools.chain(*_searched(method, problem)[0]))


def _whole(method: str, problem: str) -> set[Times]:
    asked = _asked(method, problem)
    return {each.measurement_times for each in asked if each.end is None and each.counted is None}


@cache
def _costs(problem: str) -> dict[Times, float]:
    """Expected costs of all feasible sets."""
    return {times: float(_errors(times, problem).mean()) for times in PROBLEMS[problem].every()}


# --- what it asks for -----------------------------------------------------------------------------


@both
def test_it_asks_for_sorted_sets_of_distinct_times_within_the_horizon(
    method: str, problem: str
) -> None:
    optimiser = _optimiser(method, problem)
    assert min(optimiser.generations, optimiser.evaluations) > 0  # known before it begins
    for times, end, draws, _, counted in _asked(method, problem):
        last = PROBLEMS[problem].horizon if end is None else end
        assert all(a < b for a, b in itertools.pairwise(times))
        assert all(0 <= time <= last for time in times)
        fewest = 2 if counted is None else 1  # the mean of one draw is an expected error
        assert draws is None or fewest <= draws <= DRAWS
        for first, until in zip(counted.first, counted.ends, strict=True) if counted else ():
            assert 0 <= first <= until <= last


@both
def test_whole_sets_that_it_asks_for_are_feasible(method: str, problem: str) -> None:
    feasible = _costs(problem)
    for times in _whole(method, problem):
        assert times in feasible


@both
def test_a_feasible_set_begins_with_what_it_asks_for_up_to_an_end(
    method: str, problem: str
) -> None:
    begun = {
        each.measurement_times
        for each in _asked(method, problem)
        if each.end is not None and each.counted is None
    }
    assert begun <= {whole[: k + 1] for whole in _costs(problem) for k in range(len(whole))}


@both
def test_where_errors_are_asked_for_some_feasible_set_has_the_last_of_the_measurements(
    method: str, problem: str
) -> None:
    """Windows end as a beginning of a feasible set does; before them all allowed times may be.

    Online planning gives the cost of each draw, and no errors.
    """
    feasible = PROBLEMS[problem]
    windows = [each.counted for each in _asked(method, problem) if each.counted is not None]
    assert bool(windows) != (METHODS[method].online or method == "linearized")
    for counted in windows:
        for times, first in zip(counted.sets, counted.first.tolist(), strict=True):
            assert set(feasible.required) & set(range(max(times, default=0))) <= set(times)
            assert not set(times) & set(feasible.forbidden)
            assert first == max(times, default=0)


@pytest.mark.parametrize("method", FORESEEN)
def test_it_asks_as_often_and_for_as_many_as_it_says(method: str) -> None:
    optimiser, (asked, _) = _optimiser(method, NOISY), _searched(method, NOISY)
    assert len(asked) == optimiser.generations
    assert sum(map(len, asked)) == optimiser.evaluations


@every
def test_its_settings_travel_to_a_worker(method: str) -> None:
    section = METHODS[method].section(method=method)
    travelled = pickle.loads(pickle.dumps(section))
    assert type(travelled) is type(section)
    assert travelled == section


@every
def test_the_keys_decide_what_a_search_asks_for(method: str) -> None:
    first = _content(_searched(method, NOISY)[0])
    assert _content(_search(method, NOISY)[0]) == first
    assert (_content(_search(method, NOISY, seed=2)[0]) != first) == (method in AT_RANDOM)


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
def test_no_generation_changes_the_state_or_the_evaluations_it_is_given(method: str) -> None:
    optimiser, rng = _optimiser(method, NOISY), np.random.default_rng(1)
    state, generations = optimiser.init(), 0
    while not optimiser.done(state):
        state_before = _content(state)
        told = [_evaluation(each, NOISY) for each in optimiser.ask(state, rng)]
        told_before = _content(told)
        following = optimiser.tell(state, told)
        assert _content(state) == state_before
        assert _content(told) == told_before
        assert _content(following) != state_before
        state, generations = following, generations + 1
    assert generations


# --- what it finds --------------------------------------------------------------------------------


@both
def test_it_returns_whole_sets_it_asked_for_with_what_it_was_told(
    method: str, problem: str
) -> None:
    found = _searched(method, problem)[1]
    assert {each.measurement_times for each in found} <= _whole(method, problem)
    assert 1 <= len(found) <= FINALISTS
    costs = [each.expected_mse for each in found]
    assert costs == sorted(costs)
    told = [Candidate(each.measurement_times, draws=each.draws) for each in found]
    assert costs == [_evaluation(each, problem).expected_mse for each in told]


@both
def test_what_it_finds_is_feasible_and_good(method: str, problem: str) -> None:
    costs = _costs(problem)
    found = [each.measurement_times for each in _searched(method, problem)[1]]
    assert {*found} <= costs.keys()
    share, exact = (0.05, BEST_UNDER_NOISE) if problem == NOISY else (0.1, EXACT)
    assert costs[found[0]] <= np.quantile(list(costs.values()), share)
    if method in exact and (problem not in TRUTHS or method != "relaxation"):
        # The programme of the relaxation is exact for a filter that knows the truth.
        assert costs[found[0]] == pytest.approx(min(costs.values()), rel=1e-12)


@pytest.mark.parametrize("problem", TRUTHS)
@every
def test_where_the_filter_is_wrong_a_search_may_leave_money_over(method: str, problem: str) -> None:
    """The best set that leaves no money for another measurement costs more than what is found."""
    maximal = replace(PROBLEMS[problem], smaller=False).every()
    least = min(_costs(problem)[times] for times in maximal)
    assert _searched(method, problem)[1][0].expected_mse < least
