"""Pairs of sets and ranks: closed forms on made-up errors, and the coverage of the intervals."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from pfdist.results.pairs import pairs_table, ranks_table

ERRORS = np.array([[1.0, 2.0, 5.0], [2.0, 2.0, 7.0], [3.0, 6.0, 6.0], [4.0, 3.0, 9.0]])
NAMES = ["a", "b", "c"]


def _ranks(pairs: pd.DataFrame, means: dict[str, float]) -> dict[str, tuple[int, int]]:
    ranks = ranks_table(pairs, {name: (mean, 0.1) for name, mean in means.items()})
    columns = (ranks[name] for name in ("name", "best_rank", "worst_rank"))
    return {name: (best, worst) for name, best, worst in zip(*columns, strict=True)}


def test_a_pair_has_the_difference_with_students_interval_and_the_wins() -> None:
    pair = pairs_table(NAMES, [ERRORS], {}).iloc[0]
    difference = ERRORS[:, 0] - ERRORS[:, 1]
    error = stats.sem(difference)
    assert (pair["first"], pair["second"], pair["draws"]) == ("a", "b", 4)
    assert pair["difference"] == pytest.approx(-0.75)
    low, high = stats.t.interval(0.95, 3, -0.75, error)
    assert (pair["low"], pair["high"]) == pytest.approx((low, high))
    low, high = stats.t.interval(1 - 0.05 / 3, 3, -0.75, error)
    assert (pair["simultaneous_low"], pair["simultaneous_high"]) == pytest.approx((low, high))
    assert pair["gain_of_means"] == pytest.approx(1 - 10 / 13)
    assert pair["first_wins"] == 0.5  # a tie is no win
    back = pairs_table(["b", "a"], [ERRORS[:, [1, 0]]], {}).iloc[0]
    assert (back["difference"], back["gain_of_means"]) == pytest.approx((0.75, 1 - 13 / 10))


def test_blocks_change_nothing() -> None:
    whole = pairs_table(NAMES, [ERRORS], {})
    blocks = pairs_table(NAMES, [ERRORS[:2], ERRORS[2:]], {})
    pd.testing.assert_frame_equal(whole, blocks)


def test_ranks_count_the_sets_that_are_clearly_better_and_clearly_worse() -> None:
    rows = [
        ("a", "b", -1.0, -2.0, 0.5, False),  # a and b cannot be told apart
        ("a", "c", -3.0, -4.0, -2.0, True),
        ("b", "c", -2.0, -3.0, -1.0, True),
    ]
    head = ["first", "second", "difference", "simultaneous_low", "simultaneous_high", "clear"]
    pairs = pd.DataFrame(rows, columns=head)
    pairs["low"], pairs["high"] = pairs["simultaneous_low"], pairs["simultaneous_high"]
    means = {"c": 4.0, "b": 2.0, "a": 1.0}
    assert _ranks(pairs, means) == {"a": (1, 2), "b": (1, 2), "c": (3, 3)}
    ranks = ranks_table(pairs, {name: (mean, 0.1) for name, mean in means.items()})
    assert ranks["difference"].to_list() == [0.0, 1.0, 3.0]  # to the first row
    assert ranks["low"].to_list() == [0.0, -0.5, 2.0]


def test_exact_errors_give_exact_differences_and_ranks_and_ties_share_a_rank() -> None:
    exact = {"a": 3.0, "b": 3.0, "c": 4.0}
    pairs = pairs_table(NAMES, [ERRORS], exact)
    assert pairs["difference"].to_list() == [0.0, -1.0, -1.0]
    assert (pairs["low"] == pairs["high"]).all()
    assert pairs["clear"].to_list() == [False, True, True]
    assert _ranks(pairs, exact) == {"a": (1, 1), "b": (1, 1), "c": (3, 3)}


def test_infinite_errors_are_never_clear() -> None:
    errors = ERRORS.copy()
    errors[0, 2] = math.inf
    pairs = pairs_table(NAMES, [errors], {})
    assert pairs["clear"].to_list() == [False, False, False]
    assert _ranks(pairs, {"a": 2.5, "b": 3.25, "c": math.inf})["c"] == (1, 3)


@pytest.mark.slow
def test_the_intervals_and_the_ranks_hold_as_often_as_they_say() -> None:
    rng, repeats = np.random.default_rng(5), 400
    means = np.array([3.0, 3.0, 3.3, 4.0])
    alone = together = ranked = 0
    for _ in range(repeats):
        common = rng.gamma(2.0, size=(60, 1))  # the draws that the sets share
        errors = means + common + 0.5 * rng.normal(size=(60, 4))
        pairs = pairs_table(list("abcd"), [errors], {})
        true = np.array([0.0, -0.3, -1.0, -0.3, -1.0, -0.7])
        alone += int(np.sum((pairs["low"] <= true) & (true <= pairs["high"])))
        inside = (pairs["simultaneous_low"] <= true) & (true <= pairs["simultaneous_high"])
        together += bool(inside.all())
        ranks = _ranks(pairs, dict(zip("abcd", errors.mean(axis=0), strict=True)))
        ranked += all(
            ranks[name][0] <= rank <= ranks[name][1]
            for name, rank in {"a": 1, "b": 1, "c": 3, "d": 4}.items()
        )
    # six intervals of a repeat depend on each other: at most as if there were one
    assert abs(alone / 6 / repeats - 0.95) < 4 * math.sqrt(0.95 * 0.05 / repeats)
    assert together / repeats > 0.95 - 4 * math.sqrt(0.95 * 0.05 / repeats)
    assert ranked >= together
