"""Particles that move, against exact filters.

The *excess* is the squared distance of an estimate to the exact posterior mean, over the posterior
variance; with P independent particles it is 1 / P.
"""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.three_sensors import ThreeSensors
from oracles.unknown import constants, level_and_slope, moving
from pfdist import StateSpaceModel, densities
from pfdist.filters import kalman, plain
from pfdist.filters.interface import EACH_DRAW, SUMS
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.plugins.moving import arrays

Array = NDArray[np.float64]
SENSORS = ThreeSensors(0.4, 0.95, 0.5, ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)), (0.3, 0.05, 0.5))
HORIZON = 40
TIMES = (*range(4, HORIZON + 1, 4),)
DRAWS = 200


def excesses(model: StateSpaceModel, particles: int, lag: int = 0) -> Array:
    """The mean excess at each instant, (T+1, q)."""
    draws, settings = simulate(model, HORIZON, range(DRAWS), 7), moving(particles, lag=lag)
    found = filter_checked_draws(model, draws, TIMES, 3, settings, True)
    plainly = replace(settings, proposal="plain")
    exact = kalman.filter_checked_draws(model, draws, TIMES, 3, plainly, True)
    distance = (found.estimate - exact.estimate) ** 2
    return np.mean(distance / np.maximum(exact.variance, 1e-12), axis=0)


@pytest.mark.parametrize(
    ("process", "sensor", "particles", "most"),
    [
        (0.0, 0.05, 100, 0.05),
        (0.02, 0.05, 100, 0.05),
        (0.1, 0.05, 100, 0.05),
        (0.3, 0.1, 300, 0.1),
        (0.3, 0.02, 300, 0.1),
    ],
)
def test_a_level_and_a_slope_are_learned(
    process: float, sensor: float, particles: int, most: float
) -> None:
    # Oracle: the Kalman filter. A plain filter with 100 particles has excesses of 40 and more.
    found = excesses(level_and_slope(process, sensor), particles)[list(TIMES)]
    assert found.mean(axis=0).max() <= most
    assert found.mean() >= 0.5 / particles


@pytest.mark.parametrize(("process", "sensor"), [(0.1, 0.05), (0.3, 0.1), (0.3, 0.02)])
def test_smoothed_levels_are_nearly_exact_in_every_quarter(process: float, sensor: float) -> None:
    # Oracle: the Kalman smoother. The error is 1 + the excess times that of the exact one.
    found = excesses(level_and_slope(process, sensor), 300, lag=HORIZON)[:, 0]
    assert max(part.mean() for part in np.array_split(found, 4)) <= 0.1


@pytest.mark.parametrize(("number", "readings"), [(1, 8), (10, 20)])
def test_constants_are_learned(number: int, readings: int) -> None:
    # Oracle: the normal law of the constants, from all readings.
    model, sensor = constants(number, 0.05), 0.05
    draws = simulate(model, readings, range(DRAWS), 5)
    times = (*range(1, readings + 1),)
    found = filter_checked_draws(model, draws, times, 3, moving(100), True)
    seen = np.array([model.parameters[f"factor_{c}"][1 : readings + 1] for c in range(number)])
    covariance = np.linalg.inv(np.eye(number) + seen @ seen.T / sensor**2)
    exact = draws.y[:, 1:, 0] @ seen.T @ covariance / sensor**2
    assert np.mean((found.estimate[:, -1] - exact) ** 2 / np.diag(covariance)) <= 0.05
    assert found.variance[:, -1].mean(axis=0) == pytest.approx(np.diag(covariance), rel=0.1)


def test_both_signs_of_a_constant_stay() -> None:
    # Oracle: a grid. y tells x^2 / 20 alone, so the law of x has two modes, and the mean 0.
    model = StateSpaceModel(
        name="two signs",
        initial=lambda w, p: (8.0 * w[0],),
        transition=lambda x, t, w, p: x,
        measurement=lambda x, t, v, p: (x[0] ** 2 / 20 + v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], x[0] ** 2 / 20, 1.0),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=(),
        measurement_noise=("normal",),
    )
    draws, grid = simulate(model, 8, range(400), 5), np.linspace(-40.0, 40.0, 20_001)
    found = filter_checked_draws(model, draws, (*range(1, 9),), 3, moving(100), True)
    density = -0.5 * (grid / 8.0) ** 2
    for t in range(1, 9):
        density = density - 0.5 * (draws.y[:, t] - grid**2 / 20) ** 2
    share = np.exp(density - density.max(axis=1, keepdims=True))
    variance = np.sum(share * grid**2, axis=1) / share.sum(axis=1)
    assert np.mean(found.estimate[:, -1, 0] ** 2 / variance) <= 0.05


# --- the twin, and the same bits ------------------------------------------------------------------


