"""Greedy searches: exact where times do not interact, and within 1 - 1/e where they overlap."""

import math

import numpy as np
import pytest

from oracles.searched import last
from pfdist.search import GreedyBackward, GreedyForward
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

FEASIBLE = Feasible(horizon=11, measurement_budget=4)


@pytest.mark.parametrize("search", [GreedyForward(FEASIBLE), GreedyBackward(FEASIBLE)])
def test_of_times_that_each_have_their_own_share_the_largest_are_found(
    search: GreedyForward | GreedyBackward,
) -> None:
    shares = np.random.default_rng(1).random(12)
    state = last(search, lambda times: float(shares.sum() - shares[list(times)].sum()))
    assert state.chosen == tuple(np.sort(np.argsort(shares)[-4:]))
    assert search.finalists(state)[0].measurement_times == state.chosen


def test_forward_saves_1_minus_1_over_e_of_what_can_be_saved_where_savings_overlap() -> None:
    """Nemhauser, Wolsey, Fisher 1978, for savings that are sizes of unions."""
    shares = []
    for seed in range(20):
        covers = np.random.default_rng(seed).random((12, 60)) < 0.15

        def saved(times: Times, covers: np.ndarray = covers) -> float:
            return float(covers[list(times)].any(axis=0).sum())

        state = last(GreedyForward(FEASIBLE), lambda times, saved=saved: -saved(times))
        shares.append(saved(state.chosen) / max(map(saved, FEASIBLE.every())))
    assert min(shares) >= 1 - 1 / math.e
    assert min(shares) < 1  # it is not always the best


def test_each_asks_for_one_step_and_returns_only_what_may_be_chosen() -> None:
    forward, backward = GreedyForward(FEASIBLE), GreedyBackward(FEASIBLE)
    rng = np.random.default_rng(1)
    assert [candidate.measurement_times for candidate in forward.ask(forward.init(), rng)] == [
        (time,) for time in range(12)
    ]
    assert {
        len(candidate.measurement_times) for candidate in backward.ask(backward.init(), rng)
    } == {11}
    assert forward.finalists(forward.init()) == ()
