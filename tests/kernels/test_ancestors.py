"""Weights and ancestors on vectors: the bits of plain NumPy, and unbiased numbers of children."""

import numpy as np
import pytest

from oracles import keyed
from oracles.in_turn import in_turn
from pfdist.kernels.ancestors import ancestors_of, weights_of
from pfdist.kernels.schemes import ALL_SCHEMES

STREAM, KEY = 0xFEDCBA9876543210, 5
SIZES = (1, 2, 15, 16, 17, 100, 500, 1000)


def log_weights(draws, particles):
    return np.random.default_rng(particles).normal(scale=2.0, size=(draws, particles))


@in_turn("particles", SIZES)
def test_weights_have_the_bits_of_the_reference(particles):
    values = log_weights(3, particles)
    values[1, particles // 2] = -np.inf
    values[2] -= 400.0
    expected = [keyed.weights(row) for row in values]
    np.testing.assert_array_equal(weights_of(values), expected)


def test_only_finite_log_weights_count():
    values = np.array([[0.0, np.nan, np.inf, -np.inf, -1.0], [np.nan] * 5, [-1e308] * 5])
    weight = weights_of(values)
    np.testing.assert_array_equal(weight[0, 1:4], 0.0)
    np.testing.assert_allclose(weight[0, [0, 4]], [1.0, np.exp(-1.0)], rtol=1e-6)
    np.testing.assert_array_equal(weight[1], 0.0)  # the draw is degenerate
    np.testing.assert_array_equal(weight[2], 1.0)


@pytest.mark.parametrize("scheme", ALL_SCHEMES)
@pytest.mark.parametrize("particles", SIZES)
def test_ancestors_have_the_bits_of_the_reference(scheme, particles):
    """Five draws at a time, two of which are merged side by side."""
    weight = weights_of(log_weights(5, particles))
    got = ancestors_of(scheme, weight, STREAM, range(3, 8), KEY)
    for row, draw in enumerate(range(3, 8)):
        expected = keyed.ancestors(scheme, weight[row].astype(np.float32), STREAM, draw, KEY)
        np.testing.assert_array_equal(got[row], expected)


@pytest.mark.parametrize("scheme", ALL_SCHEMES)
def test_ancestors_do_not_depend_on_other_draws(scheme):
    weight = weights_of(log_weights(7, 100))
    together = ancestors_of(scheme, weight, STREAM, range(7), KEY)
    alone = [ancestors_of(scheme, weight[[d]], STREAM, range(d, d + 1), KEY)[0] for d in range(7)]
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("scheme", ALL_SCHEMES)
def test_the_number_of_children_is_unbiased(scheme):
    """4,000 draws of 20 particles: means within 4.5 standard errors (Douc, Cappe, Moulines 2005).

    The largest of 20 normal deviates exceeds 4.5 with a probability below 2e-4.
    """
    weight = np.tile(weights_of(log_weights(1, 20)), (4_000, 1))
    ancestors = ancestors_of(scheme, weight, 99, range(4_000), KEY)
    children = np.stack([np.bincount(row, minlength=20) for row in ancestors])
    share = weight[0] / weight[0].sum()
    expected = 20 * share
    if scheme == "conditional":
        expected = 19 * share + np.eye(20)[0]
    error = children.std(axis=0) / len(children) ** 0.5
    # A particle that always has the same number of children: the whole part of its share.
    np.testing.assert_array_less(np.abs(children.mean(axis=0) - expected), 4.5 * error + 1e-3)


@pytest.mark.parametrize("scheme", ["systematic", "stratified"])
def test_the_number_of_children_is_near_its_expectation(scheme):
    """Systematic: at most one away; stratified: below two."""
    weight = weights_of(log_weights(200, 50))
    ancestors = ancestors_of(scheme, weight, STREAM, range(200), KEY)
    children = np.stack([np.bincount(row, minlength=50) for row in ancestors])
    apart = children - 50 * weight / weight.sum(axis=1, keepdims=True)
    assert np.abs(apart).max() < {"systematic": 1.0, "stratified": 2.0}[scheme] + 1e-4
