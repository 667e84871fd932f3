"""Sensors that work or not in a state: exact sums, exact filters, and a model made by hand."""

import math
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import pfdist
from pfdist import Filter, Problem, Sensor, StateSpaceModel, densities, where
from pfdist.common.sensing import Sensing
from pfdist.errors import JobError, MeasurementsError, ModelError
from pfdist.filters import particle_filter, plain
from pfdist.filters.proposal import PLAIN
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.models.recorded import recorded
from pfdist.models.sensed import sensed
from pfdist.models.written import models_of, text_of_models
from pfdist.plugins.check.measured import normalised
from pfdist.plugins.fit.evidence import log_evidence, moved_log_evidence
from pfdist.plugins.guided.proposal import GUIDED
from pfdist.plugins.moving.proposal import MOVING
from pfdist.runner.likelihood import Within, likelihood

# --- a trial that patients leave ------------------------------------------------------------------

HAZARD = 1.0 - math.exp(-0.1)  # a month


def trial(**measuring: Any) -> StateSpaceModel:
    """A marker and its slope; after a patient has left, no visit gives a value."""
    fields = {
        "measurement": lambda x, t, v, p: (x[0] + 0.3 * v[0],),
        "log_likelihood": lambda y, x, t, p: densities.normal_logpdf(y[0], x[0], 0.3),
        "works": lambda x, t, p: x[2] > 0.5,
    }
    return StateSpaceModel(
        name="trial",
        initial=lambda w, p: (0.5 * w[0], -0.2 + 0.15 * w[1], 1.0),
        transition=lambda x, t, w, p: (
            x[0] + x[1] + 0.15 * w[0], x[1], where(w[1] < HAZARD, 0.0, x[2]),
        ),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=("normal", "uniform"),
        measurement_noise=("normal",),
        normalised=True,
        **(fields | measuring),
    )  # fmt: skip


def by_hand() -> StateSpaceModel:
    """The same with a flag in y, and its likelihood."""

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        is_here, came = x[2] > 0.5, y[0] > -98.0
        value = where(is_here, densities.normal_logpdf(y[0], x[0], 0.3), -math.inf)
        return where(came, value, where(is_here, -math.inf, 0.0))

    return trial(
        measurement=lambda x, t, v, p: (where(x[2] > 0.5, x[0] + 0.3 * v[0], -99.0),),
        log_likelihood=log_likelihood,
        works=False,
    )


@cache
def error(visits: tuple[int, ...], is_smoothed: bool) -> float:
    """The Gaussian error of some visits, none of which fails."""
    t = np.arange(13)
    covariance = 0.25 + 0.0225 * (np.outer(t, t) + np.minimum.outer(t, t))
    total = 0.0
    for now in t:
        seen = [each for each in visits if is_smoothed or each <= now]
        known = covariance[np.ix_(seen, seen)] + 0.09 * np.eye(len(seen))
        explained = covariance[now, seen] @ np.linalg.solve(known, covariance[seen, now])
        total += covariance[now, now] - explained
    return float(total / 13)


def with_dropout(visits: tuple[int, ...], is_smoothed: bool) -> float:
    """The exact sum over the number of visits before the patient leaves."""
    still = [1.0, *((1.0 - HAZARD) ** visit for visit in visits), 0.0]
    return sum(
        (here - later) * error(visits[:n], is_smoothed)
        for n, (here, later) in enumerate(pairwise(still))
    )


@pytest.mark.parametrize(
    ("estimate", "best", "least"),
    [("filtered", (1, 3, 6), 0.55105), ("smoothed", (1, 3, 7), 0.5193)],
)
def test_the_best_visits_after_dropout_are_those_of_the_exact_sum(
    estimate: str, best: tuple[int, ...], least: float
) -> None:
    is_smoothed = estimate == "smoothed"
    each = {visits: with_dropout(visits, is_smoothed) for visits in combinations(range(13), 3)}
    assert min(each, key=lambda visits: each[visits]) == best
    assert each[best] == pytest.approx(least, abs=5e-5)
    problem = Problem(
        trial(), horizon=12, measurement_budget=3, estimate=estimate, particles=1000,
        proposal="plain", resampling="systematic",
    )  # fmt: skip
    for visits in (best, (7, 10, 12)):
        found = pfdist.evaluate(problem, visits, draws=6000)
        assert abs(found.expected_mse - each[visits]) < 2 * found.standard_error