def all_kinds() -> StateSpaceModel:
    """Noise of all kinds, a range outside which nothing is possible, and a state that is driven."""

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        inside = np.abs(y[0] - x[0]) < 0.5
        return np.where(inside, densities.normal_logpdf(y[0], x[0], 0.1), -np.inf)

    return StateSpaceModel(
        name="all kinds",
        initial=lambda w, p: (2.0 * w[0], w[1], w[2]),
        transition=lambda x, t, w, p: (
            x[0] + x[1] * np.cos(x[2]) + 0.2 * w[0] + 0.1 * x[0] * w[1], x[1], x[2] + 0.1 * w[2],
        ),
        measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0],),
        log_likelihood=log_likelihood,
        quantity_of_interest=lambda x, t, p: (x[1], x[0]),
        initial_noise=("normal", "uniform", "centred"),
        process_noise=("normal", "centred", "uniform"),
        measurement_noise=("normal",),
    )  # fmt: skip


@pytest.mark.parametrize("lag", [0, 3, 10])
@pytest.mark.parametrize("resampling", ["multinomial", "stratified", "systematic"])
@pytest.mark.parametrize(
    "model",
    [level_and_slope(0.1, 0.05), constants(3, 0.05), all_kinds(), SENSORS.as_model()],
    ids=lambda model: model.name,
)
def test_the_plain_twin_has_the_same_particles(
    model: StateSpaceModel, resampling: str, lag: int
) -> None:
    # Both take the same keyed noise. Rounding may turn a decision in one of many thousands.
    draws, ways = simulate(model, 10, range(8), 7), model.points.ways
    times = tuple(sorted({0, 2 * ways, 5 * ways, 5 * ways + ways - 1, 10 * ways}))
    settings = moving(48, resampling=resampling, lag=lag)
    found = filter_checked_draws(model, draws, times, 3, settings, True)
    twin = plain.filter_checked_draws(model, draws, times, 3, settings, True)
    for name in ("mse", "estimate", "variance", "sizes", "cloud", "lines"):
        values, expected = getattr(found, name), getattr(twin, name)
        assert np.allclose(values, expected, rtol=1e-8, atol=1e-10, equal_nan=True), name
    assert found.degenerate.tolist() == twin.degenerate.tolist()


@pytest.mark.parametrize("estimator", ["squared_error", "two_clouds", "filter_variance"])
@pytest.mark.parametrize("lag", [0, 10])
def test_sets_that_share_a_beginning_have_the_bits_of_each_alone(estimator: str, lag: int) -> None:
    model = level_and_slope(0.1, 0.05)
    draws, settings = simulate(model, 10, range(6), 7), moving(32, lag=lag, estimator=estimator)
    sets = [*[*combinations(range(11), 3)][::9], (2, 5, 7, 8), (2, 5), (2,)]
    ends = [10] * len(sets)
    found = filter_checked_sets(model, draws, sets, ends, 3, settings, EACH_DRAW)
    summed = filter_checked_sets(model, draws, sets, ends, 3, settings, SUMS)
    for column, times in enumerate(sets):
        alone = filter_checked_sets(model, draws, [times], [10], 3, settings, EACH_DRAW)
        assert np.array_equal(found.mse[:, column], alone.mse[:, 0])
        assert np.array_equal(found.errors[:, column], alone.errors[:, 0])
        assert summed.errors[column] == pytest.approx(alone.errors[:, 0].sum(axis=0))
    part = filter_checked_sets(model, draws[2:4], sets, ends, 3, settings)
    assert np.array_equal(part.mse, found.mse[2:4])


def test_saved_lines_take_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    # 30 noises, T = 200: each saved beginning would have 600,000 numbers; then none is saved.
    count, sets = 30, [(10, 50, 120), (10, 50, 130), (10, 60, 150)]
    model = StateSpaceModel(
        name="thirty",
        initial=lambda w, p: (w[0],),
        transition=lambda x, t, w, p: (0.9 * x[0] + 0.1 * sum(w),),
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], x[0], 1.0),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",) * count,
        measurement_noise=("normal",),
    )
    draws, saved = simulate(model, 200, range(2), 7), list[int]()
    own = arrays.Moved.arranged

    def arranged(self: arrays.Moved, request: Any, plan: Any, *others: Any) -> Any:
        saved.append(int((plan.slots >= 0).sum()))
        return own(self, request, plan, *others)

    monkeypatch.setattr(arrays.Moved, "arranged", arranged)
    given = draws, sets, [200] * 3, 3, moving(100)
    shared = filter_checked_sets(model, *given)
    monkeypatch.setattr(arrays, "_MOST_SAVED", 2**19)
    alone = filter_checked_sets(model, *given)
    assert [number > 0 for number in saved] == [True, False]
    assert np.array_equal(shared.mse, alone.mse)
