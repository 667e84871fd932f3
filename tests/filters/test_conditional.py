"""The filter of the lower bound, in which one particle follows the true states of the draw.

Given y and the cloud as a set, the truth is distributed as the weights. So the expected squared
error of the cloud's mean is the expected variance of the cloud, and this is at most the error of
the exact filter, for every number of particles (Andrieu, Doucet, Holenstein, "Particle Markov chain
Monte Carlo methods", 2010).
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.systems import scalar
from pfdist.filters import plain
from pfdist.filters.kalman import expected_mse
from pfdist.filters.particle_filter import filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.models import StateSpaceModel

HORIZON, TIMES = 12, (2, 5, 6, 10)
Array = NDArray[np.float64]


def system(sd: float, factor: float = 0.95, process_sd: float = 0.5) -> StateSpaceModel:
    return scalar("scalar", factor, process_sd, sd)


SLOW = system(3.0, 1.0, 0.1)
"""Particles stay near their ancestors, so that a wrong choice of ancestors shows."""


def settings(particles: int, estimator: str = "filter_variance") -> Estimation:
    return Estimation(particles, "conditional", estimator=estimator)


def standard_errors(difference: Array) -> float:
    """Mean over its standard error."""
    return float(difference.mean() / (difference.std(ddof=1) / math.sqrt(difference.size)))


@pytest.mark.parametrize(
    "model",
    [
        pytest.param(SLOW, id="slow"),
        pytest.param(system(1.0), id="1", marks=pytest.mark.slow),
        pytest.param(system(0.003), id="0.003", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("particles", [2, 4, 16, 100, 2000])
def test_the_variance_is_the_squared_error_on_average_and_at_most_that_of_the_exact_filter(
    particles: int, model: StateSpaceModel
) -> None:
    count = max(1000, 100_000 // particles)
    draws = simulate(model, HORIZON, range(count), 1)
    variance, squared = (
        filter_checked_sets(model, draws, [TIMES], [HORIZON], 7, settings(particles, estimator))[0]
        for estimator in ("filter_variance", "squared_error")
    )
    assert abs(standard_errors(squared - variance)) < 4
    exact = expected_mse(model, HORIZON, [TIMES])[0]
    assert standard_errors(variance - exact) < 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sd", "exact", "expected"),
    [
        (0.1, 0.8318, (0.412, 0.749, 0.815, 0.828)),
        pytest.param(1.0, 1.2578, (0.518, 1.071, 1.216, 1.250), marks=pytest.mark.slow),
        pytest.param(0.003, 0.8243, (0.410, 0.740, 0.807, 0.821), marks=pytest.mark.slow),
    ],
)
def test_it_has_the_expectation_of_an_independent_program(
    sd: float, exact: float, expected: tuple[float, ...]
) -> None:
    """Its standard errors were .002, .002, .001 and .001."""
    model = system(sd)
    draws = simulate(model, HORIZON, range(10_000), 2)
    assert expected_mse(model, HORIZON, [TIMES])[0] == pytest.approx(exact, abs=5e-5)
    given = zip((2, 10, 50, 300), expected, (0.002, 0.002, 0.001, 0.001), strict=True)
    for particles, mean, error in given:
        found = filter_checked_sets(model, draws, [TIMES], [HORIZON], 7, settings(particles))[0]
        tolerance = 4 * math.hypot(error, found.std() / math.sqrt(found.size))
        assert found.mean() == pytest.approx(mean, abs=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("particles", [1, 2, 4, 100])
def test_the_plain_twin_agrees(particles: int) -> None:
    model = system(0.1)
    draws, sets, ends = simulate(model, HORIZON, range(20), 3), [TIMES, ()], [HORIZON] * 2
    compiled, twin = (
        function(model, draws, sets, ends, 7, settings(particles))[0]
        for function in (filter_checked_sets, plain.filter_checked_sets)
    )
    np.testing.assert_allclose(compiled, twin, rtol=1e-12, atol=1e-15)


# --- versions that are wrong, and fail the identity -----------------------------------------------


def by_points(weight: Array, points: Array) -> NDArray[np.int64]:
    """Ancestors of points in (0, 1), (D, K), by the weights of each draw, (D, P)."""
    shares = np.cumsum(weight, axis=1) / weight.sum(axis=1, keepdims=True)
    found: NDArray[np.int64] = (points[:, :, None] >= shares[:, None, :-1]).sum(axis=2)
    return found


def right(weight: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """P - 1 independent ancestors among all; the truth remains its own ancestor."""
    others = by_points(weight, rng.random(weight[:, 1:].shape))
    return np.concatenate([np.zeros((len(weight), 1), np.int64), others], axis=1)


def overwritten_sorted_point(weight: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """P sorted points, the first of which is overwritten: the least point is no random one."""
    ancestors = by_points(weight, np.sort(rng.random(weight.shape), axis=1))
    ancestors[:, 0] = 0
    return ancestors


def overwritten_systematic_point(weight: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """Systematic points, the first of which is overwritten."""
    count = weight.shape[1]
    points = (np.arange(count) + rng.random((len(weight), 1))) / count
    ancestors = by_points(weight, points)
    ancestors[:, 0] = 0
    return ancestors


def truth_not_set_again(weight: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """All P choose: after the first measurement no particle follows the truth."""
    return by_points(weight, rng.random(weight.shape))


def deviation(resample: Callable[..., NDArray[np.int64]], particles: int = 4) -> float:
    """Squared error less variance over its standard error, by a filter written for this test."""
    count = 400_000
    draws, rng = simulate(SLOW, HORIZON, range(count), 5), np.random.default_rng(6)
    truth, y = draws.x[:, :, 0], draws.y[:, :, 0]
    x, difference = 2.0 * rng.standard_normal((count, particles)), np.zeros(count)
    for t in range(HORIZON + 1):
        if t > 0:
            x = x + 0.1 * rng.standard_normal(x.shape)
        if resample is not truth_not_set_again or t <= TIMES[0]:
            x[:, 0] = truth[:, t]
        weight = np.ones_like(x)
        if t in TIMES:
            log_weight = -0.5 * ((y[:, [t]] - x) / 3.0) ** 2
            weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        share = weight / weight.sum(axis=1, keepdims=True)
        mean = (share * x).sum(axis=1)
        difference += (truth[:, t] - mean) ** 2 - (share * (x - mean[:, None]) ** 2).sum(axis=1)
        if t in TIMES:
            x = np.take_along_axis(x, resample(weight, rng), axis=1)
    return standard_errors(difference)


@pytest.mark.slow
def test_the_identity_holds_for_another_program() -> None:
    assert abs(deviation(right)) < 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong", [overwritten_sorted_point, overwritten_systematic_point, truth_not_set_again]
)
def test_versions_that_are_wrong_fail_the_identity(
    wrong: Callable[..., NDArray[np.int64]],
) -> None:
    assert abs(deviation(wrong)) > 6
