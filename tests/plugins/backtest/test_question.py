"""`pfdist backtest`: simulated replicates through the whole question, its files and its words."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles import lake
from oracles.bytes_of import hashes
from oracles.lake import HORIZON, days, estimates
from pfdist.errors import (
    ArgumentError,
    JobError,
    MeasurementsError,
    MeasurementTimesError,
    PfdistWarning,
)
from pfdist.plugins.backtest.promise import KEPT, NOT_DECIDED, NOTHING_FORESEEN
from pfdist.store import backtest_schema

pytestmark = pytest.mark.filterwarnings("ignore::pfdist.errors.PfdistWarning")
GRIDS = {"from_start": (0, 12, 24, 36), "centred": (6, 18, 30, 42)}


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run with the exact filter."""
    folder = tmp_path_factory.mktemp("lake")
    text = Path(lake.__file__).read_text(encoding="utf-8")
    (folder / "lake.py").write_text(text, encoding="utf-8")
    (folder / "lake.toml").write_text(lake.JOB, encoding="utf-8")
    return pfdist.run(folder / "lake.toml", folder / "run", figures=False).path


@pytest.fixture
def problem() -> pfdist.Problem:
    return pfdist.Problem(lake.lake(), horizon=HORIZON, measurement_budget=4, engine="kalman")


def judged(job: Any, data: Any, **options: Any) -> Any:
    return pfdist.backtest(job, data, **{"pool": "serial", **options})


def test_errors_are_those_of_the_plan_and_both_grids(planned: Path) -> None:
    """Real errors of Kalman's recursion by hand, over the variance of all judged values."""
    data = days(3)
    found = judged(planned, data, times={"mine": [1, 2, 3, 40]})
    plan = tuple(map(int, found.plan))
    sets = {"plan": plan, **GRIDS, "mine": (1, 2, 3, 40)}
    assert [*found.sets] == [*sets]
    instants = [t for t in range(HORIZON + 1) if t not in {t for s in sets.values() for t in s}]
    y = data["y0"].to_numpy().reshape(3, -1)
    variance = y[:, instants].var()
    for place in range(3):
        for name, times in sets.items():
            mean, _ = estimates(y[place], times)
            row = found.table.query(f"replicate == 'd{place}' and set == '{name}'").iloc[0]
            expected = np.mean((y[place] - mean)[instants] ** 2) / variance
            assert row["real"] == pytest.approx(expected, rel=1e-9)
            assert row["judged"] == len(instants)
    assert found.judged == 3 * len(instants)
    assert found.noise == pytest.approx(0.01 / variance, rel=0.05)
    assert {*found.promises} == {*sets} - {"plan"}
    assert {each.used for each in found.shown} == {plan}
    assert found.files == ()


@pytest.mark.slow
def test_repeats_of_a_time_count_and_a_line_says_how_many(planned: Path) -> None:
    data, said = days(2), list[str]()
    more = pd.DataFrame({"day": ["d0", "d1"], "t": [40, 7], "y0": [0.5, 0.25]})
    found = judged(planned, pd.concat([data, more]), times={"mine": [1, 2, 3, 40]}, say=said.append)
    assert "2 rows repeat a time of the table: the filter weighs each row" in said
    once = judged(planned, data, times={"mine": [1, 2, 3, 40]})
    sets = [[*map(int, found.plan)], *GRIDS.values(), [1, 2, 3, 40]]
    instants = [t for t in range(HORIZON + 1) if not any(t in times for times in sets)]
    y = data["y0"].to_numpy().reshape(2, -1)
    both = np.stack([y[0], np.where(np.arange(HORIZON + 1) == 40, 0.5, np.nan)], axis=1)
    mean, _ = estimates(both, [1, 2, 3, 40])
    row = found.table.query("replicate == 'd0' and set == 'mine'").iloc[0]
    expected = np.mean((y[0] - mean)[instants] ** 2) / y[:, instants].var()
    assert row["real"] == pytest.approx(expected, rel=1e-9)
    assert row["judged"] == len(instants)
    assert found.table["real"][4:].tolist() == pytest.approx(once.table["real"][4:].tolist())


