"""Which sensor, when: against brute force, closed forms, and the same system with one sensor."""

import re
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.results_of import results_of
from oracles.three_sensors import HORIZON, NAMES, SYSTEMS, ThreeSensors
from pfdist.common.percent import relaxed_sentence
from pfdist.errors import ModelError
from pfdist.filters import kalman, particle_filter, plain
from pfdist.filters.one_filter import OneFilter
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.pages.terminal import lines_of
from pfdist.plugins.online.work import seen
from pfdist.problem.clock import Clock
from pfdist.problem.measurements import read_measurements
from pfdist.questions.bound_page import bound_page
from pfdist.questions.run_page import answer_of
from pfdist.results.stored_run import found_sets

BUDGET = 6


def _problem(system: ThreeSensors, **keys: object) -> pfdist.Problem:
    return pfdist.Problem(
        system.as_model(),
        **{"horizon": HORIZON, "measurement_budget": BUDGET, "engine": "kalman"} | keys,
    )


def _numbers(written: object) -> tuple[int, ...]:
    pairs = (str(each).split() for each in written)
    return tuple(int(t) * 3 + NAMES.index(sensor) for t, sensor in pairs)


def test_the_next_measurement_has_the_unit_unless_later_ones_do() -> None:
    problem = _problem(SYSTEMS[0], measurement_budget=2, time_step=1, time_unit="h")
    rows = pd.DataFrame([(0, NAMES[0], 0.5)], columns=["t", "sensor", "y0"])
    for table, later in ((rows, []), (rows[:0], ["; then at about "])):
        found = pfdist.next_time(problem, table)
        said, *then = re.split("(; then at about )", " ".join(lines_of(found._page())).strip())
        end = ["(t in h)"] * (not later)
        assert said.split(".")[0] == " ".join([f"Measure next at t = {found.next}", *end])
        assert then[:1] == later
        assert "".join(then).split(".")[0].endswith("(t in h)" * bool(later))


@pytest.mark.parametrize("resampling", ["systematic", "multinomial"])
def test_the_compiled_filter_is_its_plain_twin(resampling: str) -> None:
    """Sensors weigh and resample in their order, at the same instant without propagation."""
    model = SYSTEMS[0].as_model()
    draws = simulate(model, HORIZON, range(20), 7)
    twin = plain.simulate(model, HORIZON, range(20), 7)
    np.testing.assert_allclose(draws.y, twin.y, rtol=1e-12)
    sets = [(0, 1, 2, 10), (0, 1, 2, 11, 12, 14), (5,), (36, 38)]
    compiled = particle_filter.filter_checked_sets(
        model, draws, sets, [HORIZON] * len(sets), 3, Estimation(64, resampling)
    )[0]
    for column, times in enumerate(sets):
        filtered = plain.filter_draws(model, draws, times, 64, 3, resampling)
        np.testing.assert_allclose(compiled[:, column], filtered.mse, rtol=1e-5)
        alone = particle_filter.filter_draws(model, draws, times, 64, 3, resampling)
        assert np.array_equal(alone.mse, compiled[:, column])  # a shared prefix gives the same bits


def test_the_particle_filter_tends_to_the_kalman_filter() -> None:
    """With 4,000 particles, the expected MSE is that of the exact filter within 4 errors."""
    system, times = SYSTEMS[1], (0, 2, 10, 11, 30)
    draws = simulate(system.as_model(), HORIZON, range(1500), 11)
    mse = particle_filter.filter_draws(system.as_model(), draws, times, 4000, 3).mse
    error = mse.std(ddof=1) / np.sqrt(mse.size)
    assert abs(mse.mean() - system.expected_mse(times)) < 4 * error


def test_draws_of_one_sensor_are_those_of_a_model_with_this_sensor_alone() -> None:
    """The first of the sensors has the same bits: adding sensors changes nothing before them."""
    model = SYSTEMS[0].as_model()
    alone = simulate(model.ways[0].model, HORIZON, range(5), 3)
    assert np.array_equal(simulate(model, HORIZON, range(5), 3).y[:, :, :1], alone.y)


