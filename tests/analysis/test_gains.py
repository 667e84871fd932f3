"""Gains and their intervals (paper, section 3)."""

import numpy as np
import pytest

from pfdist.analysis import relative_gain, summarise_gain


def test_gains_of_a_small_example_by_hand() -> None:
    mse, reference = np.array([1.0, 3.0, 2.0]), np.array([2.0, 2.0, 2.0])
    np.testing.assert_allclose(relative_gain(mse, reference), [0.5, -0.5, 0.0])
    summary = summarise_gain(mse, reference)
    assert summary.mean_relative_gain == pytest.approx(0.0)
    assert summary.positive_fraction == pytest.approx(1 / 3)
    assert summary.gain_of_means == pytest.approx(0.0)
    assert summary.quantiles[0.5] == pytest.approx(0.0)


def test_a_draw_degenerate_with_either_set_is_left_out() -> None:
    mse, reference = np.array([1.0, np.nan, 1.0]), np.array([2.0, 2.0, np.nan])
    summary = summarise_gain(mse, reference)
    assert (summary.draws, summary.mean_relative_gain, summary.gain_of_means) == (1, 0.5, 0.5)


def test_wilson_interval_by_its_closed_form() -> None:
    n, k, z = 400, 350, 1.959963984540054
    reference = np.ones(n)
    mse = np.where(np.arange(n) < k, 0.5, 1.5)
    p = k / n
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    interval = summarise_gain(mse, reference).positive_fraction_interval
    assert interval == pytest.approx((centre - half, centre + half))


def test_the_interval_of_the_mean_covers_as_often_as_it_says() -> None:
    rng, runs, covered = np.random.default_rng(1), 1000, 0
    for _ in range(runs):
        gain = rng.normal(0.25, 0.3, 50)
        low, high = summarise_gain(1 - gain, np.ones(50)).mean_relative_gain_interval
        covered += low < 0.25 < high
    # binomial around 95 %: sd 0.7 %
    assert abs(covered / runs - 0.95) < 4 * np.sqrt(0.95 * 0.05 / runs)


def test_no_draws_give_no_figures() -> None:
    summary = summarise_gain(np.array([np.nan]), np.array([1.0]))
    assert summary.draws == 0
    assert np.isnan(summary.mean_relative_gain)


def test_an_infinite_error_makes_the_mean_infinite_and_the_fraction_count_it() -> None:
    summary = summarise_gain(np.array([1.0, np.inf]), np.array([2.0, 2.0]))
    assert summary.mean_relative_gain == summary.gain_of_means == -np.inf
    assert summary.positive_fraction == 0.5
