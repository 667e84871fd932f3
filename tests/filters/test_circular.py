"""Angles: the mean direction, its error 1 - cos, the estimators and the bound, against the circle.

Mardia, Jupp, "Directional statistics", 2000, sections 2.2 to 2.3.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

import pfdist
from oracles.circle import circle_filter
from oracles.in_turn import in_turn
from oracles.moments import assert_mean, assert_positive
from pfdist import Filter, Problem, StateSpaceModel, densities, load_model
from pfdist.errors import ModelError
from pfdist.filters import plain
from pfdist.filters.particle_filter import filter_checked_sets, filter_draws
from pfdist.filters.predicted import circular_measurements
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.models.base import within_half_turn
from pfdist.models.recorded import differences, recorded
from pfdist.plugins.check.model_checks import check_loaded

HORIZON, TIMES = 8, (1, 4, 5)
Array = NDArray[np.float64]


def _wrapped(angle: Any) -> Any:
    return angle - 2 * math.pi * np.ceil((angle - math.pi) / (2 * math.pi))


HEADING = StateSpaceModel(
    name="heading",
    initial=lambda w, p: (p.first + p.unknown * w[0],),
    transition=lambda x, t, w, p: (x[0] + p.drift + p.turn_sd * w[0],),
    measurement=lambda x, t, v, p: (
        _wrapped(densities.von_mises_draw(v[0], x[0], p.concentration)),
    ),
    log_likelihood=lambda y, x, t, p: p.concentration * np.cos(y[0] - x[0]),
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("uniform",),
    process_noise=("normal",),
    measurement_noise=("uniform",),
    parameters={
        "first": 0.0,
        "unknown": 2 * math.pi,
        "drift": 2.0,
        "turn_sd": 0.4,
        "concentration": 4.0,
    },
    z_names=("heading [rad]",),
    circular=("heading",),
)
POINTS = replace(  # an angle between two components that are none
    HEADING,
    name="points",
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
    measurement_noise=("normal",),
    quantity_of_interest=lambda x, t, p: (x[0] - 1.0, x[0] + 1.0, 0.5 * x[0]),
    z_names=(),
    circular=(1,),
)


def _mse(draws: int, particles: int, estimator: str, times: Sequence[int] = TIMES) -> Array:
    drawn = simulate(HEADING, HORIZON, range(draws), 3)
    estimation = Estimation(particles, estimator=estimator)
    return filter_checked_sets(HEADING, drawn, [tuple(times)], [HORIZON], 5, estimation)[0][:, 0]


def _angular(difference: Array) -> Array:
    return 1 - np.cos(difference)


@pytest.fixture(scope="module")
def exact() -> tuple[Any, Array, Array]:
    draws = simulate(HEADING, HORIZON, range(4000), 3)
    return (draws, *circle_filter(HEADING, draws.y[:, :, 0], TIMES))


@pytest.mark.parametrize("model", [HEADING, POINTS], ids=lambda model: model.name)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_the_compiled_filter_is_its_plain_twin(model: StateSpaceModel, estimator: str) -> None:
    draws = simulate(model, HORIZON, range(6), 3)
    sets, ends = [TIMES, (1, 4), ()], [HORIZON, 6, HORIZON]
    for lag in (0, 3) if estimator != "control" else (0,):  # controls are those of filters
        settings = Estimation(70, estimator=estimator, lag=lag)
        fast, slow = (
            f(model, draws, sets, ends, 9, settings)[0]
            for f in (filter_checked_sets, plain.filter_checked_sets)
        )
        np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("model", [HEADING, POINTS], ids=lambda model: model.name)
@in_turn("lag", [0, 3])
def test_estimates_and_variances_are_those_of_the_plain_twin(
    model: StateSpaceModel, lag: int
) -> None:
    draws = simulate(model, HORIZON, range(6), 3)
    fast, slow = (
        f(model, draws, TIMES, 70, 9, trajectories=True, lag=lag)
        for f in (filter_draws, plain.filter_draws)
    )
    np.testing.assert_allclose(fast.estimate, slow.estimate, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fast.variance, slow.variance, rtol=1e-9, atol=1e-9)
    angles = fast.estimate[:, :, model.is_angle]
    assert (np.abs(angles) <= np.pi).all()
    errors = (draws.z - fast.estimate) ** 2
    errors[:, :, model.is_angle] = _angular(draws.z[:, :, model.is_angle] - angles)
    np.testing.assert_allclose(fast.mse, errors.sum(axis=2).mean(axis=1), rtol=1e-9)


def test_the_estimate_converges_to_the_exact_filters_mean_direction(exact: Any) -> None:
    # The distance falls as 1 / P: a factor of 16, and 6 allows for chance and for flat densities.
    draws, mean, _ = exact
    few, many = (
        np.mean(_angular(estimate[:, list(TIMES), 0] - mean[:, list(TIMES)]))
        for particles in (100, 1600)
        for estimate in [
            filter_draws(HEADING, draws, TIMES, particles, 1, trajectories=True).estimate
        ]
    )
    assert many < few / 6
    assert many < 2e-3


def test_the_error_of_the_exact_filter_is_its_circular_variance(exact: Any) -> None:
    draws, mean, variance = exact
    assert_mean(np.mean(_angular(draws.z[:, :, 0] - mean) - variance, axis=1))


@pytest.mark.parametrize(("particles", "times"), [(3, ()), (20, ()), (60, TIMES)])
def test_the_variance_is_too_small_by_twice_the_distance_of_two_filters(
    particles: int, times: Sequence[int]
) -> None:
    # 1 - R' cos(m - m') and 1 - cos(z - m) have the same expectation, for any number of particles,
    # if the mean vectors have no bias, as without measurements.
    squared, variance, noise = (
        _mse(10_000, particles, estimator, times)
        for estimator in ("squared_error", "filter_variance", "filter_noise")
    )
    assert_mean(squared - variance - 2 * noise)
    assert_positive(squared - variance)


@pytest.mark.parametrize("particles", [2, 5, 50])
def test_beside_the_truth_the_error_is_one_minus_r_and_at_most_the_exact_error(
    exact: Any, particles: int
) -> None:
    """The identity on which the lower bound rests (see test_conditional)."""
    draws, _, variance_of_exact = exact
    variance, squared = (
        filter_checked_sets(
            HEADING, draws, [TIMES], [HORIZON], 7,
            Estimation(particles, "conditional", estimator=estimator),
        )[0][:, 0]
        for estimator in ("filter_variance", "squared_error")
    )  # fmt: skip
    assert_mean(squared - variance)
    assert_positive(variance_of_exact.mean(axis=1) - variance)


def test_without_measurements_a_wrapped_normal_angle_has_its_closed_form() -> None:
    # R = exp(-s^2 / 2), and the filter's P particles lose little more.
    model = HEADING.with_parameters({"first": 3.0, "unknown": 0.0})
    draws = simulate(model, HORIZON, range(4000), 3)
    spread = model.p.turn_sd * np.sqrt(np.arange(HORIZON + 1))
    mse = filter_draws(model, draws, (), 2000, 1).mse
    assert_mean(mse, np.mean(1 - np.exp(-(spread**2) / 2)))


# --- figures, real measurements, identity ---------------------------------------------------------


def test_angles_are_written_within_half_a_turn() -> None:
    values = within_half_turn(
        np.array([[3.0, 3.0], [-3.0, -3.0]]), np.array([-3.0, -3.0]), (True, False)
    )
    np.testing.assert_allclose(values, [[3.0 - 2 * np.pi, 3.0], [-3.0, -3.0]])


def test_the_trajectories_of_a_run_have_estimates_near_the_truth(tmp_path: Any) -> None:
    problem = Problem(HEADING, horizon=5, measurement_budget=2, particles=50)
    job = problem.job(search=[{"method": "random", "evaluations": 3}], comparison={"draws": 200})
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    rows = run.table("trajectories")
    estimates = [name for name in rows.columns if name.startswith("estimate_")]
    assert rows["z_heading"].max() > np.pi
    for name in estimates:
        assert (np.abs(rows[name] - rows["z_heading"]) <= np.pi + 1e-12).all()


def test_a_filter_of_real_measurements_has_a_mean_direction_and_quantiles_around_it() -> None:
    filtering = Filter(HEADING.with_parameters({"concentration": 50.0}), particles=2000)
    estimate = filtering.update(0, 3.1)
    assert abs(float(_wrapped(estimate.mean[0] - 3.1))) < 0.02
    low, high = estimate.quantiles([0.05, 0.95])[:, 0]
    assert low < estimate.mean[0] < high
    # For a concentration of 50, the standard deviation is 1 / sqrt(50) but for a percent.
    assert estimate.standard_deviation[0] == pytest.approx(1 / math.sqrt(50), rel=0.06)
    assert high - low == pytest.approx(2 * 1.645 / math.sqrt(50), rel=0.1)


@pytest.mark.parametrize(
    ("circular", "message"),
    [
        (("heding",), r"circular: got 'heding'; did .*components of z: '0', 'heading'$"),
        ((1,), r"circular must be names of components of z: '0', 'heading', got 1$"),
    ],
)
def test_an_unknown_component_is_refused(circular: Sequence[Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        replace(HEADING, circular=circular)


@pytest.mark.parametrize("name", ["heading [°]", "heading_deg", "heading [deg true]"])
def test_an_angle_in_degrees_is_refused_with_the_remedy(name: str) -> None:
    says = r"must be in radians, got '{}': convert it by np\.radians, and name the unit rad$"
    with pytest.raises(ModelError, match=says.format(re.escape(name))):
        replace(HEADING, z_names=(name,), circular=(0,))
    assert replace(HEADING, z_names=(name,), circular=()).named("z")[0].label == name
    if "[" in name:  # a measurement with the name of an angle is compared as one
        with pytest.raises(ModelError, match=says.format(re.escape(name))):
            replace(HEADING, y_names=(name,))
    replace(HEADING, y_names=("compass [deg]",), z_names=("heading [rad]",))


@pytest.mark.parametrize(("drift", "scale", "is_said"), [(50.0, 1.0, False), (2.0, 57.3, True)])
def test_only_a_wide_first_instant_looks_like_degrees(
    drift: float, scale: float, is_said: bool
) -> None:
    """A heading that counts its turns spreads and grows without end, and is right."""
    turned = replace(HEADING, parameters={**HEADING.parameters, "drift": drift})
    model = replace(
        turned,
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        quantity_of_interest=lambda x, t, p: (scale * x[0],),
    )
    first = takewhile(lambda each: each.name != "log_likelihood", check_loaded(lambda: model, 6, 5))
    said = [each.text for each in first if each.name == "angles"]
    assert len(said) == is_said
    assert all("heading [rad] is circular, so in radians, but lies in" in text for text in said)


def test_a_linear_gaussian_model_has_no_angles() -> None:
    with pytest.raises(ModelError, match=r"circular must be empty .* got \(0,\): the Kalman"):
        replace(load_model("random_walk"), circular=(0,))


def test_angles_count_in_the_identity_of_a_model() -> None:
    plain_heading = replace(HEADING, circular=())
    angular, plain = (recorded(model, range(5)) for model in (HEADING, plain_heading))
    assert dict(differences(plain, angular)) == {"circular": "nothing -> heading"}
    assert angular.is_angle == (True,)


def test_a_filters_model_takes_the_angles_of_the_truth() -> None:
    believed = replace(HEADING, circular=(), z_names=())
    assert believed.named_as(HEADING).is_angle == (True,)


# --- a measured angle may have any number of turns ------------------------------------------------


def _bearing(**changes: Any) -> StateSpaceModel:
    """The bearing of a walker beside an observer: z is no angle, y has no name."""
    return StateSpaceModel(
        name="bearing",
        initial=lambda w, p: (-5.0 + w[0], 0.3 * w[1]),
        transition=lambda x, t, w, p: (x[0] + 0.1 * w[0], x[1] + 0.3 * w[1]),
        measurement=lambda x, t, v, p: (_wrapped(np.arctan2(x[1], x[0]) + 0.05 * v[0]),),
        log_likelihood=lambda y, x, t, p: (
            -0.5 * (_wrapped(y[0] - np.arctan2(x[1], x[0])) / 0.05) ** 2
        ),
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        measurement_noise=("normal",),
        **changes,
    )


@pytest.mark.parametrize(
    "model", [HEADING, _bearing(), _bearing(y_names=("b [rad]",))], ids=[*"abc"]
)
def test_a_surprise_is_the_same_a_turn_later(model: StateSpaceModel) -> None:
    """Beside pi the cloud has values on both sides, and raw ranks call each of them extreme."""
    heading = model is HEADING
    filters = [Filter(model, 1000, seed=3, engine="numpy") for _ in range(3)]
    for t, y in ((0, math.pi - 0.02), (1, math.pi + 0.03 + 2.0 * heading)):
        found = [
            each.update(t, y + 2 * math.pi * k) for each, k in zip(filters, (0, -1, 3), strict=True)
        ]
        first = found[0].surprise
        assert first is not None
        assert first > 0.05
        for each in found[1:]:
            assert each.surprise == pytest.approx(first, abs=1e-9)
            assert each.mean == pytest.approx(found[0].mean, abs=1e-9)


def test_p_values_of_angles_are_uniform() -> None:
    """On 150 systems; the 1 % point of Kolmogorov's statistic is 1.63 / sqrt(n)."""
    model, surprises = recorded(_bearing(), range(2)), list[float]()
    for k, y in enumerate(simulate(model, 0, range(150), 5).y[:, 0]):
        found = Filter(model, 500, seed=1, engine="numpy", draw=k).update(0, y).surprise
        assert found is not None
        surprises.append(found)
    apart = np.abs(np.sort(surprises) - (np.arange(150) + 0.5) / 150)
    assert apart.max() < 1.63 / math.sqrt(150)


