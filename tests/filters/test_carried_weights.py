"""Filters that carry weights, against exact filters and their plain twin."""

import math
from dataclasses import replace

import numpy as np
import pytest

from oracles.guided import sharp_walk
from oracles.kalman import SCALAR
from pfdist import Filter, StateSpaceModel, linear_gaussian, load_model, where
from pfdist.errors import ArgumentError
from pfdist.filters import particle_filter, plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.particle_filter import filter_checked_sets, filter_draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.schemes import ALWAYS, threshold_of

HORIZON, TIMES = 12, (0, 3, 4, 9, 12)

STEPS = StateSpaceModel(
    name="steps",
    initial=lambda w, p: (2.0 * w[0], w[1]),
    transition=lambda x, t, w, p: (x[0] + w[0] - 0.5, x[1] + w[1]),
    measurement=lambda x, t, v, p: (x[0] + x[1] + 0.5 * v[0],),
    log_likelihood=lambda y, x, t, p: -2.0 * (y[0] - x[0] - x[1]) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0], x[1]),
    initial_noise=("uniform", "centred"),
    process_noise=("uniform", "centred"),
    measurement_noise=("normal",),
)
growth = load_model("ungm")


# --- the plain twin -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "resampling", "threshold"),
    [
        (growth, "multinomial", ALWAYS),
        (growth, "stratified", 0.1),
        (STEPS, "systematic", 0.1),
    ],
    ids=lambda each: getattr(each, "name", str(each)),
)
def test_compiled_and_plain_filter_agree_draw_for_draw(
    model: StateSpaceModel, resampling: str, threshold: float
) -> None:
    draws = simulate(model, HORIZON, range(5, 11), 17)
    arguments = (model, draws, TIMES, 130, 23, resampling, True, None, threshold)
    fast, slow = filter_draws(*arguments), plain.filter_draws(*arguments)
    for name in ("mse", "estimate", "variance"):
        np.testing.assert_allclose(
            getattr(fast, name), getattr(slow, name), rtol=1e-7, atol=1e-9, err_msg=name
        )
    if threshold < ALWAYS:
        np.testing.assert_allclose(fast.weight, slow.weight, rtol=1e-5)
        assert (fast.weight != 1.0).any()


@pytest.mark.parametrize("threshold", [ALWAYS, 0.5])
def test_sets_that_share_prefixes_have_the_bits_of_each_alone(threshold: float) -> None:
    draws = simulate(growth, HORIZON, range(4), 3)
    sets = [(0, 3, 4, 9), (0, 3, 4, 10), (0, 3, 5), (0, 3, 4), (1, 3), ()]
    settings = Estimation(100, "systematic", threshold=threshold)
    together = filter_checked_sets(growth, draws, sets, [HORIZON] * 6, 5, settings)[0]
    alone = [filter_checked_sets(growth, draws, [s], [HORIZON], 5, settings)[0][:, 0] for s in sets]
    np.testing.assert_array_equal(together, np.stack(alone, axis=1))


@pytest.mark.parametrize(
    ("model", "resampling", "threshold"),
    [(growth, "systematic", 0.5), (growth, "multinomial", ALWAYS), (STEPS, "stratified", 0.5)],
    ids=lambda each: getattr(each, "name", str(each)),
)
def test_a_measurement_that_no_particle_explains_is_left_out(
    model: StateSpaceModel, resampling: str, threshold: float
) -> None:
    """As if it were not made, bit for bit, with the weights from before."""
    likelihood, (_, t, *_) = model.log_likelihood, TIMES
    draws = simulate(model, HORIZON, range(12), 3)
    limit = float(np.median(draws.y[:, t, 0]))
    fails = replace(
        model,
        log_likelihood=lambda y, x, k, p: where(
            (k == t) & (y[0] > limit), -np.inf, likelihood(y, x, k, p)
        ),
    )
    degenerate = draws.y[:, t, 0] > limit
    assert 0 < degenerate.sum() < 12
    without = tuple(time for time in TIMES if time != t)
    fast, slow, left_out = (
        each.filter_draws(fails, draws, times, 60, 5, resampling, True, None, threshold)
        for each, times in ((particle_filter, TIMES), (plain, TIMES), (particle_filter, without))
    )
    for name in ("mse", "estimate", "variance"):
        found = getattr(fast, name)
        np.testing.assert_allclose(found, getattr(slow, name), rtol=1e-7, atol=1e-9)
        same = (found == getattr(left_out, name)).reshape(12, -1).all(axis=1)
        np.testing.assert_array_equal(same, degenerate)
    for filtered in (fast, slow):
        np.testing.assert_array_equal(filtered.degenerate, degenerate)


