"""The engine `jax` against the compiled engine, the plain filter, and exactly known errors."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.batched import batched
from oracles.in_turn import in_turn
from oracles.kalman import SCALAR
from pfdist import load_model
from pfdist.errors import JobError, ModelError, TraceError
from pfdist.filters import kalman, particle_filter
from pfdist.filters.evaluator import Evaluator, recorded_evaluator
from pfdist.filters.simulation import simulate
from pfdist.filters.work import GUIDED, Estimation
from pfdist.models.loader import installed_models
from pfdist.models.recorded import recorded
from pfdist.problem.needs import RULES

pytest.importorskip("jax")

accelerator: Any = pytest.importorskip("pfdist.accelerator.filter")
LARGEST_Z = 4.0  # standard errors
PAPER = tuple(range(0, 61, 3))
SHIPPED = sorted(
    name for name, (home, _) in installed_models().items() if home.startswith("pfdist.")
)
QUICK = ("two_compartments", "xray_tumour")  # the last has sensors


def _check_same_means(first: Any, second: Any) -> None:
    """Means over draws, the first axis, must agree within standard errors of their difference."""
    difference = first - second
    error = difference.std(axis=0, ddof=1) / math.sqrt(len(difference))
    allowed = LARGEST_Z * error + 1e-6 * abs(first.mean(axis=0))
    np.testing.assert_array_less(abs(difference.mean(axis=0)), allowed + 1e-300)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in SHIPPED],
)
def test_the_error_of_every_model_that_ships_is_that_of_the_compiled_engine(name: str) -> None:
    model = load_model(name)
    evaluator = recorded_evaluator(model, model, horizon=8, times=tuple(np.arange(9) / 8))
    draws, estimation = evaluator.draws(range(200), 7), Estimation(64, "systematic")
    times = [tuple(range(0, evaluator.points.first(9), 3))]
    own, compiled = (
        each.filter_checked_sets(evaluator.believed, draws, times, [8], 5, estimation)
        for each in (accelerator, particle_filter)
    )
    assert not own.degenerate.any()
    _check_same_means(own.mse, compiled.mse)


@in_turn(
    "settings",
    [Estimation(70, "multinomial", threshold=0.5, lag=4), Estimation(70, "stratified")],
)
def test_its_results_are_those_of_the_compiled_filter(settings: Estimation) -> None:
    model = recorded(load_model("ungm"), range(11))
    draws = simulate(model, 10, range(3, 403), 7)
    own, compiled = (
        each.filter_checked_draws(model, draws, (0, 3, 4, 8), 5, settings, True)
        for each in (accelerator, particle_filter)
    )
    for name in ("mse", "estimate", "variance", "sizes", "lines", "weight"):
        found, expected = (getattr(each, name) for each in (own, compiled))
        assert found.shape == expected.shape, name
        is_known = ~np.isnan(expected).any(axis=0)
        np.testing.assert_array_equal(~np.isnan(found).any(axis=0), is_known)
        _check_same_means(found[:, is_known], expected[:, is_known])
    _check_same_means(own.cloud.mean(axis=2), compiled.cloud.mean(axis=2))


def test_the_compiled_engine_computes_what_it_lacks() -> None:
    model = recorded(load_model("ungm"), range(11))
    draws, settings = simulate(model, 10, range(9), 7), Estimation(70, "conditional", "control")
    own, compiled = (
        each.filter_checked_sets(model, draws, [(0, 3), ()], [10, 10], 5, settings).mse
        for each in (accelerator, particle_filter)
    )
    np.testing.assert_array_equal(own, compiled)


def test_no_bit_of_a_draw_depends_on_the_draws_beside_it() -> None:
    model, times = recorded(load_model("ungm"), range(11)), (0, 3, 4, 8)
    draws, settings = simulate(model, 10, range(300), 7), Estimation(70, "stratified")

    def mse(some: Any, known: Any = model) -> Any:
        return accelerator.filter_checked_draws(known, some, times, 5, settings).mse

    whole = mse(draws)
    for part in (slice(0, 1), slice(229, 240), slice(299, 300)):
        np.testing.assert_array_equal(mse(draws[part]), whole[part])
    of_a_run = recorded(load_model("ungm"), range(1))  # as a run that resumes reads it
    np.testing.assert_array_equal(mse(draws, of_a_run), whole)


def test_the_papers_error_is_that_of_the_prototype() -> None:
    evaluator = Evaluator(recorded(load_model("ungm"), range(61)), 60, engine="jax")
    work = evaluator.work([PAPER], 3, 4, (0, 400), Estimation(500, "systematic"))
    mse = evaluator(work).mse[:, 0]
    assert abs(mse.mean() - 31.14) <= LARGEST_Z * mse.std() / 20 + 0.06  # 31.08 to 31.20


@in_turn("lag", [0, 3])
def test_its_error_is_the_known_one_of_a_linear_gaussian_model(lag: int) -> None:
    model, times = recorded(SCALAR.as_model(), range(13)), (2, 5, 9)
    evaluator = Evaluator(model, 12, engine="jax", lag=lag)
    work = evaluator.work([times, ()], 3, 4, (0, 600), Estimation(100, "systematic"))
    mse = evaluator(work).mse
    linear = replace(SCALAR.as_model(), linear_gaussian=True)
    exact = kalman.expected_mse(linear, 12, [times, ()], lag=lag)
    error = mse.std(axis=0) / math.sqrt(len(mse))
    assert (abs(mse.mean(axis=0) - exact * (1 + 1 / 100)) <= LARGEST_Z * error).all()


def test_a_job_can_name_it_and_what_it_lacks_is_not_accepted() -> None:
    given: dict[str, Any] = {"horizon": 60, "measurement_budget": 21, "engine": "jax"}
    problem = pfdist.Problem("ungm", resampling="systematic", proposal="plain", **given)
    found = pfdist.evaluate(problem.job(seed=1), PAPER, draws=40)
    assert 0 < found.expected_mse < math.inf
    model = load_model("ungm")
    with pytest.raises(JobError, match=r"a rule needs filter\.engine = 'compiled', got 'jax'"):
        RULES.check("a rule", problem.job(seed=1), Evaluator(model, 60, engine="jax"))
    with pytest.raises(ModelError, match=r"needs filter\.engine = 'compiled', got 'jax'"):
        Evaluator(model, 8, engine="jax", estimations=(Estimation(9, proposal=GUIDED),))
    with pytest.raises(TraceError, match="the engine 'batched' calls its functions"):
        pfdist.Filter(batched(model), 9, engine="jax")
