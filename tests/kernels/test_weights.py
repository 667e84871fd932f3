"""Weights from log-weights, and their sums, against exact exponentials and exact sums."""

import math

import numpy as np
import pytest

from pfdist.kernels import weights
from pfdist.kernels.weights import IMPOSSIBLE, cumulate, plain_weights, weigh, width

GUARD = -7.0


def weights_of(log_weights):
    """As in the filter: one row of two, as long as `width` says, IMPOSSIBLE behind the last."""
    count = len(log_weights)
    padded = np.full(width(count), IMPOSSIBLE)
    padded[:count] = log_weights
    weight = np.full((2, padded.size), GUARD, np.float32)
    assert weigh(padded, weight, 1)
    assert (weight[0] == GUARD).all()
    assert not weight[1, count:].any()
    return weight[1, :count]


def cumulated(weight, behind=0):
    """Cumulative weights and their total; there are other rows, and more behind the count."""
    rows = np.full((3, weight.size + behind), 1e6, np.float32)
    rows[1, : weight.size] = weight
    cumulative = np.full(weight.size + behind, GUARD)
    total = cumulate(rows, 1, weight.size, cumulative)
    assert (cumulative[weight.size :] == GUARD).all()
    return cumulative[: weight.size], total


# Their exponentials over- or underflow.
@pytest.mark.parametrize("highest", [0.0, 1000.0, -1000.0])
def test_weights_are_the_exponentials_with_the_largest_taken_out(highest):
    log_weight = highest - np.linspace(0, 86.99, 20_001)[::-1]
    excess = log_weight - log_weight.max()
    # The excess is rounded to float32, by 2^-24 of it at most; the polynomial is within 1.2e-7.
    error = -excess * 2.0**-24 + 1.2e-7
    assert (np.abs(weights_of(log_weight) / np.exp(excess) - 1) < error).all()


def test_the_polynomial_is_the_exponential():
    x = -np.concatenate([np.linspace(0, 2, 10**6), np.linspace(2, 87, 10**6)]).astype(np.float32)
    assert (np.abs(weights._exp(x) / np.exp(x.astype(float)) - 1) < 1.2e-7).all()


@pytest.mark.parametrize("highest", [0.0, 12.34, -1e9, 1e300, -1e300])
def test_the_largest_weight_is_one(highest):
    assert weights_of([highest, highest - 1e293, highest]).tolist() == [1, 0, 1]


def test_a_weight_far_below_the_largest_is_zero():
    given = weights_of([5.0, 5 - 86.9, 5 - 87.0, 5 - 87.1, -1e9, -1e300])
    assert given[:2].all()
    assert not given[2:].any()


def test_what_is_impossible_has_no_weight():
    assert weights_of([IMPOSSIBLE, -1.0, -1.0 - math.log(4), IMPOSSIBLE]) == pytest.approx(
        [0, 1, 0.25, 0], rel=2.4e-7
    )


@pytest.mark.parametrize("count", [1, 2, 16, 17, 500])
def test_where_each_is_impossible_the_weights_stay_as_they_are(count):
    """The filter leaves the measurement out, and keeps the weights that it had before."""
    weight = np.full((2, width(count)), GUARD, np.float32)
    assert not weigh(np.full(width(count), IMPOSSIBLE), weight, 1)
    assert (weight == GUARD).all()


@pytest.mark.parametrize("impossible", [np.nan, np.inf, -np.inf])
def test_in_the_plain_twin_what_is_not_finite_is_impossible(impossible):
    # `weigh` is given IMPOSSIBLE for it already.
    log_weight = np.array([[impossible, -1.0, -2.0], [impossible] * 3])
    expected = [weights_of([IMPOSSIBLE, -1.0, -2.0]), [0, 0, 0]]
    np.testing.assert_array_equal(plain_weights(log_weight), expected)


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 64, 65, 500, 1000])
def test_compiled_and_plain_weights_agree_to_the_last_bit(count):
    rng = np.random.default_rng(count)
    for highest, spread in ((0.0, 1.0), (-3.7, 30.0), (1e5, 200.0), (-1e12, 1e3), (0.0, 1e-6)):
        log_weight = highest - spread * rng.random((20, count))
        log_weight[:, 1:][rng.random((20, count - 1)) < 0.1] = IMPOSSIBLE  # never all of a row
        compiled = np.array([weights_of(row) for row in log_weight])
        assert compiled.tobytes() == plain_weights(log_weight).astype(np.float32).tobytes()


@pytest.mark.parametrize("count", [4, 8, 12, 16, 64, 500, 1000, 4096])
@pytest.mark.parametrize("behind", [0, 3])
def test_cumulative_weights_are_the_sums(count, behind):
    weight = np.random.default_rng(count).random(count, np.float32)
    cumulative, total = cumulated(weight, behind)
    exact = [math.fsum(weight[: i + 1].tolist()) for i in range(count)]
    # A quarter of the terms one after another, then three totals: each addition rounds once.
    np.testing.assert_allclose(cumulative, exact, rtol=(count / 4 + 3) * 2.0**-53)
    assert total == cumulative[-1]
    assert (np.diff(cumulative) >= 0).all()


def test_a_weight_of_zero_leaves_the_cumulative_weight_as_it_is():
    # so it is no point's ancestor, whatever the stretch it lies in
    weight = np.random.default_rng(1).random(100, np.float32) * (np.arange(100) % 3 == 0)
    cumulative, _ = cumulated(weight)
    np.testing.assert_array_equal(np.diff(cumulative)[weight[1:] == 0], 0)


def test_no_weights_add_up_to_nothing():
    cumulative, total = cumulated(np.zeros(64, np.float32))
    assert total == 0
    assert not cumulative.any()
