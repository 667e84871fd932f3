"""Draws and filters that start from particles of x(s) in the place of `initial`."""

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from scipy import stats

import oracles.kalman
import oracles.modes
from oracles.in_turn import in_turn
from pfdist import StateSpaceModel
from pfdist.errors import MeasurementTimesError, PriorError
from pfdist.filters import kalman, particle_filter, plain, simulation
from pfdist.filters.cloud import Cloud, Gaussian
from pfdist.filters.draws import Draws
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation

HORIZON, TIMES = 20, (0, 3, 6, 9, 12, 15, 18)
ENGINES = {"compiled": particle_filter, "numpy": plain}


def from_instant(draws: Draws, start: int) -> Draws:
    """The same draws without their instants before the start."""
    later = slice(start, None)
    return replace(
        draws, x=draws.x[:, later], y=draws.y[:, later], z=draws.z[:, later], start=start
    )


@pytest.mark.parametrize("start", [0, 4, 9, 20])
@pytest.mark.parametrize("resampling", ["multinomial", "systematic"])
@in_turn("engine", ENGINES.values())
def test_a_filter_that_stops_and_goes_on_is_the_filter_that_never_stopped(
    ungm: StateSpaceModel, engine: ModuleType, resampling: str, start: int
) -> None:
    draws = simulate(ungm, HORIZON, range(3), 7)
    settings = {"particles": 100, "stream": 9, "resampling": resampling, "trajectories": True}
    whole = engine.filter_draws(ungm, draws, TIMES, **settings)
    before = tuple(t for t in TIMES if t <= start)
    for d in range(3):
        draw = draws[d : d + 1]
        stopped = engine.filter_draws(ungm, draw.upto(start), before, **settings)
        later, prior = TIMES[len(before) :], Cloud(start, stopped.cloud[0])
        on = engine.filter_draws(ungm, from_instant(draw, start), later, **settings, prior=prior)
        np.testing.assert_array_equal(on.estimate[0, 1:], whole.estimate[d, start + 1 :])
        np.testing.assert_array_equal(on.variance[0, 1:], whole.variance[d, start + 1 :])
        np.testing.assert_array_equal(on.cloud[0], whole.cloud[d])


@pytest.mark.parametrize("weighted", [False, True])
def test_compiled_and_plain_start_alike(ungm: StateSpaceModel, weighted: bool) -> None:
    rng = np.random.default_rng(1)
    weight = rng.uniform(size=300) if weighted else None
    prior = Cloud(8, rng.normal(0, 10, (1, 300)), weight)
    found = []
    for simulated_by, engine in ((simulation, particle_filter), (plain, plain)):
        draws = simulated_by.simulate(ungm, HORIZON, range(40), 3, prior)
        filtered = engine.filter_draws(ungm, draws, (8, 11, 17), 64, 4, prior=prior)
        found.append((draws.x, draws.y, draws.z, filtered.mse))
    for by_compiled, by_plain in zip(*found, strict=True):
        np.testing.assert_allclose(by_compiled, by_plain, rtol=1e-9)


def test_several_sets_share_prefixes_as_without_a_prior(ungm: StateSpaceModel) -> None:
    prior = Cloud(8, np.random.default_rng(1).normal(0, 10, (1, 300)))
    evaluator, estimation = Evaluator(ungm, HORIZON, prior=prior), Estimation(64, "systematic")
    draws, sets = evaluator.draws(range(20), 3), [(8, 11), (9, 11, 17), (9, 12, 17), ()]
    together = evaluator.filter_sets(draws, sets, [20, 20, 19, 14], 5, estimation)[0]
    for column, times, end in zip(together.T, sets, [20, 20, 19, 14], strict=True):
        alone = evaluator.filter_sets(draws, [times], [end], 5, estimation)[0][:, 0]
        np.testing.assert_array_equal(column, alone)


def test_the_two_filters_of_an_estimator_start_from_particles_of_their_own(
    ungm: StateSpaceModel,
) -> None:
    """Their distance is to show how much the particles vary, so it must not be that of twins."""
    prior = Cloud(8, np.random.default_rng(1).normal(0, 10, (1, 200)))
    estimation, found = Estimation(40, "systematic", "filter_noise"), []
    for engine in ENGINES:
        evaluator = Evaluator(ungm, HORIZON, engine=engine, prior=prior)
        draws = evaluator.draws(range(20), 3)
        found.append(evaluator.filter_sets(draws, [(11,)], [HORIZON], 5, estimation)[0])
    np.testing.assert_allclose(*found, rtol=1e-9)


