"""The engine `jax` against the compiled engine, the plain filter, and exactly known errors."""

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.batched import batched
from oracles.bytes_of import hashes
from oracles.in_turn import in_turn
from oracles.kalman import SCALAR
from oracles.limits import limits
from pfdist import StateSpaceModel, load_model
from pfdist.errors import MissingExtraError, ModelError, TraceError
from pfdist.filters import kalman, particle_filter
from pfdist.filters.cloud import Cloud
from pfdist.filters.evaluator import Evaluator, recorded_evaluator
from pfdist.filters.interface import EACH_DRAW, SUMS
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.follows import StepLimits
from pfdist.kernels.rules import ALWAYS, Applied, Thresholds
from pfdist.models.loader import installed_models
from pfdist.models.recorded import recorded
from pfdist.plugins.accelerator.with_jax import filter as accelerator
from pfdist.plugins.guided.proposal import GUIDED
from pfdist.store import read_run

LARGEST_Z = 4.0  # standard errors
PAPER = tuple(range(0, 61, 3))
SHIPPED = sorted(
    name for name, (home, _) in installed_models().items() if home.startswith("pfdist.")
)
QUICK = ("two_compartments", "xray_tumour")  # the last has sensors


def _check_same_means(first: Any, second: Any) -> None:
    """Means over draws, the first axis, must agree within standard errors of their difference."""
    difference = first - second
    error = difference.std(axis=0, ddof=1) / math.sqrt(len(difference))
    allowed = LARGEST_Z * error + 1e-6 * abs(first.mean(axis=0))
    np.testing.assert_array_less(abs(difference.mean(axis=0)), allowed + 1e-300)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in SHIPPED],
)
def test_the_errors_of_every_model_that_ships_are_those_of_the_compiled_engine(name: str) -> None:
    model = load_model(name)
    evaluator = recorded_evaluator(model, model, horizon=8, times=tuple(np.arange(9) / 8))
    draws, estimation = evaluator.draws(range(200), 7), Estimation(64, "systematic")
    points = range(evaluator.points.first(9))
    sets = [tuple(points[::3]), tuple(points[1:-5:2]), tuple(points)]
    own, compiled = (
        each.filter_checked_sets(evaluator.believed, draws, sets, [8, 6, 8], 5, estimation)
        for each in (accelerator, particle_filter)
    )
    assert not own.degenerate.any()
    _check_same_means(own.mse, compiled.mse)


@in_turn(
    "settings",
    [Estimation(70, "multinomial", threshold=0.5, lag=4), Estimation(70, "stratified")],
)
def test_its_results_are_those_of_the_compiled_filter(settings: Estimation) -> None:
    model = recorded(load_model("ungm"), range(11))
    draws = simulate(model, 10, range(3, 403), 7)
    own, compiled = (
        each.filter_checked_draws(model, draws, (0, 3, 4, 8), 5, settings, True)
        for each in (accelerator, particle_filter)
    )
    for name in ("mse", "estimate", "variance", "sizes", "lines", "weight"):
        found, expected = (getattr(each, name) for each in (own, compiled))
        assert found.shape == expected.shape, name
        is_known = ~np.isnan(expected).any(axis=0)
        np.testing.assert_array_equal(~np.isnan(found).any(axis=0), is_known)
        _check_same_means(found[:, is_known], expected[:, is_known])
    _check_same_means(own.cloud.mean(axis=2), compiled.cloud.mean(axis=2))


ESTIMATIONS = [
    Estimation(50, "conditional", "control"),
    Estimation(50, "conditional", "filter_variance"),
    Estimation(50, "multinomial", "two_clouds", lag=2),
    Estimation(50, "systematic", "two_errors", threshold=0.5),
]


