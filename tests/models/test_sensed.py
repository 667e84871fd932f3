"""Sensors with limits, failures and repeats, against enumeration, a grid filter and Kalman filters.

Each is a transformation of the model, so the filter, the search and the proof need nothing new.
"""

import math
from dataclasses import replace
from itertools import combinations, combinations_with_replacement, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import log_ndtr

import pfdist
from oracles.late import LATE, late_walk, meter_and_laboratory, of_delays, of_late_walk
from pfdist import Filter, Problem, Sensor, StateSpaceModel, densities
from pfdist.common.sensing import Sensing
from pfdist.errors import JobError, MeasurementTimesError, ModelError
from pfdist.filters import particle_filter, plain
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.models.base import formula_of_each_sensor
from pfdist.models.sensed import sensed
from pfdist.pages.terminal import lines_of
from pfdist.pages.times_axis import forbidden_times
from pfdist.plugins.check.measured import normalised
from pfdist.problem.job import override
from pfdist.questions.run_page import answer_of
from pfdist.results.export import export_plan
from pfdist.runner.likelihood import Within, likelihood


def walk(sd: float = 0.7, **others: Any) -> StateSpaceModel:
    """A random walk from N(0, 4)."""
    return StateSpaceModel(
        name="walk",
        initial=lambda w, p: (2.0 * w[0],),
        transition=lambda x, t, w, p: (x[0] + w[0],),
        measurement=lambda x, t, v, p: (x[0] + sd * v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], x[0], sd),
        log_tails=lambda y, x, t, p: densities.normal_log_tails(y[0], x[0], sd),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        linear_gaussian=True,
        normalised=True,
        **others,
    )