def test_a_search_finds_the_best_visits(tmp_path: Path) -> None:
    """And `fails` instead, as often on average, chooses visits that lose half."""
    problem = Problem(trial(), horizon=12, measurement_budget=3, particles=300, proposal="plain")
    changes = ["comparison.draws=2000", "evaluation.draws=1500"]
    run = pfdist.plan(problem, tmp_path / "run", "survivors", changes, 0, figures=False)
    times = tuple(run.best.measurement_times)
    assert with_dropout(times, False) < 1.02 * 0.55105
    again = pfdist.plan(problem, tmp_path / "run", "survivors", changes, 0, figures=False)
    assert again.best.measurement_times == run.best.measurement_times
    y = run.table("trajectories")["y_0"]
    assert y.isna().any()
    assert np.isfinite(y.dropna()).all()


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
@pytest.mark.parametrize("proposal", [PLAIN.name, GUIDED.name])
@pytest.mark.parametrize("lag", [0, 12])
def test_errors_are_the_bytes_of_a_model_made_by_hand(engine: str, proposal: str, lag: int) -> None:
    if engine == "numpy" and proposal == GUIDED.name:
        return  # the compiled engine alone has it
    own, other = sensed(trial()), by_hand()
    draws, others = (simulate(model, 12, range(200), 1) for model in (own, other))
    np.testing.assert_array_equal(draws.y, np.where(others.y < -98.0, np.inf, others.y))
    module, settings = (
        {"compiled": particle_filter, "numpy": plain}[engine],
        Estimation(200, proposal=proposal, lag=lag),
    )
    found, made = (
        module.filter_checked_draws(model, each, (1, 3, 7, 11), 2, settings, True)
        for model, each in ((own, draws), (other, others))
    )
    assert found.mse.tobytes() == made.mse.tobytes()
    np.testing.assert_array_equal(found.variance, made.variance)
    assert not found.degenerate.any()


# --- the twin, draw for draw ----------------------------------------------------------------------


def rested() -> StateSpaceModel:
    """A charge that is read best at rest: how often depends on the state, without jumps."""
    return StateSpaceModel(
        name="rested",
        initial=lambda w, p: (1.0 + 0.3 * w[0], w[1]),
        transition=lambda x, t, w, p: (x[0] + 0.1 * x[1] + 0.1 * w[0], 0.7 * x[1] + 0.5 * w[1]),
        measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], x[0], 0.1),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        measurement_noise=("normal",),
        works=lambda x, t, p: 1.0 / (1.0 + np.exp(4.0 * np.abs(x[1]) - 3.0)),
        normalised=True,
    )


def two_sensors() -> StateSpaceModel:
    """One of which works only where x is positive; the other reads two numbers."""
    pair = Sensor(
        lambda x, t, v, p: (x[0] + v[0], x[1] + 0.2 * v[1]),
        lambda y, x, t, p: (
            densities.normal_logpdf(y[0], x[0], 1.0) + densities.normal_logpdf(y[1], x[1], 0.2)
        ),
        ("normal", "normal"),
        works=lambda x, t, p: 0.5 + 0.5 * (x[1] < 0.0),
    )
    base = rested()
    high = Sensor(
        base.measurement, base.log_likelihood, ("normal",), works=lambda x, t, p: x[0] > 1.0
    )
    none: Any = {"works": False, "measurement_noise": ()}
    fields = StateSpaceModel.__dataclass_fields__
    none |= {name: fields[name].default for name in ("measurement", "log_likelihood")}
    plain_one = Sensor(base.measurement, base.log_likelihood, ("normal",))
    return replace(
        base, name="two sensors", **none, sensors={"high": high, "pair": pair, "plain": plain_one}
    )