def test_a_model_whose_only_sensor_has_a_name_has_the_errors_of_one_without_a_name() -> None:
    measuring = (
        lambda x, t, v, p: (x[0] + 0.5 * v[0],),
        lambda y, x, t, p: -2.0 * (y[0] - x[0]) ** 2,
        ("normal",),
    )
    walk = {
        "name": "walk", "initial": lambda w, p: (w[0],), "initial_noise": ("normal",),
        "transition": lambda x, t, w, p: (x[0] + 0.5 * w[0],), "process_noise": ("normal",),
        "quantity_of_interest": lambda x, t, p: (x[0],),
    }  # fmt: skip
    own = ("measurement", "log_likelihood", "measurement_noise")
    alone = pfdist.StateSpaceModel(**walk, **dict(zip(own, measuring, strict=True)))
    named = pfdist.StateSpaceModel(**walk, sensors={"level": pfdist.Sensor(*measuring)})
    given = {"horizon": 6, "measurement_budget": 2, "particles": 50}
    mse = [
        pfdist.evaluate(pfdist.Problem(model, **given, **keys), times, draws=240).expected_mse
        for model, keys, times in (
            (alone, {}, [2, 5]),
            (named, {"sensors": ["level"]}, ["2 level", "5 level"]),
        )
    ]
    assert mse[0] == mse[1]


