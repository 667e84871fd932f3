"""The relaxation and its programme, on systems whose expected errors are known without draws."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from oracles.systems import SYSTEMS
from oracles.windows import counted_errors, relaxed_errors
from pfdist import StateSpaceModel
from pfdist.bounds.first_windows import relaxation_for, relaxation_with
from pfdist.bounds.programme import least
from pfdist.bounds.relaxation import Window
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.filters.kalman import expected_errors, expected_mse
from pfdist.times.constraints import Constraints
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

HORIZON, BUDGET = 9, 4
ROUNDING = 1e-12


CONSTRAINTS = {
    "free": {},
    "forbidden": {"forbidden": (2, 5, 6)},
    "required": {"required": (1, 8)},
    "spaced": {"minimum_spacing": 2},
    "all": {"forbidden": (3,), "required": (7,), "minimum_spacing": 2},
}
systems = pytest.mark.parametrize("model", SYSTEMS.values(), ids=list(SYSTEMS))
systems = pytest.mark.parametrize("model", SYSTEMS.values(), ids=list(SYSTEMS))


def _feasible(name: str) -> Feasible:
    return Feasible(HORIZON, BUDGET, **CONSTRAINTS[name])  # type: ignore[arg-type]


def _bound(
    model: StateSpaceModel, constraints: Constraints, window: int, gap: int, most: int = BUDGET
) -> tuple[list[float], list[Times]]:
    relaxation = relaxation_with(constraints, window, gap)
    found = least(relaxation, counted_errors(model, relaxation), most)
    return found.mse.tolist(), found.paths


@systems
@pytest.mark.parametrize("name", CONSTRAINTS)
def test_no_feasible_set_costs_less(model: StateSpaceModel, name: str) -> None:
    """Brute force finds the optimum; so does k = N + 1, and the bound never falls with k."""
    feasible = _feasible(name)
    optimum = expected_mse(model, HORIZON, list(feasible.every())).min()
    for gap in (3, 6, HORIZON + 1):
        bounds = [
            _bound(model, feasible, window, gap)[0][BUDGET] for window in range(1, BUDGET + 2)
        ]
        assert bounds[-1] <= optimum * (1 + ROUNDING)
        assert all(lower <= higher * (1 + ROUNDING) for lower, higher in pairwise(bounds))
    assert bounds[-1] == pytest.approx(optimum, rel=ROUNDING)  # with no longest gap


@systems
def test_one_programme_gives_every_number_of_measurements(model: StateSpaceModel) -> None:
    mse, paths = _bound(model, Constraints(HORIZON, 1), 2, 5, most=HORIZON + 1)
    for number, path in enumerate(paths):
        assert len(path) == number
        alone, _ = _bound(model, Constraints(HORIZON, 1), 2, 5, most=max(1, number))
        assert alone[number] == mse[number]
    assert mse[0] == pytest.approx(expected_mse(model, HORIZON, [()])[0], rel=ROUNDING)
    assert mse[-1] == pytest.approx(expected_mse(model, HORIZON, [paths[-1]])[0], rel=ROUNDING)


@systems
@pytest.mark.parametrize(("window", "gap"), [(1, 4), (2, 3), (3, 10)])
def test_the_relaxed_error_is_at_most_the_sets_own_at_every_instant(
    model: StateSpaceModel, window: int, gap: int
) -> None:
    feasible = _feasible("free")
    relaxation = relaxation_with(feasible, window, gap)
    errors = counted_errors(model, relaxation)
    sets = list(feasible.every())
    own = expected_errors(model, HORIZON, sets)
    relaxed = np.array([relaxed_errors(relaxation, errors, times) for times in sets])
    assert (relaxed <= own * (1 + ROUNDING)).all()
    # The programme finds the least of these sums, and a set that has it.
    found = least(relaxation, errors, BUDGET)
    assert found.mse[BUDGET] == pytest.approx(relaxed.mean(axis=1).min(), rel=ROUNDING)
    path = sets.index(found.paths[BUDGET])
    assert relaxed[path].mean() == pytest.approx(found.mse[BUDGET], rel=ROUNDING)


def test_each_resample_of_the_draws_has_a_programme_of_its_own() -> None:
    relaxation = relaxation_with(_feasible("required"), 2, 4)
    shape = (3, 2, int(relaxation.offsets[-1]))
    errors = np.random.default_rng(1).exponential(size=shape)
    together = least(relaxation, errors, BUDGET).mse
    for place in np.ndindex(shape[:2]):
        np.testing.assert_array_equal(together[place], least(relaxation, errors[place], BUDGET).mse)


@pytest.mark.parametrize(
    ("times", "windows"),
    [
        ((2,), [(-1,), (-1, 2)]),  # nothing is added as long as there are fewer than 3
        ((2, 4, 5), [(-1,), (-1, 2), (-1, 2, 4), (2, 4, 5)]),
        ((2, 4, 5, 6), [(-1,), (-1, 2), (-1, 2, 4), (2, 4, 5), (4, 5, 6)]),
        ((2, 7, 8), [(-1,), (-1, 2), (7,), (7, 8)]),  # a gap longer than 3
    ],
)
def test_the_windows_of_a_set(times: Times, windows: Sequence[Window]) -> None:
    relaxation = relaxation_with(Constraints(9, 4), window=3, longest_gap=3)
    assert [relaxation.windows[number] for number in relaxation.windows_of(times)] == windows


@pytest.mark.parametrize("name", ["window", "longest_gap"])
def test_a_relaxation_needs_a_window_and_a_gap(name: str) -> None:
    with pytest.raises(MeasurementTimesError, match=f"{name} must be at least 1, got 0"):
        relaxation_with(Constraints(9, 4), **{"window": 2, "longest_gap": 3, name: 0})


@pytest.mark.parametrize(("horizon", "number"), [(20, 4), (60, 21), (200, 30)])
@pytest.mark.parametrize("window", [1, 2, 3])
def test_a_relaxation_has_no_more_errors_than_it_may(
    horizon: int, number: int, window: int
) -> None:
    constraints = Constraints(horizon, number)
    instants = horizon + 1
    mean_gap = instants / (number + 1)
    for most in (10**5, 10**6, 10**7):
        try:
            relaxation = relaxation_for(constraints, window, number, most)
        except JobError:
            assert instants * (2 * mean_gap) ** window + instants**2 > most
        else:
            assert relaxation.offsets[-1] <= most
            assert 2 * mean_gap <= relaxation.longest_gap <= 3 * mean_gap + 1