NIGHT = tuple(0.5 * (t % 3 == 0) for t in range(11))
MODELS = {
    "trial": sensed(trial()),
    "rested": sensed(rested()),
    "at night": sensed(rested(), {"": Sensing(fails=NIGHT)}),
    "late": sensed(trial(), {"": Sensing(delay=2, fails=0.1)}),
    "repeated": sensed(rested(), {"": Sensing(repeats=2)}),
    "two sensors": sensed(two_sensors(), {"pair": Sensing(fails=0.2)}),
}


@pytest.mark.parametrize("lag", [0, 3, 10])
@pytest.mark.parametrize("proposal", [PLAIN.name, MOVING.name])
@pytest.mark.parametrize("name", [*MODELS])
def test_the_plain_twin_is_the_same_draw_for_draw(name: str, proposal: str, lag: int) -> None:
    model = MODELS[name]
    draws, twins = (each(model, 10, range(8), 7) for each in (simulate, plain.simulate))
    np.testing.assert_allclose(draws.y, twins.y, rtol=1e-12)
    assert 0.05 < np.isposinf(draws.y).mean() < 0.95
    ways = model.points.ways
    times = tuple(sorted({2 * ways, 4 * ways, 5 * ways, 6 * ways - 1, 8 * ways, 11 * ways - 1}))
    settings = Estimation(48, "systematic", proposal=proposal, lag=lag)
    found = particle_filter.filter_checked_draws(model, draws, times, 3, settings, True)
    twin = plain.filter_checked_draws(model, draws, times, 3, settings, True)
    for each in ("mse", "estimate", "variance", "sizes", "cloud", "lines"):
        values, expected = getattr(found, each), getattr(twin, each)
        assert np.allclose(values, expected, rtol=1e-8, atol=1e-10, equal_nan=True), each
    assert found.degenerate.tolist() == twin.degenerate.tolist()


def test_guided_and_moving_particles_have_the_error_of_many_plain_ones() -> None:
    model = sensed(rested(), {"": Sensing(fails=0.2)})
    draws = simulate(model, 10, range(300), 11)

    def errors(particles: int, proposal: str) -> Any:
        settings = Estimation(particles, "systematic", proposal=proposal)
        found = particle_filter.filter_checked_draws(model, draws, (2, 4, 6, 9), 5, settings, True)
        assert not found.degenerate.any()
        return found.mse

    many = errors(5000, PLAIN.name)
    for particles, proposal in ((1000, GUIDED.name), (200, MOVING.name)):
        difference = errors(particles, proposal) - many
        assert abs(difference.mean()) < 3.5 * stats.sem(difference)


# --- a chain that freezes, against the exact filter -----------------------------------------------

PLACES = np.arange(-2.0, 3.0)


def chance_to_freeze(x: Any) -> Any:
    return 0.05 + 0.15 * np.abs(x)


def chain() -> StateSpaceModel:
    """A walk in five places; frozen, it stays and sends nothing; it freezes more at the ends."""

    def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
        step = where(w[0] < 0.3, -1.0, where(w[0] > 0.6, 1.0, 0.0))
        moved = np.minimum(np.maximum(x[0] + step, -2.0), 2.0)
        thaws, freezes = w[1] < 0.4, w[1] < chance_to_freeze(x[0])
        is_frozen = where(x[1] > 0.5, where(thaws, 0.0, 1.0), where(freezes, 1.0, 0.0))
        return where(x[1] > 0.5, x[0], moved), is_frozen

    return StateSpaceModel(
        name="chain",
        initial=lambda w, p: (np.floor(5.0 * w[0]) - 2.0, 0.0),
        transition=transition,
        measurement=lambda x, t, v, p: (x[0] + p.sd * v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], x[0], p.sd),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("uniform",),
        process_noise=("uniform", "uniform"),
        measurement_noise=("normal",),
        parameters={"sd": 0.8},
        works=lambda x, t, p: x[1] < 0.5,
        normalised=True,
    )


