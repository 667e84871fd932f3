"""Plans for the measurements that are left, made from what a filter knows of one system."""

from dataclasses import replace

import numpy as np
import pytest

import oracles.kalman
import oracles.modes
from oracles.systems import SYSTEMS
from pfdist import Problem, StateSpaceModel
from pfdist.filters import particle_filter
from pfdist.filters.cloud import Cloud
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse
from pfdist.filters.one_filter import Followed, OneFilter
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.plugins.online.needs import ON_THE_WAY
from pfdist.plugins.online.planning import Now, Planning, Replanner, _Outlook
from pfdist.plugins.online.section import PLANNING
from pfdist.plugins.online.work import OnlineWork
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import METHODS

QUICK = Planning(PLANNING, 32, 64, Estimation(32, "systematic", "filter_variance"))
SEARCHED = replace(QUICK, search=METHODS["exhaustive"].section())
EXACT = {
    "scalar": oracles.kalman.SCALAR,
    "tracking": oracles.kalman.TRACKING,
    "three": oracles.kalman.THREE,
}


@pytest.mark.parametrize("name", EXACT)
def test_where_measurements_say_nothing_about_times_the_plan_never_changes(name: str) -> None:
    """Covariances of a linear-Gaussian model do not depend on what is measured."""
    model, feasible = EXACT[name].as_model(), Feasible(12, 4)
    evaluator = Evaluator(model, 12, engine="kalman")
    costs = exact_mse(evaluator, every := list(feasible.every()))
    best = every[int(np.argmin(costs))]
    replanner = Replanner(evaluator, feasible, SEARCHED, 5)
    draws = simulate(model, 12, range(3), 7)
    for d in range(3):
        filtering, taken, plan = OneFilter(model, Estimation(1), 3, d, "kalman"), (), best
        while plan:
            filtering, *_ = filtering.at(plan[0], draws.y[d, plan[0]])
            taken = (*taken, plan[0])
            plan = replanner.plan(Now(filtering.settings.prior, measured=True), taken, plan[1:], d)
        assert taken == best


def test_without_a_plan_at_hand_the_exact_search_finds_the_best(  # ties: the first in order
) -> None:
    model, feasible = EXACT["scalar"].as_model(), Feasible(12, 4)
    evaluator = Evaluator(model, 12, engine="kalman")
    found = Replanner(evaluator, feasible, SEARCHED, 5).plan(Now(), (), ())
    costs = exact_mse(evaluator, every := list(feasible.every()))
    assert costs[every.index(found)] == pytest.approx(costs.min(), rel=1e-12)


def test_a_plan_depends_on_its_key_alone(ungm: StateSpaceModel) -> None:
    cloud = Cloud(6, np.random.default_rng(1).normal(0, 8, (1, 200)))
    replanner = Replanner(Evaluator(ungm, 20), Feasible(20, 7), QUICK, 5)
    plans = {
        replanner.plan(Now(cloud, measured=True), (0, 3, 6), (9, 12, 15, 18), draw)
        for draw in (0, 1, 2, 3, 0, 1, 2, 3)
    }
    assert 1 < len(plans) <= 4  # systems of other numbers have other noise
    assert all(len(plan) == 4 and plan[0] > 6 for plan in plans)


def test_an_infeasible_plan_at_hand_is_replaced(ungm: StateSpaceModel) -> None:
    cloud = Cloud(6, np.random.default_rng(1).normal(0, 8, (1, 200)))
    feasible = Feasible(20, 5, minimum_spacing=3, forbidden=(9,))
    plan = Replanner(Evaluator(ungm, 20), feasible, QUICK, 5).plan(
        Now(cloud, measured=True), (0, 6), (9, 12, 15)
    )
    assert feasible.accepts((0, 6, *plan))


def test_a_plan_is_replaced_only_where_the_new_plan_is_better_on_fresh_draws(
    ungm: StateSpaceModel,
) -> None:
    """Over many clouds the new plans are better than the old, by far more draws."""
    rng, old = np.random.default_rng(3), (9, 12, 15, 18)
    evaluator, feasible = Evaluator(ungm, 20), Feasible(20, 7)
    replanner = Replanner(evaluator, feasible, QUICK, 5)
    gains = []
    for k in range(12):
        now = Now(Cloud(6, rng.normal(rng.normal(0, 8), 3, (1, 200))), measured=True)
        new = replanner.plan(now, (0, 3, 6), old, k)
        if new != old:
            kept, better = replanner.expected(now, [old, new], 2000, QUICK.estimation, k)
            gains.append(kept.expected_mse - better.expected_mse)
    assert len(gains) > 3
    assert np.mean(gains) > 2 * np.std(gains, ddof=1) / np.sqrt(len(gains))


