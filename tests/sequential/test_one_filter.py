"""A filter that stops at each measurement is the filter that is given all of them at once."""

import numpy as np
import pytest

import oracles.kalman
from pfdist import StateSpaceModel
from pfdist.errors import MeasurementsError
from pfdist.evaluation.engines import ENGINES
from pfdist.filters.settings import FilterSettings
from pfdist.filters.simulation import simulate
from pfdist.sequential.one_filter import begin

HORIZON, TIMES = 20, (0, 3, 6, 9, 12, 15, 18)


@pytest.mark.parametrize("engine", ENGINES)
def test_it_equals_the_batch_filter_draw_for_draw(ungm: StateSpaceModel, engine: str) -> None:
    model = oracles.kalman.TRACKING.as_model() if engine == "kalman" else ungm
    settings = FilterSettings(100, "systematic")
    draws = simulate(model, HORIZON, range(4), 7)
    whole = ENGINES[engine].filter_checked_draws(
        model, draws, TIMES, 9, settings, trajectories=True
    )
    for d in range(4):
        filtering = begin(model, settings, 9, d, engine)
        for t in TIMES:
            filtering, estimate, variance = filtering.at(t, draws.y[d, t])
            np.testing.assert_array_equal(estimate[-1], whole.estimate[d, t])
            np.testing.assert_array_equal(variance[-1], whole.variance[d, t])
            assert (filtering.t, filtering.measured) == (t, True)
        filtering, estimate, _ = filtering.at(HORIZON)
        np.testing.assert_array_equal(estimate[1:], whole.estimate[d, TIMES[-1] + 1 :])
        assert not filtering.measured


def test_a_measurement_that_no_particle_explains_is_named(ungm: StateSpaceModel) -> None:
    with pytest.raises(MeasurementsError, match=r"no particle of 10 explains .* at t = 3"):
        begin(ungm, FilterSettings(10), 1).at(3, np.array([np.nan]))
