"""A model with 64 sensors: a set of those that measure at an instant has 64 bits."""

from dataclasses import replace

import numpy as np
import pytest

from pfdist import Sensor, StateSpaceModel
from pfdist.errors import ModelError
from pfdist.filters import kalman, particle_filter, plain
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.prefixes import plan_prefixes
from pfdist.kernels.rules import Applied, Thresholds
from pfdist.plugins.guided.proposal import GUIDED

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
    assert len(replace(WALK, name="other").ways) == MOST


def test_the_ninth_sensor_guides_and_is_chosen_by_a_rule_as_any_other() -> None:
    """Sets of more than 8 sensors take two bytes an instant; only the second one is not 0 here."""
    model, infinite = _walk(9), float("inf")
    draws, times = simulate(model, 5, range(40), 3), (17, 36)  # t = 1 by the ninth, t = 4
    settings = Estimation(4000, proposal=GUIDED.name)
    guided = filter_checked_draws(model, draws, times, 5, settings, True)
    exact = kalman.filter_draws(model, draws, times, 1, 5, trajectories=True)
    apart = np.mean((guided.estimate - exact.estimate) ** 2)
    assert apart < 5 * np.mean(exact.variance) / 4000
    rule = Thresholds((infinite,) * 8 + (1.5,))
    found = filter_checked_draws(model, draws, range(54), 5, Estimation(70, rule=Applied(rule)))
    for draw, own in enumerate(found.measured):
        chosen = tuple(np.flatnonzero(own).tolist())
        assert chosen
        assert all(point % 9 == 8 for point in chosen)
        fixed = filter_checked_draws(model, draws[draw : draw + 1], chosen, 5, Estimation(70))
        assert fixed.mse == found.mse[draw]
