"""The effective sample size after each measurement (Kong, Liu, Wong 1994): closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from pfdist import StateSpaceModel, linear_gaussian
from pfdist.filters.work import Estimation
from pfdist.sequential.filter import effective_sample_sizes
from pfdist.sequential.one_filter import OneFilter

P = 4000


def _walk(sd: float) -> StateSpaceModel:
    unit = [[1.0]]
    noise = {"initial_noise": unit, "process_noise": unit, "measurement_noise": [[sd]]}
    return linear_gaussian(
        "walk", transition=unit, measurement=unit, quantity_of_interest=unit, **noise
    )


@pytest.mark.parametrize("sd", [0.3, 1.0, 3.0])
def test_a_normal_likelihood_has_the_size_of_the_closed_form(sd: float) -> None:
    """P (E w)^2 / E w^2 for x of N(0, 1) and w = exp(-(y - x)^2 / (2 sd^2)).

    The tolerance is 4 standard errors of 50 filters, and the estimate's bias of order 1 / sqrt(P).
    """
    y = 0.7

    def mean_of_power(k: int) -> float:  # E w^k
        variance = sd**2 / k
        return float(np.sqrt(variance / (1 + variance)) * np.exp(-(y**2) / (2 * (1 + variance))))

    expected = P * mean_of_power(1) ** 2 / mean_of_power(2)
    first = OneFilter(_walk(sd), Estimation(P), 5, engine="numpy")
    sizes = [
        effective_sample_sizes(replace(first, draw=draw), (0,), np.array([[y]]))[0]
        for draw in range(50)
    ]
    error = np.std(sizes, ddof=1) / np.sqrt(len(sizes))
    assert abs(np.mean(sizes) - expected) < 4 * error + expected / np.sqrt(P)
    assert error < 0.02 * expected


def test_a_measurement_that_says_nothing_leaves_all_particles(ungm: StateSpaceModel) -> None:
    vague = replace(ungm, log_likelihood=lambda y, x, t, p: 0.0 * x[0])
    first = OneFilter(vague, Estimation(100), 5, engine="numpy")
    sizes = effective_sample_sizes(first, (0, 4, 5), np.zeros((3, 1)))
    assert sizes == pytest.approx([100, 100, 100])


def test_from_a_measurement_that_no_particle_explains_there_is_no_size(
    ungm: StateSpaceModel,
) -> None:
    first = OneFilter(ungm, Estimation(100), 5, engine="numpy")
    sizes = effective_sample_sizes(first, (0, 4, 5), np.array([[0.0], [np.nan], [0.0]]))
    assert sizes[0] > 1
    assert np.isnan(sizes[1:]).all()
