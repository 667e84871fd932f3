"""The linearized design as times, as a search and as a rival of a plan; what a plan then says."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.unknown import constants, drug, emax, epidemic, level_and_slope, logistic, moving
from pfdist import Problem
from pfdist.errors import ModelError
from pfdist.filters import kalman
from pfdist.filters.evaluator import Evaluator
from pfdist.kernels.estimators import SQUARED_ERROR, TWO_CLOUDS
from pfdist.problem.feasible import Feasible
from pfdist.runner import search_phase

LEVEL = level_and_slope(0.1, 0.05)
HORIZON, MEASUREMENTS = 10, 3
SETS = [*Feasible(HORIZON, MEASUREMENTS).every()]
EXACT = dict(zip(SETS, kalman.expected_mse(LEVEL, HORIZON, SETS).tolist(), strict=True))
ROUNDED = replace(constants(1, 0.1), quantity_of_interest=lambda x, t, p: (np.rint(x[0]),))
BEST = min(SETS, key=lambda times: EXACT[times])


def problem(**keys: Any) -> Problem:
    return Problem(LEVEL, **{"horizon": HORIZON, "measurement_budget": MEASUREMENTS} | keys)


def test_linearized_times_of_a_linear_model_are_the_best(tmp_path: Path) -> None:
    # Oracle: the Kalman filter with each of all 165 sets.
    found = pfdist.evaluate(problem(engine="kalman"), "linearized")
    assert tuple(found.measurement_times) == BEST
    of_job = problem(engine="kalman").job(
        comparison={"draws": 20, "sets": {"design": "linearized", "mine": [0, 1, 2]}}, search=[]
    )
    run = pfdist.compare(of_job, results=tmp_path / "run", pool="serial", figures=False)
    assert run.sets["design"] == BEST
    assert run.job["comparison"]["sets"]["design"] == [*BEST]
    search = [{"method": "random", "evaluations": 2}]
    of_job = problem(engine="kalman").job(comparison={"reference": "linearized"}, search=search)
    run = pfdist.run(of_job, tmp_path / "reference", pool="serial", figures=False)
    assert run.sets["reference"] == BEST


def test_a_search_by_linearized_errors_finds_the_best_set(tmp_path: Path) -> None:
    job = problem().job(comparison={"draws": 20}, search=[{"method": "linearized"}])
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    assert run.sets["linearized"] == BEST


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"criterion": "worst_instant"}, "there is no linearized design for a criterion"),
        ({"model": ROUNDED, "horizon": 20}, "quantity_of_interest has 'rint'"),
    ],
)
def test_what_has_no_linearized_design_is_said(keys: Any, why: str) -> None:
    of_job = Problem(**{"model": LEVEL, "horizon": 10, "measurement_budget": 3} | keys)
    with pytest.raises(ModelError, match=why):
        pfdist.evaluate(of_job, "linearized")


def planned(of_job: Problem, path: Path, **sections: Any) -> pfdist.Run:
    job = of_job.job(**{"comparison": {"draws": 400}} | sections)
    return pfdist.run(job, path, pool="serial", figures=False)


def test_where_sets_are_few_a_plan_looks_at_all(tmp_path: Path) -> None:
    run = planned(problem(), tmp_path / "run")
    rows = run.table("evaluations")
    first = rows[(rows["phase"] == "relaxation.every") & (rows["generation"] == 0)]
    assert len(first) == len(SETS)
    assert EXACT[run.sets["relaxation"]] <= 1.01 * EXACT[BEST]


def test_the_design_is_a_finalist_of_a_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search_phase, "_FEW_SETS", 0)
    rows = planned(problem(), tmp_path / "run").table("evaluations")
    for phase in ("relaxation.polish", "relaxation.shortlist"):  # exchanges may begin there
        found = rows[(rows["phase"] == phase) & (rows["generation"] == 0)]["measurement_times"]
        assert BEST in {tuple(int(t) for t in times) for times in found}


# --- what answers say -----------------------------------------------------------------------------


def test_a_set_that_clearly_beats_the_search_is_named_without_a_gain(tmp_path: Path) -> None:
    worst = max(SETS, key=lambda times: EXACT[times])
    search = [{"method": "random", "evaluations": 1, "name": "one"}]
    job = problem().job(
        comparison={"draws": 2000, "reference": [*worst], "sets": {"mine": [*BEST]}}, search=search
    )
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    sets = run.table("sets").set_index("name")
    assert sets["beats_search"].tolist() == [None, True, None]
    assert run.best.name == "mine"
    answer = str(run)
    assert "This is the set mine: the search found nothing better" in answer
    assert "lower" not in answer.partition("with its set")[0]


@pytest.mark.plugins("runs")
@pytest.mark.parametrize("best", ["mine", "reference"])
def test_lists_and_bounds_name_the_set_that_beats_the_search_first(
    best: str, tmp_path: Path
) -> None:
    worst = max(SETS, key=lambda times: EXACT[times])
    given = {"mine": BEST, "reference": worst}
    if best == "reference":
        given = {"mine": worst, "reference": BEST}
    comparison = {"draws": 2000, "reference": [*given["reference"]]}
    comparison["sets"] = {"mine": [*given["mine"]]}
    search = [{"method": "random", "evaluations": 1, "name": "one"}]
    job = problem().job(comparison=comparison, search=search)
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    (row,) = pfdist.list_runs(tmp_path).itertuples()
    assert row.best == run.best.name == best
    assert row.found == f"{best}: the search found nothing better"
    assert math.isnan(row.gain_of_means)  # these draws have chosen it
    # The gap of the search's set is above .8; that of the best, which alone counts, is small.
    proved = pfdist.bound(run, draws=480, within=0.5, pool="serial", figures=False)
    gaps = {gap.name: gap.gap_at_most for gap in proved.gaps}
    assert gaps[best] < 0.5 < gaps["one"]
    assert proved.within_reached
    assert proved.as_json()["plan"] == best
    assert str(proved).startswith(f"<For the {'set ' * (best == 'mine')}{best}: Proved")


def test_a_set_that_breaks_a_constraint_is_never_named(tmp_path: Path) -> None:
    search = [{"method": "random", "evaluations": 1, "name": "one"}]
    worst = max(SETS, key=lambda times: EXACT[times])
    sets = {"draws": 500, "reference": [*worst], "sets": {"all": [*range(11)]}}
    job = problem().job(comparison=sets, search=search)
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    assert run.best.name == "one"


def test_a_loss_of_more_than_a_fifth_comes_before_the_times(tmp_path: Path) -> None:
    hours = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
    of_job = Problem(
        drug(0.03), times=[*hours], measurement_budget=4, proposal="plain", particles=100
    )
    search = [{"method": "random", "evaluations": 3}]
    job = of_job.job(comparison={"draws": 600}, search=search, evaluation={"draws": 20})
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    html = run._repr_html_()
    alarm = html.index("particles lose at most")
    assert alarm < html.index("Measure at")
    assert html.count("particles may be too few") == 1  # of the other set


# --- small systems, of which all sets are known ---------------------------------------------------

TWELVE = (0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 24.0)
SMALL = {
    "drug, 3 %": (drug(0.03), TWELVE),
    "drug, 15 %": (drug(0.15), TWELVE),
    "plateau": (emax(), tuple(range(0, 34, 3))),
    "growth": (logistic(), tuple(range(0, 24, 2))),
    "epidemic": (epidemic(), tuple(range(0, 56, 5))),
    "line": (level_and_slope(0.0, 0.3), tuple(range(12))),
}


@pytest.mark.plugins("moving")
@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_a_plan_of_constants_is_the_best_of_all_sets(name: str, tmp_path: Path) -> None:
    # All 220 sets by moved particles: some draws choose the best, others judge it and the plan. The
    # regret is at most 1 % beyond two standard errors: by squared errors, and by two clouds, whose
    # standard error is up to six times smaller where large errors are rare.
    model, times = SMALL[name]
    of_job = Problem(
        model.on_clock(times), horizon=11, measurement_budget=3, estimate="smoothed",
        proposal="moving",
    )  # fmt: skip
    run = planned(of_job, tmp_path / "run")
    evaluator = Evaluator(model.on_clock(times), 11, lag=11)
    sets = [*Feasible(11, 3).every()]
    chosen = evaluator(evaluator.work(sets, 3, 5, (0, 400), moving(100, estimator=TWO_CLOUDS.name)))
    best = sets[int(chosen.mse.mean(axis=0).argmin())]
    rivals = [run.sets["relaxation"], best]
    for estimator in (SQUARED_ERROR, TWO_CLOUDS):
        judged = moving(100, estimator=estimator.name)
        mse = evaluator(evaluator.work(rivals, 7, 11, (0, 8000), judged)).mse
        regret = mse[:, 0] - mse[:, 1]
        assert regret.mean() <= 0.01 * mse[:, 1].mean() + 2 * regret.std() / len(mse) ** 0.5
    if name == "line":  # exact
        errors = kalman.expected_mse(model, 11, [run.sets["relaxation"], *sets], lag=11)
        assert errors[0] <= 1.01 * errors.min()
