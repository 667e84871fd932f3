"""Limits of single sensors in the relaxation: by brute force, and exactly by the Kalman filter."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.windows import counted, counted_errors, longest_end, relaxed_errors
from pfdist import Sensor, StateSpaceModel
from pfdist.common.measurement_times import Lag, Times
from pfdist.constraints.spacing import Spacing
from pfdist.filters.kalman import expected_errors, expected_mse
from pfdist.problem.clock import Clock
from pfdist.problem.constraints import Constraints
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.problem.shared import Limit, OfSensors
from pfdist.runner.proof import Sums, prove
from pfdist.search.first_windows import relaxation_with
from pfdist.search.gaps import gaps_with
from pfdist.search.programme import Programme, highest, longer, near_optimal, with_multipliers
from pfdist.search.relaxation import NOTHING, Relaxation

ROUNDING = 1e-12
HORIZON = 5
SENSORS = ("near", "far", "both")
APART = Spacing.constant(4, HORIZON)
LIMITS = {
    "one": (Limit(), Limit(most=1), Limit()),
    "two": (Limit(), Limit(most=1), Limit(most=2)),
    "all": (Limit(most=2), Limit(most=1), Limit(most=1)),
    "spaced": (Limit(), Limit(spacing=APART), Limit(most=1, spacing=APART)),
}
PRICES = (1, 2, 3) * (HORIZON + 1)
Array = NDArray[np.float64]
limits = pytest.mark.parametrize(
    ("name", "money"), [("one", True), ("two", False), ("all", False), ("spaced", True)]
)


def _constraints(name: str, *, money: bool) -> Constraints:
    points = Points(Clock.counting(HORIZON), SENSORS)
    shared = (OfSensors.on(points, LIMITS[name]),)
    given = {"points": points, "minimum_spacing": 0.0, "shared": shared}
    if money:
        return Feasible(HORIZON, price=PRICES, total_price=6, smaller=True, **given)
    return Feasible(HORIZON, 4, **given)


def _within(name: str, times: Times) -> bool:
    """Whether times satisfy the limits of all sensors, one after another as they are written."""
    for sensor, limit in enumerate(LIMITS[name]):
        own = [time // 3 for time in times if time % 3 == sensor]
        if limit.most is not None and len(own) > limit.most:
            return False
        if limit.spacing is not None and any(b - a < 4 for a, b in pairwise(own)):
            return False
    return True


def _every(constraints: Constraints) -> list[Times]:
    """All sets of the sum, whatever the limits."""
    possible, most = range(constraints.possible), 4 if constraints.counted else 6
    sets = [times for n in range(most + 1) for times in combinations(possible, n)]
    if constraints.counted:
        return [times for times in sets if len(times) == 4]
    return [times for times in sets if sum(PRICES[time] for time in times) <= 6]


def _passes(name: str, relaxation: Relaxation, times: Times) -> bool:
    """Whether no measurement breaks a limit together with the window before it."""
    ends = [longest_end(relaxation.index, times[:number]) for number in range(len(times))]
    windows = [
        (*(t for t in end if t != NOTHING), time) for end, time in zip(ends, times, strict=True)
    ]
    return all(_within(name, window) for window in windows)


def _counts(times: Times) -> Array:
    return np.array([sum(time % 3 == sensor for time in times) for sensor in range(3)], float)


def _most(name: str) -> Array:
    return np.array([limit.most or 0 for limit in LIMITS[name]], float)


def _relaxation(constraints: Constraints, seed: int) -> Relaxation:
    """A relaxation with windows of two measurements, and a few longer ones."""
    short = relaxation_with(constraints, 2, 4)
    sets, rng = _every(constraints), np.random.default_rng(seed)
    chosen = [sets[number] for number in rng.integers(len(sets), size=20).tolist()]
    return short.grown([(NOTHING, *times)[-4:] for times in chosen])


@limits
def test_paths_are_all_sets_that_keep_the_limits_within_each_window(name: str, money: bool) -> None:
    relaxation = _relaxation(_constraints(name, money=money), 1)
    for window in relaxation.windows:
        assert _within(name, tuple(time for time in window if time != NOTHING))
    sets = _every(relaxation.constraints)
    some = np.random.default_rng(2).permutation(len(sets))[:2000].tolist()
    passing = 0
    for times in (sets[number] for number in some):
        number, passes = relaxation.index[(NOTHING,)], True
        for time in times:
            number = int(relaxation.after[number, time])
            passes &= number >= 0
            if not passes:
                break
        assert passes == _passes(name, relaxation, times)
        assert passes or not _within(name, times)  # no feasible set is lost
        passing += passes and not _within(name, times)
    assert passing  # other sets are only relaxed


@limits
def test_multipliers_give_the_least_error_with_them_and_a_lower_bound(
    name: str, money: bool
) -> None:
    """The least is below the error of each feasible set, but not if nothing is subtracted."""
    constraints, rng = _constraints(name, money=money), np.random.default_rng(3)
    relaxation = _relaxation(constraints, 3)
    errors = rng.exponential(size=int(relaxation.offsets[-1]))
    spent = constraints.total
    paths = [times for times in _every(constraints) if _passes(name, relaxation, times)]
    own = np.array([relaxed_errors(relaxation, errors, times).sum() for times in paths])
    counts = np.array([_counts(times) for times in paths])
    feasible = np.array([_within(name, times) for times in paths])
    limited, instants = np.array([limit.most is not None for limit in LIMITS[name]]), HORIZON + 1
    for scale in (0.1, 1.0, 10.0):
        multipliers = np.where(limited, rng.exponential(scale, size=3), 0.0)
        programme = Programme(relaxation, errors, spent, tuple(multipliers[limited].tolist()))
        lagrangian = own + counts @ multipliers - multipliers @ _most(name)
        found = programme.mse[spent]
        assert found == pytest.approx(lagrangian.min() / instants, rel=1e-9)
        assert programme.path(spent) == paths[int(lagrangian.argmin())]
        assert programme.through(spent).min() == pytest.approx(found, rel=1e-9)
        assert found <= own[feasible].min() / instants * (1 + ROUNDING)
    if name != "spaced":  # there, sensors without a multiplier are enough
        forgotten = (own + counts @ multipliers).min() / instants
        assert forgotten > own[feasible].min() / instants


@limits
def test_the_chosen_multipliers_are_the_best_of_a_grid(name: str, money: bool) -> None:
    constraints, rng = _constraints(name, money=money), np.random.default_rng(4)
    relaxation = _relaxation(constraints, 4)
    errors = rng.exponential(size=int(relaxation.offsets[-1]))
    spent = constraints.total
    paths = [times for times in _every(constraints) if _passes(name, relaxation, times)]
    own = np.array([relaxed_errors(relaxation, errors, times).sum() for times in paths])
    apart = np.array([_counts(times) for times in paths]) - _most(name)
    known = min(own[[_within(name, times) for times in paths]])
    found = with_multipliers(relaxation, errors, spent, known / (HORIZON + 1))
    grid = [
        np.where([limit.most is not None for limit in LIMITS[name]], each, 0.0)
        for each in known * rng.uniform(0, 1, (300, 3)) ** 2
    ]
    best = max((own + apart @ each).min() for each in (np.zeros(3), *grid))
    mse = found.mse[spent] * (HORIZON + 1)
    assert best * (1 - 2e-4) <= mse <= known * (1 + ROUNDING)
    assert all(each >= 0 for each in found.multipliers)


def test_the_highest_of_planes_is_where_they_meet() -> None:
    """The largest of min(a, b, 1 - a - b) is 1/3; on a + b = 1, min(a, 2 b) has it at a = 2/3."""
    planes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, -1.0, -1.0]])

    def lowest(at: Array) -> tuple[float, Array]:
        plane = planes[int(np.argmin(planes[:, 0] + planes[:, 1:] @ at))]
        return float(plane[0]), plane[1:]

    np.testing.assert_allclose(highest(lowest, np.zeros(2)), [1 / 3, 1 / 3], atol=1e-4)
    planes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    found = highest(lowest, np.array([0.5, 0.5]), total=1.0)
    np.testing.assert_allclose(found, [2 / 3, 1 / 3], atol=1e-4)


@limits
def test_a_proof_has_multipliers_for_each_budget_and_is_below_all_sets_on_its_draws(
    name: str, money: bool
) -> None:
    """Also if these draws choose the multipliers, and in each group that the jackknife leaves."""
    constraints, rng = _constraints(name, money=money), np.random.default_rng(5)
    relaxation = relaxation_with(constraints, 1, HORIZON + 1)
    # Windows that end with "far" have small errors, so sets without limits would have many.
    is_far = np.repeat(relaxation.last % 3 == 1, np.diff(relaxation.offsets))
    errors = np.where(is_far, 0.1, 1.0) * rng.exponential(size=(6, is_far.size))
    sets = [times for times in _every(constraints) if _within(name, times)]
    sets += [] if money else [times for times in combinations(range(18), 3) if _within(name, times)]
    known = [sets[number] for number in rng.integers(len(sets), size=3)]
    own = np.stack([relaxed_errors(relaxation, errors, times) for times in known], axis=1)
    proof = prove(relaxation, Sums(errors, own, np.ones(6)), known, constraints.total)
    mean, higher = errors.mean(axis=0), list[float]()
    for budget in {*proof.budgets}:
        of_budget = [times for times in sets if relaxation.spent(times) == budget]
        least = min(relaxed_errors(relaxation, mean, times).mean() for times in of_budget)
        without = Programme(relaxation, mean, budget).mse[budget]
        assert without * (1 - ROUNDING) <= proof.bounds[budget].value <= least * (1 + ROUNDING)
        best = with_multipliers(relaxation, mean, budget, least).mse[budget]
        assert proof.bounds[budget].value == pytest.approx(best, rel=2e-4)
        assert proof.bounds[budget].standard_error > 0
        higher.append(best / without)
    assert max(higher) > 1.005 or name == "spaced"
    for slack, budget, errors_of_set in zip(
        proof.slack, proof.budgets, own.mean((0, 2)), strict=True
    ):
        assert slack.value == pytest.approx(errors_of_set - proof.bounds[budget].value)


# Rows and deviations of three sensors, their prices and the total price in tenths; and in %, the
# gaps of the first windows without and with limits, and of the best set without limits.
DIRECT = ((1.0, 0.0), (0.0, 1.0), (1.0, 0.0)), (1.0, 0.3, 0.25)
SECOND = ((1.05, 1.78), (-2.55, -0.14), (1.01, 1.35)), (1.023, 2.009, 0.765)
FOURTH = ((-0.59, 0.63), (1.04, 1.03), (1.82, -0.39)), (0.937, 0.452, 0.194)
SYSTEMS = {
    "1": (*DIRECT, (25, 14, 16), 51, (54.5, 35.1, 53.8)),
    "2": (*SECOND, (23, 8, 26), 51, (60.0, 11.3, 42.4)),
    "3": (*DIRECT, (9, 11, 25), 32, (37.6, 37.6, 20.4)),
    "4": (*FOURTH, (21, 11, 20), 54, (51.2, 1.5, 50.0)),
}


def _sensor(row: tuple[float, float], sd: float) -> Sensor:
    a, b = row
    return Sensor(
        measurement=lambda x, t, v, p: (a * x[0] + b * x[1] + sd * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - a * x[0] - b * x[1]) / sd) ** 2,
        measurement_noise=("normal",),
    )


def _model(name: str) -> StateSpaceModel:
    rows, sds, *_ = SYSTEMS[name]
    return StateSpaceModel(
        name=name,
        initial=lambda w, p: (2.0 * w[0], 0.7 * w[1]),
        transition=lambda x, t, w, p: (x[0] + x[1] + 0.2 * w[0], 0.9 * x[1] + 0.5 * w[1]),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        sensors=dict(zip(SENSORS, map(_sensor, rows, sds), strict=True)),
        linear_gaussian=True,
    )


@pytest.mark.parametrize("lag", [HORIZON, (3, 2, 1, 1, 1, 0)], ids=["smoothed", "uneven"])
@limits
def test_gaps_between_sensors_are_at_most_the_errors_of_all_sets_within_the_limits(
    name: str, money: bool, lag: Lag
) -> None:
    """Several sensors may measure at an instant; a lag may differ from instant to instant."""
    constraints, model = _constraints(name, money=money), _model("2")
    sets = [times for times in _every(constraints) if _within(name, times)]
    own = expected_mse(model, HORIZON, sets, lag=lag)
    bounds = list[float]()
    for longest_gap in (1, HORIZON + 1):
        relaxation = gaps_with(constraints, longest_gap, lag)
        errors = counted(relaxation, expected_errors(model, HORIZON, relaxation.sets, lag=lag))
        spent = relaxation.total
        found = with_multipliers(relaxation, errors, spent, float(own.min()))
        relaxed = [found.of_set(times) for times in sets]
        assert (relaxed <= own * (1 + ROUNDING)).all()
        bounds.append(found.mse[spent])
    assert bounds[0] <= bounds[1] * (1 + 1e-4) <= own.min() * (1 + 2e-4)
    assert bounds[0] > 0


@pytest.mark.parametrize("name", ["1", *(pytest.param(k, marks=pytest.mark.slow) for k in "234")])
def test_exact_gaps_of_the_manual(name: str) -> None:
    """At most 1, 2 and 1 measurements; windows that grow leave no gap to the best set."""
    *_, prices, total, gaps = SYSTEMS[name]
    horizon, most, model = 8, (1, 2, 1), _model(name)
    points = Points(Clock.counting(horizon), SENSORS)
    free = Feasible(
        horizon, price=prices * (horizon + 1), total_price=total, points=points,
        minimum_spacing=0.0, smaller=True,
    )  # fmt: skip
    every = list(free.every())
    mse, counts = expected_mse(model, horizon, every), np.stack([*map(_counts, every)])
    optimum = mse[(counts <= most).all(axis=1)].min()
    limited = replace(free, shared=(OfSensors.on(points, [*map(Limit, most)]),))
    gaps_found = list[float]()
    for constraints in (free, limited):
        relaxation = relaxation_with(constraints, 2, horizon + 1)
        errors, spent = counted_errors(model, relaxation), relaxation.total
        found = with_multipliers(relaxation, errors, spent, float(optimum))
        gaps_found.append(100 * (1 - found.mse[spent] / optimum))
    gaps_found.append(100 * (1 - mse.min() / optimum))
    assert gaps_found == pytest.approx(gaps, abs=0.05)
    bounds = [float(found.mse[spent])]
    while True:
        best = near_optimal(found, spent, 8, float(optimum))
        grown = relaxation.grown(*longer(relaxation, best))
        if grown == relaxation:
            break
        relaxation = grown
        errors = counted_errors(model, relaxation)
        found = with_multipliers(relaxation, errors, spent, float(optimum))
        bounds.append(float(found.mse[spent]))
    assert max(bounds) <= optimum * (1 + ROUNDING)
    assert bounds[-1] == pytest.approx(optimum, rel=1e-5)
