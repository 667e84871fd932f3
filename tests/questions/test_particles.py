"""How many particles are enough, against the Kalman filter; "auto"; and a filter that collapses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.systems import scalar
from pfdist import Job, StateSpaceModel, linear_gaussian
from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import regular
from pfdist.errors import JobError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.kalman import expected_mse
from pfdist.filters.work import Estimation, FilterWork
from pfdist.plugins.check.model_checks import check_loaded
from pfdist.questions.run_of_job import run_and_job
from pfdist.runner import particles
from pfdist.runner.build import build
from pfdist.runner.particles import (
    NUMBERS,
    enough_particles,
    fewest_lines,
    measured_loss,
    work_of_loss,
)

HORIZON, TIMES = 12, (2, 5, 6, 10)
WALK = ("model.name=random_walk", "filter.particles=auto")


def walk(small_job: Job, *changes: str) -> Job:
    return small_job.with_changes([*WALK, *changes])


@pytest.mark.parametrize("lag", [0, pytest.param(HORIZON, marks=pytest.mark.slow)])
def test_the_number_is_enough_against_the_kalman_filter_and_fewer_are_not(lag: int) -> None:
    """On other draws, and within 4 standard errors; the first figure is right to order 1/P."""
    model = scalar("scalar", 0.95, 0.5, 1.0)
    evaluator = Evaluator(model, HORIZON, lag=lag)
    enough = enough_particles(evaluator, TIMES, 1, Estimation(1))
    exact = expected_mse(model, HORIZON, [TIMES], lag=lag)[0]

    def loss(number: int) -> Estimate:
        work = FilterWork((TIMES,), (HORIZON,), (7,), 3, (0, 16_000), Estimation(number))
        mse = Estimate.of_mean(evaluator(work).mse[:, 0])
        return Estimate(1 - exact / mse.value, mse.standard_error / mse.value)

    assert enough.is_small
    found, fewer = loss(enough.particles), loss(NUMBERS[NUMBERS.index(enough.particles) - 1])
    assert found.value < 0.01 + 4 * found.standard_error
    assert fewer.value > 0.01 - 4 * fewer.standard_error - fewer.value**2


@in_turn(("estimate", "lag"), [("filtered", 0), ("smoothed", HORIZON)])
def test_two_filters_on_the_same_draws_lose_what_the_kalman_filter_does_not(
    small_job: Job, estimate: str, lag: int
) -> None:
    """The loss falls as 1/P, and the effective sample size grows as P."""
    job = walk(small_job, f"problem.estimate={estimate}")
    losses = pfdist.particle_losses(job, (50, 200), TIMES, draws=4000)
    exact = expected_mse(pfdist.load_model("random_walk"), HORIZON, [TIMES], lag=lag)[0]
    true = 1 - exact / losses["expected_mse"]
    error = np.hypot(losses["particle_loss_error"], losses["standard_error"] / exact)
    assert (abs(losses["particle_loss"] - true) < 4 * error + true**2).all()
    assert (losses["particle_loss_limit"] > true - 4 * error).all()
    few, many = losses["particle_loss"]
    assert many == pytest.approx(few / 4, abs=0.1 * few)
    few, many = losses["effective_sample_size"]
    assert many == pytest.approx(4 * few, rel=0.1)


def test_the_fewest_lines_are_counted_where_the_error_counts_and_said(
    small_job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line is left where a hundred measurements follow; with many particles there are more.

    Before the first measurement all instants have the same lines, or more.
    """
    evaluator = Evaluator(pfdist.load_model("random_walk"), 100, lag=100)
    few, many, times = Estimation(10), Estimation(500), regular(100, 101)
    work = work_of_loss(evaluator, times, 1, few, 24)
    said, is_few = fewest_lines(evaluator, work, str)
    assert is_few
    assert said.startswith("Behind the smoothed estimate at t = 0 stand 1.0 of 10 particles: ")
    late = replace(evaluator, weights=(0.0,) * 100 + (1.0,))
    assert "at t = 100 stand 10.0 of 10 " in fewest_lines(late, work, str)[0]
    said, is_few = fewest_lines(evaluator, work_of_loss(evaluator, TIMES, 1, many, 24), str)
    assert not is_few
    assert said.endswith(" that it uses.")
    assert fewest_lines(replace(evaluator, lag=0), work, str) == ("", False)
    monkeypatch.setattr(particles, "NUMBERS", (15, 30))  # how many are enough, others test
    job = small_job.with_changes(["problem.estimate=smoothed", "filter.particles=15"])
    found = pfdist.evaluate(job, TIMES, draws=50)
    assert found.few_lines.endswith("More particles help (filter.particles).")
    checks = pfdist.check_model(job).set_index("check")
    assert "of 15 particles" in checks["text"]["ancestral lines"]


def test_a_filter_that_believes_another_model_loses_what_it_loses_in_its_own_world(
    small_job: Job,
) -> None:
    """The draws come from the filter's model, so the truth does not matter."""
    believed = walk(small_job, "model.parameters.measurement_sd=0.3")
    wrong = walk(small_job, "model.filter.parameters.measurement_sd=0.3")
    tables = [pfdist.particle_losses(job, (40,), draws=50) for job in (believed, wrong)]
    assert tables[0].equals(tables[1])
    assert not tables[0].equals(pfdist.particle_losses(walk(small_job), (40,), draws=50))