def test_a_filter_that_stops_at_each_measurement_has_the_bits_of_one_that_does_not() -> None:
    """Sensors of one instant are given together, with NaN for those that do not measure."""
    model, times = SYSTEMS[0].as_model(), (0, 2, 9, 10, 11, 20)
    settings = Estimation(50, "systematic")
    draws = simulate(model, HORIZON, range(1), 5)
    whole = particle_filter.filter_draws(model, draws, times, 50, 3, "systematic", True)
    filtering = OneFilter(model, settings, 3)
    for t in sorted({time // 3 for time in times}):
        here = tuple(time for time in times if time // 3 == t)
        filtering, mean, _ = filtering.at(t, seen(model, draws.y[0, t], here))
        assert np.array_equal(mean[-1], whole.estimate[0, t])


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[pfdist.Problem, pfdist.Run]:
    """Two measurements; the sensor that sees both components may measure once, and not at 3."""
    sensors = {"near": {}, "far": {"minimum_spacing": 9}, "both": {"most": 1, "forbidden": [3]}}
    problem = _problem(SYSTEMS[3], sensors=sensors, measurement_budget=2)
    folder = tmp_path_factory.mktemp("sensors") / "run"
    few = ("comparison.draws=50",)
    return problem, pfdist.plan(
        problem, results=folder, pool="serial", changes=few, figures=False, report=False
    )


def test_limits_of_sensors_bind_the_search_and_the_bound(
    planned: tuple[pfdist.Problem, pfdist.Run],
) -> None:
    """The plan is the best of all 699 sets within the limits, and its gap is 0."""
    problem, run = planned
    mse = {times: SYSTEMS[3].expected_mse(times) for times in combinations(range(39), 2)}
    allowed = [times for times in mse if 3 * 3 + 2 not in times]
    within = [
        times
        for times in allowed
        if sum(time % 3 == 2 for time in times) < 2
        and not (times[0] % 3 == times[1] % 3 == 1 and times[1] // 3 - times[0] // 3 < 9)
    ]
    (name,) = found_sets(run)
    assert _numbers(run.sets[name]) == min(within, key=mse.__getitem__)
    bound = results_of(run)[name].bound
    assert bound == pytest.approx(min(mse[times] for times in within), rel=1e-9)
    found = pfdist.bound(problem, results=run.path, figures=False)
    relaxed = found.as_json()["relaxed"]
    assert [*relaxed] == ["minimum_spacing of single sensors", "most of single sensors"]
    page = " ".join(lines_of(bound_page(found.as_json(), found.labels)))
    assert relaxed_sentence(relaxed) in " ".join(page.split())


def test_money_is_spent_within_limits_of_sensors_and_a_spacing_of_all(tmp_path: Path) -> None:
    """The plan is the best of all sets of up to three, each by another sensor, and 4 apart.

    A clock has a unit, and the answer names it. The gap is 0.
    """
    system = SYSTEMS[3]
    sensors = {key: {"price": 1, "most": 1} for key in NAMES}
    problem = _problem(
        system, sensors=sensors, measurement_budget=None, total_price=3, minimum_spacing=4,
        time_step=1, time_unit="h",
    )  # fmt: skip
    few = ("comparison.draws=50",)
    run = pfdist.plan(
        problem, results=tmp_path / "run", pool="serial", changes=few, figures=False, report=False
    )
    apart = {
        times: system.expected_mse(times)
        for times in combinations(range(39), 3)
        if all(later // 3 - time // 3 >= 4 for time, later in pairwise(times))
    }
    within = [times for times in apart if len({time % 3 for time in times}) == 3]
    (name,) = found_sets(run)
    assert _numbers(run.sets[name]) == min(within, key=apart.__getitem__)
    bound = results_of(run)[name].bound
    assert bound == pytest.approx(min(apart[times] for times in within), rel=1e-9)
    assert bound > min(apart.values())
    assert not pfdist.bound(problem, results=run.path, figures=False).relaxed[1:]
    assert f"Measure at t = {', '.join(run.sets[name])} (t in h)." in str(answer_of(run))
    assert all(result.price == result.measurements for result in results_of(run).values())
    (row,) = (row for row in lines_of(answer_of(run)) if re.search(r"\bplan  +3", row))
    assert row.rpartition("plan")[2].split()[:2] == ["3", "3"]  # measurements and price


@pytest.mark.slow
def test_a_bound_with_particles_knows_limits(tmp_path: Path) -> None:
    """It lies below the best set within the limits, and above what any set without them has."""
    system, (horizon, number) = SYSTEMS[2], (6, 3)
    sensors = {"near": {}, "far": {"most": 1}, "both": {"most": 1}}
    problem = pfdist.Problem(
        system.as_model(), horizon=horizon, measurement_budget=number, sensors=sensors,
        particles=80,
    )  # fmt: skip
    changes = "comparison.draws=480", "seed=5"
    quiet = {"pool": "serial", "changes": changes, "figures": False, "report": False}
    run = pfdist.plan(problem, results=tmp_path / "run", bound_draws=0, **quiet)

    every = list(combinations(range(3 * (horizon + 1)), number))
    mse = kalman.expected_mse(system.as_model(), horizon, every)
    within = [all(sum(t % 3 == s for t in times) < 2 for s in (1, 2)) for times in every]
    (name,) = found_sets(run)
    found = pfdist.bound(problem, 480, results=run.path, **quiet)
    gap = next(gap for gap in found.gaps if gap.name == name)
    assert gap.bound.value - 4 * gap.bound.standard_error < mse[within].min()
    assert gap.bound.value > mse.min()


def test_the_plan_is_compared_with_each_sensor_and_with_rotation(
    planned: tuple[pfdist.Problem, pfdist.Run],
) -> None:
    _, run = planned
    sets = {name: list(times) for name, times in run.sets.items()}
    assert sets["evenly_spaced"] == ["0 near", "12 near"]
    assert sets["alone_far"] == ["0 far", "12 far"]
    assert sets["rotation"] == ["0 near", "12 far"]
    assert "alone_both" not in sets  # it may measure once


def test_given_sets_are_compared_with_regular_times(tmp_path: Path) -> None:
    """The first set is the reference, as in a plan. It may be asked for, too."""
    run = pfdist.compare(
        _problem(SYSTEMS[3], measurement_budget=2),
        times={"regular": "regular", "mine": "2 near, 9 far"}, draws=50,
        results=tmp_path / "run", pool="serial", report=False, figures=False,
    )  # fmt: skip
    assert list(run.sets) == ["regular", "alone_far", "alone_both", "rotation", "mine"]


@pytest.mark.plugins("why")
def test_the_worth_of_each_measurement_is_exact_and_names_the_sensor(
    planned: tuple[pfdist.Problem, pfdist.Run],
) -> None:
    problem, run = planned
    worth = pfdist.why(problem, results=run.path, figures=False).worth
    (name,), system = found_sets(run), SYSTEMS[3]
    times = _numbers(run.sets[name])
    rows = worth[worth["name"] == name]
    assert _numbers(f"{row.t} {row.sensor}" for row in rows.itertuples()) == times
    for time, removed in zip(times, rows["removed"], strict=True):
        rest = tuple(other for other in times if other != time)
        rise = system.expected_mse(rest) - system.expected_mse(times)
        assert removed == pytest.approx(rise, rel=1e-9)


@pytest.mark.plugins("filter")
def test_measurements_have_a_row_for_each_sensor(
    planned: tuple[pfdist.Problem, pfdist.Run], tmp_path: Path
) -> None:
    """The exact filter of the table is the Kalman filter of the oracle."""
    problem, run = planned
    table = tmp_path / "case.csv"
    table.write_text("t,sensor,y0\n4,both,0.3\n2,near,1.5\n4,near,-0.2\n")
    filtered = pfdist.filter_measurements(problem, table, results=run.path, report=False)
    assert filtered.measured == ("2 near", "4 near", "4 both")
    means = SYSTEMS[3].means({6: 1.5, 12: -0.2, 14: 0.3})
    np.testing.assert_allclose(filtered.table["mean_0"], means, rtol=1e-9, atol=1e-12)
    following = pfdist.next_time(problem, table, results=run.path)
    assert following.measured == ("2 near", "4 near", "4 both")


def test_the_last_instant_of_a_clock_is_planned() -> None:
    """The clock of what is left has a single instant."""
    problem = _problem(SYSTEMS[3], measurement_budget=2, time_step=1, time_unit="h")
    planner = pfdist.Planner(problem, ["2 near", "9 far"])
    planner.missed(HORIZON - 1)
    assert {str(time).split()[0] for time in planner.plan()} == {str(HORIZON)}
    planner.missed(HORIZON)
    assert planner.plan() == ()


@in_turn(
    ("rows", "said"),
    [
        ("2,near,1.5\n\n40,near,1", r"t must lie in 0\.\.12, got 40 \(row 2\)$"),
        ("2,Near,1.5", "in row 1: got 'Near'; did you mean 'near'. Allowed: "),
        ("2,near,wet", "column 'y0' in row 1 must be a number, got 'wet'"),
        ("2,near,1,5", "decimals have a point; .* Expected 3 fields in line 2, saw 4$"),
    ],
)
def test_a_mistake_in_a_table_names_its_row(rows: str, said: str, tmp_path: Path) -> None:
    table = tmp_path / "case.csv"
    table.write_text(f"t,sensor,y0\n{rows}\n")
    with pytest.raises(pfdist.PfdistError, match=said):
        read_measurements(table, SYSTEMS[3].as_model(), Clock.counting(HORIZON))


@in_turn(
    ("keys", "said"),
    [
        ({"sensors": ["far", "near", "both"]}, "must name the sensors of the model"),
        ({"measurement_budget": None, "total_price": 4}, "sensors.near.price must be given"),
        ({"price": [1] * 13}, "price must be left out with sensors"),
        ({"required": [3]}, "must name times and then their sensor"),
    ],
)
def test_a_wrong_problem_is_answered_in_a_line(keys: dict[str, object], said: str) -> None:
    with pytest.raises(pfdist.PfdistError, match=said) as raised:
        pfdist.evaluate(_problem(SYSTEMS[0], **keys), ["0 near"])
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
def test_weights_are_not_carried_between_sensors(engine: str) -> None:
    said = "resample must be 'always' for a model with sensors, got 'below 0.5' for three_sensors"
    problem = {"engine": engine, "particles": 10, "resample": "below 0.5"}
    with pytest.raises(ModelError, match=said):
        pfdist.evaluate(_problem(SYSTEMS[0], **problem), ["0 near"])
    with pytest.raises(ModelError, match=said):
        pfdist.Filter(SYSTEMS[0].as_model(), 10, resample="below 0.5", horizon=HORIZON)


def test_sets_of_pairs_are_evaluated_as_the_oracle_does() -> None:
    written = {"a": "0 3 near, 12 both", "b": ["0 far", "5 near"]}
    found = pfdist.evaluate(_problem(SYSTEMS[2]), written)
    for name, times in {"a": (0, 9, 38), "b": (1, 15)}.items():
        assert found[name].expected_mse == pytest.approx(SYSTEMS[2].expected_mse(times), rel=1e-9)
        assert _numbers(found[name].measurement_times) == times


@pytest.mark.parametrize(
    ("system", "number"),
    [
        (SYSTEMS[0], 3),
        *(pytest.param(each, BUDGET, marks=pytest.mark.slow) for each in SYSTEMS),
    ],
)
def test_the_plan_is_the_optimum_of_brute_force_and_its_gap_is_0(
    system: ThreeSensors, number: int, tmp_path: Path
) -> None:
    """82,251 sets of four measurements by three sensors, or 3.3 million of six."""
    least, best = system.best(number)
    few = ("comparison.draws=50",)
    run = pfdist.plan(
        _problem(system, measurement_budget=number), results=tmp_path / "run", pool="serial",
        changes=few, figures=False, report=False,
    )  # fmt: skip
    (name,) = found_sets(run)
    times = _numbers(run.sets[name])
    assert system.expected_mse(times) == pytest.approx(least, rel=1e-9)
    assert times == best
    assert results_of(run)[name].bound_gap == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_a_plan_is_exactly_better_than_sets_that_others_choose() -> None:
    """All sets of the benchmark; Stone Soup's is among them if it is installed."""
    from benchmarks import stone_soup

    said = list[str]()
    table = stone_soup.measure(True, said.append)["stone_soup"].set_index("set")
    assert (table["exact_mse"] >= table["exact_mse"]["pfdist"]).all()
    assert table["bound"].iloc[0] == pytest.approx(table["exact_mse"]["pfdist"], rel=1e-9)
    is_installed = "stone_soup_greedy" in table.index
    assert is_installed or any("stonesoup is not installed" in line for line in said)
    # 100 particles and 100 draws
    far = abs(table["expected_mse"] - table["exact_mse"]) / table["standard_error"]
    assert far["evenly_spaced"] < 4
