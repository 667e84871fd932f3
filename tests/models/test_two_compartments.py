"""The drug with an unknown clearance and two assays: matrix exponential, Kalman, brute force."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import pfdist
from oracles.in_turn import in_turn
from oracles.results_of import results_of
from pfdist import load_model
from pfdist.filters import kalman
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.results.stored_run import found_sets

HOURS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 24.0)
MODEL = load_model("two_compartments").on_clock(HOURS)
JOB = "jobs/two_compartments.toml"
MEASURED = ["2 immunoassay", "8 20 chromatography"]
SDS = (2.5, 0.5)


@in_turn("clearance", [0.5, 4.5, 30.0])
@in_turn("t", [0, 4, 6])
def test_a_transition_is_the_exponential_of_the_matrix(clearance: float, t: int) -> None:
    model = MODEL.with_parameters({"clearance": clearance})
    p, step = model.p, HOURS[t + 1] - HOURS[t]
    to, back = p.exchange / p.central_volume, p.exchange / p.peripheral_volume
    matrix = np.array([[-clearance / p.central_volume - to, back], [to, -back]])
    amounts = np.array([300.0, 500.0])
    noise = np.array([0.3, -1.2])
    exact = expm(matrix * step) @ amounts + p.process_sd * np.sqrt(step) * noise
    following = model.transition(tuple(amounts), t, tuple(noise), p)
    np.testing.assert_allclose(following, exact, rtol=1e-9)


def test_the_particle_filter_costs_what_the_kalman_filter_costs() -> None:
    # hour 0.5 by chromatography, hour 1 by both, hour 4 by immunoassay
    times, draws = (3, 4, 5, 8), simulate(MODEL, len(HOURS) - 1, range(3000), 5)
    mse = filter_draws(MODEL, draws, times, 1000, 7).mse
    exact = kalman.expected_mse(MODEL, len(HOURS) - 1, [times])[0]
    # 1,000 particles cost about 1 / 1000 more
    assert abs(mse.mean() / 1.001 - exact) < 4 * mse.std() / np.sqrt(mse.size)


def test_a_wrong_clearance_costs_more_and_the_job_says_so() -> None:
    job = pfdist.load_job(JOB, ["filter.particles=100"])
    told = job.with_changes(["scenarios.filter=told"])
    nominal, known = (pfdist.evaluate(each, MEASURED, draws=240) for each in (job, told))
    apart = nominal.mse - known.mse  # the draws are the same
    assert apart.mean() > 4 * apart.std() / np.sqrt(apart.size)
    assert len(nominal.of_scenarios) == 8


def kalman_of_the_oracle(hours: tuple[float, ...], clearance: float, times: set[int]) -> float:
    """The expected MSE of the concentration, by a matrix exponential for each step."""
    matrix = np.array([[-(clearance + 6.0) / 20, 6 / 40], [6 / 20, -6 / 40]])
    row = np.array([1 / 20, 0.0])
    variance, errors = np.diag([100.0**2, 0.0]), []
    for t, hour in enumerate(hours):
        for sensor, sd in enumerate(SDS):
            if 2 * t + sensor in times:
                seen = variance @ row
                variance = variance - np.outer(seen, seen) / (row @ seen + sd**2)
        errors.append(row @ variance @ row)
        if t + 1 < len(hours):
            step = hours[t + 1] - hour
            move = expm(matrix * step)
            variance = move @ variance @ move.T + 400.0 * step * np.eye(2)
    return float(np.average(errors, weights=trapezoids(hours)))


def trapezoids(hours: tuple[float, ...]) -> np.ndarray:
    steps = np.diff(hours)
    return np.append(steps, 0.0) + np.append(0.0, steps)


@pytest.mark.zoo  # `test_sensors.py` and `test_scenarios.py` plan small models
def test_a_plan_with_both_assays_is_the_optimum_of_brute_force(tmp_path: Path) -> None:
    """All sets that cost 4 or 5, for two clearances that the filter is told."""
    hours, clearances = (0.0, 0.5, 1.0, 3.0, 6.0, 12.0, 24.0), (3.0, 6.0)
    mse = {
        times: np.mean([kalman_of_the_oracle(hours, each, {*times}) for each in clearances])
        for number in range(1, 6)
        for times in combinations(range(14), number)
        if sum(1 + time % 2 for time in times) in (4, 5)
    }
    problem = pfdist.Problem(
        "two_compartments",
        times=hours,
        total_price=5,
        sensors={"immunoassay": {"price": 1}, "chromatography": {"price": 2}},
        scenarios={"parameters": [{"clearance": each} for each in clearances], "filter": "told"},
        engine="kalman",
    )
    run = pfdist.plan(
        problem, results=tmp_path / "run", pool="serial", changes=("comparison.draws=50",),
        figures=False, report=False,
    )  # fmt: skip
    (name,) = found_sets(run)
    best = min(mse, key=mse.__getitem__)
    assays = ("immunoassay", "chromatography")
    assert list(run.sets[name]) == [f"{hours[m // 2]:g} {assays[m % 2]}" for m in best]
    assert results_of(run)[name].bound == pytest.approx(mse[best], rel=1e-9)
    assert pfdist.evaluate(problem, run.sets[name]).expected_mse == pytest.approx(mse[best])
