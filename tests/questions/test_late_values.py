"""Plans, backtests and moves by hand while values are in flight, against Kalman filters."""

import math
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.late import LATE, late_walk, meter_and_laboratory, of_delays, of_late_walk
from oracles.three_sensors import SYSTEMS
from pfdist import Problem
from pfdist.errors import MeasurementsError, MeasurementTimesError
from pfdist.filters.exact import exact_mse
from pfdist.filters.simulation import simulate
from pfdist.filters.variants import of_error
from pfdist.filters.work import Estimation
from pfdist.pages.terminal import lines_of
from pfdist.plugins.explorer.session import ExplorerSession
from pfdist.runner.build import build

pytestmark = pytest.mark.plugins("online")


def best_completion(taken: set[str], now: int, money: int) -> set[str]:
    """The best set of `meter_and_laboratory` that was measured like this up to now."""

    def read(written: set[str], name: str) -> tuple[int, ...]:
        return tuple(int(each.split()[0]) for each in written if each.endswith(name))

    early, late = read(taken, "bedside"), read(taken, "lab")
    money -= len(early) + 3 * len(late)
    sets = [
        ((*early, *more_early), (*late, *more_late))
        for count in range(money // 3 + 1)
        for more_late in combinations(range(now + 1, 7), count)
        for number in [min(8 - now, money - 3 * count)]
        for more_early in combinations(range(now + 1, 9), number)
    ]
    best = min(sets, key=lambda s: of_delays(s[0], tuple(t + 2 for t in s[1]), 8))
    return {f"{t} bedside" for t in best[0]} | {f"{t} lab" for t in best[1]}


EXHAUSTIVE = {"search": {"method": "exhaustive"}}


def late_planner() -> Any:
    problem = Problem(
        meter_and_laboratory(), horizon=8, total_price=9, sensors=LATE, engine="kalman"
    )
    times = ["1 lab", "2 lab", "3 bedside", "5 bedside", "6 bedside"]
    return pfdist.Planner(problem.job(search=[{"method": "exhaustive"}], online=EXHAUSTIVE), times)


def test_the_rest_is_planned_while_values_are_in_flight() -> None:
    """Against all completions, judged by a Kalman filter that takes values when they arrive."""
    planner, nan = late_planner(), math.nan
    assert (planner.plan()[0], planner.next_time()) == ("1 lab", "1 lab")
    planner.taken()
    assert planner.in_flight == ("1 lab",)
    planner.taken()
    planner.missed(2)
    assert (planner.in_flight, planner.measured) == (("1 lab", "2 lab"), ())
    assert {*planner.plan(), *planner.in_flight} == best_completion({"1 lab", "2 lab"}, 2, 9)
    planner.update([0.3, 0.2], 3)
    known = {"1 lab", "2 lab", "3 bedside"}
    assert ({*planner.measured}, planner.in_flight) == ({"1 lab", "3 bedside"}, ("2 lab",))
    assert {*planner.plan(), *known} == best_completion(known, 3, 9)
    (left,) = planner.expected()
    made = sorted(known | {*planner.plan()})
    early, late = ([int(e[0]) for e in made if e.endswith(name)] for name in ("side", "lab"))
    after = [of_delays(tuple(early), tuple(t + 2 for t in late), T) * (T + 1) for T in (8, 2)]
    assert left.expected_mse == pytest.approx((after[0] - after[1]) / 6, rel=1e-9)
    planner.missed(4)  # the value of 2 does not come: its money is left
    assert (planner.in_flight, {*planner.measured}) == ((), {"1 lab", "3 bedside"})
    made = {"1 lab", "3 bedside"}
    assert {*planner.plan(), *made} == best_completion(made, 4, 9)
    planner.update([nan, 0.1], 8)
    assert planner.measured[-1] == "6 lab"  # told when it arrives, although it was not planned


def test_a_measurement_that_was_not_planned_is_spent() -> None:
    planner = late_planner()
    planner.missed(2)
    planner.taken("4 lab")
    assert planner.in_flight == ("4 lab",)
    assert "4 lab" not in planner.plan()
    made = [each for each in planner.plan() if each.endswith("lab")]
    assert len(planner.plan()) - len(made) + 3 * len(made) == 6
    for wrong in ("5 bedside", "0 lab"):
        with pytest.raises(MeasurementsError, match="taken is for a value that arrives later"):
            planner.taken(wrong)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"most_within": {"number": 1, "time": 3}}, "got 3: most_within"),
        ({"minimum_spacing": 3}, "minimum_spacing is 3, got 1 and 3"),
        ({"forbidden": [3]}, "forbidden: 3 is measured"),
        ({"required": [5, 7]}, "got 3: required times to come no longer fit"),
    ],
)
def test_a_measurement_that_breaks_a_constraint_is_not_taken(
    keys: dict[str, Any], message: str
) -> None:
    problem = Problem(
        "random_walk", horizon=9, measurement_budget=3, sensor={"delay": 2}, engine="kalman", **keys
    )
    planner = pfdist.Planner(problem, [1, 5, 7] if "required" in keys else [1, 4, 7])
    if "forbidden" not in keys:
        planner.taken(1)
    before = planner.plan(), planner.in_flight
    with pytest.raises(MeasurementTimesError, match=message):
        planner.taken(3)
    assert (planner.plan(), planner.in_flight) == before
    planner.taken(before[0][0])


