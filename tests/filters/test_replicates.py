"""Replicates of a long table: names of columns, and clocks of their own."""

import numpy as np
import pandas as pd
import pytest

import pfdist
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


def table(times: dict[str, list[float]]) -> pd.DataFrame:
    """Measurements of years that begin with different yields."""
    noise = np.random.default_rng(1)
    rows = [
        {"year": year, "t": t, "y_amount": (place + 1) * np.exp(-0.1 * t) + noise.normal(0, 0.1),
         "yield_0": place + 1.0, "dose": t % 2}
        for place, (year, each) in enumerate(times.items()) for t in each
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_other_columns_may_begin_with_the_letter_of_measurements() -> None:
    clock = Clock(tuple(np.arange(5.0)), "h")
    rows = table({"1960": [0.0, 1.0, 2.0, 3.0, 4.0]})
    model = decaying().with_parameters({"dose": [0.0] * 5})
    [read] = read_replicates(rows, "year", model, clock, ["dose", "yield_0"])
    assert read.parameters == {"yield_0": 1.0, "dose": (0.0, 1.0, 0.0, 1.0, 0.0)}
    np.testing.assert_array_equal(read.y[:, 0], rows["y_amount"])


@pytest.mark.parametrize("number", [3, 4])
def test_replicates_with_clocks_of_their_own_are_planned_and_judged(number: int) -> None:
    """Each has its own instants, so the covariate has another length; one has too few times."""
    clocks = {str(1960 + k): (np.arange(8) * (1 + k / 10)).tolist() for k in range(4)}
    clocks |= {"1970": [0.0, 1.5]}
    problem = pfdist.Problem(
        decaying(), times=[0.0, 5.0, 10.0, 20.0], measurement_budget=number, engine="kalman",
        parameters={"dose": [0.0] * 4},
    )  # fmt: skip
    found = pfdist.backtest(problem, table(clocks), plan_each=True, within=3.0, pool="serial")
    assert set(found.table["replicate"]) == {"1960", "1961", "1962", "1963"}
    assert set(found.left_out) == {"1970"}
    judged = found.table[found.table["set"] == "plan"].set_index("replicate")["judged"]
    assert (judged >= 8 - 3 * number).all()
    assert (judged <= 8 - number).all()
    assert found.plan == ()
