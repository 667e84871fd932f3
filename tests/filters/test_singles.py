"""float32 states: nearly the errors of float64 states under the same noise, and their own bits."""

from dataclasses import replace

import numpy as np
import pytest

from oracles.clocked import with_clock
from oracles.guided import growth, sharp_walk
from oracles.kalman import SCALAR
from pfdist import load_model
from pfdist.errors import ModelError
from pfdist.filters import kalman
from pfdist.filters.cloud import Cloud
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import FLOAT32, Estimation, with_truth
from pfdist.kernels.estimators import FILTER_NOISE
from pfdist.models import installed_models

HORIZON, TIMES, STREAM = 12, (0, 3, 4, 9, 12), 5
SHIPPED = sorted(name for name, (module, _) in installed_models().items() if "pfdist." in module)
QUICK = {"ungm", "bearings_only", "two_compartments"}  # `pytest -m zoo` compiles the others
UNGM = load_model("ungm")


def filtered(model, draws, settings, times=TIMES):
    """The results with float64 states, and with float32 states."""
    singles = replace(settings, dtype=FLOAT32)
    return [
        filter_checked_draws(model, draws, times, STREAM, each, True)
        for each in (settings, singles)
    ]


def difference(with_all, singles):
    """The mean difference of the errors of draws, and its standard error."""
    apart = singles.mse - with_all.mse
    return apart.mean(), apart.std(ddof=1) / np.sqrt(apart.size)


@pytest.mark.parametrize(
    ("model", "settings"),
    [
        *(
            pytest.param(
                load_model(name),
                Estimation(100),
                id=name,
                marks=[pytest.mark.zoo] * (name not in QUICK),
            )
            for name in SHIPPED
        ),
        pytest.param(UNGM, Estimation(101, "sorted_systematic"), id="sorted"),
        pytest.param(UNGM, Estimation(100, "residual", threshold=0.5), id="carried"),
        pytest.param(UNGM, Estimation(100, estimator=FILTER_NOISE.name), id="two filters"),
        pytest.param(growth, Estimation(100, "systematic"), id="guided"),
        pytest.param(sharp_walk(3), Estimation(100, "stratified"), id="guided, 3 components"),
    ],
)
def test_the_mean_error_is_that_of_float64_states(model, settings):
    """400 paired draws: within 4 standard errors, or a thousandth."""
    model = with_clock(model, HORIZON)
    draws = simulate(model, HORIZON, range(400), 3)
    sensors = len(model.parts)
    times = tuple(t * sensors + t % sensors for t in TIMES)
    with_all, singles = filtered(model, draws, settings, times)
    apart, error = difference(with_all, singles)
    assert abs(apart) < max(4.0 * error, 1e-3 * with_all.mse.mean())
    assert not np.array_equal(singles.mse, with_all.mse)  # the states have other bits
    for cloud in singles.last[:3]:
        np.testing.assert_array_equal(cloud, cloud.astype(np.float32))


def test_the_expected_error_is_that_of_the_kalman_filter():
    """2,000 draws with 1,000 particles, beside the exact error; 4 standard errors."""
    model = SCALAR.as_model()
    draws = simulate(model, HORIZON, range(2_000), 3)
    _, singles = filtered(model, draws, Estimation(1_000, "systematic"))
    exact = kalman.filter_draws(model, draws, TIMES, 1, STREAM).mse.mean()
    error = singles.mse.std(ddof=1) / np.sqrt(singles.mse.size)
    assert abs(singles.mse.mean() - exact) < 4.0 * error + 2e-3 * exact


def test_the_truth_among_the_particles_has_its_rank():
    """The shares below and at the truth, which is rounded as the other particles are."""
    draws = simulate(UNGM, HORIZON, range(400), 3)
    with_all, singles = (each.ranks for each in filtered(UNGM, draws, with_truth(100)))
    assert (singles[1][:, list(TIMES)] > 0.0).all()  # at the truth: the truth itself
    means, shares = np.nanmean(singles, axis=(1, 2, 3)), np.nanmean(with_all, axis=(1, 2, 3))
    np.testing.assert_allclose(means, shares, atol=0.02)


def test_a_filter_starts_from_particles():
    start = Cloud(4, np.random.default_rng(1).normal(2.0, 1.0, (1, 300)))
    draws = simulate(UNGM, HORIZON, range(400), 3, start)
    with_all, singles = filtered(UNGM, draws, Estimation(100, prior=start), (4, 9, 12))
    apart, error = difference(with_all, singles)
    assert abs(apart) < max(4.0 * error, 1e-3 * with_all.mse.mean())


def test_sets_together_have_the_bits_of_each_alone():
    """A saved prefix keeps the float32 states."""
    draws, sets = simulate(UNGM, HORIZON, range(20), 3), [(0, 3), (0, 3, 9), (0, 4), (0, 3, 12)]
    settings = Estimation(70, dtype=FLOAT32)
    together, _ = filter_checked_sets(UNGM, draws, sets, [HORIZON] * 4, STREAM, settings)
    for times, mse in zip(sets, together.T, strict=True):
        alone = filter_checked_draws(UNGM, draws, times, STREAM, settings).mse
        np.testing.assert_array_equal(mse, alone)


def test_results_do_not_depend_on_how_draws_are_batched():
    settings, draws = Estimation(70, dtype=FLOAT32), simulate(UNGM, HORIZON, range(20), 3)
    whole = filter_checked_draws(UNGM, draws, TIMES, STREAM, settings).mse
    parts = [
        filter_checked_draws(UNGM, draws[d : d + 1], TIMES, STREAM, settings).mse[0]
        for d in range(20)
    ]
    np.testing.assert_array_equal(whole, parts)


def test_an_evaluation_has_another_id():
    evaluator, usual = Evaluator(UNGM, HORIZON), Estimation(40)
    assert "dtype" not in usual.recorded  # ids of float64 states are those of before
    ids = {
        evaluator.id_of(each, TIMES, HORIZON, 1) for each in (usual, replace(usual, dtype=FLOAT32))
    }
    assert len(ids) == 2


@pytest.mark.parametrize("engine", ["numpy", "kalman"])
def test_other_engines_refuse_it(engine):
    evaluator = Evaluator(SCALAR.as_model(), HORIZON, engine=engine)
    with pytest.raises(ModelError, match=rf"'float32' needs the engine 'compiled', got '{engine}'"):
        evaluator.check(Estimation(40, dtype=FLOAT32))
