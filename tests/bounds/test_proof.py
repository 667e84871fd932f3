"""The statistics of a proof: jackknife, limits and paired differences, against closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from pfdist.bounds.proof import Estimate, falls, prove
from pfdist.bounds.relaxation import Relaxation
from pfdist.times.constraints import Constraints

# One measurement in 0..2, window 2: nothing is added to it, so each state is a set.
RELAXATION = Relaxation(Constraints(2, 1), 2, 3)
SETS = [(0,), (1,), (2,)]
GROUPS, DRAWS = 20, 50


def _sums(rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """Sums of groups of errors; those of each known set are those of its states."""
    states = len(RELAXATION.states)
    errors = rng.gamma(4.0, scale / 4, size=(GROUPS, DRAWS, states, 3)).sum(axis=1)
    places = [[RELAXATION.index[state] for state in RELAXATION.states_of(times)] for times in SETS]
    own = np.stack([errors[:, place, range(3)] for place in places], axis=1)
    return np.concatenate([errors, own], axis=1)


def _counts() -> np.ndarray:
    return np.full(GROUPS, float(DRAWS))


@pytest.fixture
def sums() -> np.ndarray:
    return _sums(np.random.default_rng(3))


def test_the_bound_of_one_measurement_is_the_least_mean_of_its_sets(sums: np.ndarray) -> None:
    proof = prove(RELAXATION, sums, _counts(), SETS, 1)
    own = sums[:, -3:].mean(axis=2).sum(axis=0) / (GROUPS * DRAWS)
    assert proof.bounds[1].value == pytest.approx(own.min(), rel=1e-12)
    assert proof.paths[1] == SETS[int(own.argmin())]
    assert [slack.value for slack in proof.slack] == pytest.approx(list(own - own.min()), abs=1e-12)
    assert proof.groups == GROUPS


def test_the_jackknife_of_a_mean_is_its_textbook_error(sums: np.ndarray) -> None:
    proof = prove(RELAXATION, sums, _counts(), SETS, 1)
    means = sums.mean(axis=2) / DRAWS
    nothing = means[:, RELAXATION.index[RELAXATION.states[0]]]  # no measurement: one state alone
    assert proof.bounds[0].standard_error == pytest.approx(stats.sem(nothing), rel=1e-9)
    best = int(means[:, -3:].mean(axis=0).argmin())
    for slack, column in zip(proof.slack, means[:, -3:].T, strict=True):
        expected = stats.sem(column - means[:, -3 + best])
        if expected:  # else the least itself, whose slack is 0 but for groups that change the least
            assert slack.standard_error == pytest.approx(expected, rel=0.3)


def test_groups_of_several_sizes_count_by_their_draws(sums: np.ndarray) -> None:
    whole = prove(RELAXATION, sums, _counts(), SETS, 1)
    counts = _counts()
    counts[0], sums[0] = 2 * DRAWS, 2 * sums[0]  # twice the draws, with the same mean
    weighted = prove(RELAXATION, sums, counts, SETS, 1)
    means = sums[:, -3:].mean(axis=2).sum(axis=0) / counts.sum()
    assert weighted.bounds[1].value == pytest.approx(means.min(), rel=1e-12)
    assert weighted.bounds[1].value != whole.bounds[1].value


def test_one_group_holds_exact_errors(sums: np.ndarray) -> None:
    proof = prove(RELAXATION, sums[:1], _counts()[:1], SETS, 1)
    assert proof.groups == 0
    assert all(estimate.standard_error == 0.0 for estimate in (*proof.bounds, *proof.slack))


def test_a_fall_is_the_relative_difference_on_the_same_draws(sums: np.ndarray) -> None:
    of_bounds, of_sets = falls(RELAXATION, sums, 0.9 * sums, _counts(), 1)
    for fall in (*of_bounds, *of_sets):
        assert fall.value == pytest.approx(0.1, rel=1e-9)
        assert fall.standard_error == pytest.approx(0.0, abs=1e-9)
        assert fall.is_positive
    of_bounds, of_sets = falls(RELAXATION, sums, sums, _counts(), 1)
    assert not any(fall.is_positive or fall.is_negative for fall in (*of_bounds, *of_sets))


def test_an_estimate_of_zero_does_not_fall(sums: np.ndarray) -> None:
    of_bounds, of_sets = falls(RELAXATION, 0 * sums, 0 * sums, _counts(), 1)
    assert [fall.value for fall in (*of_bounds, *of_sets)] == [0.0] * 5


@pytest.mark.parametrize("confidence", [0.95, 0.99])
def test_the_limit_is_students(confidence: float) -> None:
    values = np.random.default_rng(5).normal(2.0, 1.0, 12)
    limit = Estimate(values.mean(), stats.sem(values)).at_most(11, confidence)
    one_sided = stats.ttest_1samp(values, 0.0, alternative="less").confidence_interval(confidence)
    assert limit == pytest.approx(one_sided.high, rel=1e-12)
    assert Estimate(3.0).at_most(11, confidence) == 3.0


def test_independent_estimates_add_their_variances() -> None:
    both = Estimate(1.0, 3.0).plus(Estimate(2.0, 4.0))
    assert (both.value, both.standard_error) == (3.0, 5.0)


def test_clearly_is_more_than_four_standard_errors() -> None:
    assert Estimate(4.1, 1.0).is_positive
    assert not Estimate(3.9, 1.0).is_positive
    assert Estimate(-4.1, 1.0).is_negative
    assert not Estimate(-3.9, 1.0).is_negative
    assert not Estimate(math.nan, math.nan).is_positive


def test_the_estimated_bound_is_too_low_on_average() -> None:
    """E min <= min E: here by chance alone, because all sets cost the same."""
    rng = np.random.default_rng(11)
    bounds = [prove(RELAXATION, _sums(rng), _counts(), SETS, 1).bounds[1].value for _ in range(200)]
    assert np.mean(bounds) < 1.0 - 4 * stats.sem(bounds)
