"""Jobs with a clock: formulas read it, errors are weighted by it, and people read it.

The oracle is an Ornstein-Uhlenbeck process, whose transition over any time is known exactly.
"""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

import pfdist
from oracles.results_of import results_of
from pfdist.cli.main import main
from pfdist.errors import PfdistError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork
from pfdist.plugins.why.question import Why
from pfdist.questions.run_page import page_of

pytestmark = pytest.mark.usefixtures("no_figures")

MODEL = """
import numpy as np
from pfdist import StateSpaceModel


def transition(x, t, w, p):
    kept = np.exp(-p.rate * p.dt[t])
    return (kept * x[0] + p.sd * np.sqrt(1 - kept**2) * w[0],)


model = StateSpaceModel(
    name="ornstein_uhlenbeck",
    initial=lambda w, p: (p.sd * w[0],),
    transition=transition,
    measurement=lambda x, t, v, p: (x[0] + p.noise * v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.noise) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"rate": 0.3, "sd": 2.0, "noise": 0.5},
    linear_gaussian=True,
)
"""
TIMES = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 12.0)
JOB = f"""
seed = 1
[model]
name = "ou.py:model"
[problem]
times = {list(TIMES)}
time_unit = "h"
measurement_budget = 3
forbidden = ["2:3"]
[filter]
engine = "kalman"
particles = 60
[evaluation]
draws = 60
[[search]]
method = "exhaustive"
[comparison]
draws = 200
[execution]
pool = "serial"
"""


@pytest.fixture
def job(tmp_path: Path) -> Path:
    (tmp_path / "ou.py").write_text(MODEL)
    path = tmp_path / "ou.toml"
    path.write_text(JOB)
    return path


def exact_errors(times: NDArray[np.float64], measured: tuple[int, ...]) -> NDArray[np.float64]:
    """Variance of x at each time given the measurements up to it, by the scalar Kalman filter."""
    rate, sd, noise, variance, errors = 0.3, 2.0, 0.5, 4.0, []
    for t, step in enumerate(np.diff(times, append=times[-1])):
        if t in measured:
            variance = 1 / (1 / variance + 1 / noise**2)
        errors.append(variance)
        kept = np.exp(-rate * step)
        variance = kept**2 * variance + sd**2 * (1 - kept**2)
    return np.array(errors)


def weighted(errors: NDArray[np.float64], times: tuple[float, ...] = TIMES) -> float:
    """The mean over time by the trapezoidal rule."""
    return float(np.trapezoid(errors, times) / (times[-1] - times[0]))


MEASURED = exact_errors(np.array(TIMES), (1, 5, 6))  # at 0.5, 5 and 8 h


def test_on_an_irregular_grid_the_error_is_weighted_by_trapezoids(job: Path) -> None:
    """The exact expected MSE is the integral of the Kalman filter's variance over time."""
    found = pfdist.evaluate(job, [0.5, 5, 8])
    assert found.expected_mse == pytest.approx(weighted(MEASURED))
    assert found.measurement_times == (0.5, 5.0, 8.0)


def test_given_weights_take_the_place_of_the_clocks(job: Path) -> None:
    last = pfdist.load_job(job, ["problem.instant_weights=[0, 0, 0, 0, 0, 0, 0, 1]"])
    assert pfdist.evaluate(last, [0.5, 5, 8]).expected_mse == pytest.approx(MEASURED[-1])


def test_a_run_speaks_of_the_clock(job: Path, tmp_path: Path) -> None:
    """Summary, tables and the sets of a run have times in hours; nothing has instants."""
    run = pfdist.run(job, tmp_path / "run")
    (regular, exhaustive), allowed = run.sets.values(), set(TIMES) - {2.0, 3.0}
    assert set(regular) | set(exhaustive) <= allowed
    answer = run.as_json()
    assert answer["time_unit"] == "h"
    weights = np.array(answer["instant_weights"])
    assert np.average(np.arange(8.0), weights=weights) == pytest.approx(weighted(np.arange(8.0)))
    page = str(page_of(run))
    assert "weights of instants in the MSE" in page
    assert "by the trapezoidal rule, because the steps differ" in page
    assert results_of(run)["exhaustive"].measurement_times == list(exhaustive)
    rows = run.table("trajectories")
    assert rows["t"].tolist()[: len(TIMES)] == list(TIMES)
    assert rows.attrs["time_unit"] == "h"
    table = pd.read_parquet(run.path / "tables" / "evaluations")
    assert {time for times in table["measurement_times"] for time in times} <= allowed
    again = pfdist.run(job, tmp_path / "run")  # a finished run is read, not computed
    assert again.sets == run.sets
    more = pfdist.run(pfdist.load_job(job, ["comparison.draws=300"]), tmp_path / "run")
    assert (more.sets, more.draws_compared) == (run.sets, 300)


