"""Weights from log-weights, and their sums, against NumPy."""

import numpy as np
import pytest

from pfdist.kernels.weights import cumulate, weigh, weighted_mean, weighted_variance

SIZES = [1, 2, 3, 4, 5, 63, 64, 500]


def weights_of(log_weights):
    weight = np.empty(len(log_weights))
    weigh(np.array(log_weights, dtype=float), weight)
    return weight


def test_weights_are_the_exponentials_with_the_largest_taken_out():
    log_weight = -np.linspace(0, 699, 20_001)[::-1] + 1000  # their exponentials overflow
    exact = np.exp(log_weight - log_weight.max())
    np.testing.assert_allclose(weights_of(log_weight), exact, rtol=1e-15 * 4)  # 4 roundings


@pytest.mark.parametrize("impossible", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_impossible(impossible):
    assert weights_of([impossible, -1.0, -1.0 - np.log(4), impossible]) == pytest.approx(
        [0, 1, 0.25, 0]
    )
    assert weights_of([impossible] * 3).tolist() == [0, 0, 0]
    assert weights_of([impossible, np.nan, -np.inf, np.inf]).tolist() == [0, 0, 0, 0]


def test_a_weight_far_below_the_largest_is_zero_and_no_weight_is_negative():
    assert weights_of([0.0, -699.0, -701.0, -1e9, -1e299]).tolist()[2:] == [0, 0, 0]


@pytest.mark.parametrize("size", SIZES)
def test_cumulative_weights(size):
    weight, cumulative = np.random.default_rng(size).random(size), np.empty(size)
    total = cumulate(weight, cumulative)
    np.testing.assert_allclose(cumulative, np.cumsum(weight), rtol=size * 1e-16)
    assert total == cumulative[-1]
    assert (np.diff(cumulative) >= 0).all()


def test_a_weight_of_zero_leaves_the_cumulative_weight_as_it_is():
    # so it is no point's ancestor, whatever the stretch it lies in
    weight = np.random.default_rng(1).random(100) * (np.arange(100) % 3 == 0)
    cumulative = np.empty(100)
    cumulate(weight, cumulative)
    np.testing.assert_array_equal(np.diff(cumulative)[weight[1:] == 0], 0)


@pytest.mark.parametrize("size", SIZES)
def test_moments(size):
    rng = np.random.default_rng(size)
    values, weight = rng.normal(3, 2, size), rng.random(size)
    mean = weighted_mean(values, weight, weight.sum())
    variance = weighted_variance(values, weight, weight.sum(), mean)
    exact = np.average(values, weights=weight)
    assert mean == pytest.approx(exact, rel=1e-13)
    assert variance == pytest.approx(np.average((values - exact) ** 2, weights=weight), abs=1e-13)
