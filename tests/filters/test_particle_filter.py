"""The intermittent particle filter against exact filters, its plain twin, and published figures."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oracles.in_turn import in_turn
from oracles.kalman import SCALAR, THREE, TRACKING, kalman_filter
from oracles.moments import assert_exact_filter
from pfdist import StateSpaceModel, where
from pfdist.common.measurement_times import regular
from pfdist.errors import MeasurementTimesError, ModelError
from pfdist.filters import plain
from pfdist.filters.particle_filter import KERNEL_VERSION, filter_draws
from pfdist.filters.settings import RESAMPLING
from pfdist.filters.simulation import simulate

HORIZON = 12
TIMES = {"none": (), "some": (0, 3, 4, 9), "all": tuple(range(HORIZON + 1))}


def test_compiled_and_plain_filter_agree_draw_for_draw() -> None:
    model = THREE.as_model()
    draws = simulate(model, HORIZON, range(5, 11), 17)
    arguments = (model, draws, TIMES["some"], 130, 23, "systematic", True)
    fast, slow = filter_draws(*arguments), plain.filter_draws(*arguments)
    for name in ("mse", "estimate", "variance"):
        np.testing.assert_allclose(
            getattr(fast, name), getattr(slow, name), rtol=1e-9, atol=1e-9, err_msg=name
        )


@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES.keys())
def test_a_linear_gaussian_model_gives_the_kalman_filter(times: tuple[int, ...]) -> None:
    particles, count, system = 4000, 100, TRACKING
    model = system.as_model()
    draws = simulate(model, HORIZON, range(count), 1)
    filtered = filter_draws(model, draws, times, particles, 2, trajectories=True)
    exact = [kalman_filter(system, y, times) for y in draws.y]
    mean, variance = (np.array(values) for values in zip(*exact, strict=True))
    assert_exact_filter(filtered.estimate, filtered.variance, mean, variance, particles)


def test_the_expected_mse_of_the_regular_times(ungm: StateSpaceModel) -> None:
    # REFERENCE: multinomial 31.240 ± 0.025, systematic 31.195 ± 0.025 with 500 particles. The
    # others lie between them, or below by what their smaller variance is worth: 0.05.
    draws = simulate(ungm, 60, range(1500), 2020)
    expected = {"multinomial": 31.240, "stratified": 31.2, "systematic": 31.195}
    for resampling in RESAMPLING:
        mse = filter_draws(ungm, draws, regular(60, 21), 500, 1, resampling).mse
        standard_error = np.hypot(mse.std() / np.sqrt(mse.size), 0.025)
        assert abs(mse.mean() - expected[resampling]) < 3.5 * standard_error
        assert abs(mse.std() - 11.3) < 4 * 11.3 / np.sqrt(2 * mse.size) * 1.3  # kurtosis 3.7


@pytest.mark.parametrize(
    ("times", "expected", "error"), [((), 55.26, 0.08), (tuple(range(61)), 13.59, 0.03)]
)
def test_the_expected_mse_of_no_and_of_all_measurements(
    ungm: StateSpaceModel, times: tuple[int, ...], expected: float, error: float
) -> None:
    draws = simulate(ungm, 60, range(2000), 7)
    mse = filter_draws(ungm, draws, times, 500, 1).mse
    assert abs(mse.mean() - expected) < 3.5 * np.hypot(mse.std() / np.sqrt(mse.size), error)


@in_turn("particles", [1, 2, 16, 63, 65])
@in_turn("resampling", RESAMPLING)
def test_any_number_of_particles(ungm: StateSpaceModel, particles: int, resampling: str) -> None:
    draws = simulate(ungm, 10, range(3), 1)
    arguments = (ungm, draws, (1, 5, 10), particles, 4, resampling)
    fast, slow = filter_draws(*arguments).mse, plain.filter_draws(*arguments).mse
    np.testing.assert_allclose(fast, slow, rtol=1e-9)


def test_figures_change_only_with_the_kernels_version(ungm: StateSpaceModel) -> None:
    # Per-draw MSEs by version: a run must not go on with another kernel. The bits are the same on
    # every processor.
    pinned = {
        9: [
            [24.045525279925258, 32.26832048300251, 32.06414141945319],
            [24.667121851207238, 31.511312796377016, 31.88791205262],
            [24.791436902800438, 32.24373377842534, 31.74645558366461],
        ]
    }
    draws = simulate(ungm, 60, range(3), 2020)
    mse = [filter_draws(ungm, draws, regular(60, 21), 500, 1, scheme).mse for scheme in RESAMPLING]
    np.testing.assert_array_equal(mse, pinned[KERNEL_VERSION])


@pytest.mark.slow
def test_the_filters_model_may_be_another_than_the_truth() -> None:
    # A filter that thinks less of the measurements than it should errs more, as Kalman's does.
    truth, believed = SCALAR, replace(SCALAR, d=5 * SCALAR.d)
    draws = simulate(truth.as_model(), HORIZON, range(2000), 1)
    times = TIMES["some"]
    filtered = filter_draws(believed.as_model(), draws, times, 2000, 2)
    exact = np.array([kalman_filter(believed, y, times)[0] for y in draws.y])
    mse = np.mean((draws.z - exact)[:, :, 0] ** 2, axis=1)
    right = filter_draws(truth.as_model(), draws, times, 2000, 2).mse
    difference = filtered.mse - mse
    assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(mse.size) + 0.01 * mse.mean()
    assert filtered.mse.mean() > 1.1 * right.mean()


def test_the_error_may_be_any_function_of_z_and_its_estimate(ungm: StateSpaceModel) -> None:
    draws = simulate(ungm, HORIZON, range(20), 1)
    weighed = replace(
        draws.model,
        error=lambda z, estimate, t, p: (t >= 3) * p.price * np.abs(z[0] - estimate[0]),
        parameters={**ungm.parameters, "price": 2.0},
    )
    filtered = filter_draws(ungm, replace(draws, model=weighed), (3, 7), 100, 1, trajectories=True)
    expected = 2 * np.abs(draws.z - filtered.estimate)[:, 3:, 0].sum(axis=1) / (HORIZON + 1)
    np.testing.assert_allclose(filtered.mse, expected, rtol=1e-12)
    assert plain.filter_draws(ungm, replace(draws, model=weighed), (3, 7), 100, 1).mse == (
        pytest.approx(expected, rel=1e-9)
    )


@pytest.mark.slow
def test_a_particle_without_weight_does_not_count(ungm: StateSpaceModel) -> None:
    # Where x < 0 the quantity of interest is NaN; the measurement rules these particles out.
    model = replace(
        ungm,
        initial=lambda w, p: (w[0] + 0.5,),
        transition=lambda x, t, w, p: (x[0],),
        measurement=lambda x, t, v, p: (v[0],),
        log_likelihood=lambda y, x, t, p: where(x[0] > 0, -x[0], -np.inf),
        quantity_of_interest=lambda x, t, p: (np.sqrt(x[0]),),
    )
    truth = replace(model, initial=lambda w, p: (1.0,))
    draws = simulate(truth, 2, range(5), 1)
    mse = filter_draws(model, draws, (0, 1, 2), 50, 1).mse
    assert np.isfinite(mse).all()
    assert mse == pytest.approx(plain.filter_draws(model, draws, (0, 1, 2), 50, 1).mse, rel=1e-9)
    assert np.isinf(filter_draws(model, draws, (1,), 50, 1).mse).all()


@in_turn(
    ("changes", "message"),
    [
        ({"resampling": "best"}, "resampling must be 'multinomial', .* got 'best'"),
        ({"resampling": "conditional"}, "resampling must be 'multinomial', .*"),  # sees the truth
        ({"particles": 0}, "particles must be at least 1, got 0"),
        ({"measurement_times": (3, 11)}, r"0\.\.4, got 11"),
        ({"model": THREE.as_model()}, "as many components of y as the model ungm, 1, got 2"),
    ],
)
@in_turn("engine", [filter_draws, plain.filter_draws])
def test_a_filter_that_is_none_is_refused(
    engine: Callable[..., Any], changes: dict[str, Any], message: str, ungm: StateSpaceModel
) -> None:
    right = {"model": ungm, "measurement_times": (1,), "particles": 10, "stream": 1}
    with pytest.raises((MeasurementTimesError, ModelError, ValueError), match=message):
        engine(**{**right, "draws": simulate(ungm, 4, range(2), 0), **changes})
