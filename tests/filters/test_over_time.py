"""The error of each draw at each instant, and sums of them over ranges of draws.

The MSE of a draw is by its definition the mean of these errors over the instants (paper, section
2.3), and the sums of a search for windows are their sums over the draws.
"""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from oracles.three_sensors import SYSTEMS
from pfdist import StateSpaceModel, load_model, where
from pfdist.common.scenario import Scenario
from pfdist.filters import kalman, particle_filter, plain
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import EACH_DRAW, SUMS
from pfdist.filters.simulation import simulate
from pfdist.filters.variants import results
from pfdist.filters.work import Estimation, joined, ranges_of_draws
from pfdist.kernels.estimators import ESTIMATORS

UNGM, WALK = load_model("ungm"), load_model("random_walk")
SETS, ENDS = (
    [(0, 3, 7), (0, 3), (), (0, 3, 7, 11), (0, 4), (3,), (0, 3, 7)],
    [12, 6, 12, 12, 4, 8, 9],
)
MODELS = [
    UNGM,
    replace(UNGM, name="own", error=lambda z, e, t, p: (1 + t) * np.abs(z[0] - e[0])),
    replace(UNGM, name="angle", quantity_of_interest=lambda x, t, p: (x[0] / 4,), circular=(0,)),
    SYSTEMS[0].as_model(),
]
models = pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
engines = pytest.mark.parametrize("engine", [particle_filter, plain], ids=["compiled", "plain"])


def _given(model: StateSpaceModel, estimator: str = "squared_error") -> tuple[Any, ...]:
    weights = np.linspace(0.0, 2.0, 13)
    draws = replace(simulate(model, 12, range(3, 12), 1), weights=weights)
    return model, draws, SETS, ENDS, 5, Estimation(40, estimator=estimator)


@engines
@models
def test_their_mean_is_the_mse_and_their_sum_over_draws_the_sum_of_errors(
    engine: Any, model: StateSpaceModel
) -> None:
    given = _, draws, *_ = _given(model)
    found, own = engine.filter_checked_sets(*given, EACH_DRAW), engine.filter_checked_sets(*given)
    mse, errors = found.mse, found.errors
    np.testing.assert_array_equal(mse, own.mse)
    np.testing.assert_array_equal(found.degenerate, own.degenerate)
    sums = engine.filter_checked_sets(*given, SUMS).errors
    for column, end in enumerate(ENDS):
        upto = draws.instant_weights[: end + 1] * errors[:, column, : end + 1]
        np.testing.assert_allclose(upto.sum(axis=1) / 13, mse[:, column], rtol=1e-12)
        np.testing.assert_allclose(upto.sum(axis=0), sums[column, : end + 1], rtol=1e-12)
    assert (errors[:, :, 0] > 0).all()  # also at an instant of weight 0


@models
def test_the_compiled_errors_are_the_plain_ones(model: StateSpaceModel) -> None:
    given = _given(model)
    compiled, plainly = (
        each.filter_checked_sets(*given, EACH_DRAW).errors for each in (particle_filter, plain)
    )
    for column, end in enumerate(ENDS):
        found, expected = (each[:, column, : end + 1] for each in (compiled, plainly))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_every_estimator_has_them(estimator: str) -> None:
    found, expected = (
        each.filter_checked_sets(*_given(UNGM, estimator), EACH_DRAW)
        for each in (particle_filter, plain)
    )
    np.testing.assert_allclose(found.errors[:, 3], expected.errors[:, 3], rtol=1e-9)
    weighted = np.linspace(0.0, 2.0, 13) * found.errors[:, 3]
    np.testing.assert_allclose(weighted.mean(axis=1), found.mse[:, 3], rtol=1e-12)


def test_those_of_the_kalman_filter_have_its_mse_as_their_mean() -> None:
    draws = simulate(WALK, 12, range(5), 1)
    given = WALK, draws, [(0, 4)], [12], 1, Estimation(1), EACH_DRAW
    found = kalman.filter_checked_sets(*given)
    np.testing.assert_allclose(found.errors.mean(axis=2), found.mse, rtol=1e-12)


@engines
def test_a_draw_whose_error_is_infinite_has_no_finite_error(engine: Any) -> None:
    """Otherwise the mean over time would be finite, and the expected MSE infinite."""
    infinite = replace(
        UNGM, quantity_of_interest=lambda x, t, p: (where((t == 8) & (x[0] > 5), math.inf, x[0]),)
    )
    draws = replace(simulate(UNGM, 12, range(40), 1), model=UNGM)
    given = infinite, draws, [(0, 3)], [12], 5, Estimation(2)
    found = engine.filter_checked_sets(*given, EACH_DRAW)
    is_finite, errors = np.isfinite(found.mse[:, 0]), found.errors
    assert 0 < is_finite.sum() < 40
    np.testing.assert_array_equal(np.isfinite(errors[:, 0]).all(axis=1), is_finite)
    np.testing.assert_array_equal(np.isinf(errors[:, 0]).all(axis=1), ~is_finite)


@pytest.mark.parametrize("controlled", [False, True])
def test_sums_over_ranges_do_not_depend_on_how_draws_are_cut(controlled: bool) -> None:
    scenarios = tuple(Scenario(0.5, {"process_sd": sd}) for sd in (2.0, 4.0))
    evaluator = Evaluator(UNGM, 12, scenarios=scenarios, knows_scenario=True)
    others = {"filter_streams": (3, 4), "controlled": controlled, "over_time": 8}
    work = evaluator.work([(0, 5), (2, 9)], 3, 5, (5, 90), Estimation(20), **others)
    [whole] = results(evaluator, [work])
    rng = np.random.default_rng(1)
    ends = [5, *np.sort(rng.choice(range(6, 90), 7, replace=False)).tolist(), 90]
    pieces = [work.piece(piece) for piece in pairwise(ends)]
    sums = {}
    for piece, result in zip(pieces, results(evaluator, pieces), strict=True):
        sums |= zip(ranges_of_draws(*piece.draws, 8), result.errors, strict=True)

    def total(first: int, draws: int) -> Any:
        if (first, draws) in sums:
            return sums[first, draws]
        return total(first, draws // 2) + total(first + draws // 2, draws // 2)

    for of_range, errors in zip(ranges_of_draws(5, 90, 8), whole.errors, strict=True):
        np.testing.assert_array_equal(total(*of_range), errors)
    found = joined([evaluator.filtered(piece) for piece in pieces])
    expected = found.mse - found.control if controlled else found.mse
    np.testing.assert_allclose(found.errors.mean(axis=2), expected, rtol=1e-9)
    np.testing.assert_allclose(whole.errors.sum(axis=0), found.errors.sum(axis=0), rtol=1e-9)