def exactly(readings: dict[int, float], horizon: int) -> tuple[list[Any], float]:
    """The probabilities of the places at each instant, and the log evidence; inf is no value."""
    steps = np.zeros((5, 5))
    for k in range(5):
        for step, share in ((-1, 0.3), (0, 0.3), (1, 0.4)):
            steps[np.clip(k + step, 0, 4), k] += share
    freezes = chance_to_freeze(PLACES)
    moving, frozen, evidence, found = np.full(5, 0.2), np.zeros(5), 0.0, list[Any]()
    for t in range(horizon + 1):
        if t:
            moving, frozen = (
                steps @ (moving * (1 - freezes)) + 0.4 * frozen,
                steps @ (moving * freezes) + 0.6 * frozen,
            )
        if t in readings:
            y = readings[t]
            moving = moving * (0.0 if math.isinf(y) else stats.norm.pdf(y, PLACES, 0.8))
            frozen = frozen * math.isinf(y)
            total = moving.sum() + frozen.sum()
            evidence += math.log(total)
            moving, frozen = moving / total, frozen / total
        found.append(moving + frozen)
    return found, evidence


READINGS = {0: 0.3, 2: 1.9, 3: math.inf, 5: math.inf, 8: 1.1, 9: math.inf, 12: -0.7}


def table(readings: dict[int, float] = READINGS) -> pd.DataFrame:
    cells = [np.nan if math.isinf(y) else y for y in readings.values()]
    return pd.DataFrame({"t": [*readings], "y0": cells})


@pytest.mark.plugins("filter")
def test_evidence_and_bands_of_a_chain_that_freezes_are_those_of_the_exact_filter() -> None:
    problem = Problem(chain(), horizon=14, measurement_budget=5, particles=20_000)
    said = list[str]()
    found = pfdist.filter_measurements(problem, table(), report=False, say=said.append)
    exact, evidence = exactly(READINGS, 14)
    assert found.log_evidence == pytest.approx(evidence, abs=0.05)
    for t, share in enumerate(exact):
        mean = share @ PLACES
        spread = math.sqrt(share @ (PLACES - mean) ** 2)
        assert found.table["mean_0"][t] == pytest.approx(mean, abs=6 * spread / math.sqrt(4000))
        assert found.table["sd_0"][t] == pytest.approx(spread, rel=0.05)
        for level in (5, 95):
            reached = np.cumsum(share)
            if np.abs(reached - level / 100).min() > 0.01:  # no place is a close call
                band = PLACES[np.searchsorted(reached, level / 100)]
                assert found.table[f"q{level:02d}_0"][t] == band
    assert (found.measured, found.failed) == ((0, 2, 8, 12), (3, 5, 9))
    (line,) = said
    assert line == ("3 empty rows are failed measurements, which say something about x (works)")
    assert found.table["t"][found.table["measured"]].tolist() == [*READINGS]
    _, alone = exactly({t: y for t, y in READINGS.items() if not math.isinf(y)}, 14)
    assert abs(alone - evidence) > 1.0  # what the empty rows tell


@pytest.mark.plugins("filter")
def test_a_table_without_empty_rows_is_said_to_be_left_out_by_chance() -> None:
    problem = Problem(chain(), horizon=14, measurement_budget=5, particles=20_000)
    made, said = {t: y for t, y in READINGS.items() if not math.isinf(y)}, list[str]()
    found = pfdist.filter_measurements(problem, table(made), report=False, say=said.append)
    assert found.log_evidence == pytest.approx(exactly(made, 14)[1], abs=0.05)
    (line,) = said
    assert "times without a row are taken as left out without knowledge of x" in line
    lost = table().assign(y0=["0.3", "1.9", "Eqp", "Eqp", "1.1", "Eqp", "-0.7"])
    coded = problem.with_changes(measurements={"missing": ["Eqp"], "failed": ["Ice"]})
    other = pfdist.filter_measurements(coded, lost, report=False, say=said.append)
    pd.testing.assert_frame_equal(other.table, found.table)
    assert other.failed == (3, 5, 9)  # made, and lost
    cold = lost.replace("Eqp", "Ice")
    informed = pfdist.filter_measurements(coded, cold, report=False, say=said.append)
    assert informed.log_evidence == pytest.approx(exactly(READINGS, 14)[1], abs=0.05)