@in_turn("settings", ESTIMATIONS)
@in_turn("errors", [EACH_DRAW, SUMS])
def test_the_errors_of_sets_are_those_of_the_compiled_engine(
    settings: Estimation, errors: str
) -> None:
    model = recorded(load_model("ungm"), range(11))
    draws, sets, ends = simulate(model, 10, range(600), 7), [(0, 3, 4, 8), (2, 5), ()], [10, 7, 9]
    own, compiled = (
        each.filter_checked_sets(model, draws, sets, ends, 5, settings, errors)
        for each in (accelerator, particle_filter)
    )
    _check_same_means(own.mse, compiled.mse)
    if errors == EACH_DRAW:
        assert own.errors.shape == compiled.errors.shape
        for number, end in enumerate(ends):
            _check_same_means(
                own.errors[:, number, : end + 1], compiled.errors[:, number, : end + 1]
            )
            sums = own.errors[:, number].cumsum(axis=1)
            np.testing.assert_allclose(sums[:, end] / 11, own.mse[:, number], rtol=1e-9)
    else:
        total = [each[: end + 1].sum() for each, end in zip(own.errors, ends, strict=True)]
        np.testing.assert_allclose(np.array(total) / 11, own.mse.sum(axis=0), rtol=1e-9)


CORNERS = StateSpaceModel(  # no initial noise, a branch on t, an angle, and weights that are all 0
    name="corners",
    initial=lambda w, p: (0.0, 1.0),
    transition=lambda x, t, w, p: (x[0] + p.sd[t] * w[0], 0.9 * x[1] + (w[1] if t % 2 else w[2])),
    measurement=lambda x, t, v, p: (x[0] + 3 * v[0],),
    log_likelihood=lambda y, x, t, p: np.where(np.abs(y[0] - x[0]) < 1.4, 0.0, -np.inf),
    quantity_of_interest=lambda x, t, p: (x[0], x[1]),
    initial_noise=(),
    process_noise=("normal", "centred", "uniform"),
    measurement_noise=("centred",),
    parameters={"sd": tuple(0.5 + 0.1 * t for t in range(10))},
    circular=(0,),
)
FAILING = StateSpaceModel(  # a measurement fails now and then
    name="failing",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: (x[0] + w[0],),
    measurement=lambda x, t, v, p: (np.where(v[1] < 0.3, np.nan, x[0] + v[0]),),
    log_likelihood=lambda y, x, t, p: np.where(np.isnan(y[0]), 0.0, -0.5 * (y[0] - x[0]) ** 2),
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal", "uniform"),
    missing_components=True,
)
KNOWN = Cloud(2, np.linspace(-3.0, 3.0, 40)[None], np.linspace(0.0, 7.0, 40))


@in_turn(
    ("model", "settings"),
    [
        (CORNERS, Estimation(50)),
        (FAILING, Estimation(40, "systematic", threshold=0.5, prior=KNOWN)),
    ],
)
def test_corners_are_those_of_the_compiled_engine(
    model: StateSpaceModel, settings: Estimation
) -> None:
    model = recorded(model, range(10))
    prior: Any = settings.prior
    draws = simulate(model, 9, range(600), 7, prior)
    weights = np.linspace(0.0, 2.0, len(draws.instants))
    draws, sets, ends = replace(draws, weights=weights), [(3, 4, 8), (2, 6)], [9, 7]
    own, compiled = (
        each.filter_checked_sets(model, draws, sets, ends, 5, settings)
        for each in (accelerator, particle_filter)
    )
    _check_same_means(own.mse, compiled.mse)
    _check_same_means(own.degenerate.astype(float), compiled.degenerate)
    assert compiled.degenerate.any() == (model.name == "corners")


@in_turn("resampling", ["multinomial", "stratified", "systematic"])
def test_a_particle_without_weight_is_never_chosen(resampling: str) -> None:
    """Although sums of 32 bits are rounded."""
    model, rng = recorded(load_model("ungm"), range(2)), np.random.default_rng(1)
    rows, particles = 3, 10**6
    settings = Estimation(particles, resampling)
    request = accelerator._request(model, simulate(model, 1, range(1), 7), settings)
    given = {"stream": np.array([1, 2], np.uint32), "draws": np.arange(rows)}
    weight = np.float32(rng.random((rows, particles)) * (rng.random((rows, particles)) < 0.1))
    found = np.asarray(accelerator._Block(request, given)._ancestors(weight, 3))
    assert (np.take_along_axis(weight, found, axis=1) > 0).all()


