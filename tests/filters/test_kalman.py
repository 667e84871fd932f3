"""The exact filter, against the joint distribution of everything, conditioned at once."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.clocked import with_clock
from oracles.figures_under import CORES, figures_under
from oracles.in_turn import in_turn
from oracles.kalman import SCALAR, THREE, TRACKING, LinearGaussian, riccati_cost
from oracles.moments import assert_mean
from pfdist import Job, StateSpaceModel, linear_gaussian, load_model
from pfdist.errors import ModelError
from pfdist.filters import kalman
from pfdist.filters.cloud import Gaussian
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_by_instant, exact_mse
from pfdist.filters.simulation import simulate
from pfdist.filters.variants import knowing_truth, of_error
from pfdist.filters.work import Estimation
from pfdist.models import installed_models, tracing
from pfdist.pages.terminal import lines_of
from pfdist.questions.evaluate import evaluated
from pfdist.runner.build import build

DECLARED = sorted(
    name
    for name, (module, _) in installed_models().items()
    if "pfdist." in module and load_model(name).linear_gaussian
)
VARYING = linear_gaussian(
    "everything varies",
    initial_noise=[[1.0, 0.0], [0.5, 2.0]],
    transition=lambda t: ((0.9, 0.1 * t), (-0.2, 0.8 + 0.1 * np.cos(t))),
    process_noise=lambda t: ((0.3,), (0.1 * t,)),
    measurement=lambda t: ((1.0, 0.0), (0.2 * t, 1.0)),
    measurement_noise=lambda t: ((0.5 + 0.1 * t, 0.0), (0.0, 1.5)),
    quantity_of_interest=lambda t: ((1.0, 0.1 * t),),
)
MODELS = {"varying": VARYING, "tracking": TRACKING.as_model(), "three": THREE.as_model()}
HORIZON = 7
SMALL = Path(__file__).parents[1] / "small.toml"
WALK = load_model("random_walk")


def joint(model: StateSpaceModel) -> tuple[np.ndarray, np.ndarray]:
    """z (T+1, q, k) and y (T+1, m, k) as linear functions of all noise, by simulating with it."""
    sizes = [len(model.initial_noise)]
    sizes += [len(model.process_noise)] * HORIZON
    sizes += [len(model.measurement_noise)] * (HORIZON + 1)
    noise = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])
    x, z, y = model.initial(tuple(noise[0]), model.p), [], []
    for t in range(HORIZON + 1):
        z.append(np.stack(model.quantity_of_interest(x, t, model.p)))
        v = tuple(noise[HORIZON + 1 + t])
        y.append(np.stack(model.measurement(x, t, v, model.p)))
        if t < HORIZON:
            x = model.transition(x, t, tuple(noise[1 + t]), model.p)
    return np.array(z), np.array(y)


@pytest.mark.parametrize("times", [(), (0, 2, 3, 7), tuple(range(HORIZON + 1))])
@pytest.mark.parametrize("name", MODELS)
@in_turn("lag", [0, 2, HORIZON])
def test_it_is_the_conditional_distribution(name: str, times: tuple[int, ...], lag: int) -> None:
    model = MODELS[name]
    draws = simulate(model, HORIZON, range(5), 3)
    filtered = kalman.filter_draws(model, draws, times, 1, 1, trajectories=True, lag=lag)
    z, y = joint(model)
    for t in range(HORIZON + 1):
        known = [s for s in times if s <= t + lag]
        seen = np.concatenate([y[s] for s in known] or [np.empty((0, z.shape[2]))])
        values = np.concatenate([draws.y[:, s] for s in known] or [np.empty((5, 0))], axis=1)
        weights = np.linalg.solve(seen @ seen.T, seen @ z[t].T).T
        mean = values @ weights.T
        variance = np.diag((z[t] - weights @ seen) @ z[t].T)
        np.testing.assert_allclose(filtered.estimate[:, t], mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(filtered.variance[0, t], variance, rtol=1e-9, atol=1e-9)
    cost = kalman.expected_mse(model, HORIZON, [times], lag=lag)
    assert cost == pytest.approx([filtered.variance[0].sum(axis=1).mean()], rel=1e-12)


@pytest.mark.parametrize("name", DECLARED)
def test_draws_have_the_expected_mse(name: str) -> None:
    model, times = with_clock(load_model(name), 30), (0, 5, 6, 20, 30)
    mse = kalman.filter_draws(model, simulate(model, 30, range(20_000), 1), times, 1, 1).mse
    (expected,) = kalman.expected_mse(model, 30, [times])
    assert_mean(mse, expected)


@pytest.mark.parametrize("matrices", [SCALAR, TRACKING, THREE])
def test_many_sets_at_once_are_as_one_by_one(matrices: LinearGaussian) -> None:
    sets = list(itertools.combinations(range(8), 3))
    together = kalman.expected_mse(matrices.as_model(), 7, sets)
    alone = [riccati_cost(matrices, 7, times) for times in sets]
    np.testing.assert_allclose(together, alone, rtol=1e-10)


def test_a_random_walk_that_is_always_measured_keeps_the_golden_variance() -> None:
    # The positive root of P = (P + 1) / (P + 2): as much is learnt of a step as it adds.
    draws = simulate(WALK, 60, range(1), 1)
    variance = kalman.filter_draws(WALK, draws, range(61), 1, 1, trajectories=True).variance
    assert variance is not None
    assert variance[0, -1, 0] == pytest.approx((math.sqrt(5) - 1) / 2, rel=1e-12)


def test_a_measurement_without_noise_may_be_no_surprise() -> None:
    model = linear_gaussian(
        "known from the start",
        initial_noise=[[2.0]],
        transition=[[1.0]],
        process_noise=[[0.0]],
        measurement=[[1.0]],
        measurement_noise=[[0.0]],
        quantity_of_interest=[[1.0]],
    )
    assert kalman.expected_mse(model, 3, [(), (2,), (1, 2)]) == pytest.approx([4.0, 2.0, 1.0])


def test_engine_kalman_evaluates_and_searches_exactly(
    small_job: Job, finished: Callable[..., Path]
) -> None:
    changes = "model.name=random_walk", "filter.engine=kalman"
    job, run = small_job.with_changes(changes), pfdist.open_run(finished(*changes))
    evaluation = pfdist.evaluate(job, (0, 4, 8))
    assert evaluation.expected_mse == kalman.expected_mse(WALK, 12, [(0, 4, 8)])[0]
    assert (evaluation.standard_error, evaluation.draws) == (0.0, 0)
    rows = run.table("evaluations")
    exact = kalman.expected_mse(WALK, 12, [tuple(times) for times in rows["measurement_times"]])
    np.testing.assert_array_equal(rows["expected_mse"], exact)
    assert (rows["standard_error"] == 0).all()
    assert len(run.table("comparison")) == job.comparison.draws


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"linear_gaussian": False}, "needs a model with linear_gaussian=True"),
        ({"process_noise": ("uniform",)}, "process_noise.* must be normal, got 'uniform'"),
        ({"error": lambda z, e, t, p: abs(z[0] - e[0])}, "error of a linear-Gaussian"),
        (
            {"transition": lambda x, t, w, p: (pfdist.where(t > 3, x[0] * w[0], x[0]),)},
            "transition at t = 4 must be linear, but component 0 is not",
        ),
        (
            {"measurement": lambda x, t, v, p: (x[0] ** 2 + v[0],)},
            "measurement at t = 0 must be linear",
        ),
    ],
    ids=["not declared", "noise", "error", "transition", "measurement"],
)
def test_what_is_declared_is_checked(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Evaluator(replace(WALK, **changes), 12, engine="kalman")


def drifting(**values: float) -> StateSpaceModel:
    """A walk with a drift, an offset of its sensor and a start that is not 0."""
    return StateSpaceModel(
        name="drifting",
        parameters=values,
        initial=lambda w, p: (p.start + 0.5 * w[0],),
        transition=lambda x, t, w, p: (p.factor * x[0] + p.drift + w[0],),
        measurement=lambda x, t, v, p: (x[0] + p.offset + p.noise * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0] - p.offset) / p.noise) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        linear_gaussian=True,
    )


def test_the_error_of_a_filter_that_believes_another_model_is_that_of_its_draws() -> None:
    """Means, factors, noises and sensors may differ."""
    truth = drifting(start=1.0, factor=0.9, drift=0.3, noise=0.5, offset=0.2)
    believed = drifting(start=0.0, factor=0.97, drift=0.0, noise=0.8, offset=0.0)
    sets = [(), (0, 4, 9), (2, 3, 10), tuple(range(13))]
    misled = Evaluator(truth, 12, filter_model=believed, engine="kalman")
    exact = exact_mse(misled, sets)
    assert exact is not None
    draws = 4000
    works = misled.work(sets, 1, 2, (0, draws), Estimation(10))
    mse = misled(works).mse
    apart = (mse.mean(axis=0) - exact) / (mse.std(axis=0) / math.sqrt(draws))
    assert np.abs(apart).max() < 3.5
    # Without measurements it is the mean squared difference of the moments of x and the guess.
    mean, variance, guess, errors = 1.0, 0.25, 0.0, []
    for _ in range(13):
        errors.append(variance + (mean - guess) ** 2)
        mean, variance, guess = 0.9 * mean + 0.3, 0.81 * variance + 1.0, 0.97 * guess
    assert exact[0] == pytest.approx(np.mean(errors), rel=1e-12)
    true = exact_mse(Evaluator(truth, 12, engine="kalman"), sets)
    assert true is not None
    assert (exact > true).all()


def test_the_smoothed_error_of_a_wrong_filter_takes_draws() -> None:
    """It is no exact number, and not that of the filter: more measurements know more."""
    truth = drifting(start=1.0, factor=0.9, drift=0.3, noise=0.5, offset=0.2)
    believed = drifting(start=0.0, factor=0.97, drift=0.0, noise=0.8, offset=0.0)
    misled, sets = Evaluator(truth, 12, filter_model=believed, engine="kalman"), [(2, 5, 9)]
    smoothed = of_error(misled, "smoothed")
    assert not smoothed.exact
    assert exact_mse(smoothed, sets) is None
    assert exact_by_instant(smoothed, sets) is None
    assert exact_mse(knowing_truth(smoothed), sets) is not None
    both = [each(each.work(sets, 1, 2, (0, 500), Estimation(10))) for each in (misled, smoothed)]
    filtered, later = (each.mse.mean() for each in both)
    assert later < 0.9 * filtered
    changes = ["model.name=random_walk", "filter.engine=kalman"]
    changes += ["model.filter.parameters.step_sd=2.0"]
    answer = evaluated(str(SMALL), times={"": "0,4,8"}, changes=changes)
    said = " ".join(lines_of(answer._page()))
    assert said.count("(exact)") == 1, said


def test_a_wrong_filter_has_an_exact_plan_and_the_proof_tells_its_part(tmp_path: Path) -> None:
    """The best of all sets by enumeration; the gap's parts sum to what the right filter gains."""
    changes = ["filter.engine=kalman", "model.filter.parameters.step_sd=2.0"]
    job = pfdist.load_job(
        SMALL, [*changes, "model.name=random_walk", "search=[{method='exhaustive'}]"]
    )
    run = pfdist.plan(job, tmp_path / "run", figures=False, bound_draws=0)
    built = build(job)
    sets = [*itertools.combinations(range(13), 4)]
    exact = exact_mse(built.evaluator, sets)
    assert run.best.expected_mse == pytest.approx(exact.min(), rel=1e-9)
    assert run.best.standard_error == 0.0
    bound = pfdist.bound(run.path, figures=False)
    truth = exact_mse(knowing_truth(built.evaluator), [tuple(run.best.measurement_times)])
    (gap,) = [each for each in bound.gaps if each.name == run.best.name]
    assert gap.filter_model.value == pytest.approx(run.best.expected_mse - truth[0], rel=1e-9)


