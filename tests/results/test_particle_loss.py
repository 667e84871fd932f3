"""The loss by a finite number of particles: when it is small, what is said, and a run's tables."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.results_of import results_of
from pfdist.common.estimate import Estimate
from pfdist.filters.kalman import expected_mse
from pfdist.results import Moments
from pfdist.results.particle_loss import (
    ParticleLoss,
    hardly_measured,
    less,
    particle_loss,
    particle_losses_of,
)


def test_a_mean_less_that_of_the_first_draws_has_the_error_of_both() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(400):
        every = rng.normal(3.0, 2.0, 500)
        other = 0.5 * every[:100] + rng.normal(0.0, 0.5, 100)
        whole = Moments()
        whole.add(every)
        found.append(less(whole, every[:100], other))
    values = np.array([each.value for each in found])
    assert values.mean() == pytest.approx(1.5, abs=4 * values.std() / 20)
    assert np.mean([each.standard_error for each in found]) == pytest.approx(values.std(), rel=0.15)
    assert math.isnan(less(whole, every[:1], every[:1]).value)


def loss(particles: int, by_two_filters: float, at_most: float, error: float = 0.0) -> ParticleLoss:
    return ParticleLoss(particles, Estimate(by_two_filters, error), Estimate(at_most, error))


@pytest.mark.parametrize(
    ("by_two_filters", "at_most", "error", "small", "open_"),
    [
        (0.01, 0.049, 0.0, True, True),
        (0.011, 0.02, 0.0, False, False),
        (0.01, 0.05, 0.0, False, False),
        (0.005, 0.04, 0.01, False, True),  # more draws may show it
        (0.005, 0.08, 0.01, False, False),
        (math.nan, math.nan, 0.0, False, False),  # all draws are infinite
    ],
)
def test_a_loss_is_small_if_both_figures_are_and_more_draws_are_taken_where_it_is_open(
    by_two_filters: float, at_most: float, error: float, small: bool, open_: bool
) -> None:
    found = loss(100, by_two_filters, at_most, error)
    assert (found.is_small, found.may_be_small) == (small, open_)
    assert not replace(found, top_share=0.26).is_small
    assert not replace(found, top_share=0.25).rare


def test_the_limit_is_at_most_100_percent() -> None:
    assert loss(100, 0.5, 0.9, 0.2).limit == 1.0


@pytest.mark.parametrize(
    ("catastrophes", "size", "is_rare"), [(0, 0.0, False), (10, 5.0, False), (10, 50.0, True)]
)
def test_a_few_draws_that_carry_the_excess_are_said(
    catastrophes: int, size: float, is_rare: bool
) -> None:
    """Exponential errors of mean 1; ten of 4,000 draws add 0.0125 or 0.125 to it."""
    rng = np.random.default_rng(3)
    variance, noise = rng.uniform(0.5, 1.5, 4000), rng.exponential(1.0, 4000)
    squared = variance * noise
    squared[:catastrophes] += size
    whole = Moments()
    whole.add(squared)
    found = particle_loss(500, whole, squared, np.zeros(4000), variance)
    assert bool(found.rare) == is_rare
    assert found.rare in found.warning


def test_a_large_loss_must_be_clear() -> None:
    assert loss(100, 0.06, 0.1).is_large
    assert loss(100, 0.01, 0.21).is_large
    assert not loss(100, 0.06, 0.21, 0.01).is_large
    assert not loss(100, 0.05, 0.2).is_large


def test_times_that_hardly_beat_no_measurement_are_named() -> None:
    assert hardly_measured(0.96, 1.0).startswith(
        "These times are hardly better than no measurement"
    )
    assert hardly_measured(0.94, 1.0) == ""


def test_a_run_tells_the_loss_of_each_set_from_its_tables(finished: Callable[..., Path]) -> None:
    changes = ["model.name=random_walk", "filter.particles=5", "comparison.draws=1500"]
    run = pfdist.open_run(finished(*changes))
    assert len(run.table("filter_distance")) == len(run.table("filter_variance")) == 1000
    nothing = expected_mse(pfdist.load_model("random_walk"), 12, [()])[0]
    column = run.table("filter_variance")["unmeasured"]
    tolerance = 4 * column.std() / math.sqrt(1000)
    assert column.mean() == pytest.approx(nothing * 4 / 5, abs=tolerance)  # (P - 1) / P of it
    for name in run.names:
        result = results_of(run)[name]
        assert 0.05 < result.particle_loss < result.particle_loss_at_most
        assert "5 particles may be too few" in result.warnings[0]


def test_exact_engines_lose_nothing_and_say_nothing(finished: Callable[..., Path]) -> None:
    run = pfdist.open_run(finished("model.name=random_walk", "filter.engine=kalman"))
    assert particle_losses_of(run) == {}
    assert not any(result.particle_loss for result in results_of(run).values())
