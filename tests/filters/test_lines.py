"""Estimates that use later measurements, by ancestral lines, against exact ones and their twin."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.grid import grid_smoother
from oracles.guided import sharp_walk
from oracles.in_turn import in_turn
from oracles.kalman import SCALAR, THREE, TRACKING, LinearGaussian
from oracles.moments import assert_mean, assert_positive
from oracles.three_sensors import ThreeSensors
from pfdist import StateSpaceModel, load_model, where
from pfdist.common.measurement_times import regular
from pfdist.filters import kalman, plain
from pfdist.filters import particle_filter as _compiled
from pfdist.filters.cloud import Cloud, Gaussian
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import EACH_DRAW
from pfdist.filters.particle_filter import (
    filter_checked_draws,
    filter_checked_sets,
    filter_draws,
)
from pfdist.filters.settings import RESAMPLING
from pfdist.filters.simulation import simulate
from pfdist.filters.variants import self_consistent
from pfdist.filters.work import Estimation, control_of, with_truth
from pfdist.plugins.guided.proposal import GUIDED

Array = NDArray[np.float64]
HORIZON, TIMES = 12, (0, 3, 4, 9)
UNGM = load_model("ungm")
SENSORS = ThreeSensors(0.4, 0.95, 0.5, ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)), (0.3, 0.05, 0.5))
DEGENERATE = replace(
    UNGM,
    log_likelihood=lambda y, x, t, p: where(y[0] > 20.0, -np.inf, -0.5 * (y[0] - x[0]) ** 2),
)
INFINITE = replace(
    UNGM, quantity_of_interest=lambda x, t, p: (where(abs(x[0]) > 22.0, np.inf, x[0]),)
)


# --- exact smoothers ------------------------------------------------------------------------------


@pytest.mark.parametrize("system", [SCALAR, THREE, TRACKING], ids=["scalar", "three", "tracking"])
@in_turn("lag", [2, HORIZON])
def test_a_linear_gaussian_model_gives_the_kalman_smoother(
    system: LinearGaussian, lag: int
) -> None:
    """The particles lose their distance from the exact mean, and this is small.

    The exact mean's error is orthogonal to all that is computed from the measurements until then.
    """
    model = system.as_model()
    draws = simulate(model, HORIZON, range(200), 1)
    own, exact = (
        engine(model, draws, TIMES, 2000, 2, trajectories=True, lag=lag)
        for engine in (filter_draws, kalman.filter_draws)
    )
    distance = np.mean(np.sum((own.estimate - exact.estimate) ** 2, axis=2), axis=1)
    assert_mean(own.mse - exact.mse - distance)
    assert distance.mean() < 0.01 * exact.mse.mean()
    # The variance lacks the part that the mean of the particles has.
    missing = np.sum(exact.variance - own.variance, axis=2).mean(axis=1)
    assert_mean(missing - distance)


@in_turn("lag", [2, HORIZON])
def test_beside_the_truth_the_variance_over_lines_is_the_error_and_a_lower_bound(lag: int) -> None:
    """Given y and the cloud as a set, the truth's line is distributed as the weights."""
    model = SCALAR.as_model()
    draws = simulate(model, HORIZON, range(20_000), 1)
    exact = kalman.expected_mse(model, HORIZON, [TIMES], lag=lag)[0]
    given = replace(with_truth(4), lag=lag)
    by_variance = filter_checked_sets(model, draws, [TIMES], [HORIZON], 2, given).mse[:, 0]
    squared = filter_checked_draws(
        model, draws, TIMES, 2, replace(given, estimator="squared_error")
    ).mse
    assert_mean(squared - by_variance)
    assert_positive(exact - by_variance)


@in_turn("lag", [2, HORIZON])
def test_the_control_is_the_error_less_the_variance_over_lines_and_its_mean_is_zero(
    lag: int,
) -> None:
    """It takes more than half of the variance away, and nothing from the mean."""
    model, own = SCALAR.as_model(), Estimation(200, lag=lag)
    draws, given = simulate(model, HORIZON, range(2000), 1), replace(control_of(own), lag=lag)
    both = [model, draws, [TIMES], [HORIZON], 2]
    control = filter_checked_sets(*both, given).mse[:, 0]
    squared = filter_checked_sets(*both, own).mse[:, 0]
    assert_mean(control)
    assert np.var(squared - control) < 0.5 * np.var(squared)
    (twin,) = plain.filter_checked_sets(model, draws[:50], [TIMES], [HORIZON], 2, given).mse.T
    np.testing.assert_allclose(control[:50], twin, rtol=1e-9, atol=1e-12)


