"""A model with 64 sensors: a set of those that measure at an instant has 64 bits."""

from dataclasses import replace

import numpy as np
import pytest

from pfdist import Sensor, StateSpaceModel
from pfdist.errors import ModelError
from pfdist.filters import kalman, particle_filter, plain
from pfdist.filters.simulation import simulate
from pfdist.kernels.prefixes import plan_prefixes

MOST = 64
SETS = (
    (0,),
    (63,),  # the sign alone
    (31, 32, 62, 63),
    (63, 64, 127, 128 + 63),
    tuple(range(64, 128)),  # every sensor at the second instant
)


def _sensor(sd: float) -> Sensor:
    return Sensor(
        measurement=lambda x, t, v, p: (x[0] + sd * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / sd) ** 2,
        measurement_noise=("normal",),
    )


def _walk(sensors: int) -> StateSpaceModel:
    """A random walk that sensors of very different noise measure."""
    return StateSpaceModel(
        name="watched",
        initial=lambda w, p: (2.0 * w[0],),
        transition=lambda x, t, w, p: (x[0] + w[0],),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        sensors={f"s{number}": _sensor(2.0 + number / 8) for number in range(sensors)},
        linear_gaussian=True,
    )


WALK = _walk(MOST)


def test_the_compiled_filter_with_64_sensors_is_its_plain_twin() -> None:
    """Each sensor weighs in its turn, the 64th, whose bit is the sign, as all others."""
    draws = simulate(WALK, 2, range(4), 3)
    for times in SETS:
        fast, slow = (
            engine.filter_draws(WALK, draws, times, 200, 5, trajectories=True)
            for engine in (particle_filter, plain)
        )
        np.testing.assert_allclose(fast.estimate, slow.estimate, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(fast.mse, slow.mse, rtol=1e-7)


def test_with_64_sensors_the_filter_has_the_error_of_the_kalman_filter() -> None:
    """Within 4 standard errors, and the 64th alone lowers the error of the first instant."""
    draws = simulate(WALK, 2, range(2000), 7)
    exact = kalman.expected_mse(WALK, 2, SETS[1:3])
    for times, expected in zip(SETS[1:3], exact, strict=True):
        mse = particle_filter.filter_draws(WALK, draws, times, 500, 11).mse
        assert abs(mse.mean() - expected) < 4 * mse.std() / np.sqrt(mse.size) + 0.01 * expected
    assert exact[1] < exact[0] < kalman.expected_mse(WALK, 2, [()])[0]


def test_every_set_of_sensors_has_its_own_bits() -> None:
    plan, places, _ = plan_prefixes(SETS, 3, None, MOST)
    for times, place in zip(SETS, places, strict=True):
        bits = np.unpackbits(plan.measured[place], bitorder="little")
        assert tuple(np.flatnonzero(bits)) == times


def test_65_sensors_are_one_clean_error() -> None:
    with pytest.raises(ModelError, match=r"^model watched: sensors must be at most 64, got 65$"):
        _walk(MOST + 1)
    assert len(replace(WALK, name="other").parts) == MOST
