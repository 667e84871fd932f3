"""The loss by a finite number of particles, against the Kalman filter and in a collapse."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.systems import scalar
from pfdist.analysis import Moments
from pfdist.analysis.particle_loss import ParticleLoss, hardly_measured, less, particle_loss
from pfdist.common.estimate import Estimate
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.kalman import expected_mse
from pfdist.filters.work import Estimation, Work, with_truth
from pfdist.models import StateSpaceModel

HORIZON, TIMES = 12, (2, 5, 6, 10)


def measured(model: StateSpaceModel, particles: int, draws: int) -> tuple[ParticleLoss, Moments]:
    """The loss of a set, and the moments of its squared error."""
    evaluator = Evaluator(model, HORIZON)
    squared, distance, variance = (
        evaluator.filtered(Work((TIMES,), (HORIZON,), (7,), 3, (0, draws), estimation)).mse[:, 0]
        for estimation in (
            Estimation(particles),
            Estimation(particles, estimator="filter_noise"),
            with_truth(particles),
        )
    )
    whole = Moments()
    whole.add(squared)
    return particle_loss(particles, whole, squared, distance, variance), whole


@pytest.mark.slow
@pytest.mark.parametrize(("sd", "particles"), [(1.0, 50), (1.0, 200), (0.1, 200)])
def test_two_filters_find_the_loss_against_the_exact_filter(sd: float, particles: int) -> None:
    """Right to order 1/P: the tolerance has the square of the loss beside 4 standard errors."""
    model = scalar("scalar", 0.95, 0.5, sd)
    loss, whole = measured(model, particles, 20_000)
    exact = 1 - expected_mse(model, HORIZON, [TIMES])[0] / whole.mean
    error = math.hypot(loss.by_two_filters.standard_error, whole.standard_error / whole.mean)
    assert loss.by_two_filters.value == pytest.approx(exact, abs=4 * error + exact**2)
    assert loss.at_most.value > exact - 4 * error
    assert loss.at_most.value < 4 * exact + 4 * error
    assert not loss.is_large
    assert loss.warning == ""


@pytest.mark.slow
def test_in_a_collapse_the_upper_figure_alone_shows_the_loss() -> None:
    """A sensor of a ten-thousandth of the prior's deviation: 20 particles never meet it."""
    model = scalar("scalar", 0.95, 0.5, 0.0002)
    loss, whole = measured(model, 20, 4000)
    exact = 1 - expected_mse(model, HORIZON, [TIMES])[0] / whole.mean
    assert loss.at_most.value > exact - 4 * whole.standard_error / whole.mean
    assert loss.is_large
    assert "20 particles may be too few: they lose" in loss.warning


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


COARSE = loss(100, 0.2, 0.4)


@pytest.mark.parametrize(
    ("coarse", "fine", "expected"),
    [
        (COARSE, loss(400, 0.05, 0.1), 400),  # as 1/P
        (COARSE, loss(400, 0.1, 0.15), 800),  # nearly
        (COARSE, loss(400, 0.19, 0.1), None),  # two filters agree in error
        (COARSE, loss(400, 0.05, 0.4), None),  # the upper figure does not fall: a collapse
        (COARSE, loss(400, 0.19, 0.4, 0.2), 1600),  # noise hides it
        (loss(500, 100.0, 100.0), loss(2000, 25.0, 25.0), None),  # nobody can afford so many
    ],
)
def test_a_number_is_named_only_if_both_figures_follow_one_over_p(
    coarse: ParticleLoss, fine: ParticleLoss, expected: int | None
) -> None:
    assert coarse.enough(fine) == expected


def test_a_large_loss_must_be_clear() -> None:
    assert loss(100, 0.06, 0.1).is_large
    assert loss(100, 0.01, 0.21).is_large
    assert not loss(100, 0.06, 0.21, 0.01).is_large
    assert not loss(100, 0.05, 0.2).is_large


def test_times_that_hardly_beat_no_measurement_are_named() -> None:
    assert hardly_measured(0.96, 1.0).startswith("These times hardly beat no measurement at all")
    assert hardly_measured(0.94, 1.0) == ""


def test_a_run_tells_the_loss_of_each_set_from_its_tables(finished: Callable[..., Path]) -> None:
    changes = ["model.name=random_walk", "filter.particles=5", "comparison.draws=1500"]
    run = pfdist.open_run(finished(*changes))
    assert len(run.filter_distance()) == len(run.filter_variance()) == 1000
    nothing = expected_mse(pfdist.load_model("random_walk"), 12, [()])[0]
    column = run.filter_variance()["unmeasured"]
    tolerance = 4 * column.std() / math.sqrt(1000)
    assert column.mean() == pytest.approx(nothing * 4 / 5, abs=tolerance)  # (P - 1) / P of it
    for name in run.names:
        result = run.summary().results[name]
        assert 0.05 < result.particle_loss < result.particle_loss_at_most
        assert "5 particles may be too few" in result.warnings[0]


def test_exact_engines_lose_nothing_and_say_nothing(finished: Callable[..., Path]) -> None:
    run = pfdist.open_run(finished("model.name=random_walk", "filter.engine=kalman"))
    assert run.particle_losses() == {}
    assert not any(result.particle_loss for result in run.summary().results.values())
