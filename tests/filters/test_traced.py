"""The filter by traced formulas: what its results depend on, and what it takes and keeps."""

import numpy as np
import pytest

from pfdist import load_model
from pfdist.filters import particle_filter
from pfdist.filters.cloud import Cloud
from pfdist.filters.formulas import simulation_blocks
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, with_truth
from pfdist.kernels.schemes import ALWAYS, SCHEMES
from pfdist.models import base

SETS = [(0, 3, 6, 9), (0, 3, 7), (0, 3, 6, 11), (1, 2), (), (0, 3, 6, 9)]


@pytest.mark.parametrize("resampling", SCHEMES)
def test_results_depend_neither_on_other_draws_nor_on_other_sets(resampling):
    """Batches hold several draws, and sets resume from each other: the bits are the same."""
    model = load_model("ungm")
    draws = simulate(model, 12, range(70), 1)
    for estimator in ("squared_error", "filter_variance", "filter_noise"):
        settings = Estimation(50, resampling, estimator)
        ends = [12, 12, 12, 8, 12, 10]
        together, *_ = particle_filter.filter_checked_sets(model, draws, SETS, ends, 2, settings)
        for number, (times, end) in enumerate(zip(SETS, ends, strict=True)):
            for some in (slice(0, 1), slice(17, 20), slice(3, 70)):
                alone, *_ = particle_filter.filter_checked_sets(
                    model, draws[some], [times], [end], 2, settings
                )
                np.testing.assert_array_equal(alone[:, 0], together[some, number])


def test_the_place_of_the_truth_is_its_weighted_rank_among_the_particles():
    """The cloud before the measurement gives the rank; weights are rounded to float32."""
    model, settings = load_model("random_walk"), with_truth(50)
    draws = simulate(model, 5, range(30), 1)
    filtered, before = (
        particle_filter.filter_checked_draws(model, draws, times, 2, settings, trajectories=True)
        for times in ((0, 2, 5), (0, 2))
    )
    for d, (x,) in enumerate(before.cloud):
        weight = np.exp(model.log_likelihood((draws.y[d, 5, 0],), (x,), 5, model.p))
        below = weight[x < draws.z[d, 5, 0]].sum() / weight.sum()
        assert filtered.ranks[0, d, 5, 0] == pytest.approx(below, abs=1e-6)


def test_the_filter_takes_whole_numbers_and_arrays_that_cannot_be_written():
    """As they arrive at a worker; the filter is compiled for one type of arrays."""
    model = load_model("ungm")
    draws = simulate(model, 6, range(3), 1)
    for values in (draws.x, draws.y, draws.z):
        values.flags.writeable = False
    x, weight = np.arange(50).reshape(1, -1), np.ones(50, np.int64)
    for each in (x, weight):
        each.flags.writeable = False
    for threshold in (ALWAYS, 0.5):
        prior = Cloud(0, x, weight)
        filtered, expected = (
            particle_filter.filter_draws(
                model, draws, (2,), 50, 2, "systematic", True, prior=each, threshold=threshold
            )
            for each in (prior, Cloud(0, x.astype(float), weight.astype(float)))
        )
        np.testing.assert_array_equal(filtered.estimate, expected.estimate)


def test_a_model_keeps_the_last_of_its_filters(monkeypatch):
    """A filter without a horizon asks for other instants at each of its steps."""
    monkeypatch.setattr(base, "_MOST_KEPT", 20)
    model = load_model("ungm")
    for horizon in range(1, 30):
        simulate(model, horizon, range(1), 1)
    assert len(model.derived) == 20
    first = simulation_blocks(model, range(30))
    assert simulation_blocks(model, range(30)) is first