def test_a_draw_starts_as_a_particle_with_the_probability_of_its_weight() -> None:
    weight, count = np.array([1.0, 0.0, 2.0, 5.0]), 8000
    cloud = Cloud(3, np.arange(4.0)[None], weight)
    for prior in (cloud, Cloud(3, np.full((1, 7), 9.0), truths=cloud)):
        found = np.bincount(prior.starts(range(count), 1)[0].astype(int), minlength=4)
        assert found[1] == 0
        p = stats.chisquare(found[[0, 2, 3]], count * np.array([1, 2, 5]) / 8).pvalue
        assert p > 1e-4


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("weight", [None, np.array([3.0, 1.0])])
def test_particles_that_are_given_are_the_distribution_itself(
    engine: str, weight: np.ndarray | None
) -> None:
    """A coin that is never measured: the error of the best estimate is q (1 - q)."""
    coin = oracles.modes.model(switch=0.0, sd=1.0)
    evaluator = Evaluator(coin, 1, engine=engine, prior=Cloud(0, np.array([[0.0, 1.0]]), weight))
    draws, settings = evaluator.draws(range(4000), 3), Estimation(400, "systematic")
    mse = evaluator.filter_sets(draws, [()], [1], 5, settings)[0][:, 0]
    q = 0.5 if weight is None else 0.25
    assert abs(mse.mean() - q * (1 - q)) < 4 * max(mse.std() / np.sqrt(mse.size), 1e-12)


def test_the_kalman_filter_goes_on_from_its_normal_distribution() -> None:
    model = oracles.kalman.TRACKING.as_model()
    draws = simulate(model, HORIZON, range(4), 7)
    whole = kalman.filter_draws(model, draws, TIMES, 1, 1, trajectories=True)
    stopped = kalman.filter_draws(model, draws.upto(9), TIMES[:4], 1, 1, trajectories=True)
    rest, settings = from_instant(draws, 9), {"particles": 1, "stream": 1, "trajectories": True}
    priors = [Gaussian(9, last[:, 0], last[:, 1:]) for last in stopped.cloud]
    for d, prior in enumerate(priors):
        on = kalman.filter_draws(model, rest[d : d + 1], TIMES[4:], **settings, prior=prior)
        np.testing.assert_allclose(on.estimate[0], whole.estimate[d, 9:], rtol=1e-12)
        np.testing.assert_allclose(on.variance[0], whole.variance[d, 9:], rtol=1e-12)
    errors = kalman.expected_errors(model, HORIZON, [TIMES])[0, 9:]
    on = kalman.expected_errors(model, HORIZON, [TIMES[4:]], priors[0])[0]
    np.testing.assert_allclose(on, errors, rtol=1e-12)


def test_the_kalman_filter_starts_from_the_moments_of_particles() -> None:
    model = oracles.kalman.SCALAR.as_model()
    prior = Cloud(2, np.array([[1.0, 4.0]]), np.array([2.0, 1.0]))
    assert prior.gaussian.mean == pytest.approx([2.0])
    assert prior.gaussian.covariance == pytest.approx(np.array([[2.0]]))
    (error,) = kalman.expected_errors(model, 2, [()], prior)
    (same,) = kalman.expected_errors(model, 2, [()], Gaussian(2, np.ones(1), np.array([[2.0]])))
    assert error == pytest.approx(same)


@pytest.mark.parametrize(
    ("x", "weight", "message"),
    [
        (np.ones(3), None, r"an array x \(components, particles\)"),
        (np.ones((1, 0)), None, "one particle or more"),
        (np.array([[1.0, np.nan]]), None, r"finite states, got x\[0\] = nan of particle 1"),
        (np.ones((1, 2)), np.ones(3), "one weight for each of its 2 particles"),
        (np.ones((1, 2)), np.array([1.0, -2.0]), "at least 0, and not all 0, got array"),
        (np.ones((1, 2)), np.zeros(2), "at least 0, and not all 0, got array"),
    ],
)
def test_wrong_particles_are_refused(
    x: np.ndarray, weight: np.ndarray | None, message: str
) -> None:
    with pytest.raises(PriorError, match=message):
        Cloud(0, x, weight)


def test_a_prior_that_does_not_fit_is_refused(ungm: StateSpaceModel) -> None:
    with pytest.raises(PriorError, match=r"components of x as the model ungm, 1, got 2"):
        simulate(ungm, 5, range(1), 1, Cloud(2, np.ones((2, 3))))
    with pytest.raises(PriorError, match=r"an instant in 0..5, got 6"):
        simulate(ungm, 5, range(1), 1, Cloud(6, np.ones((1, 3))))
    with pytest.raises(PriorError, match="got a normal distribution"):
        Evaluator(ungm, 5, prior=Gaussian(2, np.ones(1), np.eye(1)))
    draws = simulate(ungm, 5, range(1), 1, Cloud(2, np.ones((1, 3))))
    with pytest.raises(PriorError, match="first instant of its draws, 2, got a prior for 0"):
        particle_filter.filter_draws(ungm, draws, (3,), 10, 1)
    with pytest.raises(MeasurementTimesError, match=r"must lie in 2..5, got 1"):
        particle_filter.filter_draws(ungm, draws, (1,), 10, 1, prior=Cloud(2, np.ones((1, 3))))
