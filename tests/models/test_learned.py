"""Parameters that a filter learns, against the exact filter: a Kalman filter of each value."""

import math
from dataclasses import replace
from itertools import combinations
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.learned import WALK, Mixture
from pfdist import Sensor, StateSpaceModel, load_model
from pfdist.common.scenario import Scenario
from pfdist.errors import ModelError
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, with_truth
from pfdist.models.learned import learned
from pfdist.models.recorded import recorded
from pfdist.plugins.guided.proposal import GUIDED

Array = NDArray[np.float64]
HORIZON, TIMES = 10, (2, 5, 8)
VALUES = [(0.5, -0.3, 1.0), (0.25, 0.0, 2.0), (0.25, 0.4, 0.5)]
SCENARIOS = [Scenario(share, {"drift": drift, "gain": gain}) for share, drift, gain in VALUES]
LIST, EXACT = learned(WALK, SCENARIOS), Mixture(*np.array(VALUES).T)
PRIOR = {"drift": {"normal": (0.1, 0.3)}, "gain": {"lognormal": (1.0, 0.3)}}


def errors(estimate: Array | None, draws: Draws) -> Array:
    """Squared errors, (D,)."""
    assert estimate is not None
    total: Array = ((estimate - draws.z) ** 2).sum(axis=2).mean(axis=1)
    return total


def standard_errors(difference: Array) -> float:
    """Mean over its standard error."""
    return float(difference.mean() / (difference.std(ddof=1) / math.sqrt(difference.size)))


def test_each_draw_has_a_scenario_with_the_probability_of_its_share() -> None:
    """And keeps it."""
    x = simulate(LIST, HORIZON, range(20_000), 1).x[:, :, 1]
    assert (x == x[:, :1]).all()
    counts = np.bincount(x[:, 0].astype(int)) / 20_000
    np.testing.assert_allclose(counts, [each.share for each in SCENARIOS], atol=0.015)


def test_many_particles_give_the_exact_filter_of_a_list() -> None:
    draws = simulate(LIST, HORIZON, range(200), 1)
    settings = Estimation(10_000, "systematic", proposal=GUIDED.name)
    found = filter_checked_draws(LIST, draws, TIMES, 3, settings, trajectories=True)
    exact = EXACT.estimates(draws.y[:, :, 0], TIMES)
    assert np.sqrt(np.mean((found.estimate - exact) ** 2)) < 0.03
    loss = errors(found.estimate, draws) - errors(exact, draws)
    assert abs(loss.mean()) < 0.005 * errors(exact, draws).mean() + 4 * loss.std() / np.sqrt(200)


def test_many_particles_give_the_exact_filter_of_distributions() -> None:
    """The exact one on a grid of 40 by 40 medians of equal parts."""
    model = learned(WALK, PRIOR)
    draws = simulate(model, HORIZON, range(100), 1)
    scores = np.array([NormalDist().inv_cdf((k + 0.5) / 40) for k in range(40)])
    drifts, gains = np.meshgrid(0.1 + 0.3 * scores, np.exp(0.3 * scores))
    grid = Mixture(np.full(1600, 1 / 1600), drifts.ravel(), gains.ravel())
    exact = grid.estimates(draws.y[:, :, 0], TIMES)
    found = filter_checked_draws(
        model, draws, TIMES, 3, Estimation(10_000, "systematic", proposal=GUIDED.name), True
    )
    assert np.sqrt(np.mean((found.estimate - exact) ** 2)) < 0.04


def test_the_exact_error_of_each_set_lies_between_bound_and_filter() -> None:
    """Brute force over all sets of two times; with the truth inside, and by the squared error."""
    sets = [*combinations(range(7), 2)]
    draws, ends = simulate(LIST, 6, range(1500), 5), [6] * len(sets)
    exact = np.array([errors(EXACT.estimates(draws.y[:, :, 0], times), draws) for times in sets]).T
    own, *_ = filter_checked_sets(LIST, draws, sets, ends, 2, Estimation(200))
    inside, *_ = filter_checked_sets(LIST, draws, sets, ends, 2, with_truth(200))
    for k in range(len(sets)):
        assert standard_errors(own[:, k] - exact[:, k]) > -4
        assert standard_errors(inside[:, k] - exact[:, k]) < 4
    np.testing.assert_allclose(own.mean(axis=0), exact.mean(axis=0), rtol=0.05)


