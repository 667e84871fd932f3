"""Runs of jobs whose estimates use later measurements."""

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

import pfdist
from oracles.bytes_of import hashes
from oracles.systems import SYSTEMS, one_state, scalar
from pfdist import Job
from pfdist.common.rounding import with_error
from pfdist.common.streams import stream_of
from pfdist.errors import JobError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse
from pfdist.filters.kalman import expected_mse
from pfdist.filters.other_estimate import SMOOTHED as SMOOTHED_ERROR
from pfdist.filters.variants import of_error, results, shown_beside
from pfdist.filters.work import Estimation
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.pages.terminal import lines_of
from pfdist.problem.job import load_job
from pfdist.questions.about_run import problem
from pfdist.questions.evaluate import evaluated
from pfdist.questions.run_page import answer_of
from pfdist.questions.subject import Subject
from pfdist.results.stored_run import measured_of
from pfdist.runner.build import build
from pfdist.runner.driver import foreseen_steps

SMOOTHED = "problem.estimate=smoothed"
CHANGES = ["comparison.draws=500", "search.relaxation.polish=false"]
HINT = '`problem.estimate = "smoothed"` plans for that.'


@pytest.fixture(scope="module")
def run(finished: Callable[..., Path]) -> pfdist.Run:
    return pfdist.open_run(finished(SMOOTHED))


def test_the_comparison_has_the_errors_of_the_jobs_estimate(run: pfdist.Run) -> None:
    """Those of the evaluator, which oracles of `test_lines` check, and not those of the filter."""
    built = build(load_job(run.path))
    assert built.evaluator.lag == 12
    draws, rows = stream_of("comparison", 1, "draws"), run.table("comparison")
    for name, times in measured_of(run).items():
        noise = stream_of("comparison", 1, "filter", name)
        work = built.evaluator.work([times], noise, draws, (0, 250), built.comparing)
        np.testing.assert_array_equal(rows[f"mse_{name}"], built.evaluator(work).mse[:, 0])
    estimates = run.table("trajectories")
    z, found = (estimates[f"{each}_state"].to_numpy() for each in ("z", "estimate_random"))
    errors = np.mean(((found - z) ** 2).reshape(-1, 13), axis=1)
    np.testing.assert_allclose(errors, rows["mse_random"][: len(errors)], rtol=1e-12)


def test_the_report_says_which_measurements_an_estimate_uses(run: pfdist.Run) -> None:
    assert "measurements that an estimate uses" in str(problem(Subject(run)))


def test_every_answer_of_a_run_says_that_few_lines_are_left(run: pfdist.Run) -> None:
    """The small job has 40 particles; the answer is about its best set. It has losses, too."""
    said = str(answer_of(pfdist.open_run(run.path)))
    assert "of 40 particles: only these have descendants" in said
    asked = evaluated(str(run.path), times={"": "regular"}, draws=30)
    assert "of 40 particles: only these have descendants" in str(asked._page())
    assert {"filter_distance", "filter_variance"} <= {*run.tables}
    rows, built = run.table("filter_distance"), build(load_job(run.path))
    works = built.evaluator.work(
        [measured_of(run)["random"]], stream_of("comparison", 1, "filter", "filter_distance"),
        stream_of("comparison", 1, "draws"), (0, 5),
        replace(built.comparing, estimator="filter_noise"),
    )  # fmt: skip
    np.testing.assert_array_equal(rows["distance_random"][:5], built.evaluator(works).mse[:, 0])


@pytest.mark.plugins("online")
def test_what_needs_the_filters_estimate_is_one_line(run: pfdist.Run) -> None:
    with pytest.raises(JobError, match=r"^problem.estimate = 'smoothed' needs a search of method"):
        load_job(run.path / "job.toml").with_changes(sections={"search": [{"method": "survivors"}]})
    with pytest.raises(JobError, match=r"^choosing times on the way needs problem.estimate = 'fi"):
        pfdist.Planner(run.path)