def test_smoothed_estimates_are_judged_if_the_job_makes_them(planned: Path, tmp_path: Path) -> None:
    """Unused measurements from all used ones: the conditional mean of a Gaussian process."""
    changes = ["problem.estimate=smoothed"]
    smoothed = pfdist.run(planned.parent / "lake.toml", tmp_path, changes=changes, figures=False)
    data, times = days(1), [1, 15, 30, 40]
    found = judged(smoothed, data, times={"mine": times})
    t = np.arange(HORIZON + 1)
    variances = estimates(np.full(t.size, np.nan), ())[1]
    covariance = 0.95 ** abs(t - t[:, None]) * variances[np.minimum(t, t[:, None])]
    seen, y = covariance[times], data["y0"].to_numpy()
    mean = seen.T @ np.linalg.solve(seen[:, times] + 0.1**2 * np.eye(4), y[times])
    sets = [*map(int, found.plan)], *GRIDS.values(), times
    judged_at = [each for each in t if not any(each in some for some in sets)]
    real = found.table.query("set == 'mine'").iloc[0]["real"]
    assert real == pytest.approx(np.mean((y - mean)[judged_at] ** 2) / y[judged_at].var(), rel=1e-9)


def test_a_foreseen_gain_is_that_of_the_exact_errors(planned: Path) -> None:
    found = judged(planned, days(24))
    sets = {"plan": tuple(map(int, found.plan)), **GRIDS}
    used = {t for times in sets.values() for t in times}
    instants = [t for t in range(HORIZON + 1) if t not in used]
    exact = {
        name: np.mean(estimates(np.zeros(HORIZON + 1), times)[1][instants] + 0.01)
        for name, times in sets.items()
    }
    for name in GRIDS:
        promise, gain = found.promises[name], 1 - exact["plan"] / exact[name]
        error = (promise.foreseen_interval[1] - promise.foreseen_interval[0]) / 2 / 1.96
        assert abs(promise.foreseen - gain) < 4 * error
        assert 0.05 < promise.foreseen < 0.3
        assert error < 0.005
    assert found.wrong == []
    assert found.means["covered"].between(0.85, 0.95).all()


def test_a_wrong_model_is_found_and_a_promise_is_kept(planned: Path) -> None:
    """Errors three times as large as foreseen; the gain is large and measured by each day."""
    data = days(24)
    data["y0"] *= np.sqrt(3)
    late = {"late": [44, 45, 46, 47]}
    with pytest.warns(PfdistWarning, match="The model is wrong: the real error differs from"):
        found = judged(planned, data, times=late)
    assert found.wrong == [*found.sets]
    assert repr(found).startswith("<The model is wrong: ")  # before the verdict
    assert found.promises["late"].verdict == KEPT
    assert found.promises["late"].ratio == pytest.approx(3.0, rel=0.5)
    assert found.improbable > 0.02


def test_files_are_written_and_replaced_and_nothing_else(planned: Path, tmp_path: Path) -> None:
    data = tmp_path / "days.csv"
    days(3).to_csv(data, index=False)
    before = hashes(planned.parent)
    found = judged(planned, data)
    names = [f"days.backtest.{end}" for end in ("csv", "png", "html")]
    assert [file.name for file in found.files] == names
    assert {file.name for file in tmp_path.iterdir()} == {"days.csv", *names}
    assert hashes(planned.parent) == before
    table = pd.read_csv(found.files[0])
    assert [*table.columns] == backtest_schema().names
    pd.testing.assert_frame_equal(table, found.table, check_dtype=False)
    report = found.files[2].read_text(encoding="utf-8")
    assert "Does the plan help on real measurements?" in report
    assert str(tmp_path) not in report
    once = [file.read_bytes() for file in found.files]
    assert [file.read_bytes() for file in judged(planned, data).files] == once