def test_a_run_has_the_number_goes_on_with_it_and_answers_questions(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(particles, "_DRAWS", (1000,))  # whether it is enough, others test
    monkeypatch.setattr(particles, "NUMBERS", (1000, 2000))
    job, said = walk(small_job, "comparison.draws=20"), list[str]()
    run = pfdist.run(job, tmp_path / "run", figures=False, say=said.append)
    number = run.job["filter"]["particles"]
    assert number in (1000, 2000)
    assert any(f"{number:,} are enough" in line for line in said)
    assert f"particles = {number}\n" in (tmp_path / "run" / "job.toml").read_text()
    named = job.with_changes([f"filter.particles={number}"])
    assert build(job).job == named
    more = pfdist.run(job, tmp_path / "run", changes=["comparison.draws=30"], figures=False)
    assert more.job["filter"]["particles"] == number
    _, built = run_and_job(job, tmp_path / "run", (), said.append)
    assert built.job.filter.particles == number
    mse = [pfdist.evaluate(each, (0, 4), draws=10).mse for each in (job, named)]
    np.testing.assert_array_equal(*mse)


def test_where_no_number_is_enough_the_job_is_refused_with_both_losses(
    monkeypatch: pytest.MonkeyPatch, small_job: Job
) -> None:
    monkeypatch.setattr(particles, "NUMBERS", (10, 20))
    says = (
        r"filter\.particles must be a number, got 'auto': with up to 20 particles, the particle "
        r"loss is above 1%, or its limit above 5%; with 20 it is at most \d+\.\d\d % of the "
        r"expected MSE \(95 % confidence; estimate \d+\.\d\d %\)\. 1 % .* \(.*small\.toml\)$"
    )
    with pytest.raises(JobError, match=says):
        build(walk(small_job, "model.parameters.measurement_sd=0.001"))
    with pytest.raises(JobError, match="particles = 'auto' needs an engine with particles"):
        build(walk(small_job, "filter.engine=kalman"))


def test_without_a_measurement_there_is_no_effective_sample_size() -> None:
    problem = pfdist.Problem("ungm", horizon=12, measurement_budget=3)
    losses = pfdist.particle_losses(problem, (50,), draws=50, measurement_times=[])
    assert losses["effective_sample_size"].isna().all()


def test_no_loss_is_given_for_an_exact_engine(small_job: Job) -> None:
    job = walk(small_job, "filter.engine=kalman")
    with pytest.raises(
        JobError, match=r"needs an engine with particles, got filter.engine = 'kalman'"
    ):
        pfdist.particle_losses(job)


def _walk_in_four_dimensions(noise: float) -> StateSpaceModel:
    """All four components are measured; 100 particles never meet a sharp sensor."""
    unit = np.eye(4).tolist()
    return linear_gaussian(
        "four",
        transition=unit,
        process_noise=(0.3 * np.eye(4)).tolist(),
        measurement=unit,
        measurement_noise=(noise * np.eye(4)).tolist(),
        quantity_of_interest=unit,
        initial_noise=unit,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "state"), [(0.001, "note"), (0.6, "ok")])
def test_a_sensor_so_sharp_that_the_filter_collapses_is_never_ok(noise: float, state: str) -> None:
    model = replace(_walk_in_four_dimensions(noise), linear_gaussian=False)
    checks = {check.name: check for check in check_loaded(lambda: model, HORIZON, 1000)}
    sizes, loss = checks["effective sample size"], checks["particles"]
    assert (sizes.state, loss.state) == (state, state), (sizes, loss)
    assert ("of 1000 particles after 4 measurements: so few" in sizes.text) == (state == "note")
    assert ("are still too few: they lose" in loss.text) == (state == "note")


@pytest.mark.slow
def test_a_filter_that_fails_rarely_is_not_enough_whatever_few_draws_say() -> None:
    """x' = 1.2 x: on 1,000 draws 1,000 particles lose 0.3 %, at most 4.4 %. The truth is over half.

    The filter loses the system in a few of 10,000 draws, and the error then grows as 1.2^t.
    """
    model = linear_gaussian(
        "unstable",
        transition=[[1.2]],
        process_noise=[[0.5]],
        measurement=[[1.0]],
        measurement_noise=[[0.3]],
        quantity_of_interest=[[1.0]],
        initial_noise=[[1.0]],
    )
    evaluator, times = Evaluator(model, 44), regular(44, 8)
    few = work_of_loss(evaluator, times, 5, Estimation(1000), 1000)
    loss, _ = measured_loss(evaluator, few)
    assert loss.is_small
    assert not loss.rare
    loss, whole = measured_loss(evaluator, replace(few, draws=(0, 16_000)))
    assert 1 - expected_mse(model, 44, [times])[0] / whole.mean > 0.3
    assert loss.rare
    assert not loss.is_small
    assert loss.limit <= 1.0
    enough = enough_particles(evaluator, times, 5, Estimation(1))
    assert enough.rare
    assert not enough.is_small