@pytest.mark.plugins("online")
def test_the_rest_of_a_season_is_planned_with_the_measured_dates(tmp_path: Path) -> None:
    """The way that the error and docs/afterwards.md name: the best set is that of all others."""
    page = (Path(__file__).parents[2] / "docs" / "afterwards.md").read_text(encoding="utf-8")
    ((own, keys),) = re.findall(r"```toml\n# (\w+\.toml)[^\n]*\n(.*?)```", page, re.DOTALL)
    season = 'horizon = 2027-10-31\nmeasurement_budget = 4\nestimate = "smoothed"\n'
    clock = '[problem.clock]\nstart = 2027-04-01\nstep = "1 d"\n'
    job, model = tmp_path / own, '[model]\nname = "random_walk"\n[filter]\nengine = "kalman"\n'
    job.write_text(f"seed = 1\n{keys}{season}{clock}{model}")
    with pytest.raises(JobError, match=r"make measured times problem.required, .*afterwards.md"):
        pfdist.next_time(job, pd.DataFrame({"t": [], "y0": []}))
    made = pfdist.plan(job, tmp_path / "rest", pool="serial", figures=False, bound_draws=0)
    *measured, last = made.best.measurement_times
    assert measured == ["2027-04-29", "2027-06-03", "2027-07-07"]
    rest = pd.date_range("2027-07-26", "2027-10-31").to_series()
    left = [f"{day:%Y-%m-%d}" for day in rest if day.weekday() in range(1, 5)]
    errors = [pfdist.evaluate(job, [*measured, day]).expected_mse for day in left]
    assert last == left[np.argmin(errors)]


def test_a_lag_above_the_horizon_is_the_smoothed_estimate(finished: Callable[..., Path]) -> None:
    times = {"a": [0, 3, 6, 9]}
    job = load_job(finished(SMOOTHED) / "job.toml", ["seed=2"])
    smoothed = pfdist.evaluate(job, times)["a"].mse
    data = job.problem.model_dump(mode="json", exclude_none=True) | {"lag": 20}
    del data["estimate"]
    lagged = pfdist.evaluate(job.with_changes(sections={"problem": data}), times)["a"].mse
    np.testing.assert_array_equal(smoothed, lagged)


def test_a_plan_and_its_bound_enclose_the_best_set_for_smoothed_estimates(tmp_path: Path) -> None:
    """Exact errors of all 126 sets, by the Kalman smoother; with particles to 4 standard errors."""
    horizon, budget = 8, 4
    model, sets = SYSTEMS["forgetful"], list(combinations(range(horizon + 1), budget))
    exact = dict(zip(sets, expected_mse(model, horizon, sets, lag=horizon).tolist(), strict=True))
    for engine, proved in (("kalman", 0.01), ("compiled", 0.2)):
        problem = pfdist.Problem(
            model, horizon=horizon, measurement_budget=budget, estimate="smoothed", engine=engine,
            particles=400,
        )  # fmt: skip
        run = pfdist.plan(problem, tmp_path / engine, changes=CHANGES, pool="serial", figures=False)
        row = run.table("bound").iloc[-1]
        best = tuple(row["measurement_times"])
        assert exact[best] < min(exact.values()) * 1.01
        assert row["bound"] - 4 * row["bound_error"] < min(exact.values())
        assert row["gap_at_most"] < proved


# --- both errors, and the name of the estimate ----------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "other", "when"),
    [
        ([], "smoothed", "If you analyse only afterwards"),
        ([SMOOTHED], "filtered", "At the moment, with the measurements until then"),
    ],
)
def test_the_error_of_the_other_estimate_is_that_of_the_same_draws_and_noise(
    changes: list[str], other: str, when: str, finished: Callable[..., Path]
) -> None:
    """A job of the other estimate has the same errors, the smoothed ones by two filters."""
    run, swapped = pfdist.open_run(finished(*changes)), finished(*([] if changes else [SMOOTHED]))
    table, sets = run.table("other_estimate"), run.table("sets").set_index("name")
    built, of_run = build(load_job(swapped)), build(load_job(run.path))
    (error,) = shown_beside(of_run.evaluator)
    assert error.named == other
    estimation = error.settings(of_run.evaluator, of_run.comparing)
    filters = ESTIMATORS[estimation.estimator].filters
    assert filters == (2 if other == "smoothed" else 1)
    assert 5 <= len(table) <= 50
    steps = len(table) * 13 * len(run.names) * estimation.steps_an_instant
    assert steps <= foreseen_steps(of_run) / 10
    draws, measured = stream_of("comparison", 1, "draws"), measured_of(run)
    for name, times in measured.items():
        noise = stream_of("comparison", 1, "filter", name)
        work = built.evaluator.work([times], noise, draws, (0, len(table)), estimation)
        mse = built.evaluator(work).mse[:, 0]
        np.testing.assert_array_equal(table[f"{other}_{name}"], mse)
        error = mse.std(ddof=1) / np.sqrt(mse.size)
        own = sets.loc[name, [f"{other}_mse", f"{other}_error"]].astype(float)
        np.testing.assert_allclose(own, [mse.mean(), error], rtol=1e-12)
    best, said = run.best, " ".join(" ".join(lines_of(answer_of(run))).split())
    texts = [
        with_error(sets[f"{other}_mse"][name], sets[f"{other}_error"][name])
        for name in (best.name, "regular")
    ]
    assert f"{when}, " in said
    assert f"the expected MSE is {texts[0]} (regular, as above: {texts[1]})." in said
    assert (HINT in said) == (other == "smoothed")
    assert (": the expected MSE of the smoothed estimate is " in said) == bool(changes)