def test_a_component_that_is_no_angle_is_not_taken_for_one() -> None:
    walk = load_model("random_walk")
    assert circular_measurements(walk) == ()
    assert circular_measurements(_bearing()) == (0,)
    wide = replace(_bearing(), log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / 1e5) ** 2)
    assert circular_measurements(wide) == ()


@pytest.mark.plugins("backtest")
def test_a_backtest_of_angles_is_the_same_a_turn_later() -> None:
    problem = Problem(_bearing(), horizon=8, measurement_budget=2, particles=200)
    rng = np.random.default_rng(2)
    draws = simulate(_bearing(), 8, range(3), 4)
    rows = [(f"s{k}", t, float(y[t, 0])) for k, y in enumerate(draws.y) for t in range(9)]
    table = pd.DataFrame(rows, columns=["id", "t", "y0"])
    turned = table.assign(y0=table.y0 + 2 * math.pi * rng.integers(-2, 3, len(table)))
    found = [
        pfdist.backtest(problem, each, plan_each=True, pool="serial", report=False, progress=False)
        for each in (table, turned)
    ]
    first, second = (each.table for each in found)
    for column in ("real", "foreseen", "covered"):
        assert second[column].to_numpy() == pytest.approx(first[column].to_numpy(), rel=1e-9)
    assert found[0].improbable == found[1].improbable == 0.0
    for first_shown, other in zip(
        found[0].shown, found[1].shown, strict=True
    ):  # what the figure shows
        assert other.measured == pytest.approx(first_shown.measured, abs=1e-9, nan_ok=True)