def test_a_measurement_beyond_the_budget_is_not_taken() -> None:
    keys = {"sensor": {"delay": 2}, "engine": "kalman"}
    planner = pfdist.Planner(
        Problem("random_walk", horizon=9, measurement_budget=2, **keys), [1, 4]
    )
    planner.taken()
    planner.taken(2)
    with pytest.raises(MeasurementTimesError, match="measurement_budget is 2, got 3 times"):
        planner.taken(3)


def test_next_keeps_measurements_without_a_value_yet(tmp_path: Path) -> None:
    problem = Problem(
        meter_and_laboratory(), horizon=8, total_price=9, sensors=LATE, engine="kalman"
    )
    job = problem.job(search=[{"method": "exhaustive"}], online=EXHAUSTIVE | {"draws": 2},
                      comparison={"draws": 100})  # fmt: skip
    run = pfdist.plan(job, tmp_path / "run", figures=False, bound_draws=0)
    rows = [(0, "bedside", 0.2), (0, "lab", 1.0), (2, "lab", math.nan), (3, "bedside", 0.1)]
    table = pd.DataFrame(rows, columns=["t", "sensor", "y0"])
    made = {f"{t} {name}" for t, name, _ in rows}
    found = pfdist.next_time(run.path, table)
    assert ({*found.measured}, found.in_flight) == (made - {"2 lab"}, ("2 lab",))
    assert "values to come of t = 2 lab" in " ".join(" ".join(lines_of(found._page())).split())
    assert found.as_json()["in_flight"] == ["2 lab"]
    assert {*found.plan, *made} == best_completion(made, 3, 9)
    late = pfdist.next_time(run.path, table, now=5)  # its value did not arrive at 4
    assert late.in_flight == ()
    assert {*late.plan, *made} - {"2 lab"} == best_completion(made - {"2 lab"}, 5, 9)


def test_the_plan_before_is_compared_although_a_value_arrives_after_its_first_time(
    tmp_path: Path,
) -> None:
    problem = Problem(
        meter_and_laboratory(), horizon=8, measurement_budget=3, sensors=LATE, engine="kalman",
        required=["3 bedside"],
    )  # fmt: skip
    run = pfdist.plan(
        problem, tmp_path / "run", figures=False, changes=["comparison.draws=100"], bound_draws=0
    )
    table = pd.DataFrame([(2, "lab", math.nan)], columns=["t", "sensor", "y0"])
    found = pfdist.next_time(run.path, table)
    assert (found.in_flight, found.planned_before[0]) == (("2 lab",), "3 bedside")
    assert found.expected_before is not None


@pytest.mark.parametrize("value", [0.1, math.nan])
def test_a_row_whose_value_arrives_after_the_end_says_what_time_it_is(
    tmp_path: Path, value: float
) -> None:
    problem = Problem(late_walk(), horizon=8, measurement_budget=3, sensor={"delay": 3},
                      engine="kalman")  # fmt: skip
    run = pfdist.plan(
        problem, tmp_path / "run", figures=False, changes=["comparison.draws=100"], bound_draws=0
    )
    table = pd.DataFrame([(0, 0.3), (6, value)], columns=["t", "y0"])
    found = pfdist.next_time(run.path, table, say=lambda line: None)
    assert (found.now, found.plan, found.measured) == (6, (), (0,))


def test_a_failed_measurement_in_flight_is_spent() -> None:
    """Also if another sensor has a value when its value would arrive."""
    sensors = {"bedside": {}, "lab": {"delay": 2, "fails": 0.1}}
    problem = Problem(
        meter_and_laboratory(), horizon=4, measurement_budget=3, sensors=sensors, particles=20
    )
    planner = pfdist.Planner(problem, ["0 lab", "2 bedside", "3 bedside"])
    planner.taken()
    planner.update([0.2, math.nan], 2)
    assert {*planner.measured} == {"0 lab", "2 bedside"}
    assert len(planner.plan()) == 1


