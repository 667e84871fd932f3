"""Errors of one replicate: by hand with Kalman's recursion, and as they are foreseen exactly."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pfdist
from oracles.lake import HORIZON, estimates, lake
from oracles.learned import WALK
from pfdist import Sensor
from pfdist.errors import MeasurementsError, TaskError
from pfdist.filters.simulation import simulate
from pfdist.plugins.backtest.backtesting import (
    ReplicateErrors,
    ReplicateWork,
    errors_of_replicates,
    points_of_rows,
    with_repeats,
)
from pfdist.pools.base import SerialPool
from pfdist.problem.clock import Clock
from pfdist.problem.problem import as_job
from pfdist.problem.replicates import Replicate
from pfdist.runner.build import build
from pfdist.runner.replicates import evaluator_for, outcomes

SETS = ((0, 11, 17, 24), (6, 18, 30, 42))
VARIANCE = 1.7
DRAWS = 1000


def work(
    y: Any, model: Any = None, *, sets: Any = SETS, z: Any = None, parameters: Any = None,
    clock: Clock | None = None, draws: int = DRAWS, **keys: Any,
) -> ReplicateWork:  # fmt: skip
    """The work of a replicate that is measured at all instants."""
    model, y = model or lake(), np.asarray(y, np.float64)
    given = {"horizon": HORIZON, "measurement_budget": 4, "engine": "kalman"} | keys
    built = build(as_job(pfdist.Problem(model, **given), []))
    on = clock or built.job.problem.clock
    replicate = Replicate("a", on, y, z, parameters or {}, has_own_clock=clock is not None)
    evaluator = evaluator_for(built, replicate, is_predicted=z is None)
    judged = (y if z is None else z).copy()
    sensors = len(model.ways)
    judged[sorted({number // sensors for times in sets for number in times})] = np.nan
    variances = np.full(judged.shape[1], VARIANCE)
    streams = (5, 6)
    return ReplicateWork(evaluator, y, judged, variances, tuple(sets), draws, streams,
                         built.comparing, is_measured=z is None)  # fmt: skip


def means_agree(found: Any, expected: Any) -> None:
    """Each mean over draws has the expected value, within 4.5 standard errors."""
    error = found.std(axis=1, ddof=1) / np.sqrt(found.shape[1])
    assert np.all(np.abs(found.mean(axis=1) - expected) < 4.5 * error)


@pytest.fixture(scope="module")
def y() -> Any:
    return simulate(lake(), HORIZON, range(1), 99).y[0]


def exact(y: Any, judged: Any, sets: Any = SETS, **parameters: float) -> tuple[Any, Any]:
    """The real error with each set, and the exact expected error of the right model."""
    noise, real, foreseen = parameters.get("noise", 0.1), [], []
    which = ~np.isnan(judged[:, 0])
    for times in sets:
        mean, variance = estimates(y[:, 0], times, **parameters)
        real.append(np.mean((judged[:, 0] - mean)[which] ** 2) / VARIANCE)
        foreseen.append(np.mean(variance[which] + noise**2) / VARIANCE)
    return np.array(real), np.array(foreseen)


def test_errors_are_those_by_hand_and_as_foreseen_exactly(y: Any) -> None:
    todo = work(y)
    found = errors_of_replicates(todo)
    real, foreseen = exact(y, todo.judged)
    np.testing.assert_allclose(found.real, real, rtol=1e-9)
    means_agree(found.foreseen, foreseen)
    assert found.noise == pytest.approx(0.1**2 / VARIANCE, rel=0.02)
    assert found.impossible == 0
    for number, times in enumerate(SETS):
        mean, variance = estimates(y[:, 0], times)
        np.testing.assert_allclose(found.estimates[number, :, 0], mean, atol=1e-9)
        half = stats.norm.ppf(0.95) * np.sqrt(variance + 0.1**2)
        error = 1.8 * np.sqrt(variance + 0.1**2) / np.sqrt(DRAWS) * 2.1  # of a 5 % quantile
        assert np.all(np.abs(found.high[number, :, 0] - mean - half) < 2.5 * error)
        assert np.all(np.abs(mean - half - found.low[number, :, 0]) < 2.5 * error)
        low, high = (each[number] for each in (found.low, found.high))
        inside = ((low <= y) & (y <= high))[~np.isnan(todo.judged)]
        assert found.covered[number] == inside.mean()


def test_surprises_are_p_values_of_the_measurements_of_the_plan(y: Any) -> None:
    found, expected = errors_of_replicates(work(y, draws=10)).surprises, []
    for number, t in enumerate(SETS[0]):
        mean, variance = estimates(y[:, 0], SETS[0][:number])
        expected.append(2 * stats.norm.sf(abs(y[t, 0] - mean[t]) / np.sqrt(variance[t] + 0.01)))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_two_rows_of_a_time_are_weighed_twice(y: Any) -> None:
    """The filter has both; the first is judged where no set measures."""
    todo = work(y, parameters={"noise": 1.0})
    both = np.concatenate([y, np.full_like(y, np.nan)], axis=1)
    both[[0, 17, 20], 1] = [2.5, -1.0, 4.0]
    evaluator, model = with_repeats(todo.evaluator, 2), lake()
    sets = tuple(points_of_rows(times, both, model, 2) for times in SETS)
    assert sets == ((0, 1, 22, 34, 35, 48), (12, 36, 60, 84))
    found = errors_of_replicates(replace(todo, evaluator=evaluator, y=both, sets=sets))
    real, foreseen = exact(y, todo.judged, noise=1.0)
    which = ~np.isnan(todo.judged[:, 0])
    mean, variance = estimates(both, SETS[0], noise=1.0)
    real[0] = np.mean((y[:, 0] - mean)[which] ** 2) / VARIANCE
    foreseen[0] = np.mean(variance[which] + 1.0) / VARIANCE
    np.testing.assert_allclose(found.real, real, rtol=1e-9)
    means_agree(found.foreseen, foreseen)
    assert found.surprises.size == 4  # of both rows together


def test_a_right_model_covers_nine_of_ten_values_and_real_errors_are_as_foreseen() -> None:
    systems = simulate(lake(), HORIZON, range(16), 98).y
    results = [errors_of_replicates(work(each, draws=60)) for each in systems]
    means_agree(np.array([each.covered for each in results]).T, 0.9)
    expected = exact(systems[0], work(systems[0], draws=1).judged)[1]
    means_agree(np.array([each.real for each in results]).T, expected)


def test_the_parameters_of_the_replicate_are_those_of_its_filter_and_its_draws(y: Any) -> None:
    given = {"noise": 0.5, "sd": 0.2}
    todo = work(y, parameters=given)
    found = errors_of_replicates(todo)
    real, foreseen = exact(y, todo.judged, **given)
    np.testing.assert_allclose(found.real, real, rtol=1e-9)
    means_agree(found.foreseen, foreseen)
    assert found.noise == pytest.approx(0.25 / VARIANCE, rel=0.02)


def test_known_quantities_are_judged_without_noise(y: Any) -> None:
    draws = simulate(lake(), HORIZON, range(1), 99)
    todo = work(draws.y[0], z=draws.z[0])
    found = errors_of_replicates(todo)
    real, foreseen = exact(draws.y[0], todo.judged)
    np.testing.assert_allclose(found.real, real, rtol=1e-9)
    means_agree(found.foreseen, foreseen - 0.01 / VARIANCE)
    assert found.noise == 0.0


def test_particles_have_the_exact_errors_within_their_noise(y: Any) -> None:
    todo = work(y, engine="compiled", particles=2000, draws=100)
    found = errors_of_replicates(todo)
    real, foreseen = exact(y, todo.judged)
    np.testing.assert_allclose(found.real, real, rtol=0.05)
    means_agree(found.foreseen, foreseen * 1.002)


def test_a_clock_of_the_replicate_has_its_own_instants() -> None:
    """An Ornstein-Uhlenbeck process, whose transition over any time is exact."""
    model = pfdist.StateSpaceModel(
        name="ou",
        initial=lambda w, p: (w[0],),
        transition=lambda x, t, w, p: (
            np.exp(-p.dt[t]) * x[0] + np.sqrt(1 - np.exp(-2 * p.dt[t])) * w[0],
        ),
        measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0],),
        log_likelihood=lambda y, x, t, p: -50 * (y[0] - x[0]) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",), process_noise=("normal",), measurement_noise=("normal",),
        linear_gaussian=True,
    )  # fmt: skip
    clock = Clock((0.0, 0.3, 0.7, 2.0), "h")
    keys = {"horizon": 4, "time_step": 0.5, "measurement_budget": 1, "time_unit": "h"}
    todo = work([[0.5], [1.0], [-0.2], [0.8]], model, sets=((1,),), clock=clock, **keys)
    found = errors_of_replicates(todo)
    gain = 1 / 1.01
    kept = np.exp(-np.array([0.4, 1.7]))
    means, variances = kept * gain, 1 - kept**2 * gain
    real = np.array([0.5**2, *((np.array([-0.2, 0.8]) - means) ** 2)])
    assert found.real[0] == pytest.approx(real.mean() / VARIANCE)
    means_agree(found.foreseen, (np.mean([1, *variances]) + 0.01) / VARIANCE)


def test_sensors_are_judged_side_by_side() -> None:
    """The filter takes the measurements of its set alone; both sensors are predicted."""
    alone, noises = lake(), (0.1, 0.4)
    fields = type(alone).__dataclass_fields__
    model = replace(
        alone, name="two", measurement=fields["measurement"].default, y_names=(), normalised=False,
        log_likelihood=fields["log_likelihood"].default, measurement_noise=(),
        sensors={
            name: Sensor(
                lambda x, t, v, p, sd=sd: (x[0] + sd * v[0],),
                lambda y, x, t, p, sd=sd: -0.5 * ((y[0] - x[0]) / sd) ** 2,
                ("normal",),
            )
            for name, sd in zip(("fine", "coarse"), noises, strict=True)
        },
    )  # fmt: skip
    both = simulate(model, HORIZON, range(1), 99).y[0]
    sets = ((0, 23), (34, 35))  # 0 fine, 11 coarse; 17 both
    todo = work(both, model, sets=sets)
    found = errors_of_replicates(todo)
    mean, variance, means, variances = 0.0, 0.3**2 / (1 - 0.95**2), [], []
    for t in range(HORIZON + 1):
        for sensor in (0, 1):
            if t * 2 + sensor in sets[0]:
                gain = variance / (variance + noises[sensor] ** 2)
                mean, variance = mean + gain * (both[t, sensor] - mean), (1 - gain) * variance
        means.append(mean)
        variances.append(variance)
        step = 0.3 * (1 + 0.8 * np.sin(2 * np.pi * t / 48))
        mean, variance = 0.95 * mean, 0.95**2 * variance + step**2
    which = ~np.isnan(todo.judged)
    apart = (todo.judged - np.array(means)[:, None])[which]
    assert found.real[0] == pytest.approx(np.mean(apart**2) / VARIANCE)
    expected = (np.array(variances)[:, None] + np.square(noises))[which].mean() / VARIANCE
    means_agree(found.foreseen[:1], expected)


def test_missing_components_are_missing_in_the_simulated_systems(y: Any) -> None:
    """Both components measure the same state; without the exact one, more error is foreseen."""
    alone = lake()
    model = replace(
        alone, missing_components=True, normalised=False, y_names=(),
        measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0], x[0] + 2.0 * v[1]),
        log_likelihood=lambda y, x, t, p: -50 * (y[0] - x[0]) ** 2 - (y[1] - x[0]) ** 2 / 8,
        measurement_noise=("normal", "normal"),
    )  # fmt: skip
    both = np.hstack([y, y + 0.5])
    lacking = both.copy()
    lacking[list(SETS[0]), 0] = np.nan
    whole, part = (errors_of_replicates(work(each, model)) for each in (both, lacking))
    coarse = estimates(both[:, 1], SETS[0], noise=2.0)
    which = ~np.isnan(work(both, model, draws=1).judged[:, 0])
    np.testing.assert_allclose(part.estimates[0, :, 0], coarse[0], atol=1e-9)
    means_agree(part.foreseen[:1], (coarse[1][which].mean() + (0.01 + 4.0) / 2) / VARIANCE)
    assert whole.foreseen[0].mean() < part.foreseen[0].mean()
    np.testing.assert_array_equal(whole.foreseen[1], part.foreseen[1])


def test_scenarios_have_their_shares_of_the_simulated_systems(y: Any) -> None:
    section = {"parameters": [{"sd": 0.2}, {"sd": 0.6}], "weights": [1, 3], "filter": "nominal"}
    todo = work(y, engine="compiled", scenarios=section, particles=200, draws=480)
    first, second = (errors_of_replicates(replace(todo, evaluator=each)) for each in
                     todo.evaluator.of_scenarios)  # fmt: skip
    found = errors_of_replicates(todo)
    np.testing.assert_array_equal(found.real, first.real)  # the filter is the same
    expected = 0.25 * first.foreseen.mean(axis=1) + 0.75 * second.foreseen.mean(axis=1)
    means_agree(found.foreseen, expected)
    assert np.all(second.foreseen.mean(axis=1) > 2 * first.foreseen.mean(axis=1))


def test_learned_parameters_are_unknown_in_each_simulated_system() -> None:
    given = {"horizon": 8, "measurement_budget": 2, "particles": 100, "engine": "numpy"}
    learned = {"parameters": {"drift": {"normal": [0.0, 1.0]}}, "filter": "learned"}
    y, sets = simulate(WALK, 8, range(1), 3).y[0], ((2, 6),)
    known, unknown = (
        errors_of_replicates(work(y, WALK, sets=sets, draws=240, **given, **more))
        for more in ({}, {"scenarios": learned})
    )
    assert unknown.foreseen.mean() > 1.5 * known.foreseen.mean()
    assert np.isfinite(unknown.real).all()


def test_angles_are_compared_by_the_smaller_difference() -> None:
    model = replace(lake(noise=0.001, sd=0.001), linear_gaussian=False, circular=(0,))
    y = np.full((HORIZON + 1, 1), 0.01)
    y[1:6] = 2 * np.pi - 0.01
    found = errors_of_replicates(work(y, model, engine="numpy", particles=50, draws=50))
    assert np.all(found.real < 0.001)
    plain = replace(model, circular=())
    found = errors_of_replicates(work(y, plain, engine="numpy", particles=50, draws=50))
    assert np.all(found.real > 1.0)


def test_an_impossible_measurement_is_counted_and_left_out(y: Any) -> None:
    """A noise between 0 and 1 cannot give a value of 1e3."""
    uniform = replace(
        lake(), linear_gaussian=False, normalised=False, measurement_noise=("uniform",),
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        log_likelihood=lambda y, x, t, p: np.where((y[0] > x[0]) & (y[0] < x[0] + 1), 0.0, -np.inf),
    )  # fmt: skip
    far = y.copy()
    far[11] = 1e3
    found = errors_of_replicates(work(far, uniform, engine="numpy", particles=100, draws=20))
    assert found.impossible == 1  # with the plan alone
    assert 0.0 in found.surprises.tolist()
    assert np.isfinite(found.real).all()


def test_a_filter_that_collapses_is_counted(y: Any) -> None:
    """At 20 of about 100 deviations of the noise, the nearest particles carry all the weight."""
    far = y.copy()
    far[11] = 20.0  # a measurement of the plan alone
    for engine, collapsed in (("compiled", 1), ("kalman", 0)):
        assert (
            errors_of_replicates(work(far, engine=engine, particles=500, draws=20)).collapsed
            == collapsed
        )
    assert errors_of_replicates(work(y, engine="compiled", particles=500, draws=20)).collapsed == 0


def test_an_error_of_a_task_names_the_purpose() -> None:
    def fails(work: int) -> int:
        raise MeasurementsError("the filter's estimates must be finite")

    with pytest.raises(TaskError, match=r"^a task of the backtest failed: MeasurementsError: the"):
        [*outcomes(SerialPool(), fails, [1], "the backtest")]


def test_results_have_intervals_around_the_means(y: Any) -> None:
    found: ReplicateErrors = errors_of_replicates(work(y, draws=100))
    low, mean, high = found.intervals
    assert np.all((low < mean) & (mean < high))
    assert low.shape == (2, HORIZON + 1, 1)
