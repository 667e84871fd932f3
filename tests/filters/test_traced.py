"""The filter and the simulation by traced formulas, beside exact filters."""

from dataclasses import replace

import numpy as np
import pytest

from pfdist import load_model
from pfdist.filters import kalman, particle_filter
from pfdist.filters.cloud import Cloud
from pfdist.filters.formulas import simulation_blocks
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, with_truth
from pfdist.kernels.schemes import ALWAYS, SCHEMES
from pfdist.models import base

CLOCK = tuple(0.5 * t for t in range(31))


def model_of(name):
    model = load_model(name)
    return model.on_clock(CLOCK) if model.reads_clock else model


def mean_over_error(difference):
    """A mean over its standard error."""
    return difference.mean() / (difference.std(ddof=1) / difference.size**0.5)


def test_many_particles_reach_the_kalman_filter():
    """Estimates of 60 filters with 2,000 particles for the same measurements, 4.5 standard errors.

    The bias of a filter is of the order 1/2,000 of its variance, far below.
    """
    model, times = load_model("linear_gaussian"), (0, 2, 5, 6, 11)
    draws = simulate(model, 12, range(60), 1)
    for values in (draws.x, draws.y, draws.z):
        values[:] = values[:1]
    filtered = particle_filter.filter_draws(model, draws, times, 2000, 2, "systematic", True)
    exact = kalman.filter_draws(model, draws[:1], times, 1, 2, "systematic", True)
    errors = filtered.estimate.std(axis=0, ddof=1) / 60**0.5
    apart = np.abs(filtered.estimate.mean(axis=0) - exact.estimate[0]) / errors
    assert apart.max() < 4.5
    np.testing.assert_allclose(filtered.variance.mean(axis=0), exact.variance[0], rtol=0.02)


def test_the_variance_beside_the_truth_is_the_squared_error_on_average():
    """With the truth among ten particles, for 4,000 draws (Andrieu, Doucet, Holenstein, 2010)."""
    model, times = load_model("linear_gaussian"), [(0, 2, 5, 6, 11)]
    draws = simulate(model, 12, range(4000), 1)
    error, variance = (
        particle_filter.filter_checked_sets(
            model, draws, times, [12], 2, replace(with_truth(10), estimator=estimator)
        )[0][:, 0]
        for estimator in ("squared_error", "filter_variance")
    )
    assert abs(mean_over_error(error - variance)) < 4.5


SETS = [(0, 3, 6, 9), (0, 3, 7), (0, 3, 6, 11), (1, 2), (), (0, 3, 6, 9)]


@pytest.mark.parametrize("resampling", SCHEMES)
def test_results_depend_neither_on_other_draws_nor_on_other_sets(resampling):
    """Batches hold several draws, and sets resume from each other: the bits are the same."""
    model = load_model("ungm")
    draws = simulate(model, 12, range(70), 1)
    for estimator in ("squared_error", "filter_variance", "two_filters"):
        settings = Estimation(50, resampling, estimator)
        ends = [12, 12, 12, 8, 12, 10]
        together, _ = particle_filter.filter_checked_sets(model, draws, SETS, ends, 2, settings)
        for number, (times, end) in enumerate(zip(SETS, ends, strict=True)):
            for some in (slice(0, 1), slice(17, 20), slice(3, 70)):
                alone, _ = particle_filter.filter_checked_sets(
                    model, draws[some], [times], [end], 2, settings
                )
                np.testing.assert_array_equal(alone[:, 0], together[some, number])


def test_sums_of_errors_are_those_of_the_draws():
    model = load_model("ungm")
    draws = simulate(model, 12, range(30), 1)
    settings = Estimation(50, "systematic")
    sums = particle_filter.sum_errors(model, draws, SETS, [12] * len(SETS), 2, settings)
    mse, _ = particle_filter.filter_checked_sets(model, draws, SETS, [12] * len(SETS), 2, settings)
    np.testing.assert_allclose(sums.sum(axis=1) / 13, mse.sum(axis=0), rtol=1e-12)


def test_a_filter_that_stops_has_the_bits_of_one_that_does_not():
    """Also if it carries weights: `prior` holds particles and weights of the instant."""
    model = load_model("ungm")
    draws = simulate(model, 12, range(1), 1)
    whole = particle_filter.filter_draws(
        model, draws, (0, 3, 9), 50, 2, "systematic", True, threshold=0.3
    )
    first = particle_filter.filter_draws(
        model, draws.upto(5), (0, 3), 50, 2, "systematic", True, threshold=0.3
    )
    prior = Cloud(5, first.last[0], first.weight[0])
    rest = replace(draws, x=draws.x[:, 5:], y=draws.y[:, 5:], z=draws.z[:, 5:], start=5)
    second = particle_filter.filter_draws(
        model, rest, (9,), 50, 2, "systematic", True, prior=prior, threshold=0.3
    )
    np.testing.assert_array_equal(second.estimate[:, 1:], whole.estimate[:, 6:])


def test_a_measurement_that_no_particle_explains_is_left_out():
    """The draw is degenerate, and its filter goes as if the measurement were not made."""
    model = load_model("ungm")
    draws = simulate(model, 6, range(8), 1)
    draws.y[3, 4] = np.nan
    both = particle_filter.filter_draws(model, draws, (2, 4), 50, 2, "systematic", True)
    fewer = particle_filter.filter_draws(model, draws, (2,), 50, 2, "systematic", True)
    np.testing.assert_array_equal(both.degenerate, np.arange(8) == 3)
    np.testing.assert_array_equal(both.estimate[3], fewer.estimate[3])


def test_the_place_of_the_truth_is_its_weighted_rank_among_the_particles():
    """The cloud before the measurement gives the rank; weights are rounded to float32."""
    model, settings = load_model("random_walk"), with_truth(50)
    draws = simulate(model, 5, range(30), 1)
    filtered, before = (
        particle_filter.filter_checked_draws(model, draws, times, 2, settings, trajectories=True)
        for times in ((0, 2, 5), (0, 2))
    )
    for d, (x,) in enumerate(before.last):
        weight = np.exp(model.log_likelihood((draws.y[d, 5, 0],), (x,), 5, model.p))
        below = weight[x < draws.z[d, 5, 0]].sum() / weight.sum()
        assert filtered.ranks[0, d, 5, 0] == pytest.approx(below, abs=1e-6)


def test_a_simulated_draw_does_not_depend_on_the_others():
    model = load_model("bearings_only")
    together = simulate(model, 10, range(600), 1)
    alone = simulate(model, 10, range(299, 302), 1)
    for name in "xyz":
        np.testing.assert_array_equal(getattr(together, name)[299:302], getattr(alone, name))


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
