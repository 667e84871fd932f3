"""Gains and their intervals (paper, section 3)."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

from oracles.in_turn import in_turn
from pfdist.filters.estimate import Evaluation
from pfdist.results import (
    BIN,
    EDGES,
    ComparisonStatistics,
    Gain,
    Moments,
    relative_gain,
)
from pfdist.results.moments import QUANTILES, disagree
from pfdist.results.particle_loss import top_percent_share

Array = np.ndarray


class Figures:
    """The columns of a gain as attributes, with intervals as pairs."""

    def __init__(self, gain: Gain) -> None:
        self._columns = gain.columns()

    def __getattr__(self, name: str) -> Any:
        if name.endswith("_interval"):
            start = name.removesuffix("_interval")
            return self._columns[f"{start}_low"], self._columns[f"{start}_high"]
        return self._columns[name]


def figures_of(mse: Array, reference: Array) -> Figures:
    return Figures(Gain.of_draws(mse, reference))


def test_a_draw_degenerate_with_either_set_is_left_out() -> None:
    mse, reference = np.array([1.0, np.nan, 1.0]), np.array([2.0, 2.0, np.nan])
    summary = figures_of(mse, reference)
    assert (summary.gain_draws, summary.mean_relative_gain, summary.gain_of_means) == (1, 0.5, 0.5)


def test_wilson_interval_by_its_closed_form() -> None:
    n, k, z = 400, 350, 1.959963984540054
    reference = np.ones(n)
    mse = np.where(np.arange(n) < k, 0.5, 1.5)
    p = k / n
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    interval = figures_of(mse, reference).positive_fraction_interval
    assert interval == pytest.approx((centre - half, centre + half))


def test_intervals_cover_as_often_as_they_say() -> None:
    rng, runs = np.random.default_rng(2), 400
    covariance = [[4.0, 2.0], [2.0, 9.0]]  # the mean of 30 references errs by a quarter
    covered = np.zeros(2)
    for _ in range(runs):
        of_mean = figures_of(1 - rng.normal(0.25, 0.3, 50), np.ones(50))
        low, high = of_mean.mean_relative_gain_interval
        covered[0] += low < 0.25 < high
        mse, reference = rng.multivariate_normal([1.6, 2.0], covariance, 30).T
        low, high = figures_of(mse, reference).gain_of_means_interval
        covered[1] += low < 0.2 < high
    # binomial around 95 %: sd 1.1 %
    assert (abs(covered / runs - 0.95) < 4 * np.sqrt(0.95 * 0.05 / runs)).all()


def test_the_gain_of_means_interval_ends_where_a_paired_test_says_so() -> None:
    # Fieller, 1954: the ratios r for which the mean of mse - r reference may be 0.
    rng = np.random.default_rng(1)
    reference = rng.lognormal(3, 1, 40)
    mse = reference * rng.lognormal(-0.3, 0.4, 40)
    for gain in figures_of(mse, reference).gain_of_means_interval:
        assert stats.ttest_1samp(mse - (1 - gain) * reference, 0.0).pvalue == pytest.approx(0.05)


def test_a_reference_that_may_be_0_bounds_no_gain_of_means() -> None:
    mse, reference = np.array([1.0, 2.0, 3.0]), np.array([-1.0, 0.1, 1.0])
    assert figures_of(mse, reference).gain_of_means_interval == (-np.inf, np.inf)
    assert figures_of(np.ones(3), np.zeros(3)).gain_of_means == -np.inf


def test_a_set_gains_nothing_over_the_very_same() -> None:
    mse = np.random.default_rng(1).lognormal(3, 1, 100)
    summary = figures_of(mse, mse)
    assert summary.gain_of_means_interval == pytest.approx((0.0, 0.0), abs=1e-12)
    assert summary.mean_log10_ratio_interval == (0.0, 0.0)


def test_the_log_ratio_of_a_lognormal_is_its_mean_and_changes_sign_with_the_two() -> None:
    rng = np.random.default_rng(3)
    reference = rng.lognormal(3, 1, 5000)
    mse = reference * 10 ** rng.normal(-0.15, 0.2, 5000)
    there, back = figures_of(mse, reference), figures_of(reference, mse)
    assert abs(there.mean_log10_ratio + 0.15) < 4 * 0.2 / np.sqrt(5000)
    low, high = there.mean_log10_ratio_interval
    half = stats.t.ppf(0.975, 4999) * 0.2 / np.sqrt(5000)
    assert (high - low) / 2 == pytest.approx(half, rel=4 / np.sqrt(2 * 5000))
    assert back.mean_log10_ratio == pytest.approx(-there.mean_log10_ratio)
    assert back.mean_log10_ratio_interval == pytest.approx((-high, -low))


def test_no_draws_give_no_figures() -> None:
    summary = figures_of(np.array([np.nan]), np.array([1.0]))
    assert summary.gain_draws == 0
    assert np.isnan(summary.mean_relative_gain)
    assert np.isnan(summary.gain_of_means_interval).all()
    summary = figures_of(np.array([1.0]), np.array([2.0]))
    assert (summary.gain_draws, summary.gain_of_means, summary.mean_log10_ratio) == (
        1,
        0.5,
        np.log10(0.5),
    )
    assert np.isnan([*summary.gain_of_means_interval, *summary.mean_log10_ratio_interval]).all()


def _blocks(values: Array, size: int) -> list[Array]:
    return [values[first : first + size] for first in range(0, len(values), size)]


GAINS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "normal": lambda rng, count: rng.normal(0.25, 0.2, count).clip(max=1),
    "skew": lambda rng, count: (1 - rng.lognormal(-0.5, 0.8, count)).clip(min=-9),
    "atoms": lambda rng, count: rng.choice([-0.5, 0.0, 0.125, 1.0], count),
    "uniform": lambda rng, count: rng.uniform(-1, 1, count),
}


@in_turn("shape", GAINS)
@in_turn(
    ("count", "size"), [(2, 1), (3, 1), (17, 1), (17, 7), (1000, 7), (1000, 1000), (40_000, 10_000)]
)
def test_blocks_give_what_numpy_and_scipy_give_on_the_whole(
    shape: str, count: int, size: int
) -> None:
    rng = np.random.default_rng(count)
    reference = rng.lognormal(3, 1, count)
    mse = reference * (1 - GAINS[shape](rng, count))
    gain, accumulated = 1 - mse / reference, Gain()
    for a, b in zip(_blocks(mse, size), _blocks(reference, size), strict=True):
        accumulated.add(a, b)
    np.testing.assert_array_equal(relative_gain(mse, reference), gain)
    known, close = Figures(accumulated), {"rtol": 1e-12, "atol": 1e-12}
    np.testing.assert_allclose(known.mean_relative_gain, gain.mean(), **close)
    np.testing.assert_allclose(accumulated.relative.standard_error, stats.sem(gain), **close)
    np.testing.assert_allclose(accumulated.errors.x.standard_error, stats.sem(mse), **close)
    np.testing.assert_allclose(known.gain_of_means, 1 - mse.mean() / reference.mean(), **close)
    at_once = figures_of(mse, reference)
    np.testing.assert_allclose(
        known.gain_of_means_interval, at_once.gain_of_means_interval, rtol=1e-9, atol=1e-9
    )
    covariance = accumulated.errors.products / (count - 1)
    scale = np.std(mse) * np.std(reference)
    assert abs(covariance - np.cov(mse, reference)[0, 1]) <= 1e-12 * scale
    if (gain < 1).all():  # else an error is 0
        ratios = np.log10(mse / reference)
        np.testing.assert_allclose(known.mean_log10_ratio, ratios.mean(), **close)
        np.testing.assert_allclose(
            accumulated.log10_ratio.standard_error, stats.sem(ratios), **close
        )
    if gain.std():
        whole = stats.ttest_1samp(gain, 0.0).confidence_interval(0.95)
        np.testing.assert_allclose(known.mean_relative_gain_interval, whole, rtol=1e-9, atol=1e-12)
    assert known.gain_draws == count
    assert known.positive_fraction == np.mean(gain > 0)
    assert known.gain_quantile_50 == accumulated.quantile(0.5)
    for share in (0.001, *QUANTILES, 0.999):
        assert abs(accumulated.quantile(share) - np.quantile(gain, share)) <= BIN, share


def test_the_same_blocks_in_the_same_order_give_the_same_bits() -> None:
    values = np.random.default_rng(1).lognormal(0, 3, (5000, 3))
    first, second = ComparisonStatistics(["a", "b", "c"]), ComparisonStatistics(["a", "b", "c"])
    for block in _blocks(values, 100):
        first.add(block)
        second.add(block.copy(order="F"))
    assert first.mse == second.mse
    for name, gain in first.gains.items():
        assert gain.columns() == second.gains[name].columns()


def test_each_set_of_a_comparison_gains_over_its_own_reference() -> None:
    values = np.random.default_rng(1).lognormal(0, 1, (1000, 4))
    values[7, 1] = np.nan
    by_default = ComparisonStatistics(["a", "b", "c", "d"])
    chosen = ComparisonStatistics(["a", "b", "c", "d"], references={"b": "a", "d": "c"})
    for block in _blocks(values, 1000):
        by_default.add(block)
        chosen.add(block)
    columns = dict(zip("abcd", values.T, strict=True))
    for statistics, references in (
        (by_default, {"b": "a", "c": "a", "d": "a"}),
        (chosen, {"b": "a", "d": "c"}),
    ):
        expected = {
            name: Gain.of_draws(columns[name], columns[other]).columns()
            for name, other in references.items()
        }
        assert {name: each.columns() for name, each in statistics.gains.items()} == expected
    assert expected["b"]["gain_draws"] == 999


def test_the_histogram_is_numpys_and_what_lies_outside_is_counted_apart() -> None:
    gain = np.concatenate([np.random.default_rng(1).uniform(-12, 1.5, 9999), [-np.inf]])
    accumulated = Gain()
    for block in _blocks(1 - gain, 100):
        accumulated.add(block, np.ones(len(block)))
    gain = 1 - (1 - gain)  # as it is computed
    np.testing.assert_array_equal(accumulated.counts, np.histogram(gain, EDGES)[0])
    assert accumulated.below == np.sum(gain < -10) > 1000
    assert accumulated.above == np.sum(gain > 1) > 300
    assert accumulated.counts.sum() + accumulated.below + accumulated.above == 10_000
    assert accumulated.quantile(0.1) == -np.inf
    assert accumulated.quantile(0.99) == np.inf


@pytest.mark.parametrize("below", [0, 30])
@pytest.mark.parametrize("above", [0, 70])
def test_draws_without_any_gain_have_the_quantile_0_exactly(below: int, above: int) -> None:
    """As `numpy.quantile` gives it, also if other gains share the histogram's bin of 0."""
    rng = np.random.default_rng(1)
    gain = np.r_[np.zeros(900), -rng.uniform(0, BIN, below), rng.uniform(0, 2 * BIN, above)]
    accumulated = Gain()
    for block in np.array_split(rng.permutation(gain), 7):
        accumulated.add(1.0 - block, np.ones(block.size))
    quantiles = {share: accumulated.quantile(share) for share in (0.05, 0.25, 0.5, 0.75, 0.9)}
    assert quantiles == dict.fromkeys(quantiles, 0.0)
    for share in (0.01, 0.96, 0.999):
        expected = np.quantile(gain, share)
        assert accumulated.quantile(share) == pytest.approx(expected, abs=BIN)
        assert (accumulated.quantile(share) == 0.0) == (expected == 0.0)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_an_infinite_error_in_any_block_makes_the_mean_infinite_and_the_fraction_counts_it(
    place: int,
) -> None:
    mse = np.array([1.0, 1.5, 0.5])
    mse[place] = np.inf
    gain = Gain()
    for value in mse:
        gain.add(np.array([value]), np.array([2.0]))
    summary = Figures(gain)
    assert summary.mean_relative_gain == summary.gain_of_means == -np.inf
    assert summary.mean_log10_ratio == np.inf
    assert summary.positive_fraction == 2 / 3
    intervals = summary.mean_relative_gain_interval, summary.gain_of_means_interval
    assert np.isnan([*intervals, summary.mean_log10_ratio_interval]).all()