@pytest.mark.plugins("filter", "online")
def test_late_values_and_failures_are_known_when_they_arrive() -> None:
    """All together say the same; of the last row nobody knows yet whether it failed."""
    late = Problem(chain(), horizon=14, measurement_budget=9, particles=20_000, sensor={"delay": 2})
    known = {t: y for t, y in READINGS.items() if t < 10}
    rows = known | {11: math.inf}
    found = pfdist.filter_measurements(late, table(rows), report=False, say=print)
    assert found.log_evidence == pytest.approx(exactly(known, 14)[1], abs=0.14)  # 4 deviations
    assert (found.measured, found.failed) == ((0, 2, 8), (3, 5, 9))
    share = exactly(known, 11)[0][11]
    assert found.table["mean_0"][11] == pytest.approx(share @ PLACES, abs=0.06)
    answer = pfdist.next_time(late, table(rows), say=print)
    assert answer.in_flight == (11,)
    assert answer.left == 2
    planner = pfdist.Planner(late.with_changes(measurement_budget=3), [1, 4, 8])
    planner.taken(1)
    planner.missed(4)  # its arrival has passed
    assert planner.measured == (1,)


@pytest.mark.plugins("online")
def test_next_counts_failures_as_spent_and_knows_what_they_tell() -> None:
    problem = Problem(chain(), horizon=14, measurement_budget=9, particles=5000)
    exact = exactly(READINGS, 14)[0][12]
    found = pfdist.next_time(problem, table(), say=print)
    assert found.left == 2
    assert found.failed == (3, 5, 9)
    spent = pfdist.next_time(problem.with_changes(measurement_budget=7), table(), say=print)
    for answer in (found, spent):
        assert "<td>3 of 7, t = 3, 5, 9</td>" in answer._repr_html_()
    planner = pfdist.Planner(problem, [*READINGS, 13, 14])
    for t, y in READINGS.items():
        estimate = planner.update(math.nan if math.isinf(y) else y, t)
    assert len(planner.measured) == 7
    assert estimate.mean[0] == pytest.approx(exact @ PLACES, abs=0.1)
    own = Filter(problem)
    for t, y in READINGS.items():
        now = own.update(t, y)
        assert now.measured
    np.testing.assert_array_equal(now.mean, estimate.mean)
    own.wait(13)
    assert own.now.t == 13
    assert not own.now.measured


@pytest.mark.parametrize("moves", [False, True])
def test_a_fit_has_the_evidence_of_the_exact_filter(moves: bool) -> None:
    model, y = sensed(chain()), np.full((1, 15, 1), np.nan)
    for t, value in READINGS.items():
        y[0, t, 0] = value
    moved = partial(moved_log_evidence, proposal=MOVING.name, first=0)
    function, particles = (moved, 300) if moves else (log_evidence, 5000)
    found = np.exp([function(model, y, particles, seed)[0] for seed in range(20)])
    evidence = math.exp(exactly(READINGS, 14)[1])
    assert abs(found.mean() - evidence) < 4 * stats.sem(found) + 0.05 * moves * evidence
    problem = Problem(chain(), horizon=14, measurement_budget=5, particles=5000, proposal="plain")
    two = pd.concat([table().assign(id=name) for name in "ab"])
    fitted = pfdist.fit(problem, two, {"sd": (0.8, 0.8)}, replicate="id", say=print)
    assert abs(fitted.log_likelihood - 2 * math.log(evidence)) < 4 * fitted.error + 0.1


def test_surprises_of_failures_are_uniform_under_the_right_model() -> None:
    model = sensed(chain())
    draws, found = simulate(model, 3, range(300), 5), list[float]()
    for k in range(300):
        following = Filter(model, 200, seed=k)
        following.update(0, draws.y[k, 0], warn=False)
        found.append(following.update(3, draws.y[k, 3], warn=False).surprise)
    assert np.isinf(draws.y[:, 3]).mean() > 0.1
    assert stats.kstest(found, "uniform").pvalue > 1e-3