# --- exact filters --------------------------------------------------------------------------------


def test_weights_that_are_never_resampled_are_those_of_importance_sampling() -> None:
    """x stands still, so the weights are products of the likelihoods at x(0)."""
    still = linear_gaussian(
        "still", initial_noise=[[2.0]], transition=[[1.0]], process_noise=[[0.0]],
        measurement=[[1.0]], measurement_noise=[[1.5]], quantity_of_interest=[[1.0]],
    )  # fmt: skip
    draws = simulate(still, HORIZON, range(5), 3)
    filtered = filter_draws(still, draws, TIMES, 64, 7, "systematic", True, None, 1e-6)
    for d, particles in enumerate(filtered.cloud):
        x, y = np.asarray(particles)[0], draws.y[d, list(TIMES), 0]
        log_weight = -0.5 * np.sum(((y[:, None] - x) / 1.5) ** 2, axis=0)
        weight = np.exp(log_weight - log_weight.max())
        mean = weight @ x / weight.sum()
        assert filtered.estimate[d, -1, 0] == pytest.approx(mean, rel=1e-5)


def test_equal_weights_are_never_resampled_below_the_whole() -> None:
    """A measurement that says nothing leaves the weights equal, so no particle is lost."""
    blind = replace(
        SCALAR.as_model(), log_likelihood=lambda y, x, t, p: 0.0 * x[0], linear_gaussian=False
    )
    draws = simulate(blind, HORIZON, range(3), 1)
    carried = filter_draws(blind, draws, TIMES, 50, 2, "multinomial", True, None, 1.0)
    unmeasured = filter_draws(blind, draws, (), 50, 2, "multinomial", True)
    np.testing.assert_array_equal(carried.mse, unmeasured.mse)


# --- a filter that stops and goes on --------------------------------------------------------------


@pytest.mark.parametrize("resample", ["always", "below 0.5"])
def test_a_filter_of_real_measurements_has_the_bits_of_a_run(resample: str) -> None:
    following = Filter(growth, 200, 5, resample=resample, engine="compiled", horizon=HORIZON)
    draws = simulate(growth, HORIZON, range(1), 3)
    whole = filter_draws(
        growth, draws, TIMES, 200, following.stream, "systematic", True, None,
        threshold_of(resample),
    )  # fmt: skip
    for t in range(HORIZON + 1):
        now = following.update(t, draws.y[0, t]) if t in TIMES else following.predict(t)
        np.testing.assert_array_equal(now.mean, whole.estimate[0, t])
    cloud = following.cloud
    assert isinstance(cloud, Cloud)
    assert (cloud.weight is None) == (resample == "always")


@pytest.mark.parametrize("resample", ["always", "below 0.5"])
def test_the_log_evidence_is_that_of_the_kalman_filter(resample: str) -> None:
    constant = math.log(0.05) + math.log(2 * math.pi) / 2
    sharp = sharp_walk(1, sensor=0.05)
    exact, following = (
        Filter(sharp, 20_000, 5, resample=resample, engine=engine) for engine in ("kalman", "auto")
    )
    following.model = replace(sharp, normalised=True)
    (draw,) = simulate(sharp, HORIZON, range(1), 3).y
    for t in (1, 4, 5, 9):
        now, known = following.update(t, draw[t]), exact.update(t, draw[t])
        assert now.mean == pytest.approx(known.mean, abs=0.005)
        assert now.quantiles(0.9) == pytest.approx(known.quantiles(0.9), abs=0.005)
        assert now.effective_sample_size is not None
    assert exact.log_evidence is not None
    assert following.log_evidence is not None
    # Each log of a mean of 20,000 weights has a standard error below 0.02.
    assert following.log_evidence - 4 * constant == pytest.approx(exact.log_evidence, abs=0.15)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["sometimes", "below 0", "below 1.5", "below -0.5", 0.5])
def test_a_wrong_condition_is_refused(text: object) -> None:
    with pytest.raises(ValueError, match="resample must be 'always'"):
        threshold_of(text)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="resample must be 'always'"):
        Filter("ungm", resample=text)  # type: ignore[arg-type]