def test_errors_whose_squares_are_too_large_for_a_number_are_no_exception() -> None:
    moments = Moments()
    for value in (1e200, 2e200):
        moments.add(np.array([value, value]))
    assert moments.mean == pytest.approx(1.5e200)
    assert not np.isfinite(moments.standard_error)


def test_that_the_two_gains_disagree_is_known_where_their_intervals_are_apart() -> None:
    rng = np.random.default_rng(1)
    # One draw in five has a hundred times the error, and gains; the others lose.
    reference = np.where(rng.random(4000) < 0.2, 100.0, 1.0)
    mse = np.where(reference > 1, 0.7 * reference, 1.2) * rng.uniform(0.9, 1.1, 4000)
    skewed = figures_of(mse, reference)
    assert skewed.mean_relative_gain < 0 < skewed.gain_of_means
    assert skewed.gains_disagree
    alike = figures_of(0.8 * reference * rng.uniform(0.9, 1.1, 4000), reference)
    assert not alike.gains_disagree
    few = figures_of(mse[:3], reference[:3])
    assert not few.gains_disagree
    assert not figures_of(np.ones(1), np.ones(1)).gains_disagree


@in_turn(
    ("relative", "means", "apart"),
    [
        ((-0.02, -0.01), (0.01, 0.02), True),  # opposite signs
        ((0.01, 0.02), (-0.02, -0.01), True),
        ((-0.01, 0.02), (0.001, 0.03), True),  # one contains 0, and both overlap
        ((0.001, 0.03), (-0.01, 0.02), True),
        ((-0.03, -0.001), (-0.02, 0.01), True),
        ((-0.04, 0.02), (-0.01, 0.05), False),  # -.01 and .02 by chance: neither has a sign
        ((0.15, 0.17), (0.18, 0.20), False),  # apart by 3 points
        ((0.09, 0.11), (0.18, 0.20), True),
        ((0.05, 0.20), (0.10, 0.30), False),  # 7.5 points apart by chance
        ((math.nan, math.nan), (0.1, 0.2), False),
        ((0.1, 0.2), (-math.inf, math.inf), False),
    ],
)
def test_two_gains_disagree_where_one_has_another_sign_or_only_one_has_a_sign(
    relative: tuple[float, float], means: tuple[float, float], apart: bool
) -> None:
    def middle(interval: tuple[float, float]) -> float:
        return sum(interval) / 2

    assert disagree(middle(relative), relative, middle(means), means) is apart