def test_the_expected_error_is_the_realised_error_for_a_static_state() -> None:
    """However few particles are left, the error that is planned is that of real filters.

    The state never moves: of 5 particles, 2 are left after three measurements. A planned filter
    that contained its truth would find it, and one that excluded the particles of its truth would
    look better than it is, because these lie far from the others.
    """
    model, times, particles, systems = SYSTEMS["static"], (3, 4, 5, 6, 7, 8), 5, 200
    settings, evaluator = Estimation(particles, "systematic"), Evaluator(model, 8)
    draws = evaluator.draws(range(systems), 7)
    replanner = Replanner(evaluator, Feasible(8, 9), QUICK, 5)
    planned = np.empty(systems)
    for d in range(systems):
        followed = Followed(OneFilter(model, settings, 3, d))
        for t in range(3):
            followed.update(t, draws.y[d, t])
            now = Now(followed.with_truths(), measured=True)
        (expected,) = replanner.expected(now, [times], 100, settings, d)
        planned[d] = expected.expected_mse
    many = evaluator.draws(range(20_000), 8)
    every = particle_filter.filter_draws(model, many, range(9), particles, 4, "systematic", True)
    realised = np.mean((every.estimate - many.z)[:, 2:, 0] ** 2, axis=1)
    error = np.hypot(planned.std() / np.sqrt(systems), realised.std() / np.sqrt(20_000))
    assert abs(planned.mean() - realised.mean()) < 3 * error


@pytest.mark.slow
def test_replanning_two_modes_gains_what_exact_dynamic_programming_says() -> None:
    """A state of two values: a filter that excludes its truth excludes it for certain."""
    horizon, measurements, count = 7, 3, 1600
    exact = oracles.modes.Modes(switch=0.02, sd=0.4, horizon=horizon)
    plan, cost = exact.best_fixed(measurements)
    evaluator = Evaluator(oracles.modes.model(switch=0.02, sd=0.4), horizon)
    cheap = Estimation(200, "systematic", "filter_variance")
    work = OnlineWork(
        *((plan,), (horizon,), (3,), 5, (0, count), Estimation(200, "systematic")),
        feasible=Feasible(horizon, measurements),
        planning=Planning(PLANNING, 500, 1000, cheap),
        planning_stream=9,
    )
    chosen, y = work.result(evaluator).measurement_times, evaluator.draws(range(count), 5).y
    online, fixed = (exact.error_of_draws(y[..., 0], each) for each in (chosen, [plan] * count))
    gain, error = np.mean(fixed - online), np.std(fixed - online) / np.sqrt(count)
    assert abs(gain - (cost - exact.replanned(measurements))) < 3 * error
    assert gain > 3 * error


def test_a_second_filter_that_no_particle_explains_starts_again_from_the_first() -> None:
    model = SYSTEMS["static"]
    followed = Followed(OneFilter(model, Estimation(50, prior=Cloud(0, np.zeros((1, 50)))), 3))
    hopeless = replace(followed.unmeasured.settings, prior=Cloud(0, np.full((1, 50), 1e200)))
    followed._second = replace(followed.unmeasured, settings=hopeless)
    followed.update(1, np.zeros(1))
    assert followed.with_truths().truths is followed.cloud
    assert followed._second.measured
    followed.update(2, np.zeros(1))
    assert followed.with_truths().truths is not followed.cloud


@pytest.mark.parametrize("name", EXACT)
def test_exact_errors_never_rise_with_a_heuristic_search(name: str) -> None:
    """The plan at hand is replaced only by one of lower cost, so online is as good or better."""
    model, feasible = EXACT[name].as_model(), Feasible(20, 6)
    evaluator = Evaluator(model, 20, engine="kalman")
    replanner, first = Replanner(evaluator, feasible, QUICK, 5), feasible.regular()
    filtering, taken, plan = OneFilter(model, Estimation(1), 3, 0, "kalman"), (), first
    y = simulate(model, 20, range(1), 7).y[0]
    costs = [exact_mse(evaluator, [first])[0]]
    while plan:
        filtering, *_ = filtering.at(plan[0], y[plan[0]])
        taken = (*taken, plan[0])
        plan = replanner.plan(Now(filtering.settings.prior, measured=True), taken, plan[1:])
        costs.append(exact_mse(evaluator, [(*taken, *plan)])[0])
    assert np.diff(costs).max() <= 1e-9 * costs[0]
    assert feasible.accepts(taken)


def test_a_plan_that_loses_more_draws_never_takes_the_place_of_another(
    ungm: StateSpaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A paired difference knows only the draws that both survive, so lost draws would look good."""
    kept, new, whole = (5, 9), (6, 9), np.arange(64.0)
    costs = {kept: whole, new: np.where(whole < 20, whole - 1, np.nan)}
    outlook = _Outlook(Replanner(Evaluator(ungm, 12), Feasible(12, 2), QUICK, 5), Now(), 3)

    def evaluated(outlook, draws, candidates, estimation):
        return [
            Evaluation(each.measurement_times, costs[each.measurement_times]) for each in candidates
        ]

    monkeypatch.setattr(_Outlook, "_evaluated", evaluated)
    assert outlook.better([kept, new], keep=True) == kept
    costs[kept], costs[new] = np.where(whole < 20, whole, np.nan), whole - 1
    assert outlook.better([kept, new], keep=True) == new
    costs[kept] = np.where(whole == 3, np.inf, whole)
    assert outlook.better([kept, new], keep=True) == new


def test_a_filter_with_other_states_cannot_be_planned_for(ungm: StateSpaceModel) -> None:
    filter_model = oracles.kalman.LinearGaussian(
        *(np.eye(2),) * 2, np.array([[1.0, 0.0]]), np.eye(1), np.array([[1.0, 0.0]]), np.eye(2)
    ).as_model()
    job = Problem(ungm, horizon=12, measurement_budget=2).job()
    lacking = ON_THE_WAY.lacks(job, Evaluator(ungm, 12, filter_model))
    assert "as many components of x as the true model" in lacking
    assert ON_THE_WAY.lacks(job, Evaluator(ungm, 12)) == ""