def test_the_mean_of_the_control_variate_is_0() -> None:
    """Particle 0 keeps itself, and the others choose among all; see `schemes.CONDITIONAL`."""
    model = recorded(load_model("ungm"), range(11))
    draws, settings = simulate(model, 10, range(8000), 7), Estimation(10, "conditional", "control")
    found = accelerator.filter_checked_sets(model, draws, [(0, 2, 4, 6, 8)], [10], 5, settings).mse
    assert abs(found.mean()) <= LARGEST_Z * found.std() / math.sqrt(len(found))


@in_turn(
    "rule", [Thresholds((6.0,)), Thresholds((5.0,), 0.5, 4.5), Thresholds((ALWAYS,), 0.3, 3.0)]
)
def test_a_rule_measures_as_often_as_in_the_compiled_engine(rule: Thresholds) -> None:
    model = recorded(load_model("ungm"), range(21))
    draws, may = simulate(model, 20, range(600), 7), tuple(range(1, 21))
    limits = StepLimits(prices=(1.0,) * 21)  # as those of a job
    settings = Estimation(100, "systematic", rule=Applied(rule, limits))
    own, compiled = (
        each.filter_checked_sets(model, draws, [may], [20], 5, settings)
        for each in (accelerator, particle_filter)
    )
    assert not own.measured[:, 0].any()
    assert (own.measured.sum(axis=1) <= (rule.limit or 20)).all()
    assert (own.mse != compiled.mse).all()  # the other engine has not computed it
    _check_same_means(own.mse[:, 0], compiled.mse[:, 0])
    _check_same_means(own.measured.sum(axis=1, dtype=float), compiled.measured.sum(axis=1))


OTHERS = [
    Estimation(70, "conditional", "evidence"),
    Estimation(70, rule=Applied(Thresholds((6.0,)), limits(apart=tuple(range(2, 13))))),
    Estimation(70, rule=Applied(Thresholds((6.0,)), flipped=3)),
    Estimation(70, rule=Applied(Thresholds((6.0,))), lag=3),
]


@in_turn("settings", OTHERS)
def test_the_compiled_engine_computes_what_it_lacks(settings: Estimation) -> None:
    model = recorded(load_model("ungm"), range(11))
    draws = simulate(model, 10, range(9), 7)
    own, compiled = (
        each.filter_checked_sets(model, draws, [tuple(range(11))], [10], 5, settings).mse
        for each in (accelerator, particle_filter)
    )
    np.testing.assert_array_equal(own, compiled)


@in_turn("settings", [Estimation(70, "stratified"), Estimation(33, "systematic", lag=3)])
def test_no_bit_of_a_draw_depends_on_other_draws_and_sets(settings: Estimation) -> None:
    model = recorded(load_model("ungm"), range(11))
    draws, sets = simulate(model, 10, range(300), 7), [(0, 3, 4, 8), (1, 2, 9), (5,)]

    def mse(some: Any, of_sets: Any, known: Any = model) -> Any:
        ends = [10] * len(of_sets)
        return accelerator.filter_checked_sets(known, some, of_sets, ends, 5, settings).mse

    whole = mse(draws, sets)
    for part in (slice(0, 1), slice(229, 240), slice(299, 300)):
        np.testing.assert_array_equal(mse(draws[part], sets[1:]), whole[part, 1:])
    of_a_run = recorded(load_model("ungm"), range(1))  # as a run that resumes reads it
    np.testing.assert_array_equal(mse(draws, sets[:1], of_a_run), whole[:, :1])
    alone = accelerator.filter_checked_draws(model, draws, sets[0], 5, settings).mse
    np.testing.assert_allclose(alone, whole[:, 0], rtol=1e-12)


