"""The programme over windows of every length, and over prices, by brute force."""

from dataclasses import replace

import numpy as np
import pytest

from oracles.in_turn import in_turn
from oracles.systems import SYSTEMS
from oracles.windows import (
    FEASIBLE,
    HORIZON,
    Case,
    affordable,
    cases,
    counted_errors,
    relaxed_errors,
    satisfying,
    with_each,
)
from pfdist import StateSpaceModel, linear_gaussian
from pfdist.common.measurement_times import Times
from pfdist.filters.kalman import expected_mse
from pfdist.problem.clock import Clock
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.search.first_windows import relaxation_with
from pfdist.search.programme import Programme
from pfdist.search.relaxation import NOTHING, START

ROUNDING = 1e-12
systems = pytest.mark.parametrize("model", SYSTEMS.values(), ids=list(SYSTEMS))


@cases
def test_the_programme_finds_the_least_error_of_every_sum_and_a_set_that_has_it(case: Case) -> None:
    relaxation, errors = case.make()
    most = relaxation.total + 1
    programme = Programme(relaxation, errors, most)
    for spent in range(most + 1):
        sets = affordable(relaxation, spent)
        costs = {times: relaxed_errors(relaxation, errors, times).mean() for times in sets}
        if not costs:
            assert programme.mse[spent] == np.inf
            assert programme.path(spent) == ()
            continue
        assert programme.mse[spent] == pytest.approx(min(costs.values()), rel=ROUNDING)
        assert Programme(relaxation, errors, spent).mse[spent] == programme.mse[spent]
        assert costs[programme.path(spent)] == pytest.approx(programme.mse[spent], rel=ROUNDING)
        for times, cost in list(costs.items())[:50]:
            assert programme.of_set(times) == pytest.approx(cost, rel=ROUNDING)


def test_with_sensors_the_error_of_the_best_set_is_the_least_error() -> None:
    points = Points(Clock.counting(5), ("near", "far"))
    constraints = Feasible(5, 3, points=points, minimum_spacing=0.0)
    relaxation = relaxation_with(constraints, 2, 2)
    errors = np.random.default_rng(1).exponential(size=int(relaxation.offsets[-1]))
    programme = Programme(relaxation, errors, 3)
    best = programme.path(3)
    assert any(measurement % 2 for measurement in best)
    assert programme.of_set(best) == pytest.approx(programme.mse[3], rel=ROUNDING)


@cases
def test_the_programme_finds_the_best_set_through_each_window(case: Case) -> None:
    relaxation, errors = case.make()
    programme = Programme(relaxation, errors, relaxation.total)
    for spent in {relaxation.total, max(1, relaxation.total - 2)}:
        costs = {
            times: relaxed_errors(relaxation, errors, times).mean()
            for times in affordable(relaxation, spent)
        }
        passing: dict[int, list[Times]] = {}
        for times in costs:
            for window in relaxation.windows_of(times):
                passing.setdefault(window, []).append(times)
        through = programme.through(spent)
        assert {*np.flatnonzero(np.isfinite(through)).tolist()} == passing.keys()
        for window, sets in passing.items():
            assert through[window] == pytest.approx(min(map(costs.__getitem__, sets)), rel=ROUNDING)
            path = programme.path_through(window, spent)
            assert path in sets
            assert costs[path] == pytest.approx(through[window], rel=ROUNDING)
        if costs:
            assert through[relaxation.index[START]] == pytest.approx(programme.mse[spent])