def test_every_pool_gives_the_same_bytes(planned: Path) -> None:
    """Its files are made of the answer, see above."""
    data = days(2)
    of_one, of_pool = (
        pfdist.backtest(planned, data, pool=name, workers=2, plan_each=True)
        for name in ("serial", "threads")
    )
    pd.testing.assert_frame_equal(of_one.table, of_pool.table, check_exact=True)
    assert of_one.as_json() == of_pool.as_json()


def test_a_replicate_has_the_same_errors_whatever_others_are_in_the_table(planned: Path) -> None:
    """But for the variance that divides all of them."""
    both, alone = days(2), days(2).query("day == 'd1'")
    first, second = (judged(planned, each).table.set_index("replicate").loc["d1"]
                     for each in (both, alone))  # fmt: skip
    shares = [each["foreseen"] / each["foreseen"].iloc[0] for each in (first, second)]
    np.testing.assert_allclose(*shares, rtol=1e-12)


def test_the_command_says_the_verdict_and_gives_json(
    planned: Path, tmp_path: Path, said: Callable[..., str]
) -> None:
    data = tmp_path / "days.csv"
    days(4).assign(train=lambda table: (table["day"] == "d0").astype(int)).to_csv(data, index=False)
    words = ["backtest", str(planned), str(data), "--pool", "serial", "--times", "mine=0,1,2,3"]
    words.append("--no-report")
    text = " ".join(said(*words).split())
    gains = r"With the plan, the error is .* than with .*, and .* than with .*\. It is [\d.]+ times"
    assert re.match(gains, text)
    assert "not decided" not in text  # the verdicts are details
    assert "left out d0: the model was fitted to it" in text
    assert "not checked" not in text
    assert "the set mine" in text
    answer = json.loads(said(*words, "--json"))
    assert {*answer["promises"]} == {"from_start", "centred", "mine"}
    assert {*answer["sets"]} == {"plan", *answer["promises"]}
    assert answer["replicates"] == 3
    assert answer["left_out"] == {"d0": "the model was fitted to it"}
    assert answer["is_checked"] is True
    assert [Path(answer[key]).name for key in ("table", "figure")] == [
        f"days.backtest.{end}" for end in ("csv", "png")
    ]
    promise = answer["promises"]["centred"]
    assert promise["verdict"] in {"kept", "not kept", "not decided", "no gain was foreseen"}
    assert promise["interval"][0] <= promise["ratio"] <= promise["interval"][1]


def test_filters_that_collapse_come_first(planned: Path) -> None:
    found = judged(planned, days(2))
    assert found.as_json()["collapsed"] == 0  # the filter is exact
    told = replace(found, collapsed=3)
    assert told.as_json()["collapsed"] == 3
    few = "<The estimate is that of a few particles, not the model's: the effective sample size "
    few += (
        "falls below 5 in 3 of 6 filters, or fewer than 20 values of a constant are left. What may "
    )
    few += "help: more particles, filter.proposal = "
    assert repr(told).startswith(few)


def test_replicates_that_cannot_be_judged_are_named(planned: Path) -> None:
    data = days(5)
    data = data[~((data["day"] == "d1") & (data["t"] > 35))]
    plan = map(int, judged(planned, days(1)).plan)
    used = {*plan, *GRIDS["from_start"], *GRIDS["centred"]}
    data = data[(data["day"] != "d2") | data["t"].isin(used)]
    found = judged(planned, data.assign(train=(data["day"] == "d3").astype(int)))
    assert found.left_out == {
        "d1": "no measurement within 0.5 of t = 36, for the set from_start",
        "d2": "no value is left to judge",
        "d3": "the model was fitted to it",
    }
    assert found.table["replicate"].unique().tolist() == ["d0", "d4"]
    assert found.is_checked
    assert not judged(planned, days(2)).is_checked
    with pytest.raises(MeasurementsError, match=r"no replicate can be judged \(d0: the model was"):
        judged(planned, data.assign(train=1))


