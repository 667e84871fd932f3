"""The penalty of a measurement: against its plain twin, and its mean of exactly 0."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from oracles.batched import batched
from oracles.replicated import penalties
from oracles.three_sensors import SYSTEMS
from pfdist import StateSpaceModel, load_model
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import with_truth

HORIZON = 6


def found(
    model: StateSpaceModel, draws: Draws, particles: int, number: int = 3
) -> np.ndarray[tuple[int, int, int], np.dtype[np.float64]]:
    settings = replace(with_truth(particles), replicates=number)
    every = range(model.points.first(draws.instants.stop))
    return filter_checked_sets(
        model, draws, [tuple(every)], [draws.instants[-1]], 3, settings
    ).penalty


@pytest.mark.parametrize(
    "model",
    [
        lambda: load_model("ungm"),
        lambda: load_model("robot"),  # z is an angle
        SYSTEMS[0].as_model,
        lambda: batched(load_model("ungm")),
    ],
    ids=["scalar", "angle", "three sensors", "batched"],
)
def test_it_is_that_of_the_plain_filter(model: Callable[[], StateSpaceModel]) -> None:
    each = model()
    draws = simulate(each, HORIZON, range(5, 9), 17)
    expected = penalties(each, draws, 3, replace(with_truth(70), replicates=3))
    np.testing.assert_allclose(found(each, draws, 70), expected, rtol=1e-6, atol=1e-9)
    assert (expected != 0.0).all()


def test_it_does_not_depend_on_other_draws(ungm: StateSpaceModel) -> None:
    draws = simulate(ungm, HORIZON, range(70), 1)
    together = found(ungm, draws, 50)
    for some in (slice(0, 1), slice(17, 20), slice(3, 70)):
        np.testing.assert_array_equal(found(ungm, draws[some], 50), together[some])


@pytest.mark.parametrize("particles", [2, 10, pytest.param(100, marks=pytest.mark.slow)])
def test_its_mean_is_0_for_every_strategy(ungm: StateSpaceModel, particles: int) -> None:
    """Given the cloud as a set, a particle's measurement has the law of the true one.

    So its mean is 0 at each instant, also over the draws in which earlier measurements decide to
    measure. Particles lie in the order of their ancestors: with the particles behind the truth in
    the place of random ones, the mean was 6 standard errors from 0.
    """
    draws = simulate(ungm, 20, range(40_000), 1)
    penalty = found(ungm, draws, particles, 1 if particles == 2 else 5)[..., 0]
    earlier = np.roll(draws.y[..., 0], 1, axis=1)
    for measured in (np.ones(earlier.shape, bool), earlier < 2.0, np.abs(earlier - 8.0) < 5.0):
        counted = np.where(measured, penalty, 0.0)[:, 1:]
        errors = counted.std(axis=0) / np.sqrt(len(counted))
        assert (np.abs(counted.mean(axis=0)) < 3.5 * errors).all()
        every = counted.mean(axis=1)
        assert abs(every.mean()) < 3.5 * every.std() / np.sqrt(len(every))
    assert penalty.std() > 5.0
