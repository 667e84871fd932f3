import numpy as np
import pytest
from scipy.linalg import expm

import pfdist
from oracles.in_turn import in_turn
from oracles.moments import assert_mean
from pfdist import load_job
from pfdist.filters.simulation import simulate
from pfdist.models import load_model

SOURCE = load_model("pharmacokinetics")
DOSE, CLEARANCE, VOLUME, EXCHANGE, PERIPHERAL = 1000.0, 4.5, 20.0, 6.0, 40.0
HOURS = (0, 0.25, 0.5, 1, 1.5, 2, 3, 4, 6, 8, 11, 14, 18, 24, 30, 36, 42, 48)
MODEL = SOURCE.on_clock(HOURS)
TIMES = (2, 5, 9, 13)
SAME = {"clearance_sd": 0.0, "volume_sd": 0.0, "process_sd": 0.2, "measurement_sd": 0.3}


def rates(clearance, volume, exchange=EXCHANGE):
    """The matrix of the linear differential equation of both amounts."""
    to, back = exchange / volume, exchange / PERIPHERAL
    return np.array([[-clearance / volume - to, back], [to, -back]])


@in_turn("clearance", [0.1, 4.5, 90.0])
@in_turn("exchange", [1e-6, 6.0, 500.0])
@in_turn("step", [0.25, 3.0])
def test_a_transition_is_the_exponential_of_the_matrix(clearance, exchange, step):
    model = SOURCE.on_clock((0.0, step)).with_parameters({"exchange": exchange})
    amounts = np.array([300.0, 500.0])
    x = (*amounts, clearance, VOLUME)
    following = model.transition(x, 0, (0.0,), model.p)
    exact = expm(rates(clearance, VOLUME, exchange) * step) @ amounts
    np.testing.assert_allclose(following[:2], exact, rtol=1e-9)
    assert following[2:] == x[2:]


def test_half_of_the_drug_spreads_in_an_hour_and_half_is_gone_after_13_more():
    fast, slow = np.log(2) / -np.sort(np.linalg.eigvalsh(_symmetric(rates(CLEARANCE, VOLUME))))
    assert fast == pytest.approx(1.1, abs=0.05)
    assert slow == pytest.approx(12.7, abs=0.05)


def _symmetric(matrix):  # with the same eigenvalues
    other = np.sqrt(matrix[0, 1] * matrix[1, 0])
    return np.array([[matrix[0, 0], other], [other, matrix[1, 1]]])


def test_patients_differ_by_log_normal_factors():
    first = MODEL.initial((2.0, -1.0), MODEL.p)
    patient = CLEARANCE * np.exp(0.35 * 2), VOLUME * np.exp(-0.25)
    assert first == pytest.approx((DOSE, 0.0, *patient), rel=1e-12)


def test_the_logarithm_of_the_concentration_is_measured_and_wanted():
    x = (50.0, 7.0, 1.0, 10.0)
    assert MODEL.measurement(x, 4, (-2.0,), MODEL.p) == pytest.approx((np.log(5) - 0.3,))
    assert MODEL.quantity_of_interest(x, 4, MODEL.p) == pytest.approx((np.log(5),))


# --- one patient: the logarithm of the concentration is a random walk around a known curve ---


def walk_variances(times):
    """Exact variance of log concentration at each hour, (T+1,): Kalman filter of one state."""
    variance, variances = 0.0, []
    for t, hour in enumerate(HOURS):
        variance += SAME["process_sd"] ** 2 * (hour - HOURS[t - 1]) if t else 0.0
        if t in times:
            variance = 1 / (1 / variance + 1 / SAME["measurement_sd"] ** 2)
        variances.append(variance)
    return np.array(variances)


def test_in_a_known_patient_it_is_a_random_walk_around_the_known_curve():
    patient = MODEL.with_parameters(SAME)
    z = simulate(patient, len(HOURS) - 1, range(100_000), 5).z[:, :, 0]
    for t in (1, 7, 17):
        (central, _) = expm(rates(CLEARANCE, VOLUME) * HOURS[t]) @ [DOSE, 0.0]
        assert_mean(z[:, t] - np.log(central / VOLUME), 0.0)
        assert_mean((z[:, t] - np.log(central / VOLUME)) ** 2, SAME["process_sd"] ** 2 * HOURS[t])


@pytest.mark.slow
def test_the_expected_mse_is_the_kalman_filters_weighted_by_trapezoids(tmp_path):
    # The filter of particles estimates an expected MSE that is known: the integral over 48 h of the
    # variance, by the trapezoidal rule. The mean over instants is another number.
    variances = walk_variances(TIMES)
    exact = np.trapezoid(variances, HOURS) / HOURS[-1]
    path = tmp_path / "walk.toml"
    parameters = ", ".join(f"{name} = {value}" for name, value in SAME.items())
    path.write_text(
        f'seed = 1\n[model]\nname = "pharmacokinetics"\nparameters = {{ {parameters} }}\n'
        f"[problem]\ntimes = {list(HOURS)}\nmeasurement_budget = 4\n"
        "[filter]\nparticles = 2000\n[execution]\npool = 'serial'\n"
    )
    hours = [HOURS[t] for t in TIMES]
    evaluation = pfdist.evaluate(load_job(path), hours, draws=4000)
    assert abs(evaluation.expected_mse - exact) < 4.5 * evaluation.standard_error
    assert abs(variances.mean() - exact) > 20 * evaluation.standard_error


def test_no_sample_is_taken_while_the_patient_sleeps(request):
    # 8 o'clock is hour 0.
    problem = load_job(request.config.rootpath / "jobs" / "pharmacokinetics.toml").problem
    allowed = {problem.clock.times[t] for t in range(problem.clock.horizon + 1)} - {
        problem.clock.times[t] for t in problem.feasible.forbidden
    }
    assert allowed
    assert all(6 < (8 + hour) % 24 < 22 for hour in allowed)
    regular = [problem.clock.times[t] for t in problem.feasible.regular()]
    assert problem.broken(regular) == []
