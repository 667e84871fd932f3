"""A filter of real measurements: the batch filter's bits, the exact filter, surprise, errors."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import oracles.kalman
from oracles.in_turn import in_turn
from pfdist import Cloud, Filter, StateSpaceModel, densities, load_model
from pfdist.errors import ArgumentError, MeasurementsError, ModelError, PfdistWarning, PriorError
from pfdist.filters.cloud import Gaussian
from pfdist.filters.draws import Draws
from pfdist.filters.engines import ENGINES
from pfdist.filters.filter_estimate import FEW, PREDICTIVE, Particles
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import FilterArrays
from pfdist.runner.filter import SUSPICIOUS

# Few particles are wanted here: they are quick, and right or wrong as many are.
pytestmark = pytest.mark.filterwarnings("ignore:The estimate is that of a few particles")
HORIZON, TIMES = 20, (0, 3, 4, 9, 12, 18)
LEVELS = (0.05, 0.5, 0.9)
HALF_LOG_2_PI = math.log(2 * math.pi) / 2
LARGEST_Z = 4.0  # standard errors
JAX = [pytest.mark.slow, pytest.mark.needs("jax")]  # it compiles every filter for seconds
EACH = [pytest.param(engine, marks=JAX * (engine == "jax")) for engine in ENGINES]
NOT_COMPILED = [each for each in EACH if each.values != ("compiled",)]  # it equals NumPy's

SENSORS = StateSpaceModel(  # two sensors of a random walk, either of which may fail
    name="sensors",
    initial=lambda w, p: (2 * w[0],),
    transition=lambda x, t, w, p: (x[0] + 0.5 * w[0],),
    measurement=lambda x, t, v, p: (x[0] + v[0], x[0] + 2 * v[1]),
    log_likelihood=lambda y, x, t, p: (
        np.where(np.isnan(y[0]), 0.0, -0.5 * (y[0] - x[0]) ** 2 - HALF_LOG_2_PI)
        + np.where(
            np.isnan(y[1]), 0.0, -0.5 * ((y[1] - x[0]) / 2) ** 2 - HALF_LOG_2_PI - math.log(2)
        )
    ),
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal", "normal"),
    linear_gaussian=True,
    normalised=True,
    missing_components=True,
)
FIRST_SENSOR = replace(
    SENSORS,
    name="first sensor",
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2 - HALF_LOG_2_PI,
    measurement_noise=("normal",),
)
COIN = replace(
    FIRST_SENSOR,
    name="coin",
    measurement=lambda x, t, v, p: (np.where(v[0] < 1 / (1 + np.exp(-x[0])), 1.0, 0.0),),
    log_likelihood=lambda y, x, t, p: -np.log1p(np.exp(np.where(y[0] > 0.5, -x[0], x[0]))),
    measurement_noise=("uniform",),
    linear_gaussian=False,
)


def _batch(
    engine: str, model: StateSpaceModel, draws: Draws, stream: int, settings: Estimation
) -> list[tuple[Any, Any, Any]]:
    """Filter all draws at once: estimate, variance and last particles of each."""
    times = tuple(t for t in TIMES if t in draws.instants)
    filtered: FilterArrays = ENGINES[engine].filters.filter_checked_draws(
        model, draws, times, stream, settings, trajectories=True
    )
    return list(zip(filtered.estimate, filtered.variance, filtered.cloud, strict=True))


def _model_of(engine: str, ungm: StateSpaceModel) -> StateSpaceModel:
    return oracles.kalman.TRACKING.as_model() if engine == "kalman" else ungm


def _check_equal(
    filtering: Filter, draws: Draws, batch: tuple[Any, Any, Any], draw: int, instants: range
) -> None:
    """Filter a draw from one instant to the next, and compare every estimate bit for bit."""
    for t in instants:
        estimate = filtering.update(t, draws.y[draw, t]) if t in TIMES else filtering.predict(t)
        assert (estimate.t, estimate.measured) == (t, t in TIMES)
        np.testing.assert_array_equal(estimate.mean, batch[0][t])
        np.testing.assert_array_equal(estimate.standard_deviation, np.sqrt(batch[1][t]))


@pytest.mark.parametrize("engine", EACH)
@pytest.mark.parametrize("resampling", ["systematic", "multinomial"])
def test_it_equals_the_batch_filter_draw_for_draw(
    ungm: StateSpaceModel, engine: str, resampling: str
) -> None:
    model = _model_of(engine, ungm)
    draws = simulate(model, HORIZON, range(3), 7)
    stream = Filter(model, seed=5, engine=engine).stream
    batch = _batch(engine, model, draws, stream, Estimation(100, resampling))
    for d in range(3):
        filtering = Filter(model, 100, 5, resampling=resampling, engine=engine, draw=d)
        _check_equal(filtering, draws, batch[d], d, range(HORIZON + 1))


@pytest.mark.parametrize("engine", NOT_COMPILED)
def test_to_start_from_the_batch_filters_cloud_and_go_on_is_never_to_have_stopped(
    ungm: StateSpaceModel, engine: str
) -> None:
    model, settings = _model_of(engine, ungm), Estimation(100, "systematic")
    draws = simulate(model, HORIZON, range(3), 7)
    stream = Filter(model, seed=5, engine=engine).stream
    whole = _batch(engine, model, draws, stream, settings)
    for s in (4, 6):  # measured, and not measured
        stopped = _batch(engine, model, draws.upto(s), stream, settings)
        for d in range(3):
            last = stopped[d][2]
            is_exact = engine == "kalman"
            prior = Gaussian(s, last[:, 0], last[:, 1:]) if is_exact else Cloud(s, last)
            filtering = Filter(model, 100, 5, engine=engine, prior=prior, draw=d)
            _check_equal(filtering, draws, whole[d], d, range(s + 1, HORIZON + 1))
            first = Filter(model, 100, 5, engine=engine, draw=d)
            for t in [t for t in TIMES if t <= s]:
                first.update(t, draws.y[d, t])
            if s not in TIMES:
                first.update(s, np.full(model.components[1], np.nan))
            assert first.cloud.t == s
            again = Filter(model, 100, 5, engine=engine, prior=first.cloud, draw=d)
            _check_equal(again, draws, whole[d], d, range(s + 1, HORIZON + 1))


def _within(found: Any, exact: Any) -> None:
    """Refuse means over seeds that are more than some standard errors away from the exact value."""
    found = np.asarray(found)
    error = found.std(axis=0, ddof=1) / math.sqrt(len(found))
    np.testing.assert_array_less(np.abs(found.mean(axis=0) - exact), LARGEST_Z * error)
    assert (error > 0).all()


def _evidence(filtering: Filter) -> float:
    assert filtering.log_evidence is not None
    return filtering.log_evidence


def test_it_is_the_exact_filter_within_monte_carlo_error() -> None:
    draws = simulate(SENSORS, HORIZON, range(1), 3)
    exact = Filter(SENSORS, engine="kalman")
    # The bias of order 1/P must be small against the standard error over the seeds, 1/sqrt(P S).
    particles, seeds = 2000, 25
    filters = [Filter(SENSORS, particles, seed) for seed in range(seeds)]
    for t in TIMES:
        known = exact.update(t, draws.y[0, t])
        estimates = [filtering.update(t, draws.y[0, t]) for filtering in filters]
        _within([estimate.mean for estimate in estimates], known.mean)
        _within([estimate.standard_deviation for estimate in estimates], known.standard_deviation)
        _within([estimate.quantiles(LEVELS) for estimate in estimates], known.quantiles(LEVELS))
        # This ratio is an unbiased estimate of 1.
        ratios = [math.exp(_evidence(filtering) - _evidence(exact)) for filtering in filters]
        _within(ratios, 1.0)
        sizes = [estimate.effective_sample_size for estimate in estimates]
        assert all(size is not None and 1 < size < particles for size in sizes)
    assert known.effective_sample_size is None


@in_turn("engine", ["compiled", "numpy"])
@in_turn("lag", [None, 2])
def test_smoothed_estimates_are_those_of_the_batch_filter_and_of_its_lines(
    ungm: StateSpaceModel, engine: str, lag: int | None
) -> None:
    """Moments are those of the weighted lines; a filter in the middle gives them, too."""
    draws = simulate(ungm, HORIZON, range(2), 7)
    filtering = Filter(ungm, 100, 5, engine=engine, draw=1)
    for t in TIMES[:-1]:
        filtering.update(t, draws.y[1, t])
    before = filtering.smoothed()
    assert [each.t for each in before] == list(range(TIMES[-2] + 1))
    filtering.update(TIMES[-1], draws.y[1, TIMES[-1]])
    settings = Estimation(100, "systematic", lag=lag or HORIZON)
    batch = ENGINES[engine].filters.filter_checked_draws(
        ungm, draws, TIMES, filtering.stream, settings, True
    )
    found = filtering.smoothed(HORIZON, lag)
    for t, each in enumerate(found):
        assert (each.t, each.measured, each.surprise) == (t, t in TIMES, None)
        np.testing.assert_allclose(each.mean, batch.estimate[1, t], rtol=1e-9)
        belief = each._belief
        assert isinstance(belief, Particles)
        share = belief.weight / belief.weight.sum()
        held = belief.z[0, share > 0]
        assert each.mean == pytest.approx(held @ share[share > 0], rel=1e-12)
        spread = np.average((held - each.mean) ** 2, weights=share[share > 0])
        assert each.standard_deviation == pytest.approx(math.sqrt(spread), rel=1e-9)
        if not np.isnan(batch.lines[1, t]):
            assert held.size == batch.lines[1, t]
    last = filtering.predict(HORIZON)
    assert found[-1].mean == pytest.approx(last.mean, rel=1e-9)
    assert found[-1].quantiles(0.05) == pytest.approx(last.quantiles(0.05), rel=1e-9)


def test_a_smoothed_estimate_is_that_of_rauch_tung_and_striebel() -> None:
    """Means, deviations and quantiles given all measurements, within Monte Carlo error."""
    draws, times = simulate(SENSORS, 6, range(1), 3), (1, 2, 5)
    exact, filters = Filter(SENSORS, engine="kalman"), [Filter(SENSORS, 2000, s) for s in range(25)]
    for filtering in (exact, *filters):
        for t in times:
            filtering.update(t, draws.y[0, t])
    instants = np.arange(7)
    walk = 4 + 0.25 * np.minimum(*np.meshgrid(instants, instants))  # covariance of x
    own = walk[:, times].repeat(2, axis=1)  # with y, which has two components
    noise = np.diag([1.0, 4.0] * len(times))
    gain = own @ np.linalg.inv(own[list(times)].repeat(2, axis=0) + noise)
    mean, sd = gain @ draws.y[0, times].ravel(), np.sqrt(np.diag(walk - gain @ own.T))
    quantiles = mean + sd * stats.norm.ppf(LEVELS)[:, None]
    known, found = exact.smoothed(6), [each.smoothed(6) for each in filters]
    for t in instants:
        np.testing.assert_allclose(known[t].mean, mean[t], rtol=1e-9)
        np.testing.assert_allclose(known[t].standard_deviation, sd[t], rtol=1e-9)
        np.testing.assert_allclose(known[t].quantiles(LEVELS)[:, 0], quantiles[:, t], rtol=1e-9)
        _within([each[t].mean[0] for each in found], mean[t])
        _within([each[t].standard_deviation[0] for each in found], sd[t])
        _within([each[t].quantiles(LEVELS)[:, 0] for each in found], quantiles[:, t])


def test_what_cannot_be_smoothed_is_one_line(ungm: StateSpaceModel) -> None:
    with pytest.raises(ArgumentError, match=r"^lag must be at least 1, got 0$"):
        Filter(ungm).smoothed(lag=0)
    with pytest.raises(ArgumentError, match=r"^the estimate of 100,000 particles .* 103 instants"):
        Filter(ungm, 100_000).smoothed(300)


def test_the_exact_evidence_is_the_density_of_all_measurements_together() -> None:
    draws, times = simulate(SENSORS, 6, range(1), 4), (1, 2, 5)
    exact = Filter(SENSORS, engine="kalman")
    for t in times:
        exact.update(t, draws.y[0, t])
    walk = [[4 + 0.25 * min(t, s) for t in times] for s in times]  # covariance of x
    covariance = np.kron(walk, np.ones((2, 2))) + np.diag([1.0, 4.0] * len(times))
    density = stats.multivariate_normal(cov=covariance).logpdf(draws.y[0, times].ravel())
    assert exact.log_evidence == pytest.approx(density, rel=1e-10)


def test_a_prediction_does_not_move_the_filter(ungm: StateSpaceModel) -> None:
    y = simulate(ungm, HORIZON, range(1), 7).y[0, :, 0]
    quiet, asked = Filter(ungm, 80), Filter(ungm, 80)
    for t in TIMES:
        estimate = quiet.update(t, y[t])
        for later in (HORIZON, t + 1, t):
            asked.predict(max(later, asked.now.t))
        same = asked.update(t, y[t])
        assert asked.now is same
        np.testing.assert_array_equal(same.quantiles(LEVELS), estimate.quantiles(LEVELS))
        assert same.surprise == estimate.surprise
        assert same.effective_sample_size == estimate.effective_sample_size
        before = asked.predict(t)
        assert before is same
        assert asked.predict(t + 1).surprise is None
        assert asked.predict(t + 1).effective_sample_size == 80.0
        assert asked.now is same


@pytest.mark.parametrize("engine", NOT_COMPILED)
def test_a_component_that_is_missing_is_as_if_there_were_no_such_sensor(engine: str) -> None:
    y = simulate(SENSORS, HORIZON, range(1), 7).y[0]
    both, alone = (Filter(model, 60, engine=engine) for model in (SENSORS, FIRST_SENSOR))
    for t in TIMES:
        estimate, expected = both.update(t, [y[t, 0], np.nan]), alone.update(t, y[t, 0])
        np.testing.assert_allclose(estimate.mean, expected.mean, rtol=1e-12)
        np.testing.assert_allclose(
            estimate.quantiles(LEVELS), expected.quantiles(LEVELS), rtol=1e-12
        )
        assert estimate.surprise == pytest.approx(expected.surprise, abs=2 / PREDICTIVE)  # ties
    assert both.log_evidence == pytest.approx(alone.log_evidence, rel=1e-9)


def test_a_time_without_any_component_is_not_measured(ungm: StateSpaceModel) -> None:
    y = simulate(ungm, HORIZON, range(1), 7).y[0, :, 0]
    whole, skipping = Filter(ungm, 60), Filter(ungm, 60)
    for t in range(HORIZON + 1):
        if t not in TIMES:
            estimate = skipping.update(t, np.nan)
            assert (estimate.measured, estimate.surprise) == (False, None)
            continue
        filtering, other = whole.update(t, y[t]), skipping.update(t, [y[t]])
        np.testing.assert_array_equal(filtering.mean, other.mean)
    assert skipping.now.t == HORIZON
    assert skipping.update(HORIZON, 0.5).measured  # it was not measured yet


# --- surprise -------------------------------------------------------------------------------------


def _surprises(believed: StateSpaceModel, truth: StateSpaceModel, engine: str) -> Any:
    draws = simulate(truth, HORIZON, range(25), 11)
    found = []
    for d in range(25):
        filtering = Filter(believed, 400, engine=engine, draw=d)
        found += [filtering.update(t, draws.y[d, t]).surprise for t in TIMES]
    return np.array(found)


@pytest.mark.parametrize(
    ("model", "engine"),
    [
        (load_model("ungm"), "compiled"),
        (FIRST_SENSOR, "kalman"),
        pytest.param(COIN, "compiled", marks=pytest.mark.slow),
    ],
    ids=["ungm", "kalman", "coin"],
)
def test_the_surprise_is_uniform_if_the_model_is_right(model: Any, engine: str) -> None:
    found = _surprises(model, model, engine)
    assert stats.kstest(found, "uniform").pvalue > 0.001


def test_two_components_are_no_more_surprising_than_they_should_be() -> None:
    found = _surprises(SENSORS, SENSORS, "compiled")
    below = np.mean(found < 0.1)
    assert below < 0.1 + LARGEST_Z * math.sqrt(0.09 / found.size)
    assert below > 0.03  # twice the smaller of two: not far below, as errors are correlated


def test_a_wrong_model_surprises(ungm: StateSpaceModel) -> None:
    quieter = ungm.with_parameters({"measurement_sd": 0.3})
    found = _surprises(quieter, ungm, "compiled")
    assert stats.kstest(found, "uniform").pvalue < 1e-9
    filtering = Filter(ungm, 50)
    beyond_all = filtering.update(0, 1e4).surprise
    assert beyond_all is not None
    assert 0 < beyond_all < 2 / PREDICTIVE


def test_an_update_does_not_fail_because_one_of_many_states_overflows() -> None:
    overflowing = replace(
        FIRST_SENSOR,  # beyond 3.9 lie 10 of 200,000 standard normal variates
        transition=lambda x, t, w, p: (np.where(w[0] > 3.9, np.inf, x[0] + 0.5 * w[0]),),
    )
    filtering = Filter(overflowing, 50, engine="numpy")
    for t in (3, 4):
        surprise = filtering.update(t, 30.0 * t).surprise
        assert surprise is not None
        assert 0 < surprise < SUSPICIOUS


# --- few particles ----------------------------------------------------------------------------


def test_a_filter_that_collapses_says_so_ever_after() -> None:
    walk, exact = Filter("random_walk", 500, seed=1), Filter("random_walk", engine="kalman")
    assert walk.update(0, 0.3).collapsed is None
    with pytest.warns(
        PfdistWarning, match=r"few particles, not the .* below 5 at t = 3, .*\. What m"
    ):
        few = walk.update(3, 60.0)
    assert (few.collapsed, walk.predict(5).collapsed) == (3, 3)
    later = walk.update(6, 9.0)  # no second warning, although the size is large again
    assert later.effective_sample_size > FEW
    assert (later.collapsed, walk.update(7, math.nan).collapsed) == (3, 3)
    for t, y in ((0, 0.3), (3, 60.0), (6, 9.0)):
        assert exact.update(t, y).collapsed is None


# --- the prior ------------------------------------------------------------------------------------


def test_an_array_is_particles_of_the_first_instant() -> None:
    x = np.random.default_rng(0).normal(7, 1, 400)
    by_array, by_cloud = (
        Filter("random_walk", 400, prior=x),
        Filter("random_walk", 400, prior=Cloud(0, x[None])),
    )
    assert by_array.now.t == 0
    np.testing.assert_array_equal(by_array.now.mean, [x.mean()])
    np.testing.assert_array_equal(by_array.update(3, 6.0).mean, by_cloud.update(3, 6.0).mean)


# --- errors ---------------------------------------------------------------------------------------


@in_turn(
    ("t", "y", "words"),
    [
        (1.5, 0.0, r"^t must be an integer, got 1\.5: .* model\.on_clock\(times\) has their times"),
        (True, 0.0, "^t must be an integer, got True$"),
        (31, 0.0, r"^t must lie in 0\.\.30, got 31$"),
        (4, 0.0, "the order of time, each instant once: t must be after 4, got 4$"),
        (5, [1.0, 2.0], r"as many numbers as y of the model ungm, 1, got \[1.0, 2.0\] at t = 5$"),
        (5, math.inf, r"must be finite, or NaN .*, got y\[0\] = inf at t = 5$"),
        (5, "high", "got 'high' at t = 5$"),
    ],
)
def test_a_wrong_measurement_is_named_and_the_filter_stays(
    ungm: StateSpaceModel, t: Any, y: Any, words: str
) -> None:
    filtering = Filter(ungm, 20, horizon=30)
    before = filtering.update(4, 1.0)
    with pytest.raises(MeasurementsError, match=words):
        filtering.update(t, y)
    assert filtering.now is before
    with pytest.raises(MeasurementsError, match=r"^t must not be before 4, got 3$"):
        filtering.predict(3)


@pytest.mark.parametrize("engine", EACH)
def test_a_missing_component_needs_the_models_word(engine: str) -> None:
    silent = replace(SENSORS, missing_components=False)
    words = r"all .* or none, got y\[1\] missing at t = 2: the model sensors does not declare"
    with pytest.raises(MeasurementsError, match=words):
        Filter(silent, 20, engine=engine).update(2, [1.0, np.nan])
    assert not Filter(silent, 20, engine=engine).update(2, [np.nan, np.nan]).measured


def _walk(**formulas: Any) -> StateSpaceModel:
    return replace(load_model("random_walk"), linear_gaussian=False, **formulas)


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
def test_a_measurement_that_no_particle_explains_is_named_with_the_reason(engine: str) -> None:
    """More particles do not help where the likelihood is 0 for all, nor where it is NaN."""

    def refused(value: float, **formulas: Any) -> str:
        with pytest.raises(MeasurementsError) as error:
            Filter(_walk(**formulas), 20, engine=engine).update(3, value)
        return str(error.value)

    def bounded(y: Any, x: Any, t: Any, p: Any) -> Any:
        return np.where(np.abs(y[0] - x[0]) < 1, 0.0, -np.inf)

    excluded = "its likelihood is 0 for every particle, so the model excludes it"
    assert refused(1e6, log_likelihood=bounded) == (
        f"no particle of 20 explains the measurement [1000000.0] at t = 3: {excluded}"
    )
    for value, name in ((np.nan, "NaN"), *([(np.inf, "infinity")] if engine == "numpy" else [])):
        told = refused(2.5, log_likelihood=lambda y, x, t, p, value=value: 0 * x[0] + value)
        assert (
            told == f"log_likelihood of random_walk must be a number, got {name} for [2.5] at t = 3"
        )


def test_a_formula_that_gives_nan_is_named_with_the_instant() -> None:
    def at_2(value: float) -> Any:
        """A term that is this value at t = 2, and 0 elsewhere."""
        return lambda t: np.where(np.equal(t, 2), value, 0.0)

    def refused(**formulas: Any) -> str:
        with pytest.raises(MeasurementsError) as error:
            Filter(_walk(**formulas), 20, engine="numpy").update(5, 0.0)
        return str(error.value)

    nan, large = at_2(np.nan), at_2(1e300)
    cases = {
        "transition must stay finite, got NaN at t = 3": {
            "transition": lambda x, t, w, p: (x[0] + w[0] + nan(t),)
        },
        "quantity_of_interest must stay finite, got NaN at t = 2": {
            "quantity_of_interest": lambda x, t, p: (x[0] + nan(t),)
        },
        "quantity_of_interest must stay finite, got too large a value at t = 2": {
            "quantity_of_interest": lambda x, t, p: (x[0] + large(t),)
        },
    }
    for told, formulas in cases.items():
        assert refused(**formulas) == f"{told} (model random_walk)"


@in_turn(
    ("arguments", "error", "words"),
    [
        ({"particles": 0}, ValueError, "particles must be at least 1, got 0"),
        ({"engine": "gpu"}, ValueError, "engine must be 'auto', 'compiled', .* got 'gpu'"),
        ({"engine": "kalman"}, ModelError, "linear_gaussian=True, got ungm"),
        ({"model": 3}, ModelError, "a model must be a StateSpaceModel, a name, or a job, got 3"),
        ({"prior": np.ones((2, 5))}, PriorError, "as many components of x .* ungm, 1, got 2"),
        ({"prior": "mine"}, PriorError, "a Cloud, a DataFrame or an array .*, got 'mine'"),
        ({"prior": Cloud(7, np.ones((1, 5))), "horizon": 6}, PriorError, r"in 0\.\.6, got 7"),
    ],
)
def test_a_wrong_setting_is_named(
    arguments: dict[str, Any], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        Filter(**{"model": "ungm", "particles": 20} | arguments)


@pytest.mark.parametrize("levels", [0.0, 1.0, [0.5, math.nan], [[0.5]]])
def test_levels_of_quantiles_lie_between_0_and_1(ungm: StateSpaceModel, levels: Any) -> None:
    with pytest.raises(ValueError, match=r"^levels must lie between 0 and 1, got "):
        Filter(ungm, 20).now.quantiles(levels)


def given_error(u: float) -> StateSpaceModel:
    """A standard normal state; a reading comes with its own standard error."""
    return StateSpaceModel(
        name="given",
        initial=lambda w, p: (w[0],),
        transition=lambda x, t, w, p: x,
        measurement=lambda x, t, v, p: (x[0] + u * v[0], u),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], x[0], y[1]),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=(),
        measurement_noise=("normal",),
        normalised=True,
    )


@pytest.mark.parametrize(
    ("y", "u"), [(0.4, 0.05), (2.5, 0.05), (3.0, 2.0), (-40.0, 10.0), (1.5, 0.2)]
)
def test_a_given_error_is_not_tested_but_is_that_of_the_reading(y: float, u: float) -> None:
    """y is N(0, 1 + u^2), whatever error the model simulates; 20,000 draws give 2 % of p."""
    exact = 2 * stats.norm.cdf(-abs(y) / math.sqrt(1 + u**2))
    for own in (0.05, 0.2):
        found = Filter(given_error(own), 20_000, seed=2, engine="numpy").update(0, [y, u])
        assert found.surprise == pytest.approx(exact, rel=0.15, abs=0.02)