@pytest.mark.slow
def test_figures_in_numpy_agree_to_12_digits_under_the_names_of_other_processors():
    first, *others = map(figures_under, CORES)
    for other in others:
        assert other.keys() == first.keys()
        for name, figures in first.items():
            rtol = 0.0 if name == "analysis" else 1e-12  # tables of a run have the same bytes
            np.testing.assert_allclose(other[name], figures, rtol=rtol, err_msg=name)


@pytest.mark.parametrize("name", MODELS)
def test_a_draw_has_the_same_bits_alone_as_among_others(name: str) -> None:
    model, times = MODELS[name], (0, 2, 3, 6)
    draws = simulate(model, HORIZON, range(37), 1)
    together = kalman.filter_draws(model, draws, times, 1, 0, trajectories=True)
    for d in range(37):
        alone = kalman.filter_draws(model, draws[d : d + 1], times, 1, 0, trajectories=True)
        for values in ("mse", "estimate", "variance"):
            np.testing.assert_array_equal(
                getattr(together, values)[d], getattr(alone, values)[0], err_msg=values
            )


def test_the_predicted_measurement_has_the_moments_of_simulated_measurements() -> None:
    state = Gaussian(3, np.array([1.0, -2.0]), np.array([[2.0, 0.5], [0.5, 1.0]]))
    found = kalman.predicted_measurement(VARYING, state)
    rng, number = np.random.default_rng(0), 200_000
    x = rng.multivariate_normal(state.mean, state.covariance, number).T
    y = np.stack(VARYING.measurement(tuple(x), 3, tuple(rng.normal(size=(2, number))), VARYING.p))
    error = np.sqrt(np.diag(found.covariance) / number)
    np.testing.assert_array_less(np.abs(y.mean(axis=1) - found.mean), 4 * error)
    # The variance of a product of normal deviations is at most twice that of the squares.
    scale = np.sqrt(np.outer(np.diag(found.covariance), np.diag(found.covariance)))
    apart = np.abs(np.cov(y) - found.covariance)
    np.testing.assert_array_less(apart, 4 * scale * math.sqrt(2 / number))