@pytest.mark.parametrize(
    ("tails", "exact"),
    [
        (densities.normal_log_tails, stats.norm),
        (densities.laplace_log_tails, stats.laplace),
    ],
)
def test_tails_are_exact_far_from_the_mean(tails: Any, exact: Any) -> None:
    y = np.array([-30.0, -9.0, -3.0, -0.5, 0.2, 1.0, 1.4, 2.0, 5.0, 30.0])
    below, above = tails(y, 0.2, 1.5)
    np.testing.assert_allclose(below, exact.logcdf(y, 0.2, 1.5), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(above, exact.logsf(y, 0.2, 1.5), rtol=1e-13, atol=1e-15)


def test_lognormal_tails_are_normal_tails_of_the_logarithm() -> None:
    below, above = densities.lognormal_log_tails(2.0, 0.3, 0.5)
    z = (math.log(2.0) - 0.3) / 0.5
    assert (below, above) == pytest.approx((log_ndtr(z), log_ndtr(-z)))


def of_failures(
    times: tuple[int, ...],
    horizon: int,
    fails: float | list[float],
    sd: float,
    delay: int = 0,
) -> float:
    """The expected MSE by Kalman filters of all patterns of failures."""
    total, each = 0.0, np.broadcast_to(fails, horizon + 1)
    for made in product((False, True), repeat=len(times)):
        share = math.prod(
            1.0 - each[t] if is_made else each[t] for t, is_made in zip(times, made, strict=True)
        )
        variance, seen, known = 4.0, dict(zip(times, made, strict=True)), list[float]()
        for t in range(horizon + 1):
            variance += 1.0 * (t > 0)
            if seen.get(t):
                variance = variance * sd**2 / (variance + sd**2)
            known.append(variance)
        late = [4.0 + t for t in range(delay)] + [v + delay for v in known]
        total += share * sum(late[: horizon + 1]) / (horizon + 1)
    return total


def test_failed_measurements_are_those_of_all_patterns(tmp_path: Path) -> None:
    """Published case: 3.3761 with times 0, 3, 6, 8 and a detection probability of 0.6."""
    problem = Problem(walk(), horizon=12, measurement_budget=4, particles=300)
    changes = ["problem.sensor.fails=0.4", "comparison.draws=1000"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, figures=False)
    assert of_failures((0, 3, 6, 8), 12, 0.4, 0.7) == pytest.approx(3.3761, abs=5e-5)
    found = pfdist.evaluate(run.path, [0, 3, 6, 8], draws=6000)
    apart = found.expected_mse - of_failures((0, 3, 6, 8), 12, 0.4, 0.7)
    assert abs(apart) < 3.5 * found.standard_error
    best = of_failures(tuple(run.best.measurement_times), 12, 0.4, 0.7)
    assert best < 1.01 * 3.3750  # the best set of all
    row = run.table("bound").set_index("name").loc["relaxation"]
    assert row["bound"] < 3.3750
    assert not row["reason"]


NIGHT: dict[str, Any] = {
    "list": [0.9, 0.0, 0.9, 0.9, 0.1, 0.9, 0.0, 0.9],
    "ranges": {"0:2": 0.1, "3 4": 0.95, "5:7": 0.5},
}


@pytest.mark.parametrize("written", [*NIGHT])
@pytest.mark.parametrize("delay", [0, 2])
def test_failures_that_vary_with_time_are_those_of_all_patterns(written: str, delay: int) -> None:
    """Six points, and all 64 patterns."""
    times, fails = (0, 1, 2, 3, 4, 5), NIGHT[written]
    keys = {"fails": fails} | ({"delay": delay} if delay else {})
    problem = Problem(walk(), horizon=7, measurement_budget=6, particles=400, sensor=keys)
    found = pfdist.evaluate(problem, times, draws=6000)
    each = fails if written == "list" else [0.1] * 3 + [0.95] * 2 + [0.5] * 3
    exact = of_failures(times, 7, each, 0.7, delay)
    assert abs(found.expected_mse - exact) < 3.5 * found.standard_error
    wrong = [*each[delay:], *each[:delay]] if delay else each[::-1]  # of the time of arrival
    apart = abs(of_failures(times, 7, wrong, 0.7, delay) - exact)
    assert apart > 5 * found.standard_error


def test_failures_of_equal_probability_are_those_of_one_number() -> None:
    """Bit for bit; a table at times of its own has the probability of the instant before."""
    keys = {"horizon": 7, "measurement_budget": 2, "particles": 50}
    each = [
        pfdist.evaluate(Problem(walk(), sensor={"fails": fails}, **keys), [1, 5], draws=100)
        for fails in (0.3, [0.3] * 8, {"0:7": 0.3})
    ]
    assert each[0].expected_mse == each[1].expected_mse == each[2].expected_mse
    for wrong, message in (
        ([0.3] * 7, "needs 8 values"),
        ({"0:5": 0.3}, "got none for 6"),
        ({"0:8": 0.3}, "for a horizon of 7"),
        ([0.3] * 7 + [1.0], "less than 1"),
    ):
        with pytest.raises(JobError, match=rf"sensor\.fails.*{message}"):
            Problem(walk(), sensor={"fails": wrong}, **keys)
    taken = replace(walk(), parameters={"fails": 1.0})
    with pytest.raises(ModelError, match="needs the name fails"):
        pfdist.evaluate(Problem(taken, sensor={"fails": NIGHT["list"]}, **keys), [1, 5], draws=100)


@pytest.mark.plugins("online")
def test_a_failed_measurement_is_spent_and_a_missed_one_is_not(tmp_path: Path) -> None:
    problem = Problem(
        walk(), horizon=12, measurement_budget=4, particles=100, sensor={"fails": 0.4}
    )
    changes = ["comparison.draws=100"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    nothing = math.nan
    for t, y in (([0, 3], [1.0, nothing]), ([0, 0, 3], [1.0, 1.2, nothing])):
        found = pfdist.next_time(run.path, pd.DataFrame({"t": t, "y0": y}), say=print)
        assert found.left == 2
    assert pfdist.next_time(run.path, pd.DataFrame({"t": [0], "y0": [1.0]}), now=3).left == 3
    planner = pfdist.Planner(problem, [0, 3, 6, 8])
    planner.missed()
    assert len(planner.plan()) == 4
    planner.update(nothing)
    assert len(planner.measured) == 1
    assert len(planner.plan()) == 3


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
def test_a_failed_measurement_changes_nothing_and_is_not_resampled(engine: str) -> None:
    failing = sensed(walk(), {"": Sensing(fails=0.5)})
    module = {"compiled": particle_filter, "numpy": plain}[engine]
    draws = simulate(failing, 4, range(40), 1)
    settings = Estimation(50)
    found = module.filter_checked_draws(failing, draws, (0, 3), 2, settings, True)
    failed = np.isnan(draws.y[:, 3, 0])
    assert 5 < failed.sum() < 35
    without = module.filter_checked_draws(failing, draws, (0,), 2, settings, True)
    np.testing.assert_array_equal(found.estimate[failed], without.estimate[failed])
    assert (found.estimate[~failed, 3] != without.estimate[~failed, 3]).all()


def test_a_reading_at_the_limit_is_known_to_be_below() -> None:
    """A filter on a grid of x, for an assay of a falling concentration with a limit of 1."""
    sd, limit, readings = 0.3, 1.0, {2: 5.1, 6: 1.9, 10: 1.0, 14: 1.0}
    model = StateSpaceModel(
        name="assay",
        initial=lambda w, p: (np.log(8.0) + 0.2 * w[0],),
        transition=lambda x, t, w, p: (x[0] - 0.25 + 0.1 * w[0],),
        measurement=lambda x, t, v, p: (np.exp(x[0]) + sd * v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], np.exp(x[0]), sd),
        log_tails=lambda y, x, t, p: densities.normal_log_tails(y[0], np.exp(x[0]), sd),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        normalised=True,
    )
    grid = np.linspace(-4.0, 3.5, 1501)
    step, density = grid[1] - grid[0], stats.norm.pdf(grid, np.log(8.0), 0.2)
    kernel = stats.norm.pdf(grid[:, None], grid - 0.25, 0.1) * step
    evidence, own = 0.0, Filter(sensed(model, {"": Sensing(low=limit)}), 20_000, seed=1)
    for t in range(17):
        density = kernel @ density if t else density
        if t in readings:
            y, c = readings[t], np.exp(grid)
            seen = log_ndtr((limit - c) / sd) if y <= limit else stats.norm.logpdf(y, c, sd)
            weighted = density * np.exp(seen)
            evidence += np.log(weighted.sum() * step)
            density = weighted / (weighted.sum() * step)
            own.update(t, y)
    now = own.predict(16)
    mean = np.sum(density * grid) * step
    spread = math.sqrt(np.sum(density * (grid - mean) ** 2) * step)
    assert now.mean[0] == pytest.approx(mean, abs=0.01)
    assert now.standard_deviation[0] == pytest.approx(spread, rel=0.04)
    assert own.log_evidence == pytest.approx(evidence, abs=0.1)


def test_check_model_finds_limits_and_failures_right() -> None:
    changed = sensed(walk(), {"": Sensing(low=-1.0, high=2.0, fails=0.2)})
    draws = simulate(changed, 6, range(40), 1)
    state, _ = likelihood(changed, draws)
    assert state == "ok"
    state, text = normalised(changed, draws, Within())
    assert state == "note"
    assert "a point mass at" in text
    wrong = replace(changed, log_likelihood=walk().log_likelihood)  # as if nothing were censored
    state, _ = likelihood(wrong, draws)
    assert state == "wrong"


def of_repeats(times: tuple[int, ...]) -> float:
    """The expected MSE of a system that is pushed at t = 5; times may be repeated."""
    variance, total = 9.0, 0.0
    for t in range(11):
        if t:
            variance = 0.64 * variance + (4.0 if t == 6 else 0.04)
        if count := times.count(t):
            variance = 1.0 / (1.0 / variance + count / 4.0)
        total += variance
    return total / 11.0


@pytest.mark.plugins("backtest", "filter", "fit")
def test_repeats_are_those_of_brute_force_with_repetition(tmp_path: Path) -> None:
    """Published case: 0.74959 for the best four of at most three measurements at one time."""

    def push(t: Any) -> Any:
        return 2.0 if t == 5 else 0.2

    model = StateSpaceModel(
        name="pushed",
        initial=lambda w, p: (3.0 * w[0],),
        transition=lambda x, t, w, p: (0.8 * x[0] + push(t) * w[0],),
        measurement=lambda x, t, v, p: (x[0] + 2.0 * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / 2.0) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        parameters={"unused": 1.0},
        linear_gaussian=True,
    )
    sets = [
        each
        for each in combinations_with_replacement(range(11), 4)
        if max(map(each.count, each)) <= 3
    ]
    problem = Problem(model, horizon=10, measurement_budget=4, engine="kalman")
    changes = ["problem.sensor.repeats=3", "comparison.draws=100"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, figures=False, bound_draws=0)
    assert run.best.expected_mse == pytest.approx(min(map(of_repeats, sets)), rel=1e-9)
    assert run.best.expected_mse == pytest.approx(0.74959, abs=5e-6)
    assert all(each.rpartition(" ")[2] in "abc" for each in run.best.measurement_times)
    points = pfdist.load_job(run.path).problem.points
    best = points.read(run.best.measurement_times)
    assert best == points.canonical(best)  # 3 a and 3 b, or 3 a alone
    table = pd.DataFrame({"t": [0, 6, 0], "y0": [3.1, 1.0, 2.7]})  # nobody names repeats
    found = pfdist.filter_measurements(run.path, table, report=False)
    assert found.measured == ("0 a", "0 b", "6 a")
    assert (found.missing, found.extra) == (("6 b",), ())  # whichever repeats were planned
    variance = 1.0 / (1.0 / 9.0 + 2.0 / 4.0)
    assert found.table["sd_0"][0] == pytest.approx(variance**0.5)
    assert found.table["mean_0"][0] == pytest.approx(variance * (3.1 + 2.7) / 4.0)
    job = problem.job().with_changes(changes[:1])
    for times in ("2,5,5,9", ["2 b", "5 c", "5 a", 9], "2, 5, 9 b, 5 c"):  # k repeats are a, b, ...
        own = pfdist.evaluate(job, times)
        assert own.measurement_times == ("2 a", "5 a", "5 b", "9 a")
        assert own.expected_mse == pytest.approx(of_repeats((2, 5, 5, 9)), rel=1e-9)
    with pytest.raises(MeasurementTimesError, match="must differ from each other, got 5 a twice"):
        pfdist.evaluate(job, [5, 5, 5, 5])
    for data in (table.assign(id="s"), table.assign(id="s", sensor=["b", "a", "c"])):
        fitted = pfdist.fit(job, data, {"unused": (1, 1)}, replicate="id")
        assert fitted.log_likelihood == pytest.approx(found.log_evidence)
    rng = np.random.default_rng(1)
    rows = [(name, t, y) for name in "pqr" for t in range(11) for y in rng.normal(0, 3, 3)]
    judged = pfdist.backtest(run, pd.DataFrame(rows, columns=["id", "t", "y0"]))
    assert {*judged.plan} == {*run.best.measurement_times}
    assert not judged.left_out


def test_sensors_have_their_own_limits_and_prices() -> None:
    parts = {name: Sensor(walk().measurement, walk().log_likelihood, ("normal",), price=2.0,
             log_tails=walk().log_tails) for name in ("meter", "lab")}  # fmt: skip
    own = {name: getattr(walk(), name) for name in ("initial", "transition")}
    model = StateSpaceModel(
        name="two", quantity_of_interest=walk().quantity_of_interest, initial_noise=("normal",),
        process_noise=("normal",), sensors=parts, **own,
    )  # fmt: skip
    changed = sensed(model, {"meter": Sensing(low=0.0), "lab": Sensing(repeats=2)})
    assert [*changed.sensors] == ["meter", "lab_a", "lab_b"]
    assert {each.price for each in changed.sensors.values()} == {2.0}
    assert changed.sensors["meter"].measurement((-3.0,), 0, (0.1,), changed.p) == (0.0,)
    assert changed.sensors["lab_b"].measurement((-3.0,), 0, (0.0,), changed.p) == (-3.0,)


def test_a_limit_without_tails_is_refused_and_so_are_wrong_limits(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="a limit needs one component of y, and log_tails"):
        sensed(pfdist.load_model("ungm"), {"": Sensing(low=0.0)})
    problem = Problem(walk(), horizon=6, measurement_budget=2)
    for change in ("limits=[2, 1]", "fails=1", "repeats=1"):
        with pytest.raises(JobError, match="sensor"):
            pfdist.plan(
                problem, tmp_path / "run", changes=[f"problem.sensor.{change}"], bound_draws=0
            )


@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("step", [None, 2])
def test_tables_pages_and_exports_have_the_times_at_which_a_single_late_sensor_measures(
    tmp_path: Path, delay: int, step: int | None
) -> None:
    size = step or 1
    clock = {} if step is None else {"time_step": step, "time_unit": "h"}
    problem = Problem(
        late_walk(), horizon=8 * size, measurement_budget=2, sensor={"delay": delay * size},
        forbidden=[size], engine="kalman", **clock,
    )  # fmt: skip
    run = pfdist.plan(problem, tmp_path / "run", changes=["comparison.draws=100"], figures=False)
    times = [t for t in range(9 - delay) if t != 1]
    each = {made: of_late_walk(made, delay, 8) for made in combinations(times, 2)}
    best = min(each, key=lambda made: each[made])
    assert run.best.measurement_times == [size * t for t in best]
    assert run.best.expected_mse == pytest.approx(each[best], rel=1e-9)
    assert not run.table("bound")["reason"].any()
    text = " ".join(lines_of(answer_of(run)))
    assert f"Measure at t = {best[0] * size}, {best[1] * size}" in text
    export_plan(run, run.best.name, tmp_path / "plan.csv")
    assert (tmp_path / "plan.csv").read_text().splitlines()[2] == f"2,{best[1] * size}"
    assert forbidden_times(run) == [size * t for t in range(9) if t not in times]


def test_late_values_are_those_of_brute_force(tmp_path: Path) -> None:
    """Published case: a meter (price 1), a laboratory (price 3, 2 instants later), money for 7."""
    problem = Problem(
        meter_and_laboratory(), horizon=8, total_price=7, sensors=LATE, engine="kalman"
    )
    run = pfdist.plan(problem, tmp_path / "run", changes=["comparison.draws=100"], figures=False)
    each = {
        (early, late): of_delays(early, late, 8)
        for count in range(3)
        for late in combinations(range(2, 9), count)
        for early in combinations(range(9), 7 - 3 * count)
    }
    assert min(each.values()) == pytest.approx(0.567296, abs=5e-7)
    assert run.best.expected_mse == pytest.approx(min(each.values()), rel=1e-9)
    early, late = min(each, key=lambda pair: each[pair])
    written = {f"{t} bedside" for t in early} | {f"{t - 2} lab" for t in late}
    assert {*run.best.measurement_times} == written
    assert not run.table("bound")["reason"].any()


def test_particles_have_late_values_too() -> None:
    problem = Problem(meter_and_laboratory(), horizon=8, total_price=7, sensors=LATE, particles=500)
    found = pfdist.evaluate(problem, "0 bedside, 3 5 lab", draws=3000)
    exact = of_delays((0,), (5, 7), 8)
    assert abs(found.expected_mse - exact) < 3.5 * found.standard_error


def test_an_analysis_afterwards_waits_for_late_values() -> None:
    keys = {"horizon": 8, "total_price": 7, "engine": "kalman"}
    times = "0 bedside, 3 8 lab"
    own = {"bedside": {"price": 1}, "lab": {"price": 3}}
    late, at_once = (
        pfdist.evaluate(
            Problem(meter_and_laboratory(), sensors=each, estimate="smoothed", **keys), times
        )
        for each in (LATE, own)
    )
    assert late.expected_mse == pytest.approx(at_once.expected_mse, rel=1e-12)


@pytest.mark.plugins("filter", "fit")
def test_a_filter_of_real_measurements_has_values_when_they_arrive(tmp_path: Path) -> None:
    """Against conditioning on the values that have arrived; one that arrives too late is told."""
    model = meter_and_laboratory()
    keys = {"horizon": 16, "time_step": 2, "time_unit": "h", "total_price": 7, "engine": "kalman"}
    sensors = {"bedside": {"price": 1}, "lab": {"price": 3, "delay": "4 h"}}
    run = pfdist.plan(
        Problem(model, sensors=sensors, **keys), tmp_path / "run", bound_draws=0, figures=False,
        changes=["comparison.draws=100"],
    )  # fmt: skip
    rows = [(0, "lab", 1.0), (4, "bedside", 2.5), (6, "lab", 0.4), (6, "bedside", 0.5),
            (14, "lab", 0.1)]  # fmt: skip
    table, said = pd.DataFrame(rows, columns=["t", "sensor", "y0"]), list[str]()
    found = pfdist.filter_measurements(run.path, table, report=False, say=said.append)
    assert "values that arrive after 16 h do not count: 1" in said
    assert {*found.measured} == {"0 lab", "4 bedside", "6 lab", "6 bedside"}
    assert found.table["t"][found.table["measured"]].tolist() == [4, 6, 10]
    variance = [4.0]
    for _ in range(8):
        variance.append(0.95**2 * variance[-1] + 0.36)
    s, t = np.meshgrid(np.arange(9), np.arange(9))
    joint = np.array(variance)[np.minimum(s, t)] * 0.95 ** abs(s - t)
    for now in range(9):
        known = [(at // 2, y, 0.04 if name == "lab" else 1.0) for at, name, y in rows
                 if at // 2 + 2 * (name == "lab") <= now]  # fmt: skip
        at = [each for each, *_ in known]
        seen = joint[np.ix_(at, at)] + np.diag([noise for *_, noise in known])
        gain = np.linalg.solve(seen, joint[at, now]) if known else np.zeros(0)
        assert found.table["mean_0"][now] == pytest.approx(gain @ [y for _, y, _ in known])
        exact = np.sqrt(joint[now, now] - gain @ joint[at, now])
        assert found.table["sd_0"][now] == pytest.approx(exact)
    at_once = {"bedside": {"price": 1}, "lab": {"price": 3}}
    model = replace(model, parameters={"sd": 1.0})  # of no formula: one likelihood is enough
    late, early = (
        pfdist.fit(
            Problem(model, sensors=each, **keys),
            table[:4].assign(id="a"),
            {"sd": (1, 1)},
            replicate="id",
        )
        for each in (sensors, at_once)
    )
    assert late.log_likelihood == pytest.approx(early.log_likelihood, abs=1e-9)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"sensors": LATE | {"lab": {"price": 3, "delay": 1.5}}}, "a number of steps"),
        ({"sensors": LATE | {"lab": {"price": 3, "delay": 9}}}, "a number of steps"),
        ({"sensors": LATE, "minimum_spacing": 2}, "sensors of different delays"),
        ({"sensors": LATE, "required": ["7 lab"]}, "arrives 2 instants later"),
    ],
)
def test_wrong_delays_are_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=message):
        Problem(meter_and_laboratory(), horizon=8, total_price=7, engine="kalman", **keys)