@cases
def test_a_restricted_relaxation_has_the_paths_through_the_windows_of_some_sets(case: Case) -> None:
    relaxation, _ = case.make()
    rng = np.random.default_rng(case.seed)
    paths = affordable(relaxation, relaxation.total) or satisfying(relaxation.constraints)
    chosen = [paths[int(number)] for number in rng.integers(len(paths), size=3)]
    restricted = relaxation.restricted(chosen)
    passed = {number for times in chosen for number in relaxation.windows_of(times)}
    assert set(np.flatnonzero(restricted.passable)) == passed
    errors = rng.exponential(size=int(restricted.offsets[-1]))
    costs = {
        times: relaxed_errors(restricted, errors, times).mean()
        for times in affordable(relaxation, relaxation.total)
        if passed.issuperset(relaxation.windows_of(times))
    }
    (found,) = Programme(restricted, errors, relaxation.total).mse[-1:]
    assert found == pytest.approx(min(costs.values(), default=np.inf), rel=ROUNDING)
    for times in chosen:  # the errors of these count up to the next measurement
        assert restricted.overreached(times) == []
        assert np.isfinite(relaxed_errors(restricted, errors, times)).all()
    grown = restricted.grown((NOTHING, *times) for times in chosen)
    for times in chosen:  # and no path is lost as windows grow
        assert min(grown.windows_of(times)) >= 0
        assert grown.passable[grown.windows_of(times)].all()


@with_each(FEASIBLE)
def test_windows_give_bounds_that_rise_with_their_length_to_the_optimum(
    model: StateSpaceModel, name: str
) -> None:
    """For every number of measurements, or for every sum of money, whether money is left or not."""
    feasible = FEASIBLE[name]
    start, sets = relaxation_with(feasible, 1, 2), satisfying(feasible)
    costs = dict(zip(sets, expected_mse(model, HORIZON, sets), strict=True))
    optima = np.array(
        [
            min((costs[times] for times in affordable(start, spent)), default=np.inf)
            for spent in range(feasible.total + 1)
        ]
    )
    assert optima[-1] == pytest.approx(expected_mse(model, HORIZON, list(feasible.every())).min())
    longest = max(map(len, feasible.every())) + 1
    for gap in (2, 3, 6, HORIZON + 1):
        before = np.zeros(feasible.total + 1)
        for window in range(1, longest + 1):
            relaxation = relaxation_with(feasible, window, gap)
            found = Programme(relaxation, counted_errors(model, relaxation), feasible.total)
            assert (before <= found.mse * (1 + ROUNDING)).all()
            assert (found.mse <= optima * (1 + ROUNDING)).all()
            before = found.mse
    np.testing.assert_allclose(found.mse, optima, rtol=ROUNDING)  # with no longest gap
    path = found.path(feasible.total)
    assert costs[path] == pytest.approx(optima[-1], rel=ROUNDING)
    assert feasible.spent(path) <= feasible.total


@systems
@in_turn("unit", [2, 3, 5])
def test_prices_rounded_down_to_coarser_units_leave_a_bound(
    model: StateSpaceModel, unit: int
) -> None:
    feasible = FEASIBLE["money"]
    fine = relaxation_with(feasible, 3, HORIZON + 1)
    coarse = replace(fine, unit=unit)
    errors = counted_errors(model, fine)
    bound, cheaper = (
        float(Programme(each, errors, each.total).mse[each.total]) for each in (fine, coarse)
    )
    assert cheaper <= bound * (1 + ROUNDING)
    for times in feasible.every():  # no set costs more than before
        rounded = sum(coarse.prices[t] for t in times)
        assert rounded <= feasible.spent(times) / unit
        assert rounded <= coarse.spent(times) == coarse.total


def test_where_errors_explode_without_a_measurement_small_ones_keep_their_digits() -> None:
    """An error of 1e17 in a window must not round those of another, nor those before it."""
    model = linear_gaussian(
        "explosive",
        initial_noise=[[1.0]],
        transition=[[2.0]],
        process_noise=[[1.0]],
        measurement=[[1.0]],
        measurement_noise=[[0.1]],
        quantity_of_interest=[[1.0]],
    )
    feasible = Feasible(29, 28)
    relaxation = relaxation_with(feasible, 3, 30)
    errors = counted_errors(model, relaxation)
    assert errors.max() > 1e17
    # Two instants are not measured: three measurements say which, in the middle of the horizon.
    found = Programme(relaxation, errors, 28)
    optimum = expected_mse(model, 29, list(feasible.every())).min()
    assert found.mse[28] <= optimum * (1 + ROUNDING)
    relaxed = relaxed_errors(relaxation, errors, found.path(28))
    assert found.mse[28] == pytest.approx(np.sum(relaxed) / 30, rel=ROUNDING)