LAST = [0, 0, 0, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("weights", [[], [f"problem.instant_weights={LAST}"]])
def test_evaluate_and_the_comparison_show_the_error_itself_and_the_typical_error(
    weights: list[str], job: Path, tmp_path: Path, said: Callable[..., str]
) -> None:
    """Neither is weighted: at the last instant the error is the variance then."""
    asked, times = pfdist.load_job(job, weights), [0.5, 5, 8]
    evaluated = pfdist.evaluate(asked, times, draws=1000, profile=True)
    sets = {"a": times, "b": [0, 1]}
    run = pfdist.compare(asked, times=sets, results=tmp_path / "run", draws=1000, figures=False)
    row, table = run.table("sets").set_index("name").loc["a"], run.table("error_over_time")
    for profile, mse in (
        (evaluated.profile, evaluated.expected_mse),
        (table[table["name"] == "a"], row["expected_mse"]),
    ):
        np.testing.assert_allclose(profile["error"], MEASURED)
        assert (profile["weight"] * profile["error"]).mean() == pytest.approx(mse)
        gaps = np.diff(TIMES)
        given = LAST if weights else (np.append(0, gaps) + np.append(gaps, 0)) / 2
        np.testing.assert_allclose(profile["weight"], np.divide(given, np.mean(given)))
    assert row["typical_error"] == [pytest.approx(np.sqrt(row["expected_mse"]))]
    words = [word for change in weights for word in ("--set", change)]
    shown = said("evaluate", job, "--times", "0.5,5,8", "--profile", *words)
    assert re.search(r"typical error \d", shown)
    assert re.search(r"^\[h\] +weight +error$", shown, re.MULTILINE)


def _profile(run: pfdist.Run, found: Why) -> tuple[pd.DataFrame, float, NDArray[np.float64]]:
    """Errors of the best set at each instant, its expected MSE, and its exact errors."""
    profile = found.profile[found.profile["name"] == "exhaustive"]
    cost = found.sets.set_index("name").loc["exhaustive", "expected_mse"]
    measured = tuple(TIMES.index(time) for time in run.sets["exhaustive"])
    return profile, cost, exact_errors(np.array(TIMES), measured)


def test_why_keeps_the_exact_cost_where_instants_do_not_count(job: Path, tmp_path: Path) -> None:
    """An instant of weight 0 has an error too, but no part in the mean over time."""
    given = [1, 0, 2, 0, 0, 0, 0, 5]
    asked = pfdist.load_job(job, [f"problem.instant_weights={given}"])
    run = pfdist.run(asked, tmp_path / "run")
    before = results_of(run)["exhaustive"].expected_mse
    found = pfdist.why(run, draws=300, figures=False)
    profile, cost, exact = _profile(run, found)
    assert profile["t"].tolist() == list(TIMES)
    assert set(found.worth["t"]) <= set(TIMES)
    assert not {2.0, 3.0} & set(found.sampling_windows["moved_to"])
    after = results_of(pfdist.open_run(run.path))["exhaustive"].expected_mse
    assert np.average(profile["error"], weights=given) == pytest.approx(cost)
    np.testing.assert_allclose(profile["error"], exact, atol=1e-9)
    assert before == pytest.approx(np.average(exact, weights=given))
    assert after == pytest.approx(before, rel=1e-12)


def test_an_infinite_error_of_weight_0_does_not_count(job: Path) -> None:
    model = pfdist.load_model(f"{job.with_name('ou.py')}:model").on_clock(TIMES)
    infinite = replace(model, error=lambda z, e, t, p: np.where(t == 2, np.inf, (z[0] - e[0]) ** 2))
    work = FilterWork(((1, 5), (1,)), (7, 7), (3, 3), 4, (0, 6), Estimation(30))
    weights = (2.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    found, without = (
        Evaluator(each, 7, engine="numpy", weights=weights) for each in (infinite, model)
    )
    np.testing.assert_allclose(found(work).mse, without(work).mse, rtol=1e-12)
    np.testing.assert_allclose(found.sum_errors(work), without.sum_errors(work), rtol=1e-12)
    assert np.isinf(Evaluator(infinite, 7, engine="numpy")(work).mse).all()


def test_the_bound_holds_on_an_irregular_grid(job: Path, tmp_path: Path) -> None:
    """With an exact engine and windows long enough the bound is the optimum of brute force."""
    spaced = pfdist.load_job(job, ["problem.minimum_spacing=1.5"])
    run = pfdist.run(spaced, tmp_path / "run")
    (gap,) = [gap for gap in pfdist.bound(run).gaps if gap.name == "exhaustive"]
    errors = {
        times: weighted(exact_errors(np.array(TIMES), times))
        for times in spaced.problem.feasible.every()
    }
    assert run.sets["exhaustive"] == tuple(TIMES[t] for t in min(errors, key=lambda t: errors[t]))
    assert gap.bound.value <= min(errors.values()) * (1 + 1e-12)
    assert gap.gap < 0.05


def test_commands_read_and_write_hours(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(job), "--results", str(tmp_path / "run")]) == 0
    text = capsys.readouterr().out
    times = pfdist.open_run(tmp_path / "run").sets["exhaustive"]
    assert f"Measure at t = {', '.join(f'{time:g}' for time in times)} h." in text
    assert main(["evaluate", str(job), "--times", "0.5:8", "--json"]) == 0
    broken = json.loads(capsys.readouterr().out)["broken_constraints"]
    assert "problem.forbidden: 2, 3 are measured" in broken
    assert main(["evaluate", str(job), "--times", "0.7"]) == 1
    assert (
        "--times must be times of the clock, got 0.7; the nearest are 0.5 and 1 h"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("problem.horizon=12", r"problem\.horizon must be left out, because times gives every"),
        ("problem.forbidden=[4]", r"problem\.forbidden must be times .* nearest are 3 and 5 h"),
        ("problem.instant_weights=[1, 2]", r"needs 8 values, one for each instant, got 2"),
        (
            "problem.instant_weights={'0:3'=1}",
            r"instant_weights must name every time in 0\.\.12 once",
        ),
        (
            "problem.instant_weights={'0:12'=0}",
            r"must be finite, at least 0, and not all 0, got {'0",
        ),
        ("problem.instant_weights='end'", r"instant_weights.* 'last'"),
    ],
)
def test_a_wrong_clock_is_told_in_one_line(job: Path, change: str, message: str) -> None:
    with pytest.raises(PfdistError, match=message):
        pfdist.load_job(job, [change])


