"""The survivor programme and the corridor method against brute force, where costs are exact."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from oracles.kalman import SCALAR, THREE, TRACKING, prefix_costs, riccati_cost
from oracles.watched import WALK as TWO_SENSORS
from pfdist import Problem
from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import METHODS
from pfdist.search import Candidate, Survivors
from pfdist.search.corridor import Corridor
from pfdist.search.survivors import SurvivorState

SYSTEMS = {"scalar": SCALAR, "tracking": TRACKING, "three": THREE}
EARLY_IS_CHEAP, OFTEN_DEAR = (1,) * 6 + (2,) * 7, (1, 3, 2) * 4 + (1,)
PROBLEMS = {
    "10, 3": Feasible(10, 3),
    "12, 4": Feasible(12, 4),
    "14, 5": Feasible(14, 5),
    "forbidden": Feasible(12, 4, forbidden=(0, 3, 4, 5, 9)),
    "required": Feasible(12, 5, required=(6, 7, 12)),
    "spacing": Feasible(12, 4, minimum_spacing=3),
    "tight": Feasible(12, 5, minimum_spacing=3),
    "together": Feasible(14, 5, forbidden=(1, 2, 8), required=(10,), minimum_spacing=2),
    "one price": Feasible(12, price=(2,) * 13, total_price=9),
    "dearer": Feasible(12, price=EARLY_IS_CHEAP, total_price=7),
    "mixed": Feasible(12, price=OFTEN_DEAR, total_price=8),
    "all": Feasible(
        12, None, forbidden=(2,), required=(8,), minimum_spacing=2, price=OFTEN_DEAR, total_price=9
    ),
}
Cost = Callable[[Times, int], float]


def test_the_costs_are_those_of_the_kalman_filter() -> None:
    for system in SYSTEMS.values():
        cost = prefix_costs(system, 12)
        for times in ((), (0, 3, 12), (5, 6, 7)):
            assert cost(times, 12) == pytest.approx(riccati_cost(system, 12, times), rel=1e-12)


def _steps(search: Survivors, cost: Cost) -> Iterator[tuple[list[Candidate], SurvivorState]]:
    """The sets that a search asks for in each generation, and its state afterwards."""
    state, rng = search.init(), np.random.default_rng(0)
    while not state.done:
        asked, told = search.ask(state, rng), []
        for times, end, *_ in asked:
            exact = cost(times, search.feasible.horizon if end is None else end)
            told.append(Evaluation.exactly(times, exact, end=end))
        state = search.tell(state, told)
        yield asked, state


def _last(search: Survivors, cost: Cost) -> SurvivorState:
    *_, (_, state) = _steps(search, cost)
    return state


def _optimum(feasible: Feasible, cost: Cost) -> float:
    return min(cost(times, feasible.horizon) for times in feasible.every())


# --- the survivor programme -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("system", "problem"),
    [(list(SYSTEMS)[number % len(SYSTEMS)], problem) for number, problem in enumerate(PROBLEMS)],
)
@pytest.mark.parametrize(
    "settings", [{"survivors": 2}, {"survivors": 3, "by_previous": True}], ids=["last", "previous"]
)
def test_it_finds_what_brute_force_finds(
    problem: str, system: str, settings: dict[str, Any]
) -> None:
    feasible = PROBLEMS[problem]
    cost = prefix_costs(SYSTEMS[system], feasible.horizon)
    state = _last(Survivors(feasible, **settings), cost)
    assert all(feasible.accepts(evaluation.measurement_times) for evaluation in state.whole)
    assert state.whole[0].expected_mse == pytest.approx(_optimum(feasible, cost), rel=1e-12)


def test_more_survivors_are_never_worse_here_and_ask_more() -> None:
    cost, number, best = prefix_costs(THREE, 14), [], []
    for survivors in (1, 2, 4):
        steps = list(_steps(Survivors(Feasible(14, 5), survivors), cost))
        number.append(sum(len(asked) for asked, _ in steps))
        best.append(steps[-1][1].whole[0].expected_mse)
    assert number == sorted(set(number))
    assert best == sorted(best, reverse=True)
    assert best[0] > best[1]  # one survivor is not enough for this one


@pytest.mark.parametrize("problem", ["together", "dearer", "mixed", "all"])
def test_of_all_that_end_at_one_time_and_cost_the_same_two_are_extended(problem: str) -> None:
    search = Survivors(PROBLEMS[problem], survivors=2)
    extended: Counter[tuple[int, float, int, int]] = Counter()
    for _, state in _steps(search, prefix_costs(THREE, search.feasible.horizon)):
        limits = state.largest_gap, state.corridor  # when they are widened, it begins anew
        for times in state.front:
            extended[*limits, times[-1] if times else -1, search.feasible.spent(times)] += 1
    assert max(extended.values()) == 2


@pytest.mark.parametrize("smaller", [True, False])
def test_no_measurement_is_too_late_only_where_money_may_be_left_over(smaller: bool) -> None:
    """Twenty measurements fit into 41 instants, so the second should lie near t = 3."""
    search = Survivors(Feasible(40, price=(1,) * 41, total_price=20, smaller=smaller))
    steps = _steps(search, lambda times, end: float(len(times)))
    (_, state), (asked, _) = next(steps), next(steps)
    assert {times[-1] for times in state.front} == set(range(search.init().largest_gap))
    seconds = {times for times, *_ in asked}
    gaps = range(1, state.largest_gap + 1)
    within = {(*times, times[-1] + gap) for times in state.front for gap in gaps}
    latest = 40 if smaller else math.ceil(1.5 * 41 / 20 - 0.5 + state.corridor)
    assert seconds == {times for times in within if times[-1] <= latest}


def test_limits_that_are_in_the_way_are_widened() -> None:
    """Measurements are wanted late, far from their proportional places and far apart."""

    def cost(times: Times, end: int) -> float:
        return -sum(math.exp(t - 40) for t in times)

    search = Survivors(Feasible(40, 4))
    state = _last(search, cost)
    assert state.whole[0].measurement_times == (37, 38, 39, 40)
    assert state.largest_gap > search.init().largest_gap


@pytest.mark.parametrize("budget", [1, 6])
def test_one_time_and_all_times(budget: int) -> None:
    cost, feasible = prefix_costs(SCALAR, 5), Feasible(5, budget)
    assert _last(Survivors(feasible), cost).whole[0].expected_mse == _optimum(feasible, cost)


# --- the corridor method --------------------------------------------------------------------------


@pytest.mark.slow
def test_a_corridor_finds_the_optimum_from_regular_times_in_most_cases() -> None:
    excess = []
    for system in SYSTEMS.values():
        for feasible in PROBLEMS.values():
            cost = prefix_costs(system, feasible.horizon)
            found = _last(Corridor(feasible), cost).whole[0].expected_mse
            excess.append(found / _optimum(feasible, cost) - 1)
    assert min(excess) > -1e-12
    assert sum(each < 1e-12 for each in excess) >= 0.8 * len(excess)


@pytest.mark.parametrize("start", [None, (0, 1, 2, 3, 4), (10, 11, 12, 13, 14), (2, 5, 8, 11, 14)])
def test_it_starts_from_a_set_and_no_round_is_worse_under_common_noise(start: Times | None) -> None:
    feasible, cost = Feasible(14, 5), prefix_costs(THREE, 14)
    search = Corridor(feasible, start=start)
    middles = [search.init().middle]
    assert middles == [feasible.regular() if start is None else start]
    best = [cost(middles[0], 14)]
    for asked, state in _steps(search, cost):
        if asked[0].end is None:  # the end of a round
            assert Candidate(middles[-1]) in asked
            best.append(state.whole[0].expected_mse)
            middles.append(state.middle)
    assert best == sorted(best, reverse=True)
    assert best[-1] < best[0]
    assert len(best) - 1 <= search.rounds


def test_each_round_moves_each_time_by_the_reach_at_most() -> None:
    feasible, reach = Feasible(39, 5), 0.5  # a mean gap of 8: 4 instants
    search = Corridor(feasible, start=(0, 1, 2, 3, 4), reach=reach)
    middle, rounds = search.init().middle, 0
    for asked, state in _steps(search, prefix_costs(TRACKING, 39)):
        for candidate in asked:
            moves = np.abs(np.subtract(candidate.measurement_times, middle[: len(candidate[0])]))
            assert moves.max() <= 4
        rounds += state.middle != middle
        middle = state.middle
    assert rounds > 2  # times drift far in several rounds
    assert state.whole[0].measurement_times[-1] > 20


def test_one_round_and_the_best_set_as_a_start_end_at_once() -> None:
    feasible, cost = Feasible(12, 4), prefix_costs(THREE, 12)
    best = _last(Corridor(feasible), cost).whole[0].measurement_times
    for search in (
        Corridor(feasible, start=best),
        Corridor(feasible, start=(0, 1, 2, 3), rounds=1),
    ):
        steps = list(_steps(search, cost))
        assert len([asked for asked, _ in steps if asked[0].end is None]) == 1
        assert search.start != best or steps[-1][1].whole[0].measurement_times == best


def test_a_polish_by_the_corridor_starts_from_the_set_it_is_given() -> None:
    settings = METHODS["corridor"].section().settings
    made = METHODS["corridor"].make(Feasible(12, 4), 10, settings, (1, 2, 3, 4))
    assert made == Corridor(Feasible(12, 4), start=(1, 2, 3, 4))


def test_a_corridor_around_the_empty_set_has_all_times() -> None:
    """A store may pay for nothing at regular times."""
    sensors = {"cheap": {"price": 1, "delay": 2}, "sharp": {"price": 2, "delay": 1}}
    store = {"capacity": 3, "start": 2, "income": 0.25}
    problem = Problem(TWO_SENSORS, horizon=9, total_price=6, sensors=sensors, store=store)
    rest = problem.job().problem.feasible.rest((), 8)
    assert rest is not None
    assert rest.regular() == ()
    best = _last(Corridor(rest), lambda times, end: 1.0 - len(times)).whole[0]
    assert best.measurement_times == (3,)