# --- sensors, repeats, and what is kept -----------------------------------------------------------


@pytest.mark.plugins("filter", "online")
def test_only_rows_of_a_sensor_that_was_asked_are_failures() -> None:
    """Against weights by hand: an empty row of "high" says that x is not above 1."""
    sensors = {"high": {"price": 1}, "pair": {"price": 1}, "plain": {"price": 1}}
    problem = Problem(two_sensors(), horizon=4, total_price=5, sensors=sensors, particles=100_000)
    nothing = math.nan
    rows = [(0, "high", nothing, nothing), (0, "plain", nothing, nothing), (0, "pair", 0.9, -0.1)]
    given = pd.DataFrame(rows, columns=["t", "sensor", "y0", "y1"])
    found = pfdist.filter_measurements(problem, given, report=False, say=print)
    rng = np.random.default_rng(1)
    x = 1.0 + 0.3 * rng.normal(size=1_000_000), rng.normal(size=1_000_000)
    weight = (x[0] <= 1.0) * (0.5 + 0.5 * (x[1] < 0.0))
    weight = weight * stats.norm.pdf(0.9, x[0], 1.0) * stats.norm.pdf(-0.1, x[1], 0.2)
    assert found.table["mean_0"][0] == pytest.approx(np.average(x[0], weights=weight), abs=0.01)
    assert found.log_evidence == pytest.approx(math.log(weight.mean()), abs=0.03)
    assert (found.measured, found.failed) == (("0 pair",), ("0 high",))  # "plain" was not measured
    own = Filter(problem)
    now = own.update(0, [math.inf, 0.9, -0.1, math.nan])
    assert now.mean[0] == found.table["mean_0"][0]
    planner = pfdist.Planner(problem, ["0 high", "2 pair", "3 high", "3 pair", "4 plain"])
    estimate = planner.update([math.nan] * 4, 0)  # the planned sensor has failed
    assert estimate.measured
    assert planner.measured == ("0 high",)
    planner.update([math.nan, math.inf, math.inf, math.nan], 2)
    assert planner.measured == ("0 high", "2 pair")
    for wrong, message in (
        ([math.inf, math.inf, 1.0, math.nan], "must be finite"),  # half of a pair
        ([math.nan, 1.0, 1.0, math.inf], "must be finite"),  # works always
        ([-math.inf, math.nan, math.nan, math.nan], "must be finite"),
    ):
        with pytest.raises(MeasurementsError, match=message):
            planner.update(wrong, 3)


def test_each_repeat_of_a_sensor_works_or_not(tmp_path: Path) -> None:
    """Enumerated: a state that is 0 or 1, and repeats that work three or one times in four."""
    coin = StateSpaceModel(
        name="coin",
        initial=lambda w, p: (where(w[0] < 0.5, 0.0, 1.0),),
        transition=lambda x, t, w, p: x,
        measurement=lambda x, t, v, p: (v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], 0.0, 1.0),
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("uniform",),
        process_noise=(),
        measurement_noise=("normal",),
        works=lambda x, t, p: 0.25 + 0.5 * x[0],
    )
    problem = Problem(
        coin, horizon=1, measurement_budget=3, sensor={"repeats": 3}, particles=5000,
        proposal="plain", resampling="systematic", forbidden=[1],
    )  # fmt: skip
    for count in (1, 2, 3):
        exact = 0.0
        for made in range(count + 1):
            of_works, of_fails = (stats.binom.pmf(made, count, share) / 2 for share in (0.75, 0.25))
            exact += of_works * of_fails / (of_works + of_fails)
        found = pfdist.evaluate(problem, [0] * count, draws=4000)
        assert abs(found.expected_mse - exact) < 3.5 * found.standard_error + 1e-4