def test_a_model_that_reads_the_clock_needs_one(job: Path) -> None:
    text = job.read_text().replace(f"times = {list(TIMES)}", "horizon = 7")
    job.write_text(text.replace('time_unit = "h"', ""))
    with pytest.raises(PfdistError, match=r"problem\.time_step, problem\.time_unit or"):
        pfdist.evaluate(job, [1])
    model = pfdist.load_model(f"{job.with_name('ou.py')}:model")
    with pytest.raises(PfdistError, match=r"or take the model's on_clock\(times\)"):
        pfdist.Filter(model, particles=20, engine="numpy").update(1, 0.3)
    filtering = pfdist.Filter(model.on_clock([0.0, 0.5, 2.0]), particles=200, engine="numpy")
    assert np.isfinite(filtering.update(2, 0.3).mean).all()


def test_a_parameter_may_not_have_a_name_of_the_clock(job: Path) -> None:
    source = job.with_name("ou.py")
    source.write_text(source.read_text().replace('"sd": 2.0', '"sd": 2.0, "time": 1.0'))
    with pytest.raises(PfdistError, match=r"p\.time is the clock's"):
        pfdist.evaluate(job, [1])


def test_a_parameter_that_varies_has_a_number_for_each_instant(job: Path) -> None:
    source = job.with_name("ou.py")
    varying = MODEL.replace("p.rate *", "p.rate[t] *").replace('"rate": 0.3', '"rate": [0.3] * 8')
    source.write_text(varying)
    found = pfdist.evaluate(job, [0.5, 5, 8])
    assert found.expected_mse == pytest.approx(weighted(MEASURED))


@pytest.mark.plugins("filter", "online")
def test_measurements_and_the_next_time_speak_of_the_clock(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`filter`, `next` and a planner read and write hours; a planner repeats what `next` says."""
    run = pfdist.run(job, tmp_path / "run")
    planned = run.sets["exhaustive"]
    measured = pd.DataFrame({"t": [planned[0], 12.0], "y0": [0.3, -1.0]})
    found = pfdist.filter_measurements(run, measured, out=tmp_path)
    report = found.files[2].read_text()
    assert re.search(r"surprising measurement is that at t\s=\s[\d.]+\sh: p", report)
    assert found.table["t"].tolist() == list(TIMES)
    assert found.measured == (planned[0], 12.0)
    assert set(found.missing) == set(planned) - {planned[0], 12.0}
    assert found.as_json()["time_unit"] == "h"
    measured.to_csv(tmp_path / "mine.csv", index=False)
    capsys.readouterr()
    job_of_run = str(run.path / "job.toml")
    assert main(["filter", job_of_run, str(tmp_path / "mine.csv"), "--no-report"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"planned, missing +[\d., ]+ h\n", out)
    assert re.search(r"most surprising +t = [\d., ]+ h", out)
    main(["next", job_of_run, str(tmp_path / "mine.csv")])
    assert re.search(r"expected MSE .* from t = 12 h on", capsys.readouterr().out)
    after = pfdist.next_time(run, measured[:1], now=planned[0])
    planner = pfdist.Planner(pfdist.load_job(job), planned)
    assert planner.next_time() == planned[0]
    assert planner.update(0.3).t == planned[0]
    assert (planner.plan(), planner.measured) == (after.plan, after.measured)
    assert set(after.plan) <= set(TIMES)
    between = pd.DataFrame({"t": [4.0], "y0": [0.0]})
    assert pfdist.filter_measurements(run, between, report=False).measured == (4,)
    with pytest.raises(PfdistError, match=r"now must be times of the clock, got 6"):
        pfdist.next_time(run, measured[:1], now=6)