def test_a_refusal_names_its_cause_and_what_works() -> None:
    """Failures, not the model, are what the Kalman filter cannot take."""
    linear = Problem(walk(), horizon=6, measurement_budget=2, engine="kalman")
    for sensor in ({"fails": 0.2}, {"limit": 0.0}):
        with pytest.raises(JobError, match=r"sensors without fails and limits.*'compiled' takes"):
            pfdist.evaluate(linear.with_changes(sensor=sensor), [1, 2])
    two = Sensor(walk().measurement, walk().log_likelihood, ("normal",))
    fields: dict[str, Any] = {"measurement_noise": (), "log_tails": None}
    lab = replace(
        walk(),
        **fields,
        measurement=formula_of_each_sensor,
        log_likelihood=formula_of_each_sensor,
        sensors={"a": two, "b": two},
    )
    job = Problem(lab, horizon=6, measurement_budget=2).job()
    data = {"problem": {"horizon": 6, "measurement_budget": 2, "sensors": ["a", "b"]}}
    assert [*job.with_changes(["problem.sensors.a.repeats=2"]).problem.each_sensor] == [
        "a_a", "a_b", "b",
    ]  # fmt: skip
    override(data, "problem.sensors.a.repeats=2")  # names alone are sections, too
    assert data["problem"]["sensors"] == {"a": {"repeats": 2}, "b": {}}


@pytest.mark.plugins("online")
@pytest.mark.parametrize("engine", ["compiled", "numpy"])
def test_a_number_beyond_a_limit_is_the_censored_reading(engine: str) -> None:
    """Also for the surprise, and in a model with another sensor and with repeats."""
    limits = {"limits": [-0.5, 2.0]}
    problem = Problem(walk(), horizon=6, measurement_budget=3, engine=engine, sensor=limits)
    for beyond, limit in ((-0.51, -0.5), (-40.0, -0.5), (2.01, 2.0)):
        found, right = (Filter(problem).update(0, y) for y in (beyond, limit))
        assert found.surprise == right.surprise > 0.01
        np.testing.assert_array_equal(found.mean, right.mean)
    planner, same = (pfdist.Planner(problem) for _ in range(2))
    planner.update(9.0, 0)
    same.update(2.0, 0)
    np.testing.assert_array_equal(planner.estimate().mean, same.estimate().mean)
