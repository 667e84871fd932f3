"""The information of measurements against closed forms, enumeration, and the twin in NumPy.

I(A) = H(y_A) - sum of H(y_t | x_t), in nats.
"""

import math
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

from pfdist import StateSpaceModel, linear_gaussian
from pfdist.common.measurement_times import Times
from pfdist.filters.criteria.information import GAP, LOWER_SIDE, Information
from pfdist.filters.criterion import Sample
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_by_instant, exact_mse
from pfdist.filters.variants import of_information, results
from pfdist.filters.work import Estimation

HORIZON, FACTOR, SPREAD = 12, 0.95, 3.0


def autoregression(noise: float) -> StateSpaceModel:
    return linear_gaussian(
        "autoregression",
        initial_noise=[[SPREAD]],
        transition=[[FACTOR]],
        process_noise=[[1.0]],
        measurement=[[1.0]],
        measurement_noise=[[noise]],
        quantity_of_interest=[[1.0]],
    )


def of_autoregression(times: Times, noise: float) -> float:
    """log det(I + C / R) / 2 with the joint covariance C of x at the measured times."""
    variance = [SPREAD**2]
    for _ in range(HORIZON):
        variance.append(FACTOR**2 * variance[-1] + 1.0)
    joint = [[FACTOR ** abs(s - t) * variance[min(s, t)] for t in times] for s in times]
    return float(np.linalg.slogdet(np.eye(len(times)) + np.array(joint) / noise**2)[1] / 2)


def both_sides(evaluator: Evaluator, times: Times, particles: int, draws: int) -> Sample:
    """Nats of each draw beside the truth, and by how much more without it."""
    below, evidence = (each.estimation(Estimation(particles)) for each in (LOWER_SIDE, GAP))
    work = evaluator.work([times], 5, 6, (0, draws), below)
    informed, told = results(evaluator, [work, replace(work, estimation=evidence, controlled=True)])
    gap = (told.control - told.mse)[:, 0]
    return Sample(np.empty(0), aspects={LOWER_SIDE: -informed.mse[:, 0], GAP: gap})


@pytest.mark.parametrize("noise", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("times", [(3,), (0, 12), (2, 5, 6, 10), (0, 3, 6, 9, 12)])
def test_the_exact_engine_gives_the_determinant_of_the_joint_covariance(
    times: Times, noise: float
) -> None:
    evaluator = Evaluator(autoregression(noise), HORIZON, engine="kalman")
    (lost,) = exact_mse(evaluator, [times], criterion=Information())
    assert -lost == pytest.approx(of_autoregression(times, noise), rel=1e-12)
    errors = exact_by_instant(of_information(evaluator), [times])[0]
    assert np.flatnonzero(errors).tolist() == [*times]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_particles_enclose_the_information_of_a_linear_system(count: int) -> None:
    """Both sides within 3 standard errors; with 500 particles they are close to each other."""
    times = (2, 5, 6, 10, 11)[:count]
    exact = of_autoregression(times, 1.0)
    sample = both_sides(Evaluator(autoregression(1.0), HORIZON), times, 500, 1000)
    error = sample.aspects[LOWER_SIDE].std() / math.sqrt(1000)
    assert sample.aspects[LOWER_SIDE].mean() - 3.0 * error < exact
    gap = sample.aspects[GAP].mean(), sample.aspects[GAP].std() / math.sqrt(1000)
    assert exact < sample.aspects[LOWER_SIDE].mean() + gap[0] + 3.0 * math.hypot(error, gap[1])
    assert 0.0 < gap[0] + 3.0 * gap[1] < 0.1


def test_few_particles_and_a_sharp_sensor_leave_wide_sides() -> None:
    """At most log P a measurement beside the truth; without it there is no limit (collapse)."""
    times, exact = (2, 5, 6, 10), of_autoregression((2, 5, 6, 10), 0.01)
    sample = both_sides(Evaluator(autoregression(0.01), HORIZON), times, 50, 500)
    assert sample.aspects[LOWER_SIDE].max() <= len(times) * math.log(50) + 1e-6
    assert (
        sample.aspects[LOWER_SIDE].mean()
        < exact
        < sample.aspects[LOWER_SIDE].mean() + sample.aspects[GAP].mean()
    )
    assert sample.aspects[GAP].mean() > 10 * exact


@pytest.mark.parametrize("particles", [7, 40])
def test_the_compiled_filter_tells_what_the_twin_tells(particles: int) -> None:
    """To 6 digits: machine code takes logarithms of sums in single precision."""
    compiled, twin = (
        both_sides(Evaluator(autoregression(0.5), HORIZON, engine=engine), (0, 5, 6), particles, 30)
        for engine in ("compiled", "numpy")
    )
    np.testing.assert_allclose(
        compiled.aspects[LOWER_SIDE], twin.aspects[LOWER_SIDE], rtol=2e-6, atol=1e-6
    )
    np.testing.assert_allclose(compiled.aspects[GAP], twin.aspects[GAP], rtol=2e-6, atol=2e-6)


STAY, HIT = 0.8, (0.95, 0.7)  # of a sensor at even and at odd instants


def chain() -> StateSpaceModel:
    """Two states, and a sensor that says yes or no and is sometimes wrong."""

    def hit(t: int) -> float:
        return HIT[t % 2]

    return StateSpaceModel(
        name="chain",
        initial=lambda w, p: (np.where(w[0] < 0.5, 0.0, 1.0),),
        transition=lambda x, t, w, p: (np.where(w[0] < STAY, x[0], 1.0 - x[0]),),
        measurement=lambda x, t, v, p: (np.where(v[0] < hit(t), x[0], 1.0 - x[0]),),
        log_likelihood=lambda y, x, t, p: np.where(
            y[0] == x[0], np.log(hit(t)), np.log(1.0 - hit(t))
        ),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("uniform",),
        process_noise=("uniform",),
        measurement_noise=("uniform",),
    )


def of_chain(times: Times) -> float:
    """The entropy of all answers, less that of the sensor's mistakes, by enumeration."""
    horizon, answers = times[-1], dict[tuple[int, ...], float]()
    for path in product((0, 1), repeat=horizon + 1):
        steps = [STAY if a == b else 1.0 - STAY for a, b in pairwise(path)]
        for said in product((0, 1), repeat=len(times)):
            right = [
                HIT[t % 2] if path[t] == y else 1.0 - HIT[t % 2]
                for t, y in zip(times, said, strict=True)
            ]
            answers[said] = answers.get(said, 0.0) + 0.5 * math.prod(steps) * math.prod(right)
    entropy = -sum(each * math.log(each) for each in answers.values())
    mistakes = (-sum(q * math.log(q) for q in (HIT[t % 2], 1.0 - HIT[t % 2])) for t in times)
    return entropy - sum(mistakes)


@pytest.mark.parametrize("times", [(0,), (1, 2), (0, 3, 4), (1, 2, 4, 6)])
def test_particles_enclose_the_information_of_a_chain(times: Times) -> None:
    exact, draws = of_chain(times), 2000
    sample = both_sides(Evaluator(chain(), 6), times, 400, draws)
    error = sample.aspects[LOWER_SIDE].std() / math.sqrt(draws)
    gap = sample.aspects[GAP].mean(), sample.aspects[GAP].std() / math.sqrt(draws)
    assert sample.aspects[LOWER_SIDE].mean() - 3.0 * error < exact
    assert exact < sample.aspects[LOWER_SIDE].mean() + gap[0] + 3.0 * math.hypot(error, gap[1])
    assert sample.aspects[LOWER_SIDE].mean() == pytest.approx(exact, abs=3.0 * error + 0.01)