def test_two_clouds_estimate_the_error_of_the_exact_smoother_with_few_particles() -> None:
    """The squared error is too large by the distance, and the variance too small by nearly as much.

    Less than a third of either is left, and the estimate varies less than the squared error.
    """
    model, settings = SCALAR.as_model(), Estimation(40, "systematic", lag=HORIZON)
    draws = simulate(model, HORIZON, range(8000), 1)
    exact = kalman.expected_mse(model, HORIZON, [TIMES], lag=HORIZON)[0]
    squared, variance, clouds = (
        filter_checked_sets(
            model, draws, [TIMES], [HORIZON], 2, replace(settings, estimator=estimator)
        ).mse[:, 0]
        for estimator in ("squared_error", "filter_variance", "two_clouds")
    )
    assert_positive(squared - exact)
    assert_positive(exact - variance)
    assert abs(clouds.mean() - exact) < 0.3 * (exact - variance.mean())
    assert np.var(clouds) < 0.5 * np.var(squared)


def test_half_the_distance_of_two_filters_is_that_of_lines_from_the_exact_mean() -> None:
    model, settings = SCALAR.as_model(), Estimation(50, estimator="filter_noise", lag=HORIZON)
    draws = simulate(model, HORIZON, range(2000), 1)
    half = filter_checked_sets(model, draws, [TIMES], [HORIZON], 2, settings, EACH_DRAW)
    own, exact = (
        engine(model, draws, TIMES, 50, 2, trajectories=True, lag=HORIZON).estimate
        for engine in (filter_draws, kalman.filter_draws)
    )
    distance = (own - exact)[:, :, 0] ** 2
    assert_mean(half.mse[:, 0] - distance.mean(axis=1))
    np.testing.assert_allclose(half.errors.mean(axis=(1, 2)), half.mse[:, 0], rtol=1e-12)


def test_guided_paths_give_the_kalman_smoother() -> None:
    """Noise is drawn again in the gaps: the lines have z of the paths that the weights are of."""
    model, times = sharp_walk(2), (1, 8)
    draws = simulate(model, HORIZON, range(100), 1)
    for lag in (2, HORIZON):
        guided = Estimation(500, proposal=GUIDED.name, lag=lag)
        own = filter_checked_draws(model, draws, times, 2, guided, True)
        exact = kalman.filter_draws(model, draws, times, 1, 2, trajectories=True, lag=lag)
        distance = np.mean(np.sum((own.estimate - exact.estimate) ** 2, axis=2), axis=1)
        assert_mean(own.mse - exact.mse - distance)
        assert distance.mean() < 0.01 * exact.mse.mean()


def test_a_chain_of_two_states_gives_the_mean_over_all_paths() -> None:
    """The posterior of each path, by Bayes' rule, and so that of the state at each instant."""
    stay, sd, horizon, times = 0.8, 0.7, 5, (1, 3, 4)
    model = StateSpaceModel(
        name="chain",
        initial=lambda w, p: (where(w[0] < 0.5, 0.0, 1.0),),
        transition=lambda x, t, w, p: (where(w[0] < stay, x[0], 1.0 - x[0]),),
        measurement=lambda x, t, v, p: (x[0] + sd * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / sd) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("uniform",),
        process_noise=("uniform",),
        measurement_noise=("normal",),
    )
    draws = simulate(model, horizon, range(50), 3)
    paths = np.array([*itertools.product((0.0, 1.0), repeat=horizon + 1)])
    stays = np.sum(np.diff(paths) == 0, axis=1)
    prior = 0.5 * stay**stays * (1 - stay) ** (horizon - stays)
    squares = (draws.y - paths.T) ** 2 / sd**2  # (D, T+1, paths)
    for lag in (1, horizon):
        found = filter_draws(model, draws, times, 4000, 1, "systematic", True, lag=lag).estimate
        for t in range(horizon + 1):
            known = [s for s in times if s <= t + lag]
            weight = prior * np.exp(-0.5 * squares[:, known].sum(axis=1))
            apart = found[:, t, 0] - weight @ paths[:, t] / weight.sum(axis=1)
            assert_mean(apart)
            assert np.sqrt(np.mean(apart**2)) < 1.5 / np.sqrt(4000)


