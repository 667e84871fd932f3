"""Lines that one filter hands to the next: both are one filter, bit for bit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oracles.three_sensors import ThreeSensors
from oracles.unknown import constants, level_and_slope, moving
from pfdist import StateSpaceModel
from pfdist.filters import particle_filter, plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.interface import EACH_DRAW
from pfdist.filters.one_filter import OneFilter
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.simulation import simulate

SENSORS = ThreeSensors(0.4, 0.95, 0.5, ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)), (0.3, 0.05, 0.5))
MODELS = [level_and_slope(0.1, 0.05), constants(2, 0.05), SENSORS.as_model()]


def followed(model: StateSpaceModel, seen: list[tuple[int, Any]], engine: str) -> OneFilter:
    """A filter that has stopped at each measurement, and before."""
    at = OneFilter(model, moving(48), 3, 0, engine)
    for t, y in seen:
        at, *_ = at.at(t)
        at, *_ = at.at(t, y)
    return at


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
@pytest.mark.parametrize("times", [(2, 5, 6, 10), (0, 5, 10)])
def test_a_filter_that_stops_has_the_bytes_of_one_that_does_not(
    model: StateSpaceModel, times: tuple[int, ...], engine: str
) -> None:
    y = simulate(model, 12, range(1), 7).y[0]
    seen = [(t, y[t]) for t in times]
    first = OneFilter(model, moving(48), 3, 0, engine)
    filters = plain if engine == "numpy" else particle_filter
    for last in range(1, len(seen) + 1):
        stopped, mean, variance = followed(model, seen[:last], engine).at(12)
        draws, points = first._draws(12, seen[:last])
        whole = filters.filter_checked_draws(model, draws, points, 3, first.settings, True)
        cloud = stopped.settings.prior
        assert isinstance(cloud, Cloud)
        assert cloud.lines is not None
        assert np.array_equal(cloud.x, whole.cloud[0])
        assert np.array_equal(cloud.lines.noise, whole.noise[0])
        assert np.array_equal(mean[-1], whole.estimate[0, -1])
        assert np.array_equal(variance[-1], whole.variance[0, -1])


@pytest.mark.parametrize("lag", [0, 12])
def test_plans_made_on_the_way_start_from_lines_that_still_move(lag: int) -> None:
    # The slope is known by two measurements, and two more: particles without lines keep it.
    model = level_and_slope(0.1, 0.05)
    y = simulate(model, 12, range(1), 7).y[0]
    cloud = followed(model, [(2, y[2]), (5, y[5])], "compiled").at(6)[0].settings.prior
    assert isinstance(cloud, Cloud)
    draws, settings = simulate(model, 12, range(40), 11, cloud), moving(48, prior=cloud, lag=lag)
    found = filter_checked_draws(model, draws, (7, 9, 12), 5, settings, True)
    twin = plain.filter_checked_draws(model, draws, (7, 9, 12), 5, settings, True)
    assert np.allclose(found.estimate, twin.estimate, rtol=1e-8)
    assert np.allclose(found.mse, twin.mse, rtol=1e-8)
    assert found.estimate.shape == draws.z.shape
    sets = [(7, 9, 12), (7, 9), (8,), (6, 7), ()]
    together = filter_checked_sets(model, draws, sets, [12] * 5, 5, settings, EACH_DRAW)
    assert np.array_equal(together.mse[:, 0], found.mse)
    for column, times in enumerate(sets):
        alone = filter_checked_sets(model, draws, [times], [12], 5, settings, EACH_DRAW)
        assert np.array_equal(together.errors[:, column], alone.errors[:, 0])
    values = [np.unique(each[1]).size for each in found.cloud]
    stuck = replace(settings, prior=replace(cloud, lines=None))
    left = filter_checked_draws(model, draws, (7, 9, 12), 5, stuck, True)
    assert np.median(values) > 2 * np.median([np.unique(each[1]).size for each in left.cloud])


def test_particles_of_a_user_do_not_move_but_later_noise_does() -> None:
    model = level_and_slope(0.1, 0.05)
    x = np.random.default_rng(1).normal(size=(2, 48)) * 0.3
    cloud = Cloud(2, x)
    draws, settings = simulate(model, 8, range(8), 11, cloud), moving(48, prior=cloud)
    found = filter_checked_draws(model, draws, (4, 6, 8), 5, settings, True)
    twin = plain.filter_checked_draws(model, draws, (4, 6, 8), 5, settings, True)
    assert np.allclose(found.cloud, twin.cloud, rtol=1e-8)
    assert np.isin(found.cloud[:, 1], x[1]).all()
    assert np.unique(found.cloud[0, 0]).size == 48
