"""The drug with an unknown clearance and two assays: matrix exponential and Kalman."""

import numpy as np
from scipy.linalg import expm

import pfdist
from oracles.in_turn import in_turn
from pfdist import load_model
from pfdist.filters import kalman
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate

HOURS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0, 24.0)
MODEL = load_model("two_compartments").on_clock(HOURS)
JOB = "jobs/two_compartments.toml"
MEASURED = ["2 immunoassay", "8 20 chromatography"]


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
