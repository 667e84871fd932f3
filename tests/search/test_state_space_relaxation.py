"""The relaxation as a search: against brute force, and to its proof, where costs are exact."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from math import comb

import numpy as np
import pytest

from oracles.searched import exactly
from oracles.systems import SYSTEMS
from oracles.windows import with_each
from pfdist import StateSpaceModel
from pfdist.common.measurement_times import Times
from pfdist.filters.criterion import MEAN
from pfdist.filters.estimate import Evaluation
from pfdist.filters.kalman import expected_mse
from pfdist.problem.feasible import Feasible
from pfdist.search import Candidate, StateSpaceRelaxation
from pfdist.search.first_windows import relaxation_with
from pfdist.search.state_space_relaxation import RelaxationState

HORIZON, BUDGET, DRAWS = 12, 4, 320
PROVED = 1e-11  # relative: the search ends when no other set can be better by more
PRICES = (1, 3, 2) * 4 + (1,)
CONSTRAINED = {
    "free": Feasible(HORIZON, BUDGET),
    "forbidden": Feasible(HORIZON, BUDGET, forbidden=(0, 3, 4, 5, 9)),
    "required": Feasible(HORIZON, BUDGET, required=(6, 7)),
    "spaced": Feasible(HORIZON, BUDGET, minimum_spacing=3),
    "together": Feasible(HORIZON, BUDGET, forbidden=(1, 2), required=(10,), minimum_spacing=2),
    "money": Feasible(HORIZON, price=PRICES, total_price=8),
    "money together": Feasible(
        HORIZON, None, forbidden=(2,), required=(8,), minimum_spacing=2, price=PRICES, total_price=7
    ),
}
Tell = Callable[[list[Candidate]], Sequence[Evaluation]]
systems = pytest.mark.parametrize(
    "model",
    [
        pytest.param(SYSTEMS[name], id=name)
        for name in ("random walk", "constant velocity", "sharp now and then")
    ],
)


def _states(search: StateSpaceRelaxation, tell: Tell) -> Iterator[RelaxationState]:
    """The state after each generation. No set is evaluated twice."""
    state, rng = search.init(), np.random.default_rng(0)
    while not search.done(state):
        state = search.tell(state, tell(search.ask(state, rng)))
        sets = [evaluation.measurement_times for evaluation in state.whole]
        assert len(sets) == len({*sets})
        yield state


def _exactly(search: StateSpaceRelaxation, model: StateSpaceModel) -> RelaxationState:
    """The last state, where costs are those of the Kalman filter."""
    *_, state = _states(search, lambda asked: exactly(model, search.feasible.horizon, asked))
    return state


def _bound(state: RelaxationState, spent: int) -> float:
    return float(state.programmes([spent])[spent].mse[spent])


# --- the proof ---


@systems
def test_the_best_of_30_million_sets_is_proved(model: StateSpaceModel) -> None:
    feasible = Feasible(29, 10)
    assert feasible.size == comb(30, 10) == 30_045_015
    search = StateSpaceRelaxation(feasible, DRAWS)
    state = _exactly(search, model)
    (best, *_) = search.finalists(state)
    assert feasible.accepts(best.measurement_times)
    (cost,) = expected_mse(model, 29, [best.measurement_times])
    assert best.expected_mse == pytest.approx(cost, rel=1e-12)
    assert _bound(state, 10) == pytest.approx(cost, rel=PROVED)


@with_each(CONSTRAINED)
def test_it_proves_what_brute_force_finds(model: StateSpaceModel, name: str) -> None:
    feasible = CONSTRAINED[name]
    search = StateSpaceRelaxation(feasible, DRAWS)
    state = _exactly(search, model)
    optimum = expected_mse(model, HORIZON, list(feasible.every())).min()
    found = search.finalists(state)
    assert found[0].expected_mse == pytest.approx(optimum, rel=PROVED)
    assert _bound(state, feasible.total) == pytest.approx(optimum, rel=PROVED)
    assert all(feasible.accepts(evaluation.measurement_times) for evaluation in found)
    costs = expected_mse(model, HORIZON, [evaluation.measurement_times for evaluation in found])
    np.testing.assert_allclose([evaluation.expected_mse for evaluation in found], costs, rtol=1e-12)


@systems
@pytest.mark.parametrize("unit", [1, 4])
def test_with_money_it_evaluates_feasible_sets_alone(model: StateSpaceModel, unit: int) -> None:
    """Though a path may leave money over, or cost too much where prices are rounded down."""
    rng = np.random.default_rng(unit)
    for spacing in (1, 2):
        feasible = Feasible(
            HORIZON,
            minimum_spacing=spacing,
            price=tuple(rng.integers(1, 9, HORIZON + 1).tolist()),
            total_price=17,
        )
        start = replace(relaxation_with(feasible, 2, 6), unit=unit)
        search = StateSpaceRelaxation(feasible, DRAWS, start=start)
        state = _exactly(search, model)
        assert all(feasible.accepts(evaluation.measurement_times) for evaluation in state.whole)
        optimum = expected_mse(model, HORIZON, list(feasible.every())).min()
        assert _bound(state, start.total) <= optimum * (1 + 1e-12)
        if unit == 1:
            assert state.least(start.total) == pytest.approx(optimum, rel=PROVED)


@systems
def test_together_every_number_has_the_best_set_that_it_has_alone(model: StateSpaceModel) -> None:
    most = Feasible(HORIZON, 6)
    numbers = (2, 3, 5, 6)
    together = StateSpaceRelaxation(most, DRAWS, sought=numbers)
    state = _exactly(together, model)
    found = {len(each.measurement_times): each for each in together.finalists(state)}
    assert tuple(found) == numbers
    for number, evaluation in found.items():
        feasible = replace(most, measurement_budget=number)
        search = StateSpaceRelaxation(feasible, DRAWS)
        (alone, *_) = search.finalists(_exactly(search, model))
        optimum = expected_mse(model, HORIZON, list(feasible.every())).min()
        assert evaluation.expected_mse == pytest.approx(alone.expected_mse, rel=PROVED)
        assert evaluation.expected_mse == pytest.approx(optimum, rel=PROVED)
        assert _bound(state, number) == pytest.approx(optimum, rel=PROVED)


@systems
def test_bounds_rise_and_the_best_cost_falls_from_round_to_round(model: StateSpaceModel) -> None:
    feasible, least, bound = Feasible(20, 6), np.inf, 0.0
    search = StateSpaceRelaxation(feasible, DRAWS, paths=2)
    for state in _states(search, lambda asked: exactly(model, 20, asked)):
        if state.lacking:
            continue
        assert bound <= (bound := _bound(state, 6)) * (1 + 1e-12)
        assert least >= (least := state.least(6))
        assert bound <= least * (1 + 1e-12)


# --- limits ---


def test_it_ends_within_the_gap_that_is_asked_for() -> None:
    model, feasible = SYSTEMS["static"], Feasible(20, 7)
    rounds = []
    for gap in (0.3, 0.1, 0.02):
        state = _exactly(StateSpaceRelaxation(feasible, DRAWS, gap=gap), model)
        assert _bound(state, 7) >= state.least(7) * (1 - gap)
        rounds.append(state.round)
    assert rounds == sorted(rounds)
    assert rounds[0] < rounds[-1]


@pytest.mark.parametrize("limit", ["rounds", "windows"])
def test_a_limit_ends_it_with_a_bound_and_the_set_that_is_best_in_the_relaxation(
    limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    feasible = Feasible(29, 10)
    search = StateSpaceRelaxation(feasible, DRAWS)
    if limit == "windows":
        search = replace(search, most_grown=200)
    else:
        monkeypatch.setattr("pfdist.search.state_space_relaxation._ROUNDS_IF_EXACT", 4)
    state = _exactly(search, SYSTEMS["static"])
    assert _bound(state, 10) < state.least(10)  # nothing is proved
    if limit == "rounds":
        assert state.round == 4 + 1
    else:
        first = len(search.init().relaxation.windows)
        assert first > 200  # the windows of the first round do not count
        assert 0 < len(state.relaxation.windows) - first <= 200
    (best, *_) = search.finalists(state)
    assert feasible.accepts(best.measurement_times)
    evaluated = {evaluation.measurement_times for evaluation in state.whole}
    assert state.programmes([10])[10].path(10) in evaluated


def _unknown(tell: Tell, draws: int) -> Tell:
    """The same costs, but as if they came from draws: the search cannot know that it proves."""

    def told(asked: list[Candidate]) -> list[Evaluation]:
        return [
            replace(evaluation, mse=np.full(draws, evaluation.expected_mse), criterion=MEAN)
            for evaluation in tell(asked)
        ]

    return told


@systems
def test_with_draws_few_windows_are_left_to_the_programme_with_all_draws(
    model: StateSpaceModel,
) -> None:
    feasible = Feasible(24, 8)
    search = StateSpaceRelaxation(feasible, DRAWS, paths=6, rounds=8, screened=20)
    asked = list[list[Candidate]]()

    def tell(candidates: list[Candidate]) -> Sequence[Evaluation]:
        asked.append(candidates)
        return exactly(model, 24, candidates)

    *_, state = _states(search, _unknown(tell, DRAWS))
    draws = [{each.draws for each in some if each.counted is not None} for some in asked]
    assert draws[:3] == [{DRAWS // 16}, {DRAWS // 4}, {None}]
    assert {number for each in draws[3:] for number in each} <= {None}
    windows = [sum(len(each.counted.sets) for each in some if each.counted) for some in asked]
    assert windows[0] > 2 * max(windows[1:])
    whole = [sum(each.counted is None for each in some) for some in asked]
    assert whole[:3] == [1, 0, 0]  # regular times
    assert max(whole[3:]) <= search.paths
    assert len(asked) <= 3 + search.rounds + 1
    (best, *_) = search.finalists(state)
    proved = _exactly(StateSpaceRelaxation(feasible, DRAWS), model).least(8)
    assert best.expected_mse == pytest.approx(
        proved, rel=PROVED
    )  # though most windows are left out


@systems
def test_relaxed_costs_that_are_high_by_chance_do_not_keep_sets_from_being_evaluated(
    model: StateSpaceModel,
) -> None:
    """On the draws at hand, every window costs twice what it should."""
    feasible = Feasible(20, 6)
    search = StateSpaceRelaxation(feasible, DRAWS, paths=3)

    def tell(asked: list[Candidate]) -> list[Evaluation]:
        told = exactly(model, 20, asked)
        return [
            each if each.errors is None else replace(each, errors=2 * each.errors) for each in told
        ]

    *_, state = _states(search, _unknown(tell, DRAWS))
    assert 3 <= len(state.whole) - 1 <= 2 * search.paths
    assert state.least(6) < expected_mse(model, 20, [feasible.regular()])[0]


# --- degenerate draws ---


def _degenerate(tell: Tell, is_degenerate: Callable[[Times], bool]) -> Tell:
    """The same, but with a degenerate draw wherever a filter measures at such times."""

    def told(asked: list[Candidate]) -> list[Evaluation]:
        evaluations = list[Evaluation]()
        for candidate, evaluation in zip(asked, tell(asked), strict=True):
            found = evaluation
            if candidate.counted is not None:
                lost = np.array([is_degenerate(times) for times in candidate.counted.sets])
                errors = np.where(lost[candidate.counted.set_of], np.nan, evaluation.errors)
                found = replace(evaluation, errors=errors)
            elif is_degenerate(evaluation.measurement_times):
                found = replace(evaluation, criterion=MEAN.exactly(np.inf))
            evaluations.append(found)
        return evaluations

    return told


def test_where_every_draw_is_degenerate_it_ends_at_once_with_the_known_sets() -> None:
    feasible = Feasible(HORIZON, BUDGET)
    search = StateSpaceRelaxation(feasible, DRAWS)
    tell = _degenerate(lambda asked: exactly(SYSTEMS["stable"], HORIZON, asked), bool)
    (state,) = _states(search, tell)
    (found,) = search.finalists(state)
    assert found.measurement_times == feasible.regular()
    assert found.expected_mse == np.inf


@systems
def test_windows_with_a_degenerate_draw_are_forgotten_and_the_rest_is_searched(
    model: StateSpaceModel,
) -> None:
    """Filters that wait for more than 4 instants, once they have measured, lose the target."""

    def waits(times: Times) -> bool:
        return any(later - time > 4 for time, later in pairwise(times))

    feasible = Feasible(HORIZON, BUDGET)
    search = StateSpaceRelaxation(feasible, DRAWS)
    *_, state = _states(search, _degenerate(lambda a: exactly(model, HORIZON, a), waits))
    assert not any(waits(relaxed) for relaxed in state.relaxation.sets)
    (best, *_) = search.finalists(state)
    usable = [times for times in feasible.every() if not waits(times)]
    costs = expected_mse(model, HORIZON, usable)
    assert best.expected_mse <= expected_mse(model, HORIZON, [feasible.regular()])[0]
    assert costs.min() * (1 - PROVED) <= best.expected_mse <= np.quantile(costs, 0.1)
    assert _bound(state, BUDGET) <= costs.min() * (1 + PROVED)