@pytest.mark.statistics
def test_the_loss_on_the_papers_problem_is_the_distance_from_the_exact_mean() -> None:
    """Point masses on a grid; the paper's regular times, and those that suit smoothers."""
    gaps = (1, 4, 9, 11, 14, 15, 19, 22, 24, 27, 30, 32, 35, 37, 41, 45, 48, 51, 53, 56, 59)
    draws = simulate(UNGM, 60, range(100), 2020)
    for times in (regular(60, 21), gaps):
        mean = grid_smoother(UNGM, draws, times, 800)
        found = filter_draws(UNGM, draws, times, 2000, 1, "systematic", True, lag=60)
        exact = np.mean((draws.z[:, :, 0] - mean) ** 2, axis=1)
        distance = np.mean((found.estimate[:, :, 0] - mean) ** 2, axis=1)
        assert_mean(found.mse - exact - distance)
        assert distance.mean() < 0.05 * exact.mean()


# --- the same bits, and the plain twin ------------------------------------------------------------


@in_turn("resampling", RESAMPLING)
@in_turn(("particles", "lag", "threshold"), [(16, 2, np.inf), (65, HORIZON, np.inf), (40, 3, 0.5)])
def test_the_plain_twin_agrees(particles: int, lag: int, threshold: float, resampling: str) -> None:
    draws = simulate(UNGM, HORIZON, range(4), 17)
    given: dict[str, Any] = {"trajectories": True, "threshold": threshold, "lag": lag}
    fast, slow = (
        engine.filter_draws(UNGM, draws, (0, 1, 4, 9, 11), particles, 23, resampling, **given)
        for engine in (_compiled, plain)
    )
    for name in ("mse", "estimate", "variance", "sizes", "lines"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), rtol=1e-9, atol=1e-13)


