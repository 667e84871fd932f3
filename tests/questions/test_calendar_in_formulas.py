"""The calendar in formulas: p.day_of_year, p.hour and p.weekday of jobs with dates."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pfdist
from pfdist import StateSpaceModel
from pfdist.errors import ModelError, PfdistWarning

pytestmark = pytest.mark.plugins("check", "filter", "simulate")

DATES = {"start": "2026-03-28T08:00", "step": "6 h", "timezone": "Europe/Brussels"}
JOB = {"horizon": 72, "measurement_budget": 3, "clock": DATES, "engine": "kalman"}
HOURS = [8, 14, 20, 3, 9, 15, 21, 3, 9, 15, 21, 3, 9]
"""Summer time begins in the night to 29 March, so that a watch shows 9 instead of 8."""
DAYS = [87] * 3 + [88] * 4 + [89] * 4 + [90] * 2
WEEKDAYS = [5] * 3 + [6] * 4 + [0] * 4 + [1] * 2  # a Saturday, a Sunday, a Monday, a Tuesday


def _model(**parameters: object) -> StateSpaceModel:
    def here(x, t, p):  # type: ignore[no-untyped-def]
        return (x[0], p.day_of_year[t], p.hour[t], p.weekday[t])

    return StateSpaceModel(
        name="calendar",
        initial=lambda w, p: (w[0],),
        transition=lambda x, t, w, p: (x[0] + np.sin(2 * np.pi * p.hour[t] / 24),),
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
        quantity_of_interest=here,
        initial_noise=("normal",),
        process_noise=(),
        measurement_noise=("normal",),
        parameters=parameters,
        linear_gaussian=True,
        z_names=("x", "day", "hour", "weekday"),
    )


def test_formulas_read_the_local_calendar() -> None:
    found = pfdist.simulate(pfdist.Problem(_model(), **JOB), draws=1)
    assert found["z_hour"].tolist() == HOURS
    assert found["z_day"].tolist() == DAYS
    assert found["z_weekday"].tolist() == WEEKDAYS
    steps = np.diff(found["z_x"])
    np.testing.assert_allclose(steps, np.sin(2 * np.pi * np.array(HOURS[:-1]) / 24), atol=1e-12)


def test_a_parameter_of_the_user_goes_first() -> None:
    found = pfdist.simulate(pfdist.Problem(_model(hour=[*range(13)]), **JOB), draws=1)
    assert found["z_hour"].tolist() == [*range(13)]
    assert found["z_day"].tolist() == DAYS


def test_a_plan_is_made_resumed_and_filters_at_other_times_by_its_calendar(tmp_path: Path) -> None:
    """A run has the values of its instants; those of a table follow from the dates."""
    problem = pfdist.Problem(_model(), **JOB)
    for _ in range(2):
        run = pfdist.plan(problem, tmp_path / "run", bound_draws=0, figures=False, report=False)
    table = pd.DataFrame({"t": ["2026-03-28T20:00", "2026-03-30 09:00"], "y0": [0.5, 0.1]})
    with pytest.warns(PfdistWarning, match="that are not read: hour"):
        found = pfdist.filter_measurements(run, table.assign(hour=[20, 7]))
    assert found.table["mean_hour"].tolist() == HOURS
    own = pfdist.filter_measurements(problem, table)
    pd.testing.assert_frame_equal(own.table, found.table)
    step = lambda x, t, w, p: (x[0] + p.dt[t] * w[0],)  # noqa: E731  a model of any time
    free = replace(_model(), transition=step, process_noise=("normal",))
    rows = pd.DataFrame({"t": ["2026-03-28T08:30", "2026-03-29 04:15"], "y0": [0.5, 0.1]})
    found = pfdist.filter_measurements(pfdist.Problem(free, **JOB), rows)
    assert found.table["mean_hour"].tolist() == [8, 8.5, 14, 20, 3, 4.25, *HOURS[4:]]


@pytest.mark.parametrize("clock", [{}, {"time_step": 1, "time_unit": "h"}])
def test_a_model_that_reads_dates_needs_them(clock: dict[str, object]) -> None:
    problem = pfdist.Problem(_model(), **{**JOB, "clock": None}, **clock)
    with pytest.raises(
        ModelError, match=r"p\.hour\[t\] .* need a job with dates: give its clock a start"
    ):
        pfdist.simulate(problem)


def test_a_model_of_a_job_with_dates_is_checked_with_them() -> None:
    checks = pfdist.check_model(pfdist.Problem(_model(), **JOB))
    assert "wrong" not in {*checks["state"]}
