"""The corridor method against brute force, where costs are known exactly."""

from collections.abc import Iterator

import numpy as np
import pytest

from oracles.kalman import SCALAR, THREE, TRACKING, LinearGaussian, prefix_costs
from pfdist.evaluation.estimate import Evaluation
from pfdist.search import Candidate
from pfdist.search.corridor import Corridor
from pfdist.search.methods import METHODS
from pfdist.search.survivors import SurvivorState
from pfdist.times.feasible import Feasible

SYSTEMS = (SCALAR, TRACKING, THREE)
SIZES = ((10, 3), (12, 4), (14, 5))
PRICES = (1, 3, 2) * 4 + (1,)
CONSTRAINED = {
    "forbidden": Feasible(12, 4, forbidden=(0, 3, 4, 5, 9)),
    "required": Feasible(12, 5, required=(6, 7, 12)),
    "spacing": Feasible(12, 4, minimum_spacing=3),
    "tight": Feasible(12, 5, minimum_spacing=3),
    "costs": Feasible(12, cost=PRICES, total_cost=8),
    "all": Feasible(
        12, None, forbidden=(2,), required=(8,), minimum_spacing=2, cost=PRICES, total_cost=9
    ),
}


def _steps(
    search: Corridor, system: LinearGaussian
) -> Iterator[tuple[list[Candidate], SurvivorState]]:
    """Give what the search asks for in each generation, and its state afterwards."""
    cost, horizon = prefix_costs(system, search.feasible.horizon), search.feasible.horizon
    state, rng = search.init(), np.random.default_rng(0)
    while not state.done:
        asked = search.ask(state, rng)
        told = [
            Evaluation(
                candidate.measurement_times,
                np.empty(0),
                exact=cost(
                    candidate.measurement_times, horizon if candidate.end is None else candidate.end
                ),
                end=candidate.end,
            )
            for candidate in asked
        ]
        state = search.tell(state, told)
        yield asked, state


def _found(search: Corridor, system: LinearGaussian) -> Evaluation:
    *_, (_, state) = _steps(search, system)
    return search.finalists(state)[0]


def _optimum(feasible: Feasible, system: LinearGaussian) -> float:
    cost = prefix_costs(system, feasible.horizon)
    return min(cost(times, feasible.horizon) for times in feasible.every())


def test_it_finds_the_optimum_from_regular_times_in_most_cases() -> None:
    cases = [(system, Feasible(*size)) for system in SYSTEMS for size in SIZES]
    cases += [(system, feasible) for system in SYSTEMS for feasible in CONSTRAINED.values()]
    excess = [
        _found(Corridor(feasible), system).cost / _optimum(feasible, system) - 1
        for system, feasible in cases
    ]
    assert min(excess) > -1e-12
    assert sum(each < 1e-12 for each in excess) >= 0.8 * len(cases)


@pytest.mark.parametrize("system", SYSTEMS, ids=["scalar", "tracking", "three"])
@pytest.mark.parametrize("constraint", CONSTRAINED)
def test_it_keeps_to_the_constraints(constraint: str, system: LinearGaussian) -> None:
    feasible = CONSTRAINED[constraint]
    for asked, state in _steps(Corridor(feasible), system):
        whole = [each.measurement_times for each in asked if each.end is None]
        assert all(map(feasible.accepts, whole))
        assert all(feasible.accepts(each.measurement_times) for each in state.whole)


@pytest.mark.parametrize("start", [None, (0, 1, 2, 3, 4), (10, 11, 12, 13, 14), (2, 5, 8, 11, 14)])
def test_it_starts_from_a_set_and_no_round_is_worse_under_common_noise(
    start: tuple[int, ...] | None,
) -> None:
    feasible = Feasible(14, 5)
    search = Corridor(feasible, start=start)
    cost = prefix_costs(THREE, 14)
    assert search.init().middle == (feasible.regular() if start is None else start)
    best = [cost(search.init().middle, 14)]
    middles = [search.init().middle]
    for asked, state in _steps(search, THREE):
        if asked[0].end is None:  # the end of a round
            assert Candidate(middles[-1]) in asked
            best.append(state.whole[0].cost)
            middles.append(state.middle)
    assert best == sorted(best, reverse=True)
    assert best[-1] < best[0]
    assert len(best) - 1 <= search.rounds


def test_each_round_moves_each_time_by_the_reach_at_most() -> None:
    feasible, reach = Feasible(39, 5), 0.5  # a mean gap of 8: 4 instants
    search = Corridor(feasible, start=(0, 1, 2, 3, 4), reach=reach)
    middle, rounds = search.init().middle, 0
    for asked, state in _steps(search, TRACKING):
        for candidate in asked:
            moves = np.abs(np.subtract(candidate.measurement_times, middle[: len(candidate[0])]))
            assert moves.max() <= 4
        rounds += state.middle != middle
        middle = state.middle
    assert rounds > 2  # times drift far in several rounds
    assert state.whole[0].measurement_times[-1] > 20


def test_one_round_and_the_best_set_as_a_start_end_at_once() -> None:
    feasible = Feasible(12, 4)
    best = _found(Corridor(feasible), THREE)
    again = Corridor(feasible, start=best.measurement_times)
    assert _found(again, THREE).measurement_times == best.measurement_times
    whole = [asked for asked, _ in _steps(again, THREE) if asked[0].end is None]
    assert len(whole) == 1
    once = Corridor(feasible, start=(0, 1, 2, 3), rounds=1)
    assert len([asked for asked, _ in _steps(once, THREE) if asked[0].end is None]) == 1


def test_a_job_names_its_settings_and_no_start() -> None:
    section = METHODS["corridor"].section()
    assert section.settings == {"survivors": 1, "by_previous": False, "reach": 1.5, "rounds": 20}
    made = METHODS["corridor"].make(Feasible(12, 4), 10, section.settings)
    assert made == Corridor(Feasible(12, 4))
    started = METHODS["corridor"].make(Feasible(12, 4), 10, section.settings, (1, 2, 3, 4))
    assert started == Corridor(Feasible(12, 4), start=(1, 2, 3, 4))
