"""Runs of jobs whose estimates use later measurements."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pfdist
from pfdist.common.streams import stream_of
from pfdist.errors import JobError, ModelError
from pfdist.problem.job import load_job
from pfdist.questions.about_run import problem
from pfdist.questions.subject import Subject
from pfdist.results.stored_run import measured_of
from pfdist.runner.build import build

SMOOTHED = "problem.estimate=smoothed"


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
    z, found = (estimates[f"{each}_0"].to_numpy() for each in ("z", "estimate_random"))
    errors = np.mean(((found - z) ** 2).reshape(-1, 13), axis=1)
    np.testing.assert_allclose(errors, rows["mse_random"][: len(errors)], rtol=1e-12)


def test_the_report_says_which_measurements_an_estimate_uses(run: pfdist.Run) -> None:
    assert "measurements that an estimate uses" in str(problem(Subject(run)))


def test_what_needs_the_filters_estimate_is_one_line(run: pfdist.Run) -> None:
    with pytest.raises(JobError, match=r"^no bound is known for problem.estimate = 'smoothed'$"):
        pfdist.bound(run, 480, pool="serial", figures=False)
    with pytest.raises(JobError, match=r"^budget needs problem.estimate = 'filtered', got .*'smo"):
        pfdist.budget(run.path, measurements=(2, 4))
    with pytest.raises(ModelError, match=r"^online choice of times needs problem.estimate = 'filt"):
        pfdist.Planner(run.path)


def test_a_lag_above_the_horizon_is_the_smoothed_estimate(finished: Callable[..., Path]) -> None:
    times = {"a": [0, 3, 6, 9]}
    job = load_job(finished(SMOOTHED) / "job.toml", ["seed=2"])
    smoothed = pfdist.evaluate(job, times)["a"].mse
    data = job.problem.model_dump(mode="json", exclude_none=True) | {"lag": 20}
    del data["estimate"]
    lagged = pfdist.evaluate(job.with_changes(sections={"problem": data}), times)["a"].mse
    np.testing.assert_array_equal(smoothed, lagged)
