import math

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm

from pfdist.models import load_model

MODEL = load_model("xray_tumour")
PACE = 2 * math.pi / 4.0  # radians a second
SD = np.array([2.0, 5.0, 3.0])  # mm: lateral, longitudinal, vertical
STATIONARY = np.kron(np.diag([1, PACE**2]), np.diag(SD**2))
REST = (0.0, 0.0, 0.0)


def exact_step(damping, step):
    """Matrix and covariance of a step of dx = v dt, dv = -(pace^2 x + 2 damping pace v) dt + noise.

    Van Loan's block exponential, "Computing integrals involving the matrix exponential", 1978. The
    noise that makes sd^2 the stationary variance of x is 4 damping pace^3 sd^2 a second.
    """
    drift, both = generators(damping, step)
    return expm(drift), expm(drift) @ expm(both)[:6, 6:]


def generators(damping, step):
    """Give the matrices in the exponentials: the drift, and drift and noise in one block."""
    drift = np.kron([[0, 1], [-(PACE**2), -2 * damping * PACE]], np.eye(3))
    noise = np.kron(np.diag([0, 4 * damping * PACE**3]), np.diag(SD**2))
    return step * drift, step * np.block([[-drift, noise], [np.zeros((6, 6)), drift.T]])


def norm(matrix):
    return np.linalg.norm(matrix, 1)


@pytest.mark.parametrize(("damping", "step"), [(0.05, 0.25), (0.001, 0.1), (0.7, 2.0)])
def test_a_step_is_that_of_a_damped_oscillator_pushed_by_white_noise(damping, step):
    p = MODEL.with_parameters({"damping": damping, "step": step}).p
    unit, still = np.eye(6), (0.0,) * 6
    a = np.array([MODEL.transition(tuple(x), 3, still, p) for x in unit]).T
    b = np.array([MODEL.transition(still, 3, tuple(w), p) for w in unit]).T
    forward, covariance = exact_step(damping, step)
    # Rounding: an entry is a sum of up to 12 products, and what is left of larger numbers. The
    # exponential of M is wrong by about its norm times that of M; the model's noise is what is
    # left of the stationary variances. The block's exponential is large where the oscillator
    # decays much in a step, 700 in the last case.
    drift, both = generators(damping, step)
    rounding = 12 * np.finfo(float).eps
    size = 1 + norm(drift) * norm(forward)
    np.testing.assert_allclose(a, forward, rtol=0, atol=rounding * size)
    size = norm(STATIONARY) + norm(both) * norm(forward) * norm(expm(both))
    np.testing.assert_allclose(b @ b.T, covariance, rtol=0, atol=rounding * size)


def test_the_first_state_has_the_stationary_variances():
    first = MODEL.initial((1.0,) * 6, MODEL.p)
    assert first == pytest.approx(np.sqrt(np.diag(STATIONARY)), rel=1e-12)


def test_at_the_isocentre_lengths_are_magnified_by_the_ratio_of_the_distances():
    still = (0.0, 0.0)
    assert MODEL.measurement((0.0,) * 6, 7, still, MODEL.p) == (0.0, 0.0)
    seen = MODEL.measurement((10.0, -20.0, 0.0, *REST), 0, still, MODEL.p)
    assert seen == pytest.approx((15.0, -30.0), rel=1e-12)
    # Half way to the source it is twice as much.
    seen = MODEL.measurement((10.0, -20.0, 500.0, *REST), 0, still, MODEL.p)
    assert seen == pytest.approx((30.0, -60.0), rel=1e-12)


def test_the_projection_is_where_the_ray_from_the_source_meets_the_detector():
    rng = np.random.default_rng(1)
    for t in (0, 10, 33, 60, 200):
        angle = math.radians(6) * 0.25 * t
        towards = np.array([math.sin(angle), 0.0, math.cos(angle)])
        across, along = np.array([math.cos(angle), 0.0, -math.sin(angle)]), np.array([0, 1, 0])
        source, position, v = 1000 * towards, rng.normal(scale=100, size=3), rng.normal(size=2)
        noise = 2.0 * v
        ray = position - source
        # On the detector's plane, 500 mm behind the isocentre.
        there = source + ray * ((-500 - source @ towards) / (ray @ towards))
        seen = MODEL.measurement((*position, *REST), t, tuple(v), MODEL.p)
        assert seen == pytest.approx(
            (there @ across + noise[0], there @ along + noise[1]), rel=1e-11
        )


@pytest.mark.parametrize("sd", [1.0, 0.5])
def test_log_likelihood_is_that_of_the_measurement_up_to_a_constant(sd):
    p = MODEL.with_parameters({"measurement_sd": sd}).p
    position = np.random.default_rng(1).normal(scale=5, size=(3, 101))
    x = (*position, *REST)
    seen = np.stack(MODEL.measurement(x, 9, (0.0, 0.0), p))
    y = np.array([4.0, -7.0])
    exact = stats.norm.logpdf(y[:, None], loc=seen, scale=sd).sum(axis=0)
    # Rounding of values up to about 0.5 * (50 / 0.5)^2 = 5000.
    assert np.ptp(MODEL.log_likelihood(tuple(y), x, 9, p) - exact) < 1e-11


# --- a source so far away that its rays are parallel: linear and Gaussian ------------------------

# ------------------------------------------------------------------------------------------------
