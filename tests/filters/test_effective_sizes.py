"""The effective sample size after each measurement (Kong, Liu, Wong 1994): closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from pfdist import StateSpaceModel, linear_gaussian
from pfdist.filters import particle_filter, plain
from pfdist.filters.draws import Draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation

P = 4000
ENGINES = pytest.mark.parametrize("engine", [particle_filter, plain])


def _walk(sd: float) -> StateSpaceModel:
    unit = [[1.0]]
    noise = {"initial_noise": unit, "process_noise": unit, "measurement_noise": [[sd]]}
    return linear_gaussian(
        "walk", transition=unit, measurement=unit, quantity_of_interest=unit, **noise
    )


def _measured(model: StateSpaceModel, draws: int, *y: float) -> Draws:
    drawn = simulate(model, len(y) - 1, range(draws), 3)
    return replace(drawn, y=np.tile(np.array(y)[:, None], (draws, 1, 1)))


@ENGINES
@pytest.mark.parametrize("sd", [0.3, 1.0, 3.0])
def test_a_normal_likelihood_has_the_size_of_the_closed_form(sd: float, engine) -> None:
    """P (E w)^2 / E w^2 for x of N(0, 1) and w = exp(-(y - x)^2 / (2 sd^2)).

    The tolerance is 4 standard errors of 50 filters, and the estimate's bias of order 1 / sqrt(P).
    """
    y, model = 0.7, _walk(sd)

    def mean_of_power(k: int) -> float:  # E w^k
        variance = sd**2 / k
        return float(np.sqrt(variance / (1 + variance)) * np.exp(-(y**2) / (2 * (1 + variance))))

    expected = P * mean_of_power(1) ** 2 / mean_of_power(2)
    given = model, _measured(model, 50, y, y), (0,), 5, Estimation(P), True
    sizes = engine.filter_checked_draws(*given).sizes
    assert np.isnan(sizes[:, 1]).all()
    error = np.std(sizes[:, 0], ddof=1) / np.sqrt(50)
    assert abs(np.mean(sizes[:, 0]) - expected) < 4 * error + expected / np.sqrt(P)
    assert error < 0.02 * expected


@ENGINES
def test_a_measurement_that_says_nothing_leaves_all_particles(ungm, engine) -> None:
    vague = replace(ungm, log_likelihood=lambda y, x, t, p: 0.0 * x[0])
    given = vague, _measured(vague, 2, *[0.0] * 6), (0, 4, 5), 5, Estimation(100), True
    sizes = engine.filter_checked_draws(*given).sizes
    assert sizes[:, [0, 4, 5]] == pytest.approx(100)


@ENGINES
def test_a_measurement_that_no_particle_explains_has_no_size(ungm, engine) -> None:
    given = ungm, _measured(ungm, 2, 0.0, 0.0, np.nan, 0.0), (0, 2, 3), 5, Estimation(100), True
    sizes = engine.filter_checked_draws(*given).sizes
    assert np.isnan(sizes[:, [1, 2]]).all()
    assert (sizes[:, [0, 3]] > 1).all()


@pytest.mark.parametrize("threshold", [0.1, 0.9])
def test_carried_weights_count(ungm, threshold: float) -> None:
    draws, settings = simulate(ungm, 8, range(20), 3), Estimation(100, threshold=threshold)
    given = ungm, draws, (0, 2, 3, 8), 5, settings, True
    sizes, plain_sizes = (
        each.filter_checked_draws(*given).sizes for each in (particle_filter, plain)
    )
    np.testing.assert_allclose(sizes, plain_sizes, rtol=1e-9)