@pytest.mark.plugins("simulate")
def test_known_quantities_are_judged_in_place_of_measurements(
    planned: Path, problem: pfdist.Problem
) -> None:
    draws = pfdist.simulate(problem, draws=4, seed=5)
    data = draws.rename(columns={"draw": "day", "y_turbidity": "y0", "z_turbidity": "z0"})
    found = judged(planned, data[["day", "t", "y0", "z0"]])
    y, z = (data[name].to_numpy().reshape(4, -1) for name in ("y0", "z0"))
    used = {t for times in ([*map(int, found.plan)], *GRIDS.values()) for t in times}
    instants = [t for t in range(HORIZON + 1) if t not in used]
    mean, _ = estimates(y[2], GRIDS["centred"])
    expected = np.mean((z[2] - mean)[instants] ** 2) / z[:, instants].var()
    row = found.table.query("replicate == '2' and set == 'centred'").iloc[0]
    assert row["real"] == pytest.approx(expected, rel=1e-9)
    assert found.noise == 0.0


def test_a_plan_for_each_is_made_among_its_own_measurements(problem: pfdist.Problem) -> None:
    """A day that was measured at even hours only, and one with too few measurements."""
    data = days(3)
    even = data[(data["day"] != "d1") | (data["t"] % 2 == 0)]
    even = even[(even["day"] != "d2") | (even["t"] < 3)]
    found = judged(problem, even, plan_each=True, within=1.0)
    assert found.left_out == {"d2": "it has too few measurements for a plan"}
    shown = {each.name: each.used for each in found.shown}
    assert all(t % 2 == 0 for t in shown["d1"])
    assert len(shown["d0"]) == len(shown["d1"]) == 4


@pytest.mark.plugins("simulate")
def test_replicates_have_clocks_of_their_own() -> None:
    """The foreseen error is the variance at the times of the replicate, as the model reads them."""

    def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
        return (x[0] + np.sqrt(p.dt[t]) * w[0],)

    model = replace(lake.lake(), name="walk", initial=lambda w, p: (w[0],), transition=transition)
    problem = pfdist.Problem(
        model, horizon=4, time_step=0.5, time_unit="h", measurement_budget=2, engine="kalman"
    )
    draws = pfdist.simulate(problem, draws=2, seed=3).rename(columns={"draw": "patient"})
    data = draws.rename(columns={"y_turbidity": "y0"})[["patient", "t", "y0"]]
    inside = (data["patient"] == 1) & (data["t"] > 0) & (data["t"] < 4)
    data.loc[inside, "t"] += 0.1
    found = judged(problem, data, plan_each=True)
    assert not found.left_out
    (own,) = [each for each in found.shown if each.name == "1"]
    assert own.times[:2] == pytest.approx((0.0, 0.6))
    assert found.within == 0.25
    errors = found.table.set_index(["replicate", "set"])["foreseen"]
    assert np.isfinite(errors).all()
    assert (errors["0"] != errors["1"]).all()


def test_a_lag_is_a_duration_on_the_uneven_clock_of_a_replicate(tmp_path: Path) -> None:
    """The conditional mean of a walk given what is used until then; below all steps, the filter."""

    def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
        return (x[0] + np.sqrt(p.dt[t]) * w[0],)

    model = replace(lake.lake(), name="walk", initial=lambda w, p: (w[0],), transition=transition)
    problem = pfdist.Problem(
        model, horizon=8, time_step=0.5, measurement_budget=2, engine="kalman", lag=0.5
    )
    run = pfdist.plan(problem, tmp_path / "run", bound_draws=0, figures=False, pool="serial")
    clocks = {
        "a": ([0.0, 0.4, 0.7, 1.0, 1.4, 1.8, 2.9, 3.3, 4.0, 5.1, 6.2, 7.5, 8.0], [0.4, 1.0, 2.9]),
        "b": ([0.0, 0.6, 1.3, 2.0, 2.6, 3.3, 4.0, 4.7, 5.4, 6.0, 6.7, 7.4, 8.0], [0.6, 1.3, 3.3]),
    }
    for name, (times, used) in clocks.items():
        y = np.random.default_rng(1).normal(size=len(times))
        frame = pd.DataFrame({"system": name, "t": times, "y0": y})
        found = judged(run, frame, times={"mine": [0.5, 1.0, 3.0]}, within=2.0)
        (own,) = found.shown
        place = [*found.sets].index("mine")
        for k, t in enumerate(times):
            seen = [times.index(s) for s in used if s <= t + 0.5]
            covariance = 1 + np.minimum(*np.meshgrid(times, times))
            noisy = covariance[np.ix_(seen, seen)] + 0.1**2 * np.eye(len(seen))
            mean = covariance[k, seen] @ np.linalg.solve(noisy, y[seen])
            assert own.errors.estimates[place, k, 0] == pytest.approx(mean, rel=1e-9)