def test_matrices_of_all_instants_are_those_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """A formula is called once for all instants, also if it reads t, p.dt and covariates."""
    calls, values = list[str](), tracing.Traced.values
    model = StateSpaceModel(
        name="varied",
        initial=lambda w, p: (w[0], 2.0 * w[1]),
        transition=lambda x, t, w, p: (
            np.exp(-p.dt[t]) * x[0] + np.sin(t) * x[1] + p.rain[t],
            x[1] + p.dt[t] * w[0],
        ),
        measurement=lambda x, t, v, p: (x[0] + p.rain[t] * v[0], 3.0),
        log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0] + x[1], p.time[t]),
        initial_noise=("normal", "normal"),
        process_noise=("normal",),
        measurement_noise=("normal",),
        parameters={"rain": tuple(0.1 * k + 0.3 for k in range(30))},
        linear_gaussian=True,
    ).on_clock(np.sort(np.random.default_rng(1).uniform(0, 9, 30)))
    alone = [kalman.matrices_of(model, t + 1, t) for t in range(29)]

    def counted(*given: Any) -> Any:
        calls.append("")
        return values(*given)

    monkeypatch.setattr(tracing.Traced, "values", counted)
    together = kalman.matrices_of(model, 29)
    assert len(calls) == 4
    for t, each in enumerate(alone):
        for name in ("transition", "measurement", "quantity_of_interest"):
            single, other = getattr(each, name)[0], getattr(together, name)[t]
            assert other.offset == pytest.approx(single.offset, rel=1e-14)
            assert other.matrix == pytest.approx(single.matrix, rel=1e-14)
