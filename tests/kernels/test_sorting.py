"""Particles in line by their states: against the plain twin, and what makes it a line."""

import numpy as np
import pytest

from pfdist.kernels.noise import padded
from pfdist.kernels.resampling import SPARE
from pfdist.kernels.sorting import DIGITS, LEVELS, SortingScratch, plain_order, sort_by_state
from pfdist.kernels.weights import width

RNG = np.random.default_rng(3)
GUARD = 99
NORMAL = RNG.normal(size=500)
CLOUDS = {  # states and weights
    "normal": (NORMAL, RNG.random(500)),
    "two humps": (NORMAL + 20 * (RNG.random(500) < 0.4), RNG.random(500) ** 20),
    "far away": (1e9 + NORMAL, RNG.random(500)),
    "one very far": (np.where(np.arange(500) == 77, 1e12, NORMAL), np.ones(500)),
    "one very far without a weight": (
        np.where(np.arange(500) == 77, -1e12, NORMAL),
        np.arange(500) != 77,
    ),
    "ties": (RNG.integers(0, 5, 300).astype(float), RNG.random(300)),
    "all alike": (np.full(40, 2.5), np.ones(40)),
    "in line": (np.arange(70.0), np.ones(70)),
    "the other way round": (-np.arange(70.0), np.ones(70)),
    "not finite": (np.r_[np.nan, NORMAL, np.inf, -np.inf], np.r_[0.0, np.ones(500), 1.0, 1.0]),
    "none has a weight": (NORMAL, np.zeros(500)),
    "one has a weight": (NORMAL, np.eye(500)[9]),
    "huge": (1e308 * np.sign(NORMAL), np.ones(500)),
    "tiny": (5e-324 * np.arange(30.0), np.ones(30)),
}


def in_line(state, weight):
    """States, weights and order that the compiled sort gives, with arrays of the least length."""
    count, size = state.size, width(state.size)
    cloud = np.full((2, 1, size), 7.0)
    cloud[0, 0, :count] = state
    weights = np.zeros((2, size), np.float32)
    weights[1, :count] = weight
    arrays = [np.full(2 * DIGITS + padded(1), GUARD, np.uint32)]
    arrays += [np.full(padded(count + SPARE) + padded(1), GUARD, np.uint32) for _ in range(3)]
    counts = arrays[0][: 2 * DIGITS].reshape(2, DIGITS)
    keys, half_sorted, order = (array[: -padded(1)] for array in arrays[1:])
    scratch = SortingScratch(np.empty(size), counts, keys, half_sorted, order)
    half = sort_by_state(cloud, 0, count, weights, 1, scratch)
    assert half == 1
    assert all((array[-padded(1) :] == GUARD).all() for array in arrays)
    assert (weights[0] == 0).all()
    assert (weights[1, count:] == 0).all()
    return cloud[1, 0, :count], weights[1, :count], order[:count]


@pytest.mark.parametrize("name", CLOUDS)
def test_compiled_and_plain_order_agree_and_weights_go_with_their_states(name):
    state, weight = CLOUDS[name][0], np.asarray(CLOUDS[name][1], np.float32)
    states, weights, order = in_line(state, weight)
    np.testing.assert_array_equal(order, plain_order(state, weight))
    assert sorted(order) == list(range(state.size))
    np.testing.assert_array_equal(states, state[order])
    np.testing.assert_array_equal(weights, weight[order])


@pytest.mark.parametrize("particles", [1, 2, 3, 15, 16, 17, 64, 65, 1000, 30_000])
def test_states_stand_in_line_but_for_less_than_a_level(particles):
    rng = np.random.default_rng(particles)
    state = rng.normal(size=particles) * 10.0 ** rng.integers(-3, 4)
    states, _, order = in_line(state, rng.random(particles) + 0.1)
    level = np.ptp(state) / (LEVELS - 1)
    assert (np.diff(states) > -level * (1 + 1e-9)).all()
    # Those of one level stand as they stood.
    alike = np.flatnonzero(np.diff(states) < 0)
    assert (np.diff(order.astype(int))[alike] > 0).all()


def test_many_draws_are_sorted_each_for_itself():
    state, weight = RNG.normal(size=(3, 50)), RNG.random((3, 50))
    each = [plain_order(s, w) for s, w in zip(state, weight, strict=True)]
    np.testing.assert_array_equal(plain_order(state, weight), each)