@in_turn(
    ("model", "times"),
    [
        (DEGENERATE, TIMES),
        (INFINITE, TIMES),
        (SENSORS.as_model(), (0, 2, 4, 9, 10, 11, 30)),
    ],
)
def test_the_plain_twin_agrees_on_sensors_and_draws_that_fail(
    model: StateSpaceModel, times: tuple[int, ...]
) -> None:
    truth = UNGM if not model.sensors else model
    draws = simulate(truth, HORIZON, range(20), 3)
    fast, slow = (
        engine.filter_draws(model, draws, times, 50, 5, trajectories=True, lag=4)
        for engine in (_compiled, plain)
    )
    np.testing.assert_allclose(fast.mse, slow.mse, rtol=1e-7)
    np.testing.assert_allclose(fast.estimate, slow.estimate, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(fast.degenerate, slow.degenerate)


@in_turn("proposal", ["plain", GUIDED.name])
@in_turn("lag", [2, HORIZON])
def test_sets_together_and_draws_apart_give_the_same_bits(lag: int, proposal: str) -> None:
    """Sets that share a prefix share its lines, and no draw depends on its batch."""
    rng = np.random.default_rng(0)
    masks = rng.random((30, HORIZON + 1)) < rng.random((30, 1))
    sets = [tuple(np.flatnonzero(mask).tolist()) for mask in masks] + [(), (12,), (0,), (12,)]
    model, settings = SCALAR.as_model(), Estimation(70, lag=lag, proposal=proposal)
    draws = simulate(model, HORIZON, range(40), 3)
    ends = [HORIZON] * len(sets)
    together = filter_checked_sets(model, draws, sets, ends, 9, settings, EACH_DRAW)
    alone = [filter_checked_draws(model, draws, times, 9, settings).mse for times in sets]
    np.testing.assert_array_equal(together.mse, np.stack(alone, axis=1))
    np.testing.assert_allclose(together.errors.mean(axis=2), together.mse, rtol=1e-12)
    few = filter_checked_sets(model, draws[7:9], sets, ends, 9, settings)
    np.testing.assert_array_equal(few.mse, together.mse[7:9])


def test_lines_have_the_moments_of_the_estimate() -> None:
    """Whether lines come from one measurement, from several within a lag, or from none."""
    settings, model = Estimation(70, lag=2), SCALAR.as_model()
    draws = simulate(model, HORIZON, range(5), 3)
    found = plain.filter_checked_draws(model, draws, TIMES, 9, settings, lines=True)
    share = found.line_weight / found.line_weight.sum(axis=2, keepdims=True)
    z = np.where(share > 0, found.line_z[:, :, 0], 0.0)
    np.testing.assert_allclose(np.sum(share * z, axis=2), found.estimate[:, :, 0], rtol=1e-12)
    squares = np.sum(share * (z - found.estimate) ** 2, axis=2)
    np.testing.assert_allclose(squares, found.variance[:, :, 0], rtol=1e-9)


@in_turn("engine", [_compiled, plain, kalman])
def test_each_instant_may_have_a_lag_of_its_own(engine: Any) -> None:
    """The estimate of an instant is that with its lag at all instants, also after a start at 2."""
    model, lags = SCALAR.as_model(), (0, 3, 2, 1, 4, 3, 2, 1, 4, 3, 2, 1, 0)
    draws = simulate(model, HORIZON, range(3), 5)
    found, evaluated = (
        {lag: function(lag) for lag in (lags, *{*lags})}
        for function in (
            lambda lag: engine.filter_draws(model, draws, TIMES, 30, 4, trajectories=True, lag=lag),
            lambda lag: kalman.expected_errors(model, HORIZON, [TIMES], lag=lag),
        )
    )
    for t, lag in enumerate(lags):
        np.testing.assert_allclose(found[lags].estimate[:, t], found[lag].estimate[:, t], 1e-12)
        np.testing.assert_allclose(found[lags].variance[:, t], found[lag].variance[:, t], 1e-12)
        np.testing.assert_allclose(evaluated[lags][:, t], evaluated[lag][:, t], 1e-12)
    prior = Gaussian(2, np.zeros(1), np.eye(1)) if engine is kalman else Cloud(2, np.zeros((1, 30)))
    late = simulate(model, HORIZON, range(3), 5, Cloud(2, np.zeros((1, 30))))
    started = {
        lag: engine.filter_draws(
            model, late, (3, 9), 30, 4, prior=prior, trajectories=True, lag=lag
        )
        for lag in (lags, *{*lags})
    }
    for t, lag in [*enumerate(lags)][2:]:
        own, alike = (started[each].estimate[:, t - 2] for each in (lags, lag))
        np.testing.assert_allclose(own, alike, 1e-12)


def test_without_a_measurement_within_the_lag_it_is_the_filters_estimate() -> None:
    draws = simulate(UNGM, HORIZON, range(5), 3)
    now, later = (
        filter_draws(UNGM, draws, (0, 6, 11), 70, 9, trajectories=True, lag=lag).estimate
        for lag in (0, 2)
    )
    changes = (now != later).any(axis=(0, 2))
    assert np.flatnonzero(changes).tolist() == [4, 5, 9, 10]


@in_turn("estimator", ["squared_error", "filter_variance", "filter_noise", "two_clouds"])
def test_an_evaluator_uses_later_measurements(estimator: str) -> None:
    """Its identity has the lag; the control variate of an own error is that of the filter."""
    filtered, smoothed = (Evaluator(UNGM, HORIZON, lag=lag) for lag in (0, HORIZON))
    own = Estimation(50, estimator=estimator)
    assert filtered.id_of(own) != smoothed.id_of(own)
    assert smoothed.settings(control_of(own)).lag == HORIZON
    other = replace(UNGM, error=lambda z, estimate, t, p: abs(z[0] - estimate[0]))
    assert Evaluator(other, HORIZON, lag=HORIZON).settings(control_of(own)).lag == 0
    assert self_consistent(smoothed) == smoothed
    draws, work = simulate(UNGM, HORIZON, range(30), 2), smoothed.work([TIMES], 1, 2, (0, 30), own)
    for evaluator in (filtered, smoothed):
        given = replace(own, lag=evaluator.lag)
        expected = filter_checked_sets(UNGM, draws, [TIMES], [HORIZON], 1, given).mse
        np.testing.assert_array_equal(evaluator(work).mse, expected)
        plainly = plain.filter_checked_sets(UNGM, draws, [TIMES], [HORIZON], 1, given).mse
        np.testing.assert_allclose(expected, plainly, rtol=1e-9)
