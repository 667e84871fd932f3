"""Which sensor, when: against brute force, closed forms, and the same system with one sensor."""

from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.three_sensors import HORIZON, NAMES, SYSTEMS, ThreeSensors
from pfdist.filters import particle_filter, plain
from pfdist.filters.simulation import simulate

BUDGET = 6


def _problem(system: ThreeSensors, **keys: object) -> pfdist.Problem:
    return pfdist.Problem(
        system.as_model(),
        **{"horizon": HORIZON, "measurement_budget": BUDGET, "engine": "kalman"} | keys,
    )


def _numbers(written: object) -> tuple[int, ...]:
    pairs = (str(each).split() for each in written)
    return tuple(int(t) * 3 + NAMES.index(sensor) for t, sensor in pairs)


@pytest.mark.parametrize("resampling", ["systematic", "multinomial"])
def test_the_compiled_filter_is_its_plain_twin(resampling: str) -> None:
    """Sensors weigh and resample in their order, at the same instant without propagation."""
    model = SYSTEMS[0].as_model()
    draws = simulate(model, HORIZON, range(20), 7)
    twin = plain.simulate(model, HORIZON, range(20), 7)
    np.testing.assert_allclose(draws.y, twin.y, rtol=1e-12)
    sets = [(0, 1, 2, 10), (0, 1, 2, 11, 12, 14), (5,), (36, 38)]
    compiled = particle_filter.filter_sets(model, draws, sets, 64, 3, resampling)
    for column, times in enumerate(sets):
        filtered = plain.filter_draws(model, draws, times, 64, 3, resampling)
        np.testing.assert_allclose(compiled[:, column], filtered.mse, rtol=1e-5)
        alone = particle_filter.filter_draws(model, draws, times, 64, 3, resampling)
        assert np.array_equal(alone.mse, compiled[:, column])  # a shared prefix gives the same bits


def test_the_particle_filter_tends_to_the_kalman_filter() -> None:
    """With 4,000 particles, the expected MSE is that of the exact filter within 4 errors."""
    system, times = SYSTEMS[1], (0, 2, 10, 11, 30)
    draws = simulate(system.as_model(), HORIZON, range(1500), 11)
    mse = particle_filter.filter_draws(system.as_model(), draws, times, 4000, 3).mse
    error = mse.std(ddof=1) / np.sqrt(mse.size)
    assert abs(mse.mean() - system.expected_mse(times)) < 4 * error


def test_draws_of_one_sensor_are_those_of_a_model_with_this_sensor_alone() -> None:
    """The first of the sensors has the same bits: adding sensors changes nothing before them."""
    model = SYSTEMS[0].as_model()
    alone = simulate(model.parts[0].model, HORIZON, range(5), 3)
    assert np.array_equal(simulate(model, HORIZON, range(5), 3).y[:, :, :1], alone.y)


@pytest.mark.parametrize(
    "system", [SYSTEMS[0], *(pytest.param(each, marks=pytest.mark.slow) for each in SYSTEMS[1:])]
)
def test_the_plan_is_the_optimum_of_brute_force_and_its_gap_is_0(
    system: ThreeSensors, tmp_path: Path
) -> None:
    """3.3 million sets of six measurements by three sensors, all filtered by the oracle."""
    least, best = system.best(BUDGET)
    run = pfdist.plan(_problem(system), results=tmp_path / "run", pool="serial")
    (name,) = run.found
    times = _numbers(run.sets()[name])
    assert system.expected_mse(times) == pytest.approx(least, rel=1e-9)
    assert times == best
    bound = run.summary().results[name].lower_bound
    assert bound["gap"] == pytest.approx(0.0, abs=1e-9)
