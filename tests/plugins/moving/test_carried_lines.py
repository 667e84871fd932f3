"""Lines that one filter hands to the next: both are one filter, bit for bit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.three_sensors import ThreeSensors
from oracles.unknown import constants, level_and_slope, moving
from pfdist import Filter, Problem, StateSpaceModel
from pfdist.densities import normal_logpdf
from pfdist.errors import MeasurementsError
from pfdist.filters import particle_filter, plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.interface import EACH_DRAW
from pfdist.filters.one_filter import OneFilter
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.plugins.online.planning import Replanner

SENSORS = ThreeSensors(0.4, 0.95, 0.5, ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)), (0.3, 0.05, 0.5))
MODELS = [level_and_slope(0.1, 0.05), constants(2, 0.05), SENSORS.as_model()]


def followed(model: StateSpaceModel, seen: list[tuple[int, Any]], engine: str) -> OneFilter:
    """A filter that has stopped at each measurement, and before."""
    at = OneFilter(model, moving(48), 3, 0, engine)
    for t, y in seen:
        at, *_ = at.at(t)
        at, *_ = at.at(t, y)
    return at


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
@pytest.mark.parametrize("times", [(2, 5, 6, 10), (0, 5, 10)])
def test_a_filter_that_stops_has_the_bytes_of_one_that_does_not(
    model: StateSpaceModel, times: tuple[int, ...], engine: str
) -> None:
    y = simulate(model, 12, range(1), 7).y[0]
    seen = [(t, y[t]) for t in times]
    first = OneFilter(model, moving(48), 3, 0, engine)
    filters = plain if engine == "numpy" else particle_filter
    for last in range(1, len(seen) + 1):
        stopped, mean, variance = followed(model, seen[:last], engine).at(12)
        draws, points = first._draws(12, seen[:last])
        whole = filters.filter_checked_draws(model, draws, points, 3, first.settings, True)
        cloud = stopped.settings.prior
        assert isinstance(cloud, Cloud)
        assert cloud.lines is not None
        assert np.array_equal(cloud.x, whole.cloud[0])
        assert np.array_equal(cloud.lines.noise, whole.noise[0])
        assert np.array_equal(mean[-1], whole.estimate[0, -1])
        assert np.array_equal(variance[-1], whole.variance[0, -1])


@pytest.mark.parametrize("lag", [0, 12])
def test_plans_made_on_the_way_start_from_lines_that_still_move(lag: int) -> None:
    # The slope is known by two measurements, and two more: particles without lines keep it.
    model = level_and_slope(0.1, 0.05)
    y = simulate(model, 12, range(1), 7).y[0]
    cloud = followed(model, [(2, y[2]), (5, y[5])], "compiled").at(6)[0].settings.prior
    assert isinstance(cloud, Cloud)
    draws, settings = simulate(model, 12, range(40), 11, cloud), moving(48, prior=cloud, lag=lag)
    found = filter_checked_draws(model, draws, (7, 9, 12), 5, settings, True)
    twin = plain.filter_checked_draws(model, draws, (7, 9, 12), 5, settings, True)
    assert np.allclose(found.estimate, twin.estimate, rtol=1e-8)
    assert np.allclose(found.mse, twin.mse, rtol=1e-8)
    assert found.estimate.shape == draws.z.shape
    sets = [(7, 9, 12), (7, 9), (8,), (6, 7), ()]
    together = filter_checked_sets(model, draws, sets, [12] * 5, 5, settings, EACH_DRAW)
    assert np.array_equal(together.mse[:, 0], found.mse)
    for column, times in enumerate(sets):
        alone = filter_checked_sets(model, draws, [times], [12], 5, settings, EACH_DRAW)
        assert np.array_equal(together.errors[:, column], alone.errors[:, 0])
    values = [np.unique(each[1]).size for each in found.cloud]
    stuck = replace(settings, prior=replace(cloud, lines=None))
    left = filter_checked_draws(model, draws, (7, 9, 12), 5, stuck, True)
    assert np.median(values) > 2 * np.median([np.unique(each[1]).size for each in left.cloud])


def test_particles_of_a_user_do_not_move_but_later_noise_does() -> None:
    model = level_and_slope(0.1, 0.05)
    x = np.random.default_rng(1).normal(size=(2, 48)) * 0.3
    cloud = Cloud(2, x)
    draws, settings = simulate(model, 8, range(8), 11, cloud), moving(48, prior=cloud)
    found = filter_checked_draws(model, draws, (4, 6, 8), 5, settings, True)
    twin = plain.filter_checked_draws(model, draws, (4, 6, 8), 5, settings, True)
    assert np.allclose(found.cloud, twin.cloud, rtol=1e-8)
    assert np.isin(found.cloud[:, 1], x[1]).all()
    assert np.unique(found.cloud[0, 0]).size == 48


# --- readings with errors of their own ------------------------------------------------------------

READINGS = [(2, 0.5, 0.05), (5, 1.2, 0.1), (8, 1.9, 0.3)]


def slope_of_readings(u: tuple[float, ...] = (0.2,) * 13) -> StateSpaceModel:
    """A level that grows by an unknown slope, read with the errors u."""
    return replace(
        level_and_slope(0.1, 0.2),
        measurement=lambda x, t, v, p: (x[0] + p.u[t] * v[0],),
        log_likelihood=lambda y, x, t, p: normal_logpdf(y[0], x[0], p.u[t]),
        parameters={"u": u},
        linear_gaussian=False,
    )


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
def test_with_given_errors_a_filter_that_stops_has_the_bytes_of_one_that_does_not(
    engine: str,
) -> None:
    u = dict(zip(range(13), (0.2,) * 13, strict=True)) | {t: own for t, _, own in READINGS}
    known = {"particles": 48, "proposal": "moving", "engine": engine, "horizon": 12, "seed": 3}
    stopped = Filter(slope_of_readings(), **known)
    for t, y, own in READINGS:
        stopped.update(t, y, u=own)
    whole = Filter(slope_of_readings(tuple(u.values())), **known).unmeasured
    seen = [(t, np.array([y])) for t, y, _ in READINGS]
    draws, points = whole._draws(8, seen)
    filters = plain if engine == "numpy" else particle_filter
    found = filters.filter_checked_draws(whole.model, draws, points, whole.stream, whole.settings,
                                         True)  # fmt: skip
    cloud = stopped.cloud
    assert isinstance(cloud, Cloud)
    assert cloud.lines is not None
    assert np.array_equal(cloud.x, found.cloud[0])
    assert np.array_equal(cloud.lines.noise, found.noise[0])
    assert np.array_equal(stopped.now.mean, found.estimate[0, -1])


@pytest.mark.parametrize("by_table", [False, True], ids=["planner", "next"])
def test_plans_behind_readings_with_given_errors_start_from_lines_that_move(
    by_table: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = Problem(
        slope_of_readings(), horizon=12, measurement_budget=5, proposal="moving",
        moved_particles=20, given={"u": "error"},
    )  # fmt: skip
    planned = list[tuple[Any, Any]]()

    def plan(replanner: Replanner, now: Any, *others: Any) -> Any:
        planned.append((replanner.evaluator, now.prior))
        return ()

    monkeypatch.setattr(Replanner, "plan", plan)
    if by_table:
        table = pd.DataFrame(READINGS, columns=["t", "y0", "error"])
        pfdist.next_time(problem, table)
    else:
        planner = pfdist.Planner(problem, [2, 5, 8, 10, 12])
        for t, y, u in READINGS:
            planner.update(y, t, u=u)
    evaluator, cloud = planned[-1]
    assert cloud.lines_for(evaluator.believed) is not None
    assert evaluator.model == evaluator.believed  # so the filter still knows the truth's model
    assert [evaluator.model.parameters["u"][t] for t in (1, 2, 5, 8, 9)] == [0.2, 0.05, 0.1, 0.3,
                                                                            0.2]  # fmt: skip
    # Its slopes move: two more measurements leave far more values than particles without lines.
    draws = replace(evaluator, prior=cloud).draws(range(20), 11)
    found = filter_checked_draws(
        evaluator.believed, draws, (10, 12), 5, moving(20, prior=cloud), True
    )
    stuck = moving(20, prior=replace(cloud, lines=None))
    left = filter_checked_draws(evaluator.believed, draws, (10, 12), 5, stuck, True)
    values, of_copies = (
        np.median([np.unique(x[1]).size for x in each.cloud]) for each in (found, left)
    )
    assert values > 1.5 * of_copies


# --- lines that do not fit ------------------------------------------------------------------------


def a_cloud(model: StateSpaceModel, t: int = 4) -> Cloud:
    """The cloud of a filter with two measurements."""
    y = simulate(model, 12, range(1), 7).y[0]
    cloud = followed(model, [(2, y[2]), (t, y[t])], "compiled").settings.prior
    assert isinstance(cloud, Cloud)
    return cloud


@pytest.mark.parametrize(
    "change",
    [
        lambda model, cloud: (model.with_parameters({"factor_0": (2.0,) * 21}), cloud),
        lambda model, cloud: (
            replace(model, initial=lambda w, p: tuple(2.0 * e for e in w)),
            cloud,
        ),
        lambda model, cloud: (model, replace(cloud, t=6)),
    ],
    ids=["parameters", "formula", "clock"],
)
def test_lines_of_another_system_or_clock_are_left_out(change: Any) -> None:
    # Their noise would give other paths, and other numbers of steps lie outside of arrays.
    model, cloud = change(constants(2, 0.05), a_cloud(constants(2, 0.05)))
    draws = simulate(model, 12, range(4), 11, cloud)
    settings = moving(48, prior=cloud)
    found = filter_checked_draws(model, draws, (8, 12), 5, settings, True)
    without = replace(settings, prior=replace(cloud, lines=None))
    alone = filter_checked_draws(model, draws, (8, 12), 5, without, True)
    assert np.array_equal(found.estimate, alone.estimate)
    assert np.isin(found.cloud[:, 0], cloud.x[0]).all()


def test_an_instant_that_lines_have_measured_is_not_measured_again() -> None:
    model = level_and_slope(0.1, 0.05)
    first = Filter(model, seed=1, horizon=12)
    first.update(3, 0.5)
    second = Filter(model, seed=1, horizon=12, prior=first.cloud)
    assert np.array_equal(second.now.mean, first.now.mean)
    with pytest.raises(MeasurementsError, match="t must be after 3, got 3"):
        second.update(3, 0.7)
    first.update(5, 0.9)
    assert np.array_equal(second.update(5, 0.9).mean, first.now.mean)


def test_lines_of_a_sensor_that_works_or_not_go_on_with_the_same_formula_alone() -> None:
    """Failures say something about x by `works`; any other would change what has happened."""

    def half_of(x: Any, t: Any, p: Any) -> Any:
        return 0.5 + 0.4 * (x[0] > 0.0)

    model = replace(level_and_slope(0.1, 0.05), works=half_of, linear_gaussian=False)
    known: dict[str, Any] = {"seed": 1, "horizon": 12, "proposal": "moving", "particles": 48}
    first = Filter(model, **known)
    first.update(2, 0.5)
    first.update(5, np.nan)
    second = Filter(model, **known, prior=first.cloud)
    first.update(8, 0.9)
    assert np.array_equal(second.update(8, 0.9).mean, first.now.mean)
    cloud = second.cloud
    assert isinstance(cloud, Cloud)
    assert cloud.lines_for(second.model) is not None
    for works in (lambda x, t, p: 0.5 + 0.4 * (x[0] > 0.5), False):
        other = replace(model, works=works)
        assert cloud.lines_for(Filter(other, **known).model) is None
        assert replace(cloud, lines=replace(cloud.lines, model=model)).lines_for(other) is None


@pytest.mark.filterwarnings("ignore:1 row repeats")
@pytest.mark.parametrize(
    ("times", "extra"),
    [
        ((0.1, 0.3, 0.35, 0.8, 1.7), 5),
        ((0.5, 0.5, 1.0, 1.5, 2.0), 0),
        ((0.1, 0.1, 0.8, 1.7, 2.0), 3),
    ],
    ids=["off the clock", "repeats", "both"],
)
def test_any_table_is_planned_from_lines_that_move(
    times: tuple[float, ...], extra: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The filter has an instant for each time of the table and a sensor for each repeat, and so has
    # the evaluator of the plan.
    model = StateSpaceModel(
        name="decay",
        initial=lambda w, p: (1.0 + 0.3 * w[0], -1.0 + 0.3 * w[1]),
        transition=lambda x, t, w, p: (x[0] * np.exp(-np.exp(x[1]) * p.dt[t]), x[1]),
        measurement=lambda x, t, v, p: (x[0] + 0.05 * v[0],),
        log_likelihood=lambda y, x, t, p: normal_logpdf(y[0], x[0], 0.05),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=(),
        measurement_noise=("normal",),
    )
    problem = Problem(model, horizon=12, time_step=0.5, time_unit="h", measurement_budget=4)
    table = pd.DataFrame({"t": times, "y": [0.9, 0.9, 0.8, 0.7, 0.5]})
    planned, plan = list[tuple[Any, Any]](), Replanner.plan

    def noted(replanner: Replanner, now: Any, *others: Any) -> Any:
        planned.append((replanner.evaluator, now))
        return plan(replanner, now, *others)

    monkeypatch.setattr(Replanner, "plan", noted)
    found = pfdist.next_time(problem, table)
    assert found.now == pytest.approx(times[-1], abs=0.5)
    assert found.expected.expected_mse < 0.1
    evaluator, now = planned[-1]
    assert now.extra == extra
    assert evaluator.horizon == 24 + now.extra
    assert now.prior.lines_for(evaluator.believed) is not None