def test_a_point_is_spent_once(tmp_path: Path) -> None:
    """Two rows of a time, of which one failed."""
    problem = Problem(
        late_walk(), horizon=5, measurement_budget=3, sensor={"fails": 0.1}, particles=200
    )
    run = pfdist.plan(
        problem, tmp_path / "run", figures=False, changes=["comparison.draws=100"], bound_draws=0
    )
    table = pd.DataFrame([(1, math.nan), (1, 0.3)], columns=["t", "y0"])
    assert pfdist.next_time(run.path, table).left == 2


@pytest.mark.slow
def test_online_times_of_a_linear_system_are_those_of_the_plan(tmp_path: Path) -> None:
    problem = Problem(
        late_walk(), horizon=9, measurement_budget=4, sensor={"delay": 3}, engine="kalman"
    )
    run = pfdist.online(problem, tmp_path / "run", draws=3, figures=False,
                        changes=["comparison.draws=100"])  # fmt: skip
    best = [int(t) for t in run.best.measurement_times]
    exact = min(of_late_walk(made, 3, 9) for made in combinations(range(7), 4))
    assert of_late_walk(tuple(best), 3, 9) == pytest.approx(exact)
    assert [[*each] for each in run.table("online")["measurement_times"]] == [best] * 3


def test_late_measurements_are_numbered_by_the_arrival_of_their_values() -> None:
    problem = Problem(late_walk(), horizon=8, measurement_budget=2, sensor={"delay": 3},
                      engine="kalman", forbidden=[1])  # fmt: skip
    session = ExplorerSession(problem)
    assert session.state()["forbidden"] == (0, 1, 2, 4)  # by arrival
    answer = session.answer((5, 7))
    mse = pfdist.evaluate(problem, [2, 4]).expected_mse
    assert (answer["times"], answer["broken"]) == ([5, 7], [])
    curve = np.square(answer["curves"]["yours"][0])
    assert curve.mean() == pytest.approx(mse) == pytest.approx(of_late_walk((2, 4), 3, 8))
    assert session.answer((4, 7))["broken"] == ["forbidden: 1 is measured"]
    assert session.judge("mine", (5, 7))[0]["times"] == [5, 7]
    assert "'mine': '2,4'" in session.command_line({"mine": (5, 7)})


@pytest.mark.plugins("backtest")
@pytest.mark.filterwarnings("ignore::pfdist.errors.PfdistWarning")
def test_a_backtest_judges_values_when_they_are_made_by_those_that_have_arrived(
    tmp_path: Path,
) -> None:
    """The real and the foreseen error by conditioning on the values that have arrived."""
    horizon, delay = 12, 3
    problem = Problem(late_walk(), horizon=horizon, measurement_budget=2,
                      sensor={"delay": delay}, engine="kalman")  # fmt: skip
    run = pfdist.plan(
        problem, tmp_path / "run", figures=False, changes=["comparison.draws=100"], bound_draws=0
    )
    y = simulate(late_walk(), horizon, range(2), 5).y[..., 0]
    rows = [(k, t, y[k, t]) for k in range(2) for t in range(horizon + 1)]
    table = pd.DataFrame(rows, columns=["id", "t", "y0"])
    found = pfdist.backtest(run.path, table, times={"mine": [1, 5]}, pool="serial", report=False)
    even = pfdist.open_run(run.path).sets["evenly_spaced"]
    assert found.plan == tuple(run.best.measurement_times)
    sets = [found.plan, (1, 5), (0, 5), (2, 7), even]
    used = {t for each in sets for t in each}
    judged = [t for t in range(horizon + 1 - delay) if t not in used]
    gains = np.array([1.0 + (3 * t) % 5 for t in range(horizon + 1)])
    variance = [4.0]
    for _ in range(horizon):
        variance.append(0.95**2 * variance[-1] + 0.36)
    s, t = np.meshgrid(np.arange(horizon + 1), np.arange(horizon + 1))
    joint = np.array(variance)[np.minimum(s, t)] * 0.95 ** abs(s - t) * np.outer(gains, gains)
    spread = np.concatenate([each[judged] for each in y]).var()
    for name, made in (("plan", found.plan), ("mine", (1, 5))):
        real, foreseen = np.zeros((2, len(judged))), []
        for k, now in enumerate(judged):
            known = [at for at in made if at + delay <= now]
            seen = joint[np.ix_(known, known)] + np.eye(len(known))
            gain = np.linalg.solve(seen, joint[known, now])
            real[:, k] = (y[:, now] - y[:, known] @ gain) ** 2
            foreseen.append(joint[now, now] - gain @ joint[known, now] + 1.0)
        of_set = found.table[found.table["set"] == name]
        assert of_set["real"].to_numpy() == pytest.approx(real.mean(axis=1) / spread)
        assert of_set["foreseen"].mean() == pytest.approx(np.mean(foreseen) / spread, rel=0.1)
    each = pfdist.backtest(problem, table, plan_each=True, pool="serial", report=False)
    assert {*each.table["set"]} == {"plan", "from_start", "centred"}
    assert not each.left_out


