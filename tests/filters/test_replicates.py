"""The penalty of a measurement: against its plain twin, and its mean of exactly 0."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.batched import batched
from oracles.replicated import penalties
from oracles.three_sensors import SYSTEMS
from pfdist import StateSpaceModel, load_model
from pfdist.common.measurement_times import Times
from pfdist.filters.draws import Draws
from pfdist.filters.interface import EACH_DRAW
from pfdist.filters.particle_filter import filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import with_truth

HORIZON = 6
EVERY = tuple(range(HORIZON + 1))


def found(
    model: StateSpaceModel, draws: Draws, sets: list[Times], particles: int, factor: float = 1.0
) -> NDArray[np.float64]:
    """The penalties of sets, (D, S, T+1): errors with and without them."""
    settings, ends = with_truth(particles), [draws.instants[-1]] * len(sets)
    each = (settings, replace(settings, penalty=factor))
    without, errors = (
        filter_checked_sets(model, draws, sets, ends, 3, settings, EACH_DRAW).errors
        for settings in each
    )
    return errors - without


@pytest.mark.parametrize(
    ("model", "times"),
    [
        (lambda: load_model("ungm"), EVERY),
        (lambda: load_model("ungm"), (0, 3, 4)),
        (lambda: load_model("robot"), EVERY),  # z is an angle
        (SYSTEMS[0].as_model, tuple(3 * t + t % 3 for t in EVERY)),
        (lambda: batched(load_model("ungm")), EVERY),
    ],
    ids=["scalar", "some", "angle", "three sensors", "batched"],
)
def test_it_is_that_of_the_plain_filter(model: Callable[[], StateSpaceModel], times: Times) -> None:
    each = model()
    draws = simulate(each, HORIZON, range(5, 9), 17)
    expected = penalties(each, draws, times, 3, with_truth(70))
    for factor in (1.0, -2.0):
        own = found(each, draws, [times], 70, factor)[:, 0]
        np.testing.assert_allclose(own, factor * expected, rtol=1e-6, atol=1e-9)
    assert ((expected != 0.0).sum(axis=1) == len(times)).all()


def test_it_depends_neither_on_other_draws_nor_on_other_sets(ungm: StateSpaceModel) -> None:
    draws = simulate(ungm, HORIZON, range(70), 1)
    sets = [EVERY, (0, 1, 2), (0, 1, 5), (0, 1, 2, 6), ()]
    together = found(ungm, draws, sets, 50)
    for number, times in enumerate(sets):
        for some in (slice(0, 1), slice(17, 20), slice(3, 70)):
            alone = found(ungm, draws[some], [times], 50)[:, 0]
            np.testing.assert_array_equal(alone, together[some, number])


def test_only_the_last_measurement_of_an_instant_has_one() -> None:
    model = SYSTEMS[0].as_model()
    draws = simulate(model, HORIZON, range(4), 1)
    penalty = found(model, draws, [(3, 4, 5, 9, 11), (3, 4, 5), (3, 4)], 2000)
    assert (np.count_nonzero(penalty, axis=2) == [2, 1, 1]).all()
    np.testing.assert_array_equal(penalty[:, 0, 1], penalty[:, 1, 1])
    assert (penalty[:, 1, 1] != penalty[:, 2, 1]).all()


@pytest.mark.parametrize("particles", [2, 10, pytest.param(100, marks=pytest.mark.slow)])
def test_its_mean_is_0_for_every_strategy(ungm: StateSpaceModel, particles: int) -> None:
    """Given the cloud as a set, a particle's measurement has the law of the true one.

    So its mean is 0 at each instant, also over the draws in which earlier measurements decide to
    measure. Particles lie in the order of their ancestors: with the particles behind the truth in
    the place of random ones, the mean was 6 standard errors from 0.
    """
    draws = simulate(ungm, 20, range(40_000), 1)
    every = tuple(range(21))
    penalty = found(ungm, draws, [every], particles)[:, 0]
    earlier = np.roll(draws.y[..., 0], 1, axis=1)
    for measured in (np.ones(earlier.shape, bool), earlier < 2.0, np.abs(earlier - 8.0) < 5.0):
        counted = np.where(measured, penalty, 0.0)[:, 1:]
        errors = counted.std(axis=0) / np.sqrt(len(counted))
        assert (np.abs(counted.mean(axis=0)) < 3.5 * errors).all()
        mean = counted.mean(axis=1)
        assert abs(mean.mean()) < 3.5 * mean.std() / np.sqrt(len(mean))
    assert penalty.std() > 4.0
