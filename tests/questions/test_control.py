"""Questions that compare with a control: what the tables hold, and where there is none."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles import walks
from oracles.bytes_of import hashes
from oracles.systems import one_state
from pfdist import Job, Problem
from pfdist.errors import JobError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation

QUICK = ["search.random.evaluations=3", "search.genetic.generations=1", "comparison.draws=20"]
WRONG = ["model.name=random_walk", "model.filter.parameters.step_sd=2.0"]
NOMINAL = [
    "model.name=random_walk",
    "scenarios.parameters=[{step_sd=0.5}, {step_sd=1.0}]",
    "scenarios.filter=nominal",
]
EXACT = ["model.name=random_walk", "filter.engine=kalman"]
SETS = {"early": [0, 1, 2, 5], "late": [6, 8, 10, 12]}


def _controls(run: pfdist.Run) -> list[str]:
    return [name for name in run.table("comparison") if str(name).startswith("control_")]


def test_a_job_asks_for_controls_and_the_printed_mean_is_less_them(
    finished: Callable[..., Path],
) -> None:
    asked, plain = (
        pfdist.open_run(finished(*changes)) for changes in (["comparison.control=true"], [])
    )
    rows, sets = asked.table("comparison"), asked.table("sets").set_index("name")
    assert _controls(asked) == [f"control_{name}" for name in asked.names]
    assert not _controls(plain)
    assert rows[[*plain.table("comparison")]].equals(plain.table("comparison"))
    assert asked.table("gains").equals(plain.table("gains"))
    before = plain.table("sets").set_index("name")
    for name in asked.names:
        values = rows[f"mse_{name}"] - rows[f"control_{name}"]
        assert sets["expected_mse"][name] == pytest.approx(values.mean())
        alone = (rows[f"mse_{name}"].max() - values.mean()) / len(rows)  # the control fails there
        assert sets["standard_error"][name] == pytest.approx(math.hypot(values.sem(), alone))
        assert values.sem() < before["standard_error"][name]
        apart = rows[f"control_{name}"]
        assert abs(apart.mean()) < 4 * apart.sem()
    assert "control" not in plain.job["comparison"]
    assert [row["name"] for row in asked.as_json()["sets"]] == asked.names


def test_pools_and_a_comparison_that_grows_give_the_same_bytes(
    small_job: Job, finished: Callable[..., Path], tmp_path: Path
) -> None:
    whole, changes = finished("comparison.control=true"), ["comparison.control=true"]
    for draws in (60, 250):
        few = small_job.with_changes([*changes, f"comparison.draws={draws}"])
        run = pfdist.run(few, tmp_path / "run", pool="threads", figures=False)
    assert hashes(run.path) == hashes(whole)


@pytest.mark.plugins("why")
@pytest.mark.parametrize(
    ("changes", "got"),
    [
        (WRONG, "a filter with the true model, got a section model.filter"),
        (NOMINAL, "scenarios.filter = 'told' or 'learned', got 'nominal'"),
        (EXACT, "an engine with particles, got filter.engine = 'kalman'"),
    ],
    ids=["wrong", "nominal", "exact"],
)
def test_where_the_filter_does_not_know_the_truth_a_job_cannot_ask_and_questions_do_without(
    changes: list[str], got: str, small_job: Job, tmp_path: Path
) -> None:
    with pytest.raises(JobError, match=f"^comparison.control = true needs {got}") as error:
        small_job.with_changes([*changes, "comparison.control=true"])
    assert "\n" not in str(error.value)
    job = small_job.with_changes([*changes, *QUICK])
    run = pfdist.compare(job, times=SETS, results=tmp_path / "compare", figures=False)
    assert not _controls(run)
    assert "control" not in run.job["comparison"]
    if changes is NOMINAL:
        assert (pfdist.why(run, 20, figures=False).sets["expected_mse"] > 0).all()


@pytest.mark.plugins("budget")
def test_questions_have_controls_unless_the_job_says_no(small_job: Job, tmp_path: Path) -> None:
    job = small_job.with_changes(QUICK)
    asked = pfdist.compare(job, times=SETS, results=tmp_path / "asked", figures=False)
    assert _controls(asked) == ["control_early", "control_late"]
    assert asked.job["comparison"]["control"] is True
    plain = job.with_changes(["comparison.control=false"])
    assert not _controls(pfdist.compare(plain, times=SETS, results=tmp_path / "no", figures=False))
    curve = pfdist.budget(job, (2, 3), tmp_path / "curve", 40, bound_draws=0, figures=False)
    assert len(_controls(curve)) == 4


@pytest.mark.plugins("why")
def test_why_computes_means_with_controls(small_job: Job, tmp_path: Path) -> None:
    """Both answers filter the same draws, so their difference is the mean of a control."""
    job = small_job.with_changes([*QUICK, "comparison.draws=30"])
    answers = {}
    for control in ("", "false"):
        changes = [f"comparison.control={control}"] if control else []
        run = pfdist.run(job.with_changes(changes), tmp_path / f"run{control}", figures=False)
        answers[control] = pfdist.why(run, 800, figures=False)
    found, plain = answers[""].sets, answers["false"].sets
    apart = np.abs(found["expected_mse"] - plain["expected_mse"])
    assert (apart > 0).all()
    assert (apart < 4 * plain["standard_error"]).all()
    assert (found["standard_error"] < 0.9 * plain["standard_error"]).all()
    profile = answers[""].profile.groupby("name", sort=False)["error"].mean()
    np.testing.assert_allclose(profile, found["expected_mse"])
    worth = [answers[key].worth["removed_error"].mean() for key in ("", "false")]
    assert worth[0] < worth[1]


def test_told_scenarios_have_their_own_controls_and_agree_with_kalman_filters(
    tmp_path: Path,
) -> None:
    problem = Problem(
        walks.WALK,
        horizon=walks.HORIZON,
        measurement_budget=4,
        particles=400,
        scenarios={"parameters": walks.SCENARIOS, "weights": walks.WEIGHTS, "filter": "told"},
    )
    run = pfdist.compare(problem, times=SETS, results=tmp_path / "run", draws=800, figures=False)
    exact = walks.costs([*SETS.values()], told=True)
    rows = run.table("scenarios").set_index(["name", "scenario"])
    for name, of_scenarios in zip(SETS, exact, strict=True):
        for scenario, mse in enumerate(of_scenarios):
            row = rows.loc[name, scenario]
            assert abs(row["expected_mse"] - mse) < 4 * row["standard_error"]
        controls = run.table("comparison")[f"control_{name}"]
        assert abs(controls.mean()) < 4 * controls.sem()


def test_a_draw_in_which_the_truth_explains_nothing_keeps_its_error_and_is_counted() -> None:
    """Its measurement is left out, as elsewhere, and its control is 0."""

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        return np.where(y[0] > 3.0, -np.inf, -0.5 * (y[0] - x[0]) ** 2)

    model = one_state(
        "blind",
        initial=lambda w, p: (2.0 * w[0],),
        transition=lambda x, t, w, p: (x[0] + 0.5 * w[0],),
        log_likelihood=log_likelihood,
    )
    evaluator = Evaluator(model, 4)
    work = evaluator.work([(1, 3)], 3, 4, (0, 300), Estimation(50), controlled=True)
    y = evaluator.draws(range(300), 4).y[:, [1, 3], 0]
    result = evaluator.filtered(work)
    blind = (y > 3.0).any(axis=1)
    assert 10 < blind.sum() < 290
    np.testing.assert_array_equal(result.degenerate[:, 0], blind)
    np.testing.assert_array_equal(result.control[:, 0] == 0.0, blind)
    assert np.isfinite(result.mse).all()