def test_numbers_of_32_bits_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device other than a processor computes with them."""
    monkeypatch.setattr(accelerator.jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(accelerator, "_ON_OTHERS", 2**13)
    model = recorded(load_model("ungm"), range(21))
    draws, sets = simulate(model, 20, range(400), 7), [tuple(range(0, 21, 3)), (5,)]
    for settings in (Estimation(500, "systematic"), Estimation(100, lag=3)):
        own, compiled = (
            each.filter_checked_sets(model, draws, sets, [20, 20], 5, settings).mse
            for each in (accelerator, particle_filter)
        )
        _check_same_means(own, compiled)
        np.testing.assert_array_equal(
            accelerator.filter_checked_sets(model, draws[7:9], sets, [20, 20], 5, settings).mse,
            own[7:9],
        )


def test_the_papers_error_is_that_of_the_prototype() -> None:
    evaluator = Evaluator(recorded(load_model("ungm"), range(61)), 60, engine="jax")
    work = evaluator.work([PAPER], 3, 4, (0, 2000), Estimation(500, "systematic"))
    mse = evaluator(work).mse[:, 0]
    error = mse.std() / math.sqrt(len(mse))
    assert abs(mse.mean() - 31.14) <= LARGEST_Z * error + 0.06  # 31.08 to 31.20


@in_turn("lag", [0, 3])
def test_its_error_is_the_known_one_of_a_linear_gaussian_model(lag: int) -> None:
    model, times = recorded(SCALAR.as_model(), range(13)), (2, 5, 9)
    evaluator = Evaluator(model, 12, engine="jax", lag=lag)
    work = evaluator.work([times, ()], 3, 4, (0, 600), Estimation(100, "systematic"))
    mse = evaluator(work).mse
    linear = replace(SCALAR.as_model(), linear_gaussian=True)
    exact = kalman.expected_mse(linear, 12, [times, ()], lag=lag)
    error = mse.std(axis=0) / math.sqrt(len(mse))
    assert (abs(mse.mean(axis=0) - exact * (1 + 1 / 100)) <= LARGEST_Z * error).all()


def test_a_library_that_is_missing_is_named_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pfdist.filters.engine.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"needs pip install -e '\.\[jax\]', got no jax"):
        Evaluator(load_model("ungm"), 8, engine="jax")


def test_without_a_device_a_line_says_so() -> None:
    call = [sys.executable, "-c", "import pfdist.plugins.accelerator.with_jax"]
    environment = os.environ | {"JAX_PLATFORMS": "abacus"}
    ended = subprocess.run(call, env=environment, capture_output=True, text=True, check=False)
    last = ended.stderr.splitlines()[-1]
    assert "needs JAX and a device, got Unable to initialize backend 'abacus'" in last


def test_a_job_can_name_it() -> None:
    given: dict[str, Any] = {"horizon": 60, "measurement_budget": 21, "engine": "jax"}
    problem = pfdist.Problem("ungm", resampling="systematic", proposal="plain", **given)
    found = pfdist.evaluate(problem.job(seed=1), PAPER, draws=40)
    assert 0 < found.expected_mse < math.inf
    model = load_model("ungm")
    with pytest.raises(ModelError, match=r"needs filter\.engine = 'compiled', got 'jax'"):
        Evaluator(model, 8, engine="jax", estimations=(Estimation(9, proposal=GUIDED.name),))
    with pytest.raises(TraceError, match="the engine 'batched' calls its functions"):
        pfdist.Filter(batched(model), 9, engine="jax")


@pytest.mark.slow
def test_a_run_has_the_same_bytes_with_any_workers(tmp_path: Path) -> None:
    problem = pfdist.Problem("ungm", horizon=8, measurement_budget=3, particles=40, engine="jax")
    search = [{"method": "genetic", "population": 6, "generations": 2}]
    job = problem.job(seed=1, evaluation={"draws": 30}, search=search, comparison={"draws": 60})
    for pool, workers in (("serial", 1), ("threads", 2)):
        pfdist.run(job, tmp_path / pool, pool=pool, workers=workers)
    assert hashes(tmp_path / "serial") == hashes(tmp_path / "threads")
    about = read_run(tmp_path / "serial")[0]
    assert {"jax", "jaxlib"} <= about["provenance"]["libraries"].keys()