THREE = {"near": {"delay": 3}, "far": {"delay": 1}, "both": {}}
LATE_JOBS = {  # of smoothed estimates: the model, its sensors, and sets of three and four
    "one": (late_walk(), {"sensor": {"delay": 4}}, [[2, 6, 8], [0, 3, 5, 8]]),
    "two": (meter_and_laboratory(), {"sensors": LATE}, [["1 lab", "3 bedside", "6 lab"]]),
    "three": (
        SYSTEMS[2].as_model(),
        {"sensors": THREE},
        [["1 near", "4 far", "4 both"], ["0 far", "9 near"]],
    ),
}


@in_turn("name", LATE_JOBS)
def test_at_the_moment_a_value_counts_when_it_has_arrived(name: str) -> None:
    """The other estimate of a smoothed job is the filtered job's, also with particles.

    A value that arrives after T counts only afterwards.
    """
    model, sensors, sets = LATE_JOBS[name]
    given = {"horizon": 12, "measurement_budget": 4, **sensors}
    for times in sets:
        own, other, sampled = (
            build(Problem(model, estimate=estimate, engine=engine, **given).job())
            for estimate, engine in (
                ("smoothed", "kalman"), ("filtered", "kalman"), ("smoothed", "compiled")
            )
        )  # fmt: skip
        [set_of_own], [set_of_other] = (
            [each.job.problem.points.read(times)] for each in (own, other)
        )
        [right] = exact_mse(other.evaluator, [set_of_other])
        moment = of_error(own.evaluator, "filtered")
        assert exact_mse(moment, [set_of_own]) == pytest.approx([right], rel=1e-9)
        works = of_error(sampled.evaluator, "filtered").work(
            [set_of_own], 1, 2, (0, 2000), Estimation(400, "systematic")
        )
        mse = of_error(sampled.evaluator, "filtered").filtered(works).mse
        error = mse.std() / math.sqrt(mse.size)
        assert abs(mse.mean() - right) <= 4 * error + right / 400


def test_the_other_estimate_of_a_plan_and_of_a_comparison_has_the_delay(tmp_path: Path) -> None:
    """`plan` and `compare` show it beside the smoothed one; a run from its folder has it, too."""
    job = Problem(
        late_walk(), horizon=12, measurement_budget=3, sensor={"delay": 4}, estimate="smoothed",
        engine="kalman",
    )  # fmt: skip
    changes = ["comparison.draws=2"]
    run = pfdist.plan(job, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    compared = pfdist.compare(
        job, times={"a": [2, 6, 8], "b": [1, 5, 8]}, results=tmp_path / "c", changes=changes,
        figures=False,
    )  # fmt: skip
    filtered = Problem(
        late_walk(), horizon=12, measurement_budget=3, sensor={"delay": 4}, engine="kalman"
    )
    for rows in (
        run.table("sets"),
        compared.table("sets"),
        pfdist.open_run(run.path).table("sets"),
    ):
        for row in rows.to_dict("records"):
            in_time = [t for t in row["measurement_times"] if t + 4 <= 12]
            right = pfdist.evaluate(filtered, in_time).expected_mse
            assert row["filtered_mse"] == pytest.approx(right, rel=1e-9)


@pytest.mark.plugins("filter")
def test_filtered_estimates_of_a_smoothed_job_use_values_that_have_arrived(tmp_path: Path) -> None:
    """The columns of the filtered estimate are those of the filtered job, with one row a value."""
    table = pd.DataFrame({"t": [1, 4, 4, 9], "sensor": ["near", "far", "both", "near"],
                          "y0": [0.7, 1.1, 0.2, -0.4]})  # fmt: skip
    given = {"horizon": 12, "measurement_budget": 4, "sensors": THREE}
    for engine in ("kalman", "compiled"):
        smoothed, filtered = (
            pfdist.filter_measurements(
                Problem(SYSTEMS[2].as_model(), estimate=estimate, engine=engine, **given), table
            ).table
            for estimate in ("smoothed", "filtered")
        )
        columns = [name for name in filtered if not name.startswith("smoothed")]
        pd.testing.assert_frame_equal(smoothed[columns], filtered[columns])
        assert smoothed["measured"].to_numpy().nonzero()[0].tolist() == [4, 5, 12]
