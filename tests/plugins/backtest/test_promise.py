"""Promises and ratios on made-up errors: Fieller by hand, and the limits of verdicts."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from oracles.in_turn import in_turn
from pfdist.plugins.backtest.promise import (
    KEPT,
    NOT_DECIDED,
    NOT_KEPT,
    NOTHING_FORESEEN,
    Promise,
    RelativeErrors,
    promise,
    real_over_foreseen,
)

PROMISE = Promise(0.2, (0.1, 0.3), 0.2, (0.1, 0.3), 1.0, (0.6, 1.4), 50, 0.0)


def _errors(real: Any, foreseen: Any) -> RelativeErrors:
    """RelativeErrors with nearly the same foreseen error in two simulated systems."""
    means = np.asarray(foreseen, np.float64)[:, None]
    return RelativeErrors(np.asarray(real, np.float64), np.hstack([means - 1e-6, means + 1e-6]))


def _fieller(x: np.ndarray, y: np.ndarray, confidence: float = 0.95) -> tuple[float, float]:
    """All r for which the mean of x - r y does not differ from 0, by bisection of the t-test."""

    def excess(r: float) -> float:
        return abs(stats.ttest_1samp(x - r * y, 0.0).statistic) - critical

    critical, centre = stats.t.isf((1 - confidence) / 2, len(x) - 1), x.mean() / y.mean()
    ends = []
    for side in (-1.0, 1.0):
        inside, outside = centre, centre + side * 100
        for _ in range(200):
            middle = (inside + outside) / 2
            inside, outside = (middle, outside) if excess(middle) < 0 else (inside, middle)
        ends.append(inside)
    return ends[0], ends[1]


@pytest.fixture
def made() -> tuple[RelativeErrors, RelativeErrors]:
    """RelativeErrors of a plan and of other times, of 12 replicates."""
    rng = np.random.default_rng(3)
    plan, other = rng.gamma(4.0, 0.25, 12), rng.gamma(4.0, 0.5, 12)
    foreseen = 1 + 0.1 * rng.random((2, 12))
    return _errors(plan, foreseen[0]), _errors(other, 1 + foreseen[1])


def test_a_promise_is_fiellers_ratio_of_the_differences(
    made: tuple[RelativeErrors, RelativeErrors],
) -> None:
    plan, other = made
    found = promise(plan, other)
    x, y = other.real - plan.real, other.means - plan.means
    assert found.ratio == pytest.approx(x.mean() / y.mean())
    assert found.interval == pytest.approx(_fieller(x, y), rel=1e-5)
    assert found.found == pytest.approx(1 - plan.real.mean() / other.real.mean())
    low, high = _fieller(plan.real, other.real)
    assert found.found_interval == pytest.approx((1 - high, 1 - low), rel=1e-6)
    assert found.foreseen == pytest.approx(1 - plan.means.mean() / other.means.mean())
    assert found.replicates == 12
    rest = x - x.mean()
    assert found.correlation == pytest.approx((rest[1:] * rest[:-1]).sum() / (rest**2).sum())


def test_the_foreseen_interval_is_that_of_the_delta_method() -> None:
    rng = np.random.default_rng(4)
    plan, other = rng.gamma(3.0, 0.2, (5, 480)), rng.gamma(3.0, 0.25, (5, 480))
    found = promise(RelativeErrors(np.ones(5), plan), RelativeErrors(np.ones(5), other))
    gain = 1 - plan.mean() / other.mean()
    rest = (1 - gain) * other - plan
    error = np.sqrt(sum(np.var(row, ddof=1) / 480 for row in rest)) / 5 / other.mean()
    assert found.foreseen == pytest.approx(gain)
    assert found.foreseen_interval == pytest.approx((gain - 1.96 * error, gain + 1.96 * error),
                                                    abs=1e-3 * error)  # fmt: skip


def test_the_interval_is_at_least_as_wide_as_the_model_foresees_for_half_of_the_gain() -> None:
    """Real differences that happen to be alike are no proof."""
    rng = np.random.default_rng(5)
    plan, other = rng.gamma(3.0, 0.2, (8, 480)), rng.gamma(3.0, 0.4, (8, 480))
    alike = 0.01 * rng.random(8)
    found = promise(RelativeErrors(0.3 + alike, plan), RelativeErrors(0.6 - alike, other))
    difference = other - plan
    error = np.sqrt(difference.var(axis=1, ddof=1).sum()) / 8 / difference.mean()
    half = 0.5 * stats.t.ppf(0.975, 7) * error
    assert found.interval == pytest.approx((found.ratio - half, found.ratio + half))


@in_turn(
    ("change", "verdict"),
    [
        ({}, KEPT),
        ({"interval": (0.5, 9.0)}, KEPT),
        ({"interval": (0.499999, 9.0)}, NOT_DECIDED),
        ({"interval": (-9.0, 0.5)}, NOT_DECIDED),
        ({"interval": (-9.0, 0.499999)}, NOT_KEPT),
        ({"interval": (-math.inf, math.inf)}, NOT_DECIDED),
        ({"interval": (math.nan, math.nan)}, NOT_DECIDED),
        ({"foreseen": 0.0199}, NOTHING_FORESEEN),
        ({"foreseen": 0.02}, KEPT),
        ({"foreseen": math.nan}, NOTHING_FORESEEN),
        ({"foreseen_interval": (0.0, 0.4)}, NOTHING_FORESEEN),
        ({"foreseen": -0.2, "foreseen_interval": (-0.3, -0.1)}, NOTHING_FORESEEN),
    ],
)
def test_a_verdict_has_these_limits(change: dict[str, Any], verdict: str) -> None:
    assert replace(PROMISE, **change).verdict == verdict


def test_blocks_are_means_of_consecutive_replicates(
    made: tuple[RelativeErrors, RelativeErrors],
) -> None:
    plan, other = made
    x, y = other.real - plan.real, other.means - plan.means
    found = promise(plan, other, 3)
    assert found.interval == pytest.approx(
        _fieller(x.reshape(4, 3).mean(axis=1), y.reshape(4, 3).mean(axis=1)), rel=1e-5
    )
    assert found.ratio == pytest.approx(x.mean() / y.mean())
    assert found.replicates == 12
    wide = promise(plan, other, 12)  # a single block
    assert np.isnan(wide.interval).all()
    assert wide.verdict == NOT_DECIDED


def test_one_replicate_and_equal_errors_have_no_verdict() -> None:
    single = promise(_errors([1.0], [1.0]), _errors([2.0], [2.0]))
    assert single.ratio == pytest.approx(1.0)
    assert np.isnan([*single.interval, *single.found_interval, single.correlation]).all()
    assert single.verdict == NOT_DECIDED
    ratio, interval = real_over_foreseen(_errors([2.0], [1.0]), 3)
    assert ratio == pytest.approx(2.0)
    assert np.isnan(interval).all()
    same = _errors([1.0, 2.0, 3.0], [1.0, 1.5, 2.0])
    equal = promise(same, same)
    assert (equal.verdict, equal.found, equal.foreseen) == (NOTHING_FORESEEN, 0.0, 0.0)
    assert math.isnan(equal.correlation)
    zero = real_over_foreseen(_errors([0.0, 0.0], [1.0, 1.0]), 3)
    assert zero[0] == 0.0
    assert np.isnan(zero[1]).all()


def test_draws_that_are_not_finite_are_left_out_of_the_foreseen_error() -> None:
    foreseen = np.array([[1.0, 3.0, math.nan], [2.0, math.nan, 4.0]])
    assert RelativeErrors(np.ones(2), foreseen).means.tolist() == [2.0, 3.0]


def test_real_over_foreseen_is_an_interval_of_the_logarithm(
    made: tuple[RelativeErrors, RelativeErrors],
) -> None:
    plan, _ = made
    ratio, (low, high) = real_over_foreseen(plan, 3)
    x, y = plan.real, plan.means
    assert ratio == pytest.approx(x.mean() / y.mean())
    assert low * high == pytest.approx(ratio**2)
    error = stats.sem(x - ratio * y) / y.mean()
    width = stats.t.ppf(1 - 0.05 / 3 / 2, 11) * error / ratio
    assert math.log(high / ratio) == pytest.approx(width)


def test_the_error_of_a_ratio_is_at_least_that_of_the_model() -> None:
    foreseen = np.random.default_rng(6).gamma(2.0, 0.5, (9, 480))
    ratio, (_, high) = real_over_foreseen(RelativeErrors(np.full(9, 0.5), foreseen), 1)
    error = np.sqrt(foreseen.var(axis=1, ddof=1).sum()) / 9 / foreseen.mean()
    assert math.log(high / ratio) == pytest.approx(stats.t.ppf(0.975, 8) * error)