@pytest.mark.parametrize("is_told", [True, False])
def test_few_ancestors_do_not_raise_the_error_of_the_other_estimate(is_told: bool) -> None:
    """It is the error of the exact smoother, also if the filter has another model (a renamed one).

    With a sharp sensor few ancestors are left, and the squared error is a quarter or more too high;
    with 20 particles, higher than the filter's.
    """
    sharp, times = scalar("sharp", 0.7, 1.0, 0.02), [(0, 3, 7, 10), (1, 4, 7, 10)]
    other = None if is_told else replace(sharp, name="renamed", linear_gaussian=False)
    of_filter = Evaluator(sharp, 12, other)
    smoothing, own = of_error(of_filter, "smoothed"), Estimation(500)
    chosen = SMOOTHED_ERROR.settings(of_filter, own)
    assert chosen.estimator == ("two_clouds" if is_told else "two_errors")

    def errors(evaluator: Evaluator, estimation: Estimation) -> NDArray[np.float64]:
        return evaluator(evaluator.work(times, 1, 2, (0, 400), estimation)).mse

    found, exact = errors(smoothing, chosen), expected_mse(sharp, 12, times, lag=12)
    error = found.std(axis=0, ddof=1) / 20
    assert (abs(found.mean(axis=0) - exact) < 3 * error).all()
    assert (errors(smoothing, own).mean(axis=0) > 1.25 * exact).all()
    few = replace(own, particles=20)
    chosen = SMOOTHED_ERROR.settings(of_filter, few)
    filtered = errors(of_filter, few).mean(axis=0)
    assert (errors(smoothing, few).mean(axis=0) > filtered).all()
    assert (errors(smoothing, chosen).mean(axis=0) < filtered).all()