def test_a_formula_that_needs_numbers_is_computed_for_each_scenario() -> None:
    """The same draws, bit for bit but for rounding."""
    needs = replace(
        WALK, transition=lambda x, t, w, p: (x[0] + math.fsum([p.drift, 0.0]) + 0.5 * w[0],)
    )
    found, expected = (
        simulate(learned(each, SCENARIOS), HORIZON, range(50), 1) for each in (needs, WALK)
    )
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-12)
    with pytest.raises(ModelError, match=r"transition failed: .* as a number .*test_learned.py"):
        learned(needs, PRIOR)


def test_a_parameter_may_have_a_value_for_each_instant_in_each_scenario() -> None:
    """The drift of the second scenario is that of the first, a step later."""
    steps = np.arange(HORIZON + 1.0)
    model = replace(
        WALK,
        transition=lambda x, t, w, p: (x[0] + p.drift[t],),
        quantity_of_interest=lambda x, t, p: (x[0],),
        parameters={"drift": (0.0,) * (HORIZON + 1), "gain": 1.0},
    )
    drifts = (tuple(steps), tuple(steps + 1.0))
    known = learned(model, [Scenario(0.5, {"drift": each}) for each in drifts])
    draws = simulate(known, HORIZON, range(40), 1)
    moved = draws.x[:, 1:, 0] - draws.x[:, :-1, 0]
    expected = np.array(drifts)[draws.x[:, 0, 1].astype(int), :-1]
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    assert 10 < draws.x[:, 0, 1].sum() < 30


def test_sensors_read_what_is_learned() -> None:
    sensor = Sensor(WALK.measurement, WALK.log_likelihood, ("normal",))
    both = StateSpaceModel(
        name="two sensors",
        initial=WALK.initial,
        transition=WALK.transition,
        quantity_of_interest=WALK.quantity_of_interest,
        initial_noise=("normal",),
        process_noise=("normal",),
        parameters=WALK.parameters,
        sensors={"first": sensor, "second": sensor},
    )
    model = learned(both, SCENARIOS)
    draws = simulate(model, HORIZON, range(200), 1)
    found = filter_checked_draws(model, draws, (4, 10, 16), 3, Estimation(2000)).mse
    exact = errors(EXACT.estimates(draws.y[:, :, 0], TIMES), draws)
    assert abs(found.mean() - exact.mean()) < 0.01 * exact.mean() + 4 * (found - exact).std() / 14


def test_parameters_that_move_are_only_those_of_the_filter() -> None:
    moving = learned(WALK, PRIOR, motion=0.1)
    assert moving.process_noise == ("normal",) * 3
    x = simulate(moving, HORIZON, range(4000), 1).x
    steps = x[:, 1:, 1] - x[:, :-1, 1], np.log(x[:, 1:, 2] / x[:, :-1, 2])
    for step in steps:
        np.testing.assert_allclose(step.std(), 0.03, rtol=0.02)


def test_it_is_recorded_as_any_other_model() -> None:
    model = learned(load_model("two_compartments"), {"clearance": {"uniform": (3.0, 6.0)}})
    assert model.components[0] == load_model("two_compartments").components[0] + 1
    kept = recorded(LIST, range(HORIZON + 1))
    found, expected = (simulate(each, HORIZON, range(5), 1).z for each in (kept, LIST))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("prior", "says"),
    [
        ([Scenario(1.0, {"drif": 1.0})], "unknown parameter 'drif'"),
        ({"speed": {"normal": (0.0, 1.0)}}, "unknown parameter 'speed'"),
    ],
)
def test_unknown_parameters_are_refused(prior: Any, says: str) -> None:
    with pytest.raises(ModelError, match=says):
        learned(WALK, prior)
