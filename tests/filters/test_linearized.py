"""The linearized error of sets: exact for linear formulas; closed forms of information."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from oracles.late import late_walk, meter_and_laboratory
from oracles.unknown import constants, drug, level_and_slope
from pfdist import StateSpaceModel, densities
from pfdist.common.measurement_times import Lag
from pfdist.errors import ModelError
from pfdist.filters import kalman
from pfdist.filters.linearized import linearized
from pfdist.models.repeating import repeated_steps

SETS = [(), (0,), (3, 4), (1, 5, 9, 12), (12,), tuple(range(13))]
LAGS = 0, 12, 3, (2,) * 4 + (0,) * 9
MODELS = level_and_slope(0.1, 0.05), meter_and_laboratory(), late_walk()


@pytest.mark.parametrize("lag", LAGS)
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_it_is_that_of_the_kalman_filter_where_formulas_are_linear(
    model: StateSpaceModel, lag: Lag
) -> None:
    weights = np.linspace(0.5, 1.5, 13)
    found = linearized(model, 12, 3, lag, weights, draws=4)(SETS)
    exact = kalman.expected_mse(model, 12, SETS, weights=weights, lag=lag)
    assert found == pytest.approx(exact, rel=1e-6)


def reading(measurement: Any, log_likelihood: Any, noise: str) -> StateSpaceModel:
    """A constant with a nonlinear measurement."""
    return replace(
        constants(1, 1.0),
        measurement=lambda x, t, v, p: (measurement(x[0], v[0]),),
        log_likelihood=lambda y, x, t, p: log_likelihood(y[0], x[0]),
        measurement_noise=(noise,),
        normalised=False,
        parameters={},
    )


def test_a_reading_whose_error_depends_on_x_counts_in_full() -> None:
    # Closed form, for a mean m and a deviation s: (m'/s)^2 + 2 (s'/s)^2. The slope of the mean
    # alone forgets the second term.
    def deviation(x: Any) -> Any:
        return 0.5 * np.exp(x)

    model = reading(
        lambda x, v: np.exp(x) + deviation(x) * v,
        lambda y, x: densities.normal_logpdf(y, np.exp(x), deviation(x)),
        "normal",
    )
    information = 0.5**-2 + 2.0
    assert linearized(model, 1, 3, draws=8)([(0,)]) == pytest.approx(
        1 / (1 + information), rel=1e-4
    )


@pytest.mark.parametrize(("a", "b"), [(3.0, 0.1), (0.0, 0.5), (-4.0, 0.5)])
def test_counts_have_the_information_of_their_mean(a: float, b: float) -> None:
    # Closed form of a Poisson variable with the mean exp(a + b x): b^2 times the mean.
    model = reading(
        lambda x, v: densities.poisson_draw(v, np.exp(a + b * x)),
        lambda y, x: densities.poisson_logpmf(y, np.exp(a + b * x)),
        "uniform",
    )
    of_draws = linearized(model, 1, 3, draws=400)
    mean = np.exp(a + b * np.random.default_rng(0).normal(size=10**5))
    exact = np.mean(1 / (1 + b**2 * mean))
    lost = 1.0 - of_draws([(0,)])[0]
    assert lost == pytest.approx(1.0 - exact, rel=0.2)


def test_a_step_in_a_loop_is_refused_and_a_smooth_loop_is_not() -> None:
    def transition(jumps: bool) -> Any:
        def moved(x: Any, t: Any, w: Any, p: Any) -> Any:
            def step(values: Any, k: Any, entries: Any) -> Any:
                grown = values[0] + 0.3 * x[0]
                return (np.where(values[0] > 1.5, 0.0, grown) if jumps else grown,)

            return repeated_steps(step, (0.0,), 3)

        return moved

    smooth, broken = (
        replace(constants(1, 0.1), transition=transition(each)) for each in (False, True)
    )
    assert np.isfinite(linearized(smooth, 4, 3)([(1,)])).all()
    with pytest.raises(ModelError, match="transition has 'greater' of x"):
        linearized(broken, 4, 3)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"quantity_of_interest": lambda x, t, p: (np.floor(x[0]),)}, "has 'floor' of x"),
        ({"transition": lambda x, t, w, p: (np.where(x[0] > 0, 1.0, 2.0),)}, "has 'greater' of x"),
        ({"error": lambda z, estimate, t, p: abs(z[0] - estimate[0])}, "only a squared error"),
    ],
)
def test_formulas_without_derivatives_are_refused(changes: Any, why: str) -> None:
    with pytest.raises(ModelError, match=why):
        linearized(replace(constants(1, 0.1), **changes), 4, 3)


def test_a_likelihood_that_jumps_is_refused() -> None:
    model = reading(
        lambda x, v: np.where(v < np.where(x > 0.5, 0.9, 0.1), 1.0, 0.0),
        lambda y, x: densities.binomial_logpmf(y, 1.0, np.where(x > 0.5, 0.9, 0.1)),
        "uniform",
    )
    with pytest.raises(ModelError, match="log_likelihood jumps where x changes"):
        linearized(model, 4, 3)


def test_a_reading_with_bounds_that_depend_on_x_is_refused() -> None:
    model = reading(
        lambda x, v: x + v, lambda y, x: np.where(abs(y - x) < 0.5, 0.0, -np.inf), "centred"
    )
    with pytest.raises(ModelError, match="log_likelihood jumps where x changes"):
        linearized(model, 4, 3)


def test_a_reading_without_noise_is_refused() -> None:
    model = replace(
        reading(lambda x, v: x, lambda y, x: -0.5 * (y - x) ** 2, "normal"),
        measurement=lambda x, t, v, p: (x[0],), measurement_noise=(),
    )  # fmt: skip
    with pytest.raises(ModelError, match="no smooth information"):
        linearized(model, 4, 3)


def test_the_design_of_a_sharp_drug_is_that_of_another_program() -> None:
    # The least linearized error of all 3,003 sets, by 60 draws: .5, 3, 4, 6, 16, 24 h.
    hours = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 24.0)
    model = drug(0.03).on_clock(hours)
    steps = np.diff(hours, prepend=hours[0], append=hours[-1])
    weights = (steps[:-1] + steps[1:]) / 2
    errors = linearized(model, 13, 3, 13, weights / weights.mean())
    least = errors([*combinations(range(14), 6)]).min()
    assert errors([(1, 5, 6, 7, 11, 13)]) <= 1.01 * least
