"""The Monte Carlo estimate, and that it finds what mathematics says is best."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pfdist import StateSpaceModel
from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork, cut


def _evaluation(mse: list[float], policy: str = "kill", degenerate: int = 0) -> Evaluation:
    flags = np.arange(len(mse)) < degenerate
    return Evaluation((0, 1), np.array(mse), policy, degenerate=flags)


def test_expected_mse_and_its_standard_error() -> None:
    evaluation = _evaluation([1.0, 2.0, 6.0])
    assert evaluation.expected_mse == evaluation.expected_mse == 3.0
    assert evaluation.standard_error == pytest.approx(math.sqrt(7.0 / 3.0))  # sd^2 = 7, D = 3
    assert (evaluation.draws, evaluation.degenerate_draws) == (3, 0)


def _work(
    sets: tuple[Times, ...], horizon: int, particles: int, draws: tuple[int, int]
) -> FilterWork:
    return FilterWork(sets, (horizon,) * 2, (5, 6), 4, draws, Estimation(particles))


def test_one_degenerate_draw_kills_an_individual() -> None:
    killed = _evaluation([1.0, 2.0, 3.0], "kill", 1)
    assert killed.expected_mse == killed.standard_error == math.inf
    assert (killed.draws, killed.degenerate_draws) == (3, 1)


def test_otherwise_a_degenerate_draw_counts_with_its_error() -> None:
    """A set must not look better because its worst draws are left out."""
    counted = _evaluation([9.0, 1.0, 2.0], "continue", 1)
    assert (counted.expected_mse, counted.degenerate_draws) == (4.0, 1)
    assert counted.first(1).degenerate_draws == 1
    assert "1 of 3 draws are degenerate" in counted.degenerate_text
    assert not _evaluation([1.0, 2.0], "kill").degenerate_text


def test_sets_compared_share_their_draws_and_not_their_filters_noise(ungm: StateSpaceModel) -> None:
    same_set = ((3, 7, 11),) * 2
    mse = Evaluator(ungm, 20)(_work(same_set, 20, 200, (0, 400))).mse
    assert (mse[:, 0] != mse[:, 1]).all()
    assert np.corrcoef(mse.T)[0, 1] > 0.9


def test_trajectories_are_those_of_the_draws(ungm: StateSpaceModel) -> None:
    result = Evaluator(ungm, 9)(replace(_work(((3,), (1, 2)), 9, 30, (0, 5)), trajectories=True))
    error = (result.z[None] - result.estimates) ** 2  # (S, D, T+1, q)
    np.testing.assert_allclose(error.sum(axis=3).mean(axis=2).T, result.mse)


@pytest.mark.parametrize("block", [1, 3, 7, 100])
def test_cut_covers_every_draw_once_and_respects_the_blocks(block: int) -> None:
    draws = np.flatnonzero(np.random.default_rng(1).random(50) < 0.6)
    pieces = cut(draws, block)
    assert [d for first, last in pieces for d in range(first, last)] == draws.tolist()
    assert all(first // block == (last - 1) // block for first, last in pieces)
    assert cut([], block) == []
