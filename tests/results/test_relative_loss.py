"""Relative losses of paired draws: their limits, their states, and draws that are degenerate."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pfdist.results.sampling_windows import RelativeLoss, state_of


def _loss(changed: NDArray[np.float64], kept: NDArray[np.float64], blocks: int = 1) -> RelativeLoss:
    loss = RelativeLoss()
    for block in np.array_split(np.stack([changed, kept]), blocks, axis=1):
        loss.add(*block)
    return loss


def _pairs(draws: int, rise: float, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    kept = rng.gamma(4.0, size=draws)
    return kept * (1 + rise) + 0.3 * rng.normal(size=draws), kept


def test_mean_error_and_limits_are_those_of_the_textbook() -> None:
    changed, kept = _pairs(5000, 0.02, seed=1)
    loss, ratio = _loss(changed, kept, blocks=7), changed.mean() / kept.mean() - 1
    error = np.std(changed - (1 + ratio) * kept, ddof=1) / math.sqrt(5000) / kept.mean()
    assert loss.mean == pytest.approx(ratio)
    assert loss.standard_error == pytest.approx(error)
    # Fieller's limits are those of the delta method as far as the error of the mean is small
    z = stats.norm.isf(0.05)
    assert loss.limits == pytest.approx((ratio - z * error, ratio + z * error), rel=1e-2)


def test_equal_sets_lose_nothing_without_error() -> None:
    _, kept = _pairs(50, 0.0, seed=2)
    loss = _loss(kept, kept)
    assert (loss.mean, loss.standard_error, loss.limits) == (0.0, 0.0, (0.0, 0.0))
    assert state_of(loss.limits, 0.01) == "inside"


def test_a_state_follows_from_the_limits() -> None:
    loss = _loss(*_pairs(5000, 0.02, seed=3))
    low, high = loss.limits
    levels = (high + 1e-9, high, high - 1e-9, low, low - 1e-9)
    states = [state_of(loss.limits, level) for level in levels]
    assert states == ["inside", "inside", "open", "open", "outside"]


@pytest.mark.parametrize("case", ["infinite", "one draw", "negative", "zero"])
def test_a_loss_that_is_unknown_is_open(case: str) -> None:
    changed, kept = _pairs(5, 0.0, seed=5)
    if case == "infinite":
        changed[2] = kept[2] = np.inf
    elif case == "one draw":
        changed, kept = changed[:1], kept[:1]
    else:
        changed, kept = (changed - 100, kept - 100) if case == "negative" else (changed, 0 * kept)
    loss = _loss(changed, kept)
    assert math.isnan(loss.mean) or case == "one draw"
    assert math.isnan(loss.standard_error)
    assert all(map(math.isnan, loss.limits))
    assert state_of(loss.limits, 0.01) == state_of(loss.limits, 0.05) == "open"


@pytest.mark.statistics
def test_each_limit_covers_the_loss_with_95_percent() -> None:
    repeats, rise = 4000, 0.01
    losses = [_loss(*_pairs(400, rise, seed)) for seed in range(repeats)]
    lows, highs = np.array([loss.limits for loss in losses]).T
    error = math.sqrt(0.05 * 0.95 / repeats)
    # The exact coverage of Student's t for these skew errors is within 1/sqrt(n) * skewness / 6
    # times the density: far below 0.01.
    for covered in (lows <= rise, highs >= rise):
        assert abs(covered.mean() - 0.95) < 4 * error + 0.01