def test_wrong_options_and_tables_are_one_line(planned: Path, problem: pfdist.Problem) -> None:
    data = days(2)
    for options, error, said in (
        ({"times": {"plan": [0]}}, ArgumentError, "times: 'plan' is the name of another set"),
        ({"times": {"centred": [0]}}, ArgumentError, "times: 'centred' is the name of another"),
        ({"times": {"mine": [48]}}, MeasurementTimesError, "times of mine"),
        ({"replicate": "dya"}, MeasurementsError, "did you mean 'day'"),
    ):
        with pytest.raises(error, match=said):
            judged(planned, data, **options)
    for table, said in (
        (data.assign(y0=1.0), "component 0 must differ from each other, .*, got 1 to 1"),
        (data.assign(y0=data["y0"] * 1e200), "must differ from each other, by less than 1e150"),
        (
            data[data["t"] < 20],
            r"judged \(d0: .* within 0\.5 of t = .*, for the set plan\); --within allows more",
        ),
    ):
        with pytest.raises(MeasurementsError, match=said):
            judged(planned, table)
    scenarios = {"parameters": [{"sd": 0.2}, {"sd": 0.4}], "filter": "nominal"}
    several = pfdist.Problem(
        lake.lake(), horizon=HORIZON, measurement_budget=4, scenarios=scenarios
    )
    with pytest.raises(JobError, match="plan_each needs no scenarios, or"):
        judged(several, data, plan_each=True)


def test_a_single_replicate_and_a_single_block_have_no_interval(planned: Path) -> None:
    for found in (judged(planned, days(1)), judged(planned, days(3), block=3)):
        assert {each.verdict for each in found.promises.values()} <= {NOT_DECIDED, NOTHING_FORESEEN}
        assert found.wrong == []
        text = repr(found)
        assert "(too few replicates for an interval)" in text
        assert "unknown" not in text.lower()
        assert "nan" not in text


def test_a_job_is_as_good_as_its_run(planned: Path) -> None:
    of_run = judged(pfdist.open_run(planned), days(2)).table
    of_job = judged(planned.parent / "lake.toml", days(2), results=planned).table
    pd.testing.assert_frame_equal(of_run, of_job)


def test_the_best_evenly_spaced_times_of_the_run_are_a_third_grid(tmp_path: Path) -> None:
    problem = pfdist.Problem(lake.lake(), horizon=HORIZON, measurement_budget=4, engine="kalman")
    run = pfdist.plan(
        problem, tmp_path / "run", changes=["comparison.draws=2"], figures=False, bound_draws=0
    )
    found = judged(run, days(3))
    assert [*found.sets] == ["plan", "from_start", "centred", "evenly_spaced"]
    again = judged(run, days(3), times={"same": run.sets["evenly_spaced"]})
    real = again.means["real"]
    assert real["same"] == real["evenly_spaced"]
    assert "than with the best evenly spaced times" in str(found._page())
    same = replace(found.promises["evenly_spaced"], found=0.0, found_interval=(0.0, 0.0))
    text = str(replace(found, promises={**found.promises, "evenly_spaced": same})._page())
    assert "The plan has the same times as the best evenly spaced times. With" in text
    assert "(exact) than" not in text
