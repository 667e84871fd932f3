"""Replicates of a long table: the names of its columns."""

import numpy as np
import pandas as pd

from pfdist.common.clock import Clock
from pfdist.filters.replicates import read_replicates
from pfdist.models import StateSpaceModel


def decaying() -> StateSpaceModel:
    """A component that decays by the clock, with a dose at each instant and a yield."""
    return StateSpaceModel(
        name="decaying",
        initial=lambda w, p: (p.yield_0 + w[0],),
        transition=lambda x, t, w, p: (np.exp(-0.1 * p.dt[t]) * x[0] + p.dose[t],),
        measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / 0.1) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=(),
        measurement_noise=("normal",),
        parameters={"dose": (0.0,), "yield_0": 1.0},
        linear_gaussian=True,
        y_names=("amount",),
    )


def test_other_columns_may_begin_with_the_letter_of_measurements() -> None:
    clock = Clock(tuple(np.arange(5.0)), "h")
    rows = pd.DataFrame({
        "year": 1960, "t": clock.times, "y_amount": [1.0, 0.9, 0.8, 0.8, 0.7], "yield_0": 1.0,
        "dose": [0.0, 1.0, 0.0, 1.0, 0.0],
    })  # fmt: skip
    model = decaying().with_parameters({"dose": [0.0] * 5})
    [read] = read_replicates(rows, "year", model, clock, ["dose", "yield_0"])
    assert read.parameters == {"yield_0": 1.0, "dose": (0.0, 1.0, 0.0, 1.0, 0.0)}
    np.testing.assert_array_equal(read.y[:, 0], rows["y_amount"])
