"""Measurements as quantities of interest: the same draws, and the exact predictive mean of y."""

from dataclasses import replace

import numpy as np
import pytest

import pfdist
from oracles.batched import batched
from oracles.clocked import with_clock
from oracles.guided import sharp_walk
from oracles.lake import HORIZON, estimates, lake
from oracles.two_platforms import two_platforms
from pfdist.filters import kalman
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.predicted import circular_measurements, predicted
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation

TIMES = (3, 10, 11, 30)
SHIPPED = "ungm", "constant_velocity"  # which has angles
MODELS = {
    **{name: with_clock(pfdist.load_model(name), 6) for name in SHIPPED},
    "two platforms": two_platforms(),
    "walk": sharp_walk(2),
    "uniform noise": replace(
        pfdist.load_model("random_walk"),
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        measurement_noise=("uniform",),
        log_likelihood=lambda y, x, t, p: -np.abs(y[0] - x[0]),
        linear_gaussian=False,
    ),
    "batched": batched(replace(lake(), linear_gaussian=False)),
}


@pytest.mark.parametrize("name", MODELS)
def test_draws_have_the_same_states_and_measurements(name: str) -> None:
    """And z is another measurement of the same state."""
    model = MODELS[name]
    draws, others = (simulate(each, 6, range(5), 3) for each in (model, predicted(model)))
    assert np.array_equal(others.y, draws.y)
    assert np.array_equal(others.x[..., : draws.x.shape[2]], draws.x)
    assert others.z.shape == draws.y.shape
    assert not np.array_equal(others.z, draws.y)


@pytest.mark.parametrize("name", ["uniform noise", "two platforms"])
def test_z_and_y_are_exchangeable(name: str) -> None:
    """Both have the same mean at each instant, and the same second moment."""
    draws = simulate(predicted(MODELS[name]), 6, range(4000), 3)
    for power in (1, 2):
        apart = draws.z**power - draws.y**power
        error = apart.std(axis=0, ddof=1) / np.sqrt(len(apart))
        assert np.all(np.abs(apart.mean(axis=0)) <= 4.5 * error)


def test_kalman_predicts_what_is_computed_by_hand() -> None:
    model = predicted(lake())
    draws = simulate(model, HORIZON, range(3), 3)
    exact = kalman.filter_checked_draws(model, draws, TIMES, 0, Estimation(1), trajectories=True)
    for d in range(3):
        mean, variance = estimates(draws.y[d, :, 0], TIMES)
        np.testing.assert_allclose(exact.estimate[d, :, 0], mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(exact.variance[d, :, 0], variance + 0.1**2, rtol=1e-9)


@pytest.mark.plugins("guided")
@pytest.mark.parametrize("guided", [False, True])
def test_particles_tend_to_the_exact_predictive_mean(guided: bool) -> None:
    """Also with a proposal: the noise of y is proposed as it is drawn."""
    model, particles, runs = sharp_walk(1, sensor=0.3), 400, 200
    draws = simulate(predicted(model), 8, range(1), 7)
    settings = Estimation(1)
    exact = kalman.filter_checked_draws(
        predicted(model), draws, (0, 3, 5), 0, settings, trajectories=True
    ).estimate[0, :, 0]
    settings = Estimation(particles, proposal="guided" if guided else "plain")
    same = replace(draws, index=range(runs), x=draws.x.repeat(runs, 0), y=draws.y.repeat(runs, 0),
                   z=draws.z.repeat(runs, 0))  # fmt: skip
    found = filter_checked_draws(predicted(model), same, (0, 3, 5), 1, settings, trajectories=True)
    means = found.estimate[:, :, 0]
    error = means.std(axis=0, ddof=1) / np.sqrt(runs)
    bias = 4.0 / particles  # of the order of 1 / P
    assert np.all(np.abs(means.mean(axis=0) - exact) < 4.5 * error + bias)


def test_angles_have_the_name_of_a_circular_z_or_a_likelihood_with_a_period() -> None:
    """The second component of y is a bearing; the first, a range, is only called a heading."""
    model = pfdist.load_model("constant_velocity")
    names = {"y_names": ("heading [rad]", "range"), "z_names": ("x", "heading [rad]")}
    circular = replace(model, **names, circular=(1,))
    assert circular_measurements(circular) == predicted(circular).circular == (0, 1)
    assert predicted(circular).is_angle == (True, True)
    assert circular_measurements(replace(circular, circular=(0,))) == (1,)
    assert circular_measurements(replace(circular, y_names=())) == (1,)


def test_the_noise_of_a_measurement_is_half_of_the_square_of_y_less_z() -> None:
    """For the lake, whose deviation is 0.1."""
    draws = simulate(predicted(lake()), HORIZON, range(2000), 3)
    half = ((draws.y - draws.z) ** 2 / 2).mean(axis=(1, 2))
    error = half.std(ddof=1) / np.sqrt(len(half))
    assert abs(half.mean() - 0.01) < 4 * error