def test_a_run_keeps_that_a_sensor_may_not_work() -> None:
    for model in MODELS.values():
        truth = recorded(model, range(11))
        text = text_of_models(truth, truth)
        (again, _) = models_of(text.encode())
        assert [way.model.works for way in again.ways] == [way.model.works for way in model.ways]
        assert text_of_models(again, again) == text
    walk = recorded(pfdist.load_model("random_walk"), range(3))
    text = text_of_models(walk, walk)
    assert "works" not in text
    with pytest.raises(ValueError, match="works is true"):
        models_of(text.replace('"sensors":{}', '"sensors":{},"works":1').encode())


def test_check_model_finds_sensors_right_that_work_or_not() -> None:
    for model in (MODELS["trial"], MODELS["rested"], sensed(rested(), {"": Sensing(fails=0.3)})):
        draws = simulate(model, 6, range(40), 1)
        assert likelihood(model, draws)[0] == "ok"
        assert normalised(model, draws, Within())[0] == "ok"
    wrong = sensed(replace(rested(), log_likelihood=lambda y, x, t, p: -50.0 * (y[0] - x[0]) ** 2))
    draws = simulate(wrong, 6, range(40), 1)
    assert normalised(wrong, draws, Within())[0] == "wrong"
    checked = pfdist.check_model(trial(), horizon=12)
    assert "wrong" not in {*checked["state"]}


def test_what_cannot_be_is_refused() -> None:
    linear = replace(pfdist.load_model("random_walk"), works=lambda x, t, p: x[0] > 0.0)
    with pytest.raises((JobError, ModelError), match="sensors without works, got random_walk"):
        pfdist.evaluate(Problem(linear, horizon=5, measurement_budget=2, engine="kalman"), [1, 2])
    with pytest.raises(ModelError, match=r"works must be a function of \(x, t, p\)"):
        replace(trial(), works=lambda x: x)
    with pytest.raises(ModelError, match="each sensor must have its own works"):
        replace(two_sensors(), works=lambda x, t, p: x[0] > 0.0)
    for works, message in (
        (lambda x, t, p: x[7] > 0.5, "works failed: IndexError"),
        (lambda x, t, p: (x[2] > 0.5,), "works must give one number a particle"),
        (lambda x, t, p: p.nothing, "works failed: AttributeError"),
        (
            lambda x, t, p: 80.0 + 0.0 * x[0],
            "works must give a probability, 0 to 1, got 80 at t = 0",
        ),
        (lambda x, t, p: -0.1, "works must give a probability, 0 to 1, got -0.1 at t = 0"),
    ):
        with pytest.raises(ModelError, match=message):
            replace(trial(), works=works)
    other = replace(trial(), works=False)
    problem = Problem(trial(), filter_model=other, horizon=5, measurement_budget=2)
    with pytest.raises(ModelError, match="the filter's model must have works"):
        pfdist.evaluate(problem, [1, 2])


@pytest.mark.plugins("backtest", "simulate")
def test_a_backtest_of_the_right_model_finds_it_right(tmp_path: Path) -> None:
    """Systems that it simulates; failed measurements are in the sets, and are not judged."""
    problem = Problem(
        chain(), horizon=12, measurement_budget=3, particles=300, sensor={"fails": 0.1}
    )
    changes = ["comparison.draws=200"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    simulated = pfdist.simulate(problem, draws=150, seed=3)
    data = simulated.rename(columns={"draw": "id", "y_0": "y0"})[["id", "t", "y0"]]
    assert 0.2 < data["y0"].isna().mean() < 0.6
    said = list[str]()
    found = pfdist.backtest(run, data, say=said.append)
    assert any("empty rows are failed measurements" in line for line in said)
    assert not found.wrong
    assert all(0.75 < ratio < 1.3 for ratio, _ in found.ratios.values())
    assert found.means["covered"].between(0.83, 0.95).all()
    assert found.improbable < 0.03
    fixed = pfdist.backtest(run, data.dropna(), say=said.append)  # as if nobody had asked
    assert any("without knowledge of x" in line for line in said)
    assert fixed.means["real"]["plan"] != found.means["real"]["plan"]