@pytest.mark.parametrize("alpha", [1.3, 3.0])
def test_the_share_of_the_top_percent_is_the_lorenz_curve_of_a_pareto_distribution(
    alpha: float,
) -> None:
    """The largest share q of a Pareto distribution carries q^(1 - 1/alpha) of its mean.

    Arnold, "Pareto distributions", 2015. The values are its quantiles, so there is no random error.
    The sum over the top q differs from the integral by the order of its last term.
    """
    draws = 200_000
    mse = (1 - (np.arange(draws) + 0.5) / draws) ** (-1 / alpha)
    values = np.random.default_rng(1).permutation(mse)
    share = top_percent_share(values)
    assert share == pytest.approx(0.01 ** (1 - 1 / alpha), rel=(0.01 * draws) ** (1 / alpha - 1))
    exact = np.sort(mse)[-draws // 100 :].sum() / mse.sum()
    assert share == pytest.approx(exact, rel=1e-12)


def test_degenerate_draws_count_with_their_errors() -> None:
    mse = np.r_[np.full(199, 1.0), 101.0]
    statistics = ComparisonStatistics(["regular"])
    statistics.add(mse[:, None], (mse > 100)[:, None])
    assert statistics.degenerate_draws == {"regular": 1}
    assert statistics.mse["regular"].mean == pytest.approx(1.5)


def test_the_share_of_the_largest_draws() -> None:
    """Ten of 1,000 draws have the error 1001, the others 1: they carry 10,010 of 11,000."""
    mse = np.r_[np.full(990, 1.0), np.full(10, 1001.0)]
    for blocks in (1, 7):
        statistics = ComparisonStatistics(["regular"])
        for block in np.array_split(mse[::-1], blocks):
            statistics.add(block[:, None])
        assert statistics.largest_share("regular") == pytest.approx(10010 / 11000)
    assert Evaluation((0,), mse).largest_share == pytest.approx(10010 / 11000)
    assert np.isnan(Evaluation((0,), mse[901:]).largest_share)
    assert np.isnan(Evaluation((0,), np.r_[mse, np.inf]).largest_share)
