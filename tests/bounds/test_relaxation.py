"""The relaxation and its programme, on systems whose expected errors are known without draws."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from oracles.kalman import SCALAR, THREE, TRACKING
from pfdist import StateSpaceModel, linear_gaussian, load_model
from pfdist.bounds.programme import least
from pfdist.bounds.relaxation import START, Relaxation
from pfdist.errors import MeasurementTimesError
from pfdist.filters.kalman import expected_errors, expected_mse
from pfdist.times.constraints import Constraints
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

HORIZON, BUDGET = 9, 4
ROUNDING = 1e-12


def _scalar(name: str, factor: float, push: float, noise: float) -> StateSpaceModel:
    return linear_gaussian(
        name,
        initial_noise=[[2.0]],
        transition=[[factor]],
        process_noise=[[push]],
        measurement=[[1.0]],
        measurement_noise=[[noise]],
        quantity_of_interest=[[1.0]],
    )


SYSTEMS = {
    "stable": _scalar("stable", 0.7, 1.0, 0.5),
    "random walk": _scalar("walk", 1.0, 1.0, 1.0),
    "static": _scalar("static", 1.0, 0.0, 1.0),
    "unstable": _scalar("unstable", 1.05, 0.5, 0.3),
    "forgetful": SCALAR.as_model(),
    "tracking": TRACKING.as_model(),
    "three states": THREE.as_model(),
    "constant velocity": linear_gaussian(
        "constant velocity",
        initial_noise=[[1.0, 0.0], [0.0, 1.0]],
        transition=[[1.0, 1.0], [0.0, 1.0]],
        process_noise=[[0.1], [0.2]],
        measurement=[[1.0, 0.0]],
        measurement_noise=[[0.5]],
        quantity_of_interest=[[1.0, 0.0]],
    ),
    "sharp now and then": linear_gaussian(
        "sharp",
        initial_noise=[[3.0]],
        transition=[[1.0]],
        process_noise=[[0.5]],
        measurement=[[1.0]],
        measurement_noise=lambda t: ((0.05 if t % 3 == 0 else 1.5,),),
        quantity_of_interest=[[1.0]],
    ),
    "wanted late": linear_gaussian(
        "late",
        initial_noise=[[1.0]],
        transition=[[1.0]],
        process_noise=[[0.4]],
        measurement=[[1.0]],
        measurement_noise=[[0.4]],
        quantity_of_interest=lambda t: ((0.1 + t / 4,),),
    ),
    "oscillator": load_model("linear_gaussian"),
    "walk that ships": load_model("random_walk"),
}
CONSTRAINTS = {
    "free": {},
    "forbidden": {"forbidden": (2, 5, 6)},
    "required": {"required": (1, 8)},
    "spaced": {"minimum_spacing": 2},
    "all": {"forbidden": (3,), "required": (7,), "minimum_spacing": 2},
}
systems = pytest.mark.parametrize("model", SYSTEMS.values(), ids=list(SYSTEMS))


def _feasible(name: str) -> Feasible:
    return Feasible(HORIZON, BUDGET, **CONSTRAINTS[name])  # type: ignore[arg-type]


def _bound(
    model: StateSpaceModel, constraints: Constraints, window: int, gap: int, most: int = BUDGET
) -> tuple[list[float], list[Times]]:
    relaxation = Relaxation(constraints, window, gap)
    errors = expected_errors(model, constraints.horizon, relaxation.sets)
    found = least(relaxation, errors, most)
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


def _relaxed_errors(relaxation: Relaxation, errors: np.ndarray, times: Times) -> np.ndarray:
    """The relaxed error at each instant of a set: what the programme adds up for it."""
    places = [relaxation.index[state] for state in relaxation.states_of(times)]
    found: np.ndarray = errors[places, range(relaxation.horizon + 1)]
    return found


@systems
@pytest.mark.parametrize(("window", "gap"), [(1, 4), (2, 3), (3, 10)])
def test_the_relaxed_error_is_at_most_the_sets_own_at_every_instant(
    model: StateSpaceModel, window: int, gap: int
) -> None:
    feasible = _feasible("free")
    relaxation = Relaxation(feasible, window, gap)
    errors = expected_errors(model, HORIZON, relaxation.sets)
    sets = list(feasible.every())
    own = expected_errors(model, HORIZON, sets)
    relaxed = np.array([_relaxed_errors(relaxation, errors, times) for times in sets])
    assert (relaxed <= own * (1 + ROUNDING)).all()
    # The programme finds the least of these sums, and a set that has it.
    found = least(relaxation, errors, BUDGET)
    assert found.mse[BUDGET] == pytest.approx(relaxed.mean(axis=1).min(), rel=ROUNDING)
    path = sets.index(found.paths[BUDGET])
    assert relaxed[path].mean() == pytest.approx(found.mse[BUDGET], rel=ROUNDING)


def test_each_resample_of_the_draws_has_a_programme_of_its_own() -> None:
    relaxation = Relaxation(_feasible("required"), 2, 4)
    shape = (3, 2, len(relaxation.states), HORIZON + 1)
    errors = np.random.default_rng(1).exponential(size=shape)
    together = least(relaxation, errors, BUDGET).mse
    for place in np.ndindex(shape[:2]):
        np.testing.assert_array_equal(together[place], least(relaxation, errors[place], BUDGET).mse)


@pytest.mark.parametrize(
    ("times", "states"),
    [
        ((2,), [(-1, (2,))]),  # nothing is added as long as there are fewer than 3
        ((2, 4, 5), [(-1, (2,)), (-1, (2, 4)), (2, (4, 5))]),
        ((2, 4, 5, 6), [(-1, (2,)), (-1, (2, 4)), (2, (4, 5)), (4, (5, 6))]),
        ((2, 7, 8), [(-1, (2,)), (7, ()), (7, (8,))]),  # a gap longer than 3
    ],
)
def test_the_states_of_a_set(times: Times, states: Sequence[tuple[int, Times]]) -> None:
    relaxation, state, found = Relaxation(Constraints(9, 4), window=3, longest_gap=3), START, []
    for time in times:
        state = relaxation.after(state, time)
        found.append(tuple(state))
    assert found == states
    assert set(found) <= set(map(tuple, relaxation.states))


@pytest.mark.parametrize("name", ["window", "longest_gap"])
def test_a_relaxation_needs_a_window_and_a_gap(name: str) -> None:
    with pytest.raises(MeasurementTimesError, match=f"{name} must be at least 1, got 0"):
        Relaxation(Constraints(9, 4), **{name: 0})
