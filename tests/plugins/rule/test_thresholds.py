"""Sweeps of thresholds, against all thresholds and on a system whose best ones are known."""

import numpy as np
import pytest

from pfdist.kernels.rules import ALWAYS, NEVER, Thresholds
from pfdist.plugins.rule.thresholds import (
    Changes,
    ThresholdSweep,
    Trial,
    Tried,
    at_price,
    best_threshold,
    point_groups,
)


@pytest.mark.parametrize("price", [0.0, 0.3, 2.0])
def test_no_other_threshold_has_a_smaller_sum(price: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        deviation = rng.integers(0, 6, 12) / 2.0  # with ties
        changes = Changes(deviation, rng.normal(-0.3, 1.0, 12), np.ones(12))

        def total(threshold: float, changes: Changes = changes) -> float:
            return float((changes.mse + price)[changes.deviation > threshold].sum())

        best = best_threshold(changes, price)
        candidates = ALWAYS, NEVER, *(0.25 + np.arange(12) / 4)
        assert total(best) == pytest.approx(min(map(total, candidates)), abs=1e-12)


POINTS, DRAWS = 24, 4000
GAINS = np.linspace(0.2, 1.0, POINTS)
ENDS = (POINTS - 1,) * POINTS


def evaluated(trial: Trial, generation: int) -> Tried:
    """Instants apart: a measurement at t takes gain * deviation^2 from the error of a draw."""
    deviation = np.random.default_rng(generation).exponential(1.0, (DRAWS, POINTS))
    measured = deviation > trial.rule.thresholds_of(range(POINTS))
    at = np.full(DRAWS, np.nan)
    if trial.flipped is not None:
        measured[:, trial.flipped] ^= True
        at = deviation[:, trial.flipped]
    error = (deviation**2 * np.where(measured, 1.0 - GAINS, 1.0)).sum(axis=1)
    return Tried(error[None], measured.sum(axis=1).astype(float)[None], at)


def test_a_sweep_finds_the_thresholds_at_which_a_measurement_is_worth_its_price() -> None:
    price = 0.5
    sweep = ThresholdSweep(
        Thresholds((2.0,) * POINTS), point_groups(tuple(range(POINTS)), 1, 64), price, ENDS
    )
    state, rng, trials = sweep.init(), np.random.default_rng(1), 0
    while not sweep.done(state):
        state = sweep.ask(state, rng)
        trials += len(state.trials)
        state = sweep.tell(state, [evaluated(each, 7) for each in state.trials])
    exact = np.sqrt(price / GAINS)  # gain * deviation^2 = price
    # The sum over draws is flat at its least value, so the threshold errs by about D^(-1/3).
    np.testing.assert_allclose(state.rule.thresholds, exact, rtol=3 * DRAWS ** (-1 / 3))
    assert trials == POINTS + 8
    assert len(state.changes) == POINTS
    dear = at_price(state.rule, state.changes, 2.0)  # another price needs no other trials
    exact = np.sqrt(2.0 / GAINS)
    np.testing.assert_allclose(dear.thresholds, exact, rtol=6 * DRAWS ** (-1 / 3))
    assert at_price(state.rule, state.changes, price) == state.rule


def test_points_of_a_group_share_a_threshold() -> None:
    groups = point_groups(tuple(range(POINTS)), 2, 8)
    assert sorted(point for group in groups for point in group) == [*range(POINTS)]
    sweep = ThresholdSweep(Thresholds((2.0,) * POINTS), groups, 0.5, ENDS)
    state, rng = sweep.init(), np.random.default_rng(1)
    while not sweep.done(state):
        state = sweep.ask(state, rng)
        state = sweep.tell(state, [evaluated(each, 7) for each in state.trials])
    for group in groups:
        assert len({state.rule.thresholds[point] for point in group}) == 1
        assert len({point % 2 for point in group}) == 1
    assert len({*state.rule.thresholds}) == len(groups)


def test_a_change_counts_up_to_the_end_of_its_point() -> None:
    """A measurement at t takes 1 from the error at t, and adds 3 at t + 2, which may not count."""
    for window, best in ((2, ALWAYS), (3, NEVER)):
        ends = tuple(min(POINTS - 1, t + window - 1) for t in range(POINTS))
        sweep = ThresholdSweep(Thresholds((NEVER,) * POINTS), ((5,), (9,)), 0.0, ends)
        state = sweep.init()
        while not sweep.done(state):
            state = sweep.ask(state, np.random.default_rng(1))
            results = list[Tried]()
            for trial in state.trials:
                at = () if trial.flipped is None else (trial.flipped,)
                mse = [[sum(3.0 * (t + 2 <= end) - 1.0 for t in at)] * 4 for end in trial.ends]
                results.append(Tried(np.array(mse), np.zeros((len(mse), 4)), np.ones(4)))
            state = sweep.tell(state, results)
        assert {state.rule.thresholds[t] for t in (5, 9)} == {best}
