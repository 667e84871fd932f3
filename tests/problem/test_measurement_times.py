import math
import re
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from oracles.in_turn import in_turn
from pfdist.common.measurement_times import random, regular, validated
from pfdist.constraints.spacing import Spacing
from pfdist.errors import MeasurementTimesError
from pfdist.problem.affordable import nearest


@in_turn("horizon", [1, 2, 3, 5, 10, 37, 60, 101])
def test_regular_times_are_the_papers_with_halves_rounded_up(horizon):
    for budget in range(2, horizon + 2):
        # Paper, equation 13, in exact arithmetic: Round[k T / (N - 1)], k = 0..N-1.
        exact = (Fraction(k * horizon, budget - 1) for k in range(budget))
        rounded = tuple(math.floor(time + Fraction(1, 2)) for time in exact)
        assert regular(horizon, budget) == rounded
        assert len(set(rounded)) == budget


def test_regular_times_of_the_papers_experiment():
    assert regular(horizon=60, measurement_budget=21) == tuple(range(0, 61, 3))


@pytest.mark.parametrize(
    "times", [[5, 0, 3], (0, 3, 5), {3, 5, 0}, np.array([3, 0, 5], np.int16), iter([5, 3, 0])]
)
def test_valid_times_are_sorted_python_integers(times):
    result = validated(times, horizon=5)
    assert result == (0, 3, 5)
    assert [type(time) for time in result] == [int] * 3


APART = Spacing.constant(4, 10)


@in_turn(
    ("call", "words"),
    [
        (lambda: validated([0, 61], 60), "measurement_times must lie in 0..60, got 61"),
        (lambda: validated([3, 5, 3], 60), "must differ from each other, got 3 twice"),
        (lambda: validated([0, 1.0], 60, "--times"), "must be integers, got 1.0 (--times)"),
        (lambda: validated([True], 60), "must be integers, got True"),
        (lambda: validated("3", 60), "must be a list of integers, got '3'"),
        (lambda: regular(60, 0), "a measurement_budget in 1..61 (horizon 60), got 0"),
        (lambda: nearest((0, 5, 9), (1, 2, 9), (), APART), "3 usable times far enough apart, got"),
    ],
)
def test_times_that_cannot_be_are_named(call, words):
    with pytest.raises(MeasurementTimesError, match=re.escape(words)):
        call()


@pytest.mark.parametrize(("horizon", "budget"), [(60, 21), (60, 1), (3, 4)])
def test_random_times_are_distinct_sorted_and_in_the_horizon(horizon, budget):
    times = random(horizon, budget, 200, np.random.default_rng(3))
    assert times.shape == (200, budget)
    assert [validated(row, horizon) for row in times] == [tuple(row) for row in times]


def test_random_times_take_each_time_equally_often():
    horizon, budget, sets = 60, 21, 20_000
    instants, p = horizon + 1, budget / (horizon + 1)
    counts = np.bincount(random(horizon, budget, sets, np.random.default_rng(4)).ravel())
    # N of T+1 without replacement: the counts' covariance is S p (1-p) (T+1)/T (I - 1/(T+1)),
    # so their squared deviations over its factor are chi-square with T degrees of freedom.
    statistic = np.sum((counts - sets * p) ** 2) / (sets * p * (1 - p) * instants / horizon)
    assert counts.size == instants
    assert 1e-3 < stats.chi2.cdf(statistic, horizon) < 1 - 1e-3


def test_random_times_take_each_set_equally_often():
    drawn = random(5, 3, 20_000, np.random.default_rng(5))
    sets, counts = np.unique(drawn, axis=0, return_counts=True)
    assert [tuple(times) for times in sets] == list(combinations(range(6), 3))
    assert stats.chisquare(counts).pvalue > 1e-3