def test_an_error_of_the_models_own_is_an_upper_limit_afterwards(tmp_path: Path) -> None:
    """Nothing takes the part of few ancestors out of it, which only raises a convex error."""
    own = one_state("own", error=lambda z, e, t, p: abs(z[0] - e[0]))
    problem = pfdist.Problem(own, horizon=8, measurement_budget=3, proposal="plain")
    changes = ["comparison.draws=100", "filter.particles=50", "search.relaxation.polish=false"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    said = " ".join(" ".join(lines_of(answer_of(run))).split())
    assert "the expected MSE is at most " in said
    assert "afterwards, at most ±" in str(answer_of(run))
    evaluation = evaluated(str(run.path), times={"": "0,4,8"}, draws=50)
    assert "with all measurements: at most " in " ".join(lines_of(evaluation._page()))


def test_an_exact_engine_has_both_errors_exactly(finished: Callable[..., Path]) -> None:
    exact = "filter.engine=kalman", "model.name=random_walk", "comparison.draws=2"
    for lag, other in ((0, "smoothed"), (12, "filtered")):
        run = pfdist.open_run(finished(*exact, *([SMOOTHED] if lag else [])))
        sets, both = run.table("sets"), build(load_job(run.path)).evaluator
        assert both.lag == lag
        of_other = exact_mse(replace(both, lag=12 - lag), [*measured_of(run).values()])
        np.testing.assert_allclose(sets[f"{other}_mse"], of_other, rtol=1e-12)
        assert (sets[f"{other}_error"] == 0.0).all()
        assert "other_estimate" not in run.tables
        # More measurements never hurt an exact estimate.
        assert ((sets["expected_mse"] > of_other) == (other == "smoothed")).all()


def test_the_worst_scenario_decides_both_errors(tmp_path: Path) -> None:
    scenarios = {
        "parameters": [{"step_sd": 0.5}, {"step_sd": 2.0}],
        "criterion": "worst",
        "filter": "told",
    }
    problem = pfdist.Problem(
        "random_walk", horizon=8, measurement_budget=3, scenarios=scenarios, proposal="plain"
    )
    job = ["comparison.draws=600", "filter.particles=60"]
    times, folder = {"a": [0, 3, 6], "b": [2, 5, 8]}, tmp_path / "run"
    run = pfdist.compare(problem, times=times, results=folder, changes=job, figures=False)
    rows = run.table("comparison", 120).merge(run.table("other_estimate"), on="draw")
    means = rows.groupby("scenario")[["smoothed_a", "smoothed_b"]].mean()
    np.testing.assert_allclose(run.table("sets")["smoothed_mse"], means.max(), rtol=1e-12)
    assert "afterwards" in " ".join(lines_of(answer_of(run)))


def test_the_plain_twin_has_nearly_the_same_errors(run: pfdist.Run) -> None:
    """Particles of single precision now and then take another way."""
    built = build(load_job(run.path))
    work = built.evaluator.work([(0, 4, 8), ()], 1, 2, (0, 40), built.comparing)
    work = replace(work, beside="filtered")
    plain = replace(built.evaluator, engine="numpy")
    (compiled,), (twin,) = results(built.evaluator, [work]), results(plain, [work])
    np.testing.assert_allclose(compiled.mse.mean(axis=0), twin.mse.mean(axis=0), rtol=0.01)


def test_evaluate_names_the_estimate_and_evaluate_shows_both_errors(
    run: pfdist.Run, finished: Callable[..., Path]
) -> None:
    job, times = str(run.path / "job.toml"), {"": "0:12:4", "b": "0:12:3"}
    alone = evaluated(job, times={"": times[""]}, draws=100)
    said = " ".join(" ".join(lines_of(alone._page())).split())
    assert said.startswith("Expected MSE of the smoothed estimate ")
    swapped = pfdist.evaluate(
        load_job(job).with_changes(["problem.estimate=filtered"]), "0:12:4", draws=20
    )
    answer = alone.as_json()
    assert answer["filtered_mse"] == swapped.expected_mse
    assert f"At the moment, with the measurements until then: {swapped.estimate.text}." in said
    several = evaluated(job, times={"a": times[""], "b": times["b"]}, draws=100)
    assert "at the moment ± standard error" in str(several._page())
    lagged = evaluated(
        str(finished() / "job.toml"), times={"": "0:12:4"}, changes=["problem.lag=3"]
    )
    assert "Expected MSE of the estimate with a lag of 3 " in str(lagged._page())


@pytest.mark.slow
def test_a_smoothed_plan_says_how_many_evenly_spaced_measurements_do_as_well(
    small_job: Job, tmp_path: Path
) -> None:
    """A plan that lacks the table gets it."""
    folder, changes = tmp_path / "run", [SMOOTHED, "comparison.draws=2000"]
    run = pfdist.plan(small_job, folder, changes=changes, bound_draws=0, figures=False)
    assert "evenly_spaced" not in run.tables
    run = pfdist.plan(small_job, folder, changes=changes, figures=False)
    table, plan = run.table("evenly_spaced").set_index("measurements"), run.best
    assert f"{plan.evenly_spaced} evenly spaced measurements do as well" in str(answer_of(run))
    row, evaluator = table.loc[plan.evenly_spaced], build(load_job(run.path)).evaluator
    assert evaluator.lag == 12
    assert row["difference"] + 1.96 * row["difference_error"] < 0.03 * row["plan_mse"]
    before = hashes(folder)
    pfdist.plan(small_job, folder, changes=changes, figures=False)
    assert hashes(folder) == before
