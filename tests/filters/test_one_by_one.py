"""Estimates of a draw's MSE by what the filter knows: their means, their bits, their limits."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oracles.in_turn import in_turn
from oracles.kalman import TRACKING, riccati_cost
from pfdist import load_model
from pfdist.common.measurement_times import Times, regular
from pfdist.common.scenario import Scenario
from pfdist.filters import particle_filter, plain
from pfdist.filters.draws import Draws
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse
from pfdist.filters.particle_filter import filter_checked_sets, filter_draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, FilterWork, filter_streams

HORIZON = 12
UNGM = load_model("ungm")
SETS = [(0, 3, 7), (0, 3, 7, 11), (), (0, 4), (0, 3, 8), (12,), (0, 3, 7)]
ENDS = [12, 12, 5, 12, 8, 12, 7]
others = pytest.mark.parametrize("estimator", ["filter_variance", "filter_noise"])
Array = np.ndarray


def test_with_twice_the_noise_of_the_particles_the_variance_has_no_bias() -> None:
    # The bias is of order 1/P^2. Without the distance of the means it would be twice what 100
    # particles lose against the exact filter: by REFERENCE 2 * 0.56 % * 500 / 100 = 5.6 %.
    drawn = simulate(UNGM, 60, range(4000), 11)
    error, variance, distance = (
        filter_checked_sets(
            UNGM, drawn, [regular(60, 21)], [60], 12, Estimation(100, "multinomial", name)
        )[0][:, 0]
        for name in ("squared_error", "filter_variance", "filter_noise")
    )
    apart = (variance + 2.0 * distance - error) / error.mean()
    standard_error = apart.std() / math.sqrt(4000)
    assert standard_error < 0.007
    assert abs(apart.mean()) < 3 * standard_error
    assert (variance - error).mean() / error.mean() < -0.05  # else the distance is of no use


# The mean of P independent particles has the variance V / P, and their variance has the mean
# V - V / P: so the estimates of V, without a measurement, have the mean V (1 + c / P).
BLIND = {"squared_error": 1.0, "filter_variance": -1.0}


@pytest.mark.parametrize("estimator", BLIND)
def test_of_a_linear_gaussian_model_the_mean_is_the_riccati_cost(estimator: str) -> None:
    # q = 2: variances are summed over the components of z.
    particles, draws, horizon = 200, 4000, 6
    sets = [(), (2,), (0, 3, 5), tuple(range(7))]
    exact = np.array([riccati_cost(TRACKING, horizon, times) for times in sets])
    model = TRACKING.as_model()
    drawn = simulate(model, horizon, range(draws), 1)
    found, fewer = (
        filter_checked_sets(
            model, drawn, sets, [horizon] * 4, 2, Estimation(count, "systematic", estimator)
        )[0]
        for count in (particles, particles // 2)
    )
    limit = 4 * found.std(axis=0) / math.sqrt(draws)
    error = found.mean(axis=0) - exact
    assert abs(error[0] - BLIND[estimator] * exact[0] / particles) < limit[0]
    # Weights and resampling add another bias of order 1/P: twice as large with half as many.
    without = 2 * found - fewer
    limit = 4 * without.std(axis=0) / math.sqrt(draws)
    assert (np.abs(without.mean(axis=0) - exact) < limit).all()
    if estimator != "squared_error":  # the truth's own chance is gone
        assert (found.std(axis=0) < 0.4 * exact).all()


@in_turn("engine", [particle_filter, plain])
def test_two_filters_of_which_one_is_infinite_have_an_infinite_difference(engine: Any) -> None:
    overflow = replace(
        UNGM, transition=lambda x, t, w, p: (np.exp(np.where(w[0] > 3.0, 1000.0, w[0])),)
    )
    draws, settings = simulate(UNGM, HORIZON, range(60), 1), Estimation(20, estimator="two_errors")
    with np.errstate(all="ignore"):
        found = engine.filter_checked_sets(overflow, draws, SETS, ENDS, 9, settings).mse
    assert 0 < np.isinf(found).mean() < 1
    assert not np.isnan(found).any()


def by_hand(draws: Draws, times: Times, end: int, estimator: str) -> Array:
    """The estimate from what `filter_draws` records of filters with these streams."""
    filters = [
        filter_draws(draws.model, draws, times, 70, key, trajectories=True)
        for key in filter_streams(9, estimator)
    ]
    estimates = np.array([filtered.estimate for filtered in filters])
    variances = np.array([filtered.variance for filtered in filters])
    costs = variances[0].sum(axis=2)
    if estimator == "filter_noise":
        costs = ((estimates[0] - estimates[1]) ** 2).sum(axis=2) / 2
    return np.asarray(costs[:, : end + 1].sum(axis=1) / draws.z.shape[1])


@others
def test_only_instants_up_to_the_end_count(estimator: str) -> None:
    draws = simulate(UNGM, HORIZON, range(5), 3)
    found = filter_checked_sets(UNGM, draws, SETS, ENDS, 9, Estimation(70, estimator=estimator))[0]
    # A later measurement changes nothing before.
    expected = [
        by_hand(draws, times, end, estimator) for times, end in zip(SETS, ENDS, strict=True)
    ]
    np.testing.assert_allclose(found, np.stack(expected, axis=1), rtol=1e-12)


# --- what is refused, and what it costs ---


WRONG = UNGM.with_parameters({"process_sd": 0.5})
NORM = replace(UNGM, error=lambda z, estimate, t, p: abs(z[0] - estimate[0]))


# --- the variance of the particles ---


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
def test_the_variance_of_a_wrong_filter_is_what_it_computes(engine: str) -> None:
    """The variance of its particles, however wrong it is about the error."""
    evaluator = Evaluator(UNGM, HORIZON, WRONG, engine=engine)
    estimation = Estimation(70, estimator="filter_variance")
    own = evaluator(
        FilterWork(tuple(SETS), tuple(ENDS), (9,) * len(SETS), 3, (0, 6), estimation)
    ).mse
    draws = simulate(UNGM, HORIZON, range(6), 3)
    believed = [
        by_hand(replace(draws, model=WRONG), times, end, "filter_variance")
        for times, end in zip(SETS, ENDS, strict=True)
    ]
    np.testing.assert_allclose(own, np.stack(believed, axis=1), rtol=1e-9)


SCENARIOS = tuple(Scenario(0.5, {"process_sd": sd}) for sd in (2.0, 4.0))


@pytest.mark.parametrize(
    ("evaluator", "is_error"),
    [
        pytest.param(Evaluator(UNGM, 5), True, id="true model"),
        pytest.param(Evaluator(UNGM, 5, WRONG), False, id="wrong filter"),
        pytest.param(Evaluator(NORM, 5), False, id="own error"),
        pytest.param(Evaluator(UNGM, 5, scenarios=SCENARIOS), False, id="scenarios"),
        pytest.param(Evaluator(UNGM, 5, scenarios=SCENARIOS, knows_scenario=True), True, id="told"),
    ],
)
def test_the_variance_is_the_error_of_a_filter_that_has_the_true_model(
    evaluator: Evaluator, is_error: bool
) -> None:
    assert evaluator.variance_is_error == is_error


def test_of_an_exact_engine_the_variance_is_exact() -> None:
    evaluator = Evaluator(load_model("random_walk"), HORIZON, engine="kalman")
    estimation = Estimation(1, "systematic", "filter_variance")
    evaluator.check(estimation)
    sets: Sequence[Times] = ((0, 4, 8), (2, 9))
    mse = evaluator(FilterWork(tuple(sets), (12, 9), (1, 1), 1, (0, 3), estimation)).mse
    np.testing.assert_allclose(mse, [exact_mse(evaluator, sets, (12, 9))] * 3, rtol=1e-12)


def test_two_filters_take_the_work_of_two() -> None:
    def steps(estimator: str) -> int:
        estimation = Estimation(10, estimator=estimator)
        return FilterWork(((1, 2), (1, 3)), (5, 5), (1, 1), 1, (0, 7), estimation).steps

    # 6 instants and, since the first two are shared, 4 more.
    assert steps("squared_error") == steps("filter_variance") == 7 * 10 * (6 + 4)
    assert steps("filter_noise") == 2 * steps("squared_error")
