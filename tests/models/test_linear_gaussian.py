"""Linear models from covariance matrices and a prior mean, against a Kalman filter of our own."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import pfdist
from oracles.moments import assert_exact_filter
from pfdist import Sensor, StateSpaceModel, linear_gaussian
from pfdist.filters import kalman
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models.recorded import recorded

F = np.array([[1.0, 0.5], [-0.1, 0.9]])
H = np.array([[1.0, 0.0], [1.0, 0.3]])
P = np.array([[4.0, -1.0], [-1.0, 1.0]])
Q = np.outer([0.3, 0.5], [0.3, 0.5])  # one noise of two states: singular
R = np.array([[0.5, 0.4], [0.4, 0.8]])  # two sensors whose noise is correlated
MEAN = np.array([10.0, -2.0])
COMMON, OWN = 0.6, (0.3, 0.4)
HORIZON, TIMES = 8, (0, 3, 4, 7)


def noise_at(t):
    """A covariance that varies with t, and stays one."""
    return ((0.5 + 0.1 * t, 0.4), (0.4, 0.8 + 0.3 * np.sin(t) ** 2))


def model_of(noise=R, process=Q):
    return linear_gaussian(
        "two sensors",
        initial_noise=P,
        initial_mean=MEAN,
        transition=F,
        process_noise=process,
        measurement=H,
        measurement_noise=noise,
        quantity_of_interest=np.eye(2),
        covariances=True,
    )


MODELS = {
    "one matrix": (model_of(), lambda t: R),
    "a function": (model_of(noise_at, lambda t: Q), lambda t: np.array(noise_at(t))),
}


def kalman_filter(y, noise):
    """Means (T+1, 2) and variances (T+1, 2) of x."""
    mean, covariance, means, variances = MEAN, P, [], []
    for t in range(HORIZON + 1):
        if t in TIMES:
            gain = covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + noise(t))
            mean = mean + gain @ (y[t] - H @ mean)
            covariance = (np.eye(2) - gain @ H) @ covariance
        means.append(mean)
        variances.append(np.diag(covariance))
        mean, covariance = F @ mean, F @ covariance @ F.T + Q
    return np.array(means), np.array(variances)


@pytest.mark.parametrize("name", MODELS)
def test_the_exact_engine_is_the_kalman_filter_and_particles_agree(name):
    model, noise = MODELS[name]
    draws = simulate(model, HORIZON, range(200), 3)
    own = [np.array(each) for each in zip(*(kalman_filter(y, noise) for y in draws.y), strict=True)]
    exact = kalman.filter_draws(model, draws, TIMES, 1, 1, trajectories=True)
    np.testing.assert_allclose(exact.estimate, own[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(exact.variance, own[1], rtol=1e-9)
    found = filter_draws(model, draws, TIMES, 2000, 7, trajectories=True)
    assert_exact_filter(found.estimate, found.variance, *own, 2000)


def test_simulated_starts_have_the_prior_mean_and_covariance():
    x = simulate(model_of(), 1, range(40_000), 3).x[:, 0]
    scaled = np.linalg.solve(np.linalg.cholesky(P), (x - MEAN).T)
    np.testing.assert_allclose(scaled.mean(axis=1), 0.0, atol=4 / 200)
    np.testing.assert_allclose(np.cov(scaled), np.eye(2), atol=4 * np.sqrt(2) / 200)


@pytest.mark.parametrize(
    ("covariances", "noise", "spread"),
    [
        (True, R, lambda t: R),
        (True, noise_at, lambda t: np.array(noise_at(t))),
        (False, [[0.5, 0.2], [0.1, 0.9]], lambda t: np.array([[0.29, 0.23], [0.23, 0.82]])),
        (False, [[0.5, 0.2, 0.0], [0.1, 0.9, 0.4]], lambda t: [[0.29, 0.23], [0.23, 0.98]]),
        (False, [[0.5, 0.0], [0.1, 0.9]], lambda t: np.array([[0.25, 0.05], [0.05, 0.82]])),
    ],
    ids=["covariance", "function", "factor", "wide factor", "triangular factor"],
)
def test_the_likelihood_is_the_normal_density_up_to_a_constant(covariances, noise, spread):
    model = linear_gaussian(
        "densities",
        initial_noise=P,
        transition=F,
        process_noise=Q,
        measurement=H,
        measurement_noise=noise,
        quantity_of_interest=[[1.0, 0.0]],
        covariances=covariances,
    )
    found = recorded(model, range(6)).log_likelihood
    rng = np.random.default_rng(2)
    for t in (0, 5):
        y, *states = rng.normal(size=(3, 2))
        expected = [multivariate_normal.logpdf(y, H @ x, spread(t)) for x in states]
        values = [found(tuple(y), tuple(x), t, model.p) for x in states]
        assert np.diff(values)[0] == pytest.approx(np.diff(expected)[0], rel=1e-9)


def test_a_common_error_as_a_component_of_x_is_correlated_noise():
    """The recipe of the cookbook: at the same times, it has the error of a covariance matrix."""

    def sensor(sd):
        return Sensor(
            lambda x, t, v, p: (x[0] + x[1] + sd * v[0],),
            lambda y, x, t, p: -0.5 * ((y[0] - x[0] - x[1]) / sd) ** 2,
            ("normal",),
        )

    apart = StateSpaceModel(
        "apart",
        lambda w, p: (w[0], COMMON * w[1]),
        lambda x, t, w, p: (0.9 * x[0] + 0.5 * w[0], COMMON * w[1]),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        sensors={"left": sensor(OWN[0]), "right": sensor(OWN[1])},
        linear_gaussian=True,
    )
    pair = linear_gaussian(
        "pair",
        initial_noise=[[1.0]],
        transition=[[0.9]],
        process_noise=[[0.25]],
        measurement=[[1.0], [1.0]],
        measurement_noise=np.diag(np.square(OWN)) + COMMON**2,
        quantity_of_interest=[[1.0]],
        covariances=True,
    )
    both = [f"{time} {side}" for time in (1, 4, 6) for side in ("left", "right")]
    errors = [
        pfdist.evaluate(
            pfdist.Problem(model, horizon=HORIZON, measurement_budget=6, engine="kalman"), times
        ).expected_mse
        for model, times in ((apart, both), (pair, [1, 4, 6]))
    ]
    assert errors[0] == pytest.approx(errors[1], rel=1e-12)
