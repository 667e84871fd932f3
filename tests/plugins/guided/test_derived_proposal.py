"""The proposal that a filter derives: against exact filters, and with the truth inside.

Given y and a guided cloud as a set, the truth is distributed as the weights, as in any other cloud
(see `test_conditional`). So the squared error of the cloud's mean is its variance on average, for
every model and every number of particles. That holds only if the density of the proposal is right.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.guided import sharp_walk
from oracles.three_sensors import ThreeSensors
from pfdist import StateSpaceModel, load_model, where
from pfdist.errors import ModelError
from pfdist.filters import kalman
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import SUMS
from pfdist.filters.one_filter import OneFilter
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.proposal import PLAIN
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, with_truth
from pfdist.plugins.guided.formulas import guide_of
from pfdist.plugins.guided.proposal import GUIDED

Array = NDArray[np.float64]
HORIZON, TIMES = 10, (0, 3, 4, 9)
SENSORS = ThreeSensors(0.4, 0.95, 0.5, ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)), (0.3, 0.05, 0.5))


def guided(particles: int, **others: Any) -> Estimation:
    return Estimation(particles, proposal=GUIDED.name, **others)


def standard_errors(difference: Array) -> Array:
    """Mean over its standard error, for each column."""
    error: Array = difference.std(axis=0, ddof=1) / math.sqrt(len(difference))
    return difference.mean(axis=0) / np.maximum(error, 1e-300)


# --- exact filters --------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("times", [(1, 8), (0, 3, 4, 9)])
def test_sharp_sensors_give_the_kalman_filter(times: tuple[int, ...]) -> None:
    """Sensors of .001 of the prior's deviation in six dimensions, gaps of 1 to 7: within 1 %.

    The exact filter has the same draws, so the difference of the errors counts, and not their
    spread. The plain filter loses 6 % and more.
    """
    model = sharp_walk(6)
    draws = simulate(model, HORIZON, range(200), 1)
    exact = kalman.filter_draws(model, draws, times, 1, 2).mse
    loss = filter_checked_draws(model, draws, times, 2, guided(500)).mse - exact
    plain = filter_checked_draws(model, draws, times, 2, Estimation(500)).mse - exact
    error = loss.std(ddof=1) / math.sqrt(loss.size)
    assert loss.mean() + 3 * error < 0.01 * exact.mean()
    assert plain.mean() > 0.05 * exact.mean()


def test_a_target_that_is_seen_sharply_is_not_lost() -> None:
    """Constant velocity, gaps of 7 of 40, bearing and range to 1e-4: as with 8 times as many.

    Distance and bearing are bent, so a single linearisation is not enough: its errors are three
    times as large.
    """
    sharp = {"bearing_sd": 1e-4, "range_sd": 1e-4}
    model, times = load_model("constant_velocity").with_parameters(sharp), (5, 12, 19, 26, 33, 40)
    draws = simulate(model, 40, range(40), 11)
    few, many = (
        filter_checked_draws(model, draws, times, 7, guided(particles)).mse
        for particles in (150, 1200)
    )
    assert abs(few.mean() / many.mean() - 1.0) < 0.02
    assert (
        filter_checked_draws(model, draws, times, 7, Estimation(1200)).mse.mean() > 2 * many.mean()
    )


# --- with the truth inside ------------------------------------------------------------------------

MIXED = StateSpaceModel(
    name="mixed noise",
    initial=lambda w, p: (w[0], 2.0 * w[1]),
    transition=lambda x, t, w, p: (0.9 * x[0] + w[0] * w[1], np.sin(x[0]) + x[1] + 0.3 * w[2]),
    measurement=lambda x, t, v, p: (x[0] * x[1] + 0.1 * v[0], x[0] + 0.5 * (v[1] + v[2])),
    log_likelihood=lambda y, x, t, p: -50.0 * (y[0] - x[0] * x[1]) ** 2 - (y[1] - x[0]) ** 2,
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("uniform", "normal"),
    process_noise=("normal", "uniform", "normal"),
    measurement_noise=("normal", "normal", "normal"),
)
"""Normal noise between uniform noise; two noises of one component of y."""

COUNTS = StateSpaceModel(
    name="counts",
    initial=lambda w, p: (0.5 * w[0], w[1]),
    transition=lambda x, t, w, p: (0.9 * x[0] + 0.3 * w[0], x[1] + 0.2 * w[1]),
    measurement=lambda x, t, v, p: (where(v[0] < 1.0 / (1.0 + np.exp(-3.0 * x[0])), 1.0, 0.0),),
    log_likelihood=lambda y, x, t, p: -np.log1p(np.exp(where(y[0] > 0.5, -3.0, 3.0) * x[0])),
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("normal", "normal"),
    process_noise=("normal", "normal"),
    measurement_noise=("uniform",),
)
"""Yes or no, whose noise has no derivative."""

CORRELATED = StateSpaceModel(
    name="correlated",
    initial=lambda w, p: w,
    transition=lambda x, t, w, p: (0.9 * x[0] + 0.2 * x[1] + w[0], 0.8 * x[1] + w[1]),
    measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0], x[1] + 0.1 * v[0] + 0.1 * v[1]),
    log_likelihood=lambda y, x, t, p: (
        -50.0 * ((y[0] - x[0]) ** 2 + (y[1] - x[1] - (y[0] - x[0])) ** 2)
    ),
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("normal", "normal"),
    process_noise=("normal", "normal"),
    measurement_noise=("normal", "normal"),
)
"""Two components of y with one noise in common."""


def truths_inside(
    model: StateSpaceModel,
    settings: Estimation,
    draws: int = 4000,
    change: Callable[[Draws], Draws] = lambda each: each,
    times: tuple[int, ...] = TIMES,
) -> Array:
    """Squared error less variance of the particles beside the truth, (D, T+1)."""
    simulated = simulate(model, HORIZON, range(draws), 3)
    found = filter_checked_draws(model, change(simulated), times, 7, settings, trajectories=True)
    squared: Array = ((simulated.z - found.estimate) ** 2).sum(axis=2)
    return squared - found.variance.sum(axis=2)


@pytest.mark.parametrize(
    "model",
    [
        MIXED,
        COUNTS,
        CORRELATED,
        pytest.param(load_model("lotka_volterra"), marks=pytest.mark.slow),
        SENSORS.as_model(),
    ],
    ids=lambda model: model.name,
)
def test_the_variance_is_the_squared_error_on_average(model: StateSpaceModel) -> None:
    times = (1, 8, 9, 17, 27, 28) if model.sensors else TIMES
    difference = truths_inside(model, with_truth(6, GUIDED.name), times=times)
    assert abs(standard_errors(difference.mean(axis=1))) < 4
    assert (abs(standard_errors(difference)) < 4.5).all()


def test_weights_that_are_carried_count() -> None:
    """Resampling below half the particles; the truth is beside particles that carry weights."""
    settings = replace(with_truth(20, GUIDED.name), threshold=0.5)
    difference = truths_inside(MIXED, settings)
    assert (abs(standard_errors(difference)) < 4.5).all()


def test_the_bound_of_sharp_sensors_is_nearer_to_the_exact_error() -> None:
    """Its expectation is at most that of the exact filter, for any number of particles."""
    model = sharp_walk(2, sensor=0.1)
    exact = kalman.expected_mse(model, HORIZON, [TIMES])[0]
    draws = simulate(model, HORIZON, range(1500), 3)
    plain, near = (
        filter_checked_draws(model, draws, TIMES, 7, with_truth(20, proposal)).mse
        for proposal in (PLAIN.name, GUIDED.name)
    )
    assert standard_errors(near - exact) < 4
    assert standard_errors(near - plain) > 4


# --- the same filter ------------------------------------------------------------------------------


@pytest.mark.parametrize("model", [MIXED, SENSORS.as_model()], ids=lambda model: model.name)
def test_sets_together_are_bit_for_bit_as_alone(model: StateSpaceModel) -> None:
    count = (HORIZON + 1) * len(model.ways)
    rng = np.random.default_rng(2)
    sets = [tuple(np.flatnonzero(rng.random(count) < 0.25).tolist()) for _ in range(12)]
    draws, ends = simulate(model, HORIZON, range(40), 3), [HORIZON] * len(sets)
    together, *_ = filter_checked_sets(model, draws, sets, ends, 9, guided(30))
    for times, mse in zip(sets, together.T, strict=True):
        alone = filter_checked_draws(model, draws, times, 9, guided(30)).mse
        np.testing.assert_array_equal(mse, alone)
    sums = filter_checked_sets(model, draws, sets, ends, 9, guided(30), SUMS).errors
    np.testing.assert_allclose(sums.sum(axis=1), together.sum(axis=0) * (HORIZON + 1), rtol=1e-9)


def test_draws_together_are_bit_for_bit_as_alone() -> None:
    draws = simulate(MIXED, HORIZON, range(90), 3)
    together = filter_checked_draws(MIXED, draws, TIMES, 9, guided(60)).mse
    alone = [
        filter_checked_draws(MIXED, draws[k : k + 1], TIMES, 9, guided(60)).mse for k in (0, 57)
    ]
    np.testing.assert_array_equal(together[[0, 57]], np.concatenate(alone))


def test_a_filter_that_goes_on_from_measurement_to_measurement_has_the_same_bits() -> None:
    draws = simulate(MIXED, HORIZON, range(4, 5), 3)
    whole = filter_checked_draws(MIXED, draws, TIMES, 9, guided(60), trajectories=True)
    filtering = OneFilter(MIXED, guided(60), 9, 4)
    for t in TIMES:
        filtering, mean, _ = filtering.at(t, draws.y[0, t])
        np.testing.assert_array_equal(mean[-1], whole.estimate[0, t])


def test_a_measurement_that_no_particle_explains_is_left_out() -> None:
    """As if it were not made, bit for bit; the next noise is drawn again from there on."""
    likelihood = MIXED.log_likelihood
    fails = replace(
        MIXED,
        name="fails",
        log_likelihood=lambda y, x, t, p: where(
            (t == 4) & (y[0] > 0.0), -np.inf, likelihood(y, x, t, p)
        ),
    )
    draws = simulate(MIXED, HORIZON, range(60), 3)
    found = filter_checked_draws(fails, draws, TIMES, 9, guided(60), trajectories=True)
    degenerate = draws.y[:, 4, 0] > 0.0
    assert 10 < degenerate.sum() < 50
    np.testing.assert_array_equal(found.degenerate, degenerate)
    without = tuple(t for t in TIMES if t != 4)
    other = filter_checked_draws(fails, draws, without, 9, guided(60), trajectories=True)
    same = (found.estimate == other.estimate)[:, :9].reshape(60, -1).all(axis=1)
    np.testing.assert_array_equal(same, degenerate)


def test_a_component_that_was_not_measured_leaves_the_proposal() -> None:
    """Two walks, of which one is measured at t = 3: the mean and variance of a Kalman filter."""
    walks = StateSpaceModel(
        name="walks",
        initial=lambda w, p: w,
        transition=lambda x, t, w, p: (x[0] + w[0], x[1] + w[1]),
        measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0], x[1] + 0.1 * v[1]),
        log_likelihood=lambda y, x, t, p: sum(
            where(np.isnan(a), 0.0, -50.0 * (where(np.isnan(a), b, a) - b) ** 2)
            for a, b in zip(y, x, strict=True)
        ),
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        measurement_noise=("normal", "normal"),
        missing_components=True,
    )
    particles, gain = 20_000, 4.0 / 4.01
    _, mean, variance = OneFilter(walks, guided(particles), 5).at(3, np.array([np.nan, 1.7]))
    expected = np.array([0.0, gain * 1.7]), np.array([4.0, 4.0 * (1.0 - gain)])
    np.testing.assert_array_less(abs(mean[-1] - expected[0]), 5 * np.sqrt(expected[1] / particles))
    np.testing.assert_allclose(variance[-1], expected[1], rtol=6 * math.sqrt(2.0 / particles))


# --- how it looks at a model ----------------------------------------------------------------------


def test_angles_are_those_whose_full_turn_changes_no_likelihood() -> None:
    for name, angles in (("constant_velocity", (False, True)), ("ungm", (False,))):
        guide = guide_of(load_model(name), range(HORIZON))
        assert guide is not None
        assert guide.angles == angles


@pytest.mark.parametrize(
    ("model", "components"),
    [(COUNTS, (0,)), (MIXED, ()), (load_model("stochastic_volatility"), (0,))],
    ids=lambda value: getattr(value, "name", ""),
)
def test_the_likelihood_serves_where_measurements_at_noise_0_do_not(
    model: StateSpaceModel, components: tuple[int, ...]
) -> None:
    """They have no density, as counts; or do not depend on x, as those of a volatility."""
    guide = guide_of(model, range(HORIZON))
    assert guide is not None
    assert guide.components == components


def test_a_sensor_that_is_blind_at_times_is_guided_at_others() -> None:
    """Its measurements do not depend on x at t = 0; one that never sees is not guided."""
    turning = replace(
        MIXED,
        name="turning",
        measurement=lambda x, t, v, p: (np.sin(0.7 * t) * x[0] + 0.05 * v[0],),
        log_likelihood=lambda y, x, t, p: -200.0 * (y[0] - np.sin(0.7 * t) * x[0]) ** 2,
        measurement_noise=("normal",),
    )
    assert guide_of(turning, range(HORIZON)) is not None
    difference = truths_inside(turning, with_truth(6, GUIDED.name))
    assert (abs(standard_errors(difference)) < 4.5).all()
    assert guide_of(turning, range(1)) is None


def test_where_a_derivative_is_not_finite_the_noise_is_that_of_the_model() -> None:
    """The root of a negative number, which is not chosen."""

    def sensor(x: Any) -> Any:
        return where(x > 0.0, np.sqrt(x), 0.0)

    model = StateSpaceModel(
        name="chosen",
        initial=lambda w, p: (w[0],),
        transition=lambda x, t, w, p: (0.9 * x[0] + 0.5 * w[0],),
        measurement=lambda x, t, v, p: (sensor(x[0]) + 0.1 * v[0],),
        log_likelihood=lambda y, x, t, p: -50.0 * (y[0] - sensor(x[0])) ** 2,
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
    )
    draws = simulate(model, HORIZON, range(1000), 3)
    plain, own = (
        filter_checked_draws(model, draws, TIMES, 7, Estimation(500, proposal=each))
        for each in (PLAIN.name, GUIDED.name)
    )
    assert not own.degenerate.any()
    assert abs(standard_errors(own.mse - plain.mse)) < 4
    difference = truths_inside(model, with_truth(6, GUIDED.name))
    assert (abs(standard_errors(difference)) < 4.5).all()


def test_a_prior_of_particles_is_where_the_first_path_begins() -> None:
    """Also for the truth among the particles."""
    rng = np.random.default_rng(5)
    prior = Cloud(3, rng.normal(size=(2, 400)))
    for times in ((4,), (4, 9), (3, 9)):
        draws = simulate(MIXED, HORIZON, range(4000), 3, prior)
        settings = replace(with_truth(6, GUIDED.name), prior=prior)
        found = filter_checked_draws(MIXED, draws, times, 7, settings, trajectories=True)
        squared = ((draws.z - found.estimate) ** 2).sum(axis=2)
        difference = squared - found.variance.sum(axis=2)
        assert (abs(standard_errors(difference)) < 4.5).all()


@pytest.mark.parametrize(
    ("engine", "said"),
    [
        ("numpy", "filter.engine = 'compiled', got 'numpy'"),
        ("batched", "'plain' is for every model"),
    ],
)
def test_other_engines_refuse_it(engine: str, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        Evaluator(MIXED, 5, estimations=(guided(20),), engine=engine)


def test_a_model_without_normal_noise_is_refused() -> None:
    model = replace(
        COUNTS, initial_noise=("uniform",) * 2, process_noise=("centred", "uniform"), name="other"
    )
    with pytest.raises(
        ModelError, match=r"proposal = 'guided' is not possible: .* no normal noise"
    ):
        Evaluator(model, 5).compile(guided(20))
