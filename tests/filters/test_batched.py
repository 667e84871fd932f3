"""Batched models: the compiled filter calls their functions, and has the errors of formulas."""

import dataclasses
import gc
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import special

from oracles.batched import batched
from oracles.clocked import times_of
from oracles.in_turn import in_turn
from pfdist import BatchedModel, Filter, Sensor, StateSpaceModel, densities, load_model
from pfdist.errors import ModelError, TraceError
from pfdist.filters.cloud import Cloud
from pfdist.filters.evaluator import Evaluator, recorded_evaluator
from pfdist.filters.interface import SUMS
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, with_truth
from pfdist.kernels.estimators import FILTER_NOISE
from pfdist.models.by_value import by_value, models_made
from pfdist.models.recorded import declared, differences, recorded, with_functions
from pfdist.models.written import models_of, text_of_models

HORIZON, TIMES, STREAM = 12, (0, 3, 4, 9, 12), 5
UNGM = load_model("ungm")
KINDS = [
    pytest.param(
        UNGM, Estimation(100, "stratified", threshold=0.5), id="carried", marks=pytest.mark.slow
    ),
    pytest.param(UNGM, Estimation(100, estimator=FILTER_NOISE.name), id="two filters"),
    pytest.param(UNGM, with_truth(100), id="truth inside"),
    pytest.param(
        load_model("pharmacokinetics"), Estimation(100), id="clock", marks=pytest.mark.slow
    ),
    pytest.param(load_model("xray_tumour"), Estimation(100), id="two of y"),
]


def pair(model: StateSpaceModel) -> list[StateSpaceModel]:
    """The model with traced formulas, and as a batched model; both on a clock if they read it."""
    models = [model, batched(model)]
    return [each.on_clock(times_of(HORIZON)) if each.reads_clock else each for each in models]


def sets_of(model: StateSpaceModel) -> tuple[tuple[int, ...], ...]:
    """Sets that share prefixes, whose measurements the sensors make in turn."""
    sensors = len(model.ways)
    return tuple(
        tuple(t * sensors + t % sensors for t in times) for times in (TIMES, TIMES[:3], (), (1, 8))
    )


@pytest.mark.parametrize(("model", "settings"), KINDS)
def test_a_batched_model_has_the_errors_of_its_formulas(model, settings):
    """The same noise, weights and resampling: NumPy's functions may differ in the last bits."""
    formulas, arrays = pair(model)
    draws = simulate(formulas, HORIZON, range(70), 3)
    again = simulate(arrays, HORIZON, range(70), 3)
    for name in "xyz":
        np.testing.assert_allclose(getattr(again, name), getattr(draws, name), rtol=1e-9, atol=1e-9)
    sets = sets_of(model)
    given = draws, sets, (HORIZON, HORIZON, 6, HORIZON), STREAM, settings
    for errors in ("", SUMS):
        expected, found = (filter_checked_sets(each, *given, errors) for each in (formulas, arrays))
        np.testing.assert_allclose(found.mse, expected.mse, rtol=1e-7)
        np.testing.assert_allclose(found.errors, expected.errors, rtol=1e-7)
    if settings.estimator == FILTER_NOISE.name:
        return  # one filter has trajectories
    expected, found = (
        filter_checked_draws(each, draws[:10], sets[0], STREAM, settings, trajectories=True)
        for each in (formulas, arrays)
    )
    for name in ("mse", "estimate", "variance", "ranks", "sizes"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-7, atol=1e-9
        )


def test_results_do_not_depend_on_how_draws_are_cut():
    arrays = batched(UNGM)
    draws, sets, settings = simulate(arrays, HORIZON, range(100), 3), sets_of(UNGM), Estimation(64)
    ends = (HORIZON,) * len(sets)
    whole, *_ = filter_checked_sets(arrays, draws, sets, ends, STREAM, settings)
    for cut in (1, 37, 99):
        parts = [
            filter_checked_sets(arrays, some, sets, ends, STREAM, settings)[0]
            for some in (draws[:cut], draws[cut:])
        ]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
    prior = Cloud(0, np.linspace(-5.0, 5.0, 64)[None])
    cut = [simulate(arrays, HORIZON, index, 3, prior) for index in (range(9), range(9, 300))]
    both = simulate(arrays, HORIZON, range(300), 3, prior)
    np.testing.assert_array_equal(np.concatenate([each.z for each in cut]), both.z)


def test_a_function_always_gets_as_many_particles():
    """Libraries may round by the shapes of arrays."""
    sizes = set[int]()

    def transition(x, t, w, p):
        sizes.add(x.shape[1])
        return 0.5 * x + w

    arrays = dataclasses.replace(batched(UNGM), transition=transition)
    draws = simulate(arrays, HORIZON, range(50), 3)
    sizes.clear()
    for some in (draws, draws[:1], draws[7:20]):
        filter_checked_sets(arrays, some, (TIMES,), (HORIZON,), STREAM, Estimation(100))
    assert len(sizes) == 1


def test_a_coupled_model_has_the_particles_of_one_draw_in_an_array():
    """The values of a particle depend on the others, and no result on how draws are cut."""
    widths = set[int]()

    def transition(x, t, w, p):
        widths.add(x.shape[1])
        return 0.9 * x + w - 0.1 * x.mean()

    arrays = batched(UNGM, coupled=True, transition=transition)
    draws = simulate(arrays, HORIZON, range(20), 3)
    assert widths == {1, 2}  # one draw, and two particles when the model was made
    widths.clear()
    given = (TIMES,), (HORIZON,), STREAM, Estimation(100)
    whole, *_ = filter_checked_sets(arrays, draws, *given)
    assert widths == {112}  # rounded up to whole vectors
    alone = [filter_checked_sets(arrays, draws[k : k + 1], *given)[0] for k in range(20)]
    np.testing.assert_array_equal(np.concatenate(alone), whole)


def test_functions_of_arrays_that_can_be_traced_become_formulas():
    """A walk in two dimensions, with two sensors."""
    matrix = np.array([[0.9, 0.2], [-0.1, 0.8]])

    def sensor(component, sd):
        return Sensor(
            lambda x, t, v, p: x[component : component + 1] + sd * v,
            lambda y, x, t, p: -0.5 * ((y[0] - x[component]) / sd) ** 2,
            ("normal",),
        )

    arrays = BatchedModel(
        "walk",
        lambda w, p: p.spread * w,
        lambda x, t, w, p: matrix @ x + 0.3 * np.sin(x + t) + w,
        quantity_of_interest=lambda x, t, p: (x[0], x[0] * x[1]),
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        sensors={"near": sensor(0, 0.2), "far": sensor(1, 1.0)},
        parameters={"spread": 2.0},
        version="1",
    )
    formulas = recorded(arrays.as_formulas(), range(HORIZON + 1))
    assert not declared(formulas)
    draws = simulate(arrays, HORIZON, range(30), 3)
    given = draws, sets_of(arrays), (HORIZON,) * 4, STREAM, Estimation(64)
    expected, found = (filter_checked_sets(each, *given)[0] for each in (arrays, formulas))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_formulas_that_call_another_library_are_declared_as_they_are():
    """x[0] is a row of particles, too, and a tuple of rows is accepted."""
    fields = {each.name: getattr(UNGM, each.name) for each in dataclasses.fields(UNGM)}

    def drawn(kind, erf, **declared):
        fields["transition"] = lambda x, t, w, p: (erf(0.5 * x[0]) + w[0],)
        return simulate(kind(**(fields | declared)), HORIZON, range(20), 3).z

    expected = drawn(StateSpaceModel, densities.erf)
    np.testing.assert_allclose(drawn(BatchedModel, special.erf, version="1"), expected, rtol=1e-9)
    with pytest.raises(TraceError, match=r"declare functions of arrays as a .*BatchedModel"):
        drawn(StateSpaceModel, special.erf)


# --- mistakes -------------------------------------------------------------------------------------


NOISE = np.random.default_rng(1)


def changing(x, t, w, p):
    x *= 0.5
    return x


@in_turn(
    ("transition", "message"),
    [
        (lambda x, t, w, p: 1 / 0 if t == 3 else x + w, r"transition failed: ZeroDivisionError"),
        (lambda x, t, w, p: x[:, :-1], r"transition must give an array \(components, particles\)"),
        (lambda x, t, w, p: x.astype(np.float32), r"got float32 of shape \(1, 2\): JAX computes"),
        (changing, r"transition failed: ValueError: output array is read-only"),
        (lambda x, t, w, p: x + NOISE.normal(), r"transition must compute the same whenever it is"),
        (lambda x, t, w, p: x + np.nan, r"must stay finite, got x\[0\] = nan at t = 1"),
        (lambda x, t, w, p: (np.zeros(3),), r"failed: ValueError: .*\(3,\).*shape \(2,\)"),
        (lambda x, t, w, p: (x[0], x[0]), r"as many components as initial, 1, got 2"),
    ],
)
def test_a_function_that_is_wrong_gets_one_line(transition, message):
    with pytest.raises(ModelError, match=message) as refused:
        simulate(batched(UNGM, transition=transition), HORIZON, range(5), 3)
    assert "\n" not in str(refused.value)


def test_a_log_likelihood_is_one_number_a_particle():
    """A row for each component of y, of which somebody forgot the sum."""
    with pytest.raises(ModelError, match=r"must give an array \(particles,\).*shape \(2, 2\)"):
        BatchedModel(
            "plane",
            lambda w, p: w,
            lambda x, t, w, p: x + w,
            measurement=lambda x, t, v, p: x + v,
            log_likelihood=lambda y, x, t, p: -0.5 * (y - x) ** 2,
            quantity_of_interest=lambda x, t, p: x,
            initial_noise=("normal", "normal"),
            process_noise=("normal", "normal"),
            measurement_noise=("normal", "normal"),
            version="1",
        )


def test_a_function_may_give_a_view_of_its_argument():
    """The filter copies what it gets."""
    view, copy = (batched(UNGM, transition=each) for each in (
        lambda x, t, w, p: x, lambda x, t, w, p: x.copy(),
    ))  # fmt: skip
    draws = simulate(copy, HORIZON, range(20), 3)
    given = draws, (TIMES,), (HORIZON,), STREAM, Estimation(100)
    np.testing.assert_array_equal(
        filter_checked_sets(view, *given)[0], filter_checked_sets(copy, *given)[0]
    )


# --- identity -------------------------------------------------------------------------------------


def test_a_model_is_what_it_declares(tmp_path: Path):
    table = tmp_path / "table.csv"
    table.write_text("1", encoding="utf-8")

    def made_now(version: str = "1") -> BatchedModel:
        return batched(UNGM, version=version, files=(str(table),), libraries=("numpy",))

    first = made_now()
    identity = json.loads(text_of_models(first, first))["truth"]["formulas"]["transition"][
        "declared"
    ]
    assert identity["libraries"] == {"numpy": np.__version__}
    assert not [*differences(first, made_now())]
    text = dict(differences(first, made_now("2")))["transition"]
    assert text.startswith("declared as version 1, ")
    table.write_text("2", encoding="utf-8")
    assert [*differences(first, made_now())]


def test_a_run_needs_the_code_of_a_batched_model():
    model = batched(UNGM)
    kept, _ = models_of(text_of_models(model, model).encode())
    assert kept.components == model.components
    with pytest.raises(ModelError, match="a run does not contain the functions of a batched model"):
        simulate(kept, HORIZON, range(5), 3)
    again = with_functions(kept, model)
    np.testing.assert_array_equal(*(simulate(e, HORIZON, range(5), 3).z for e in (again, model)))


def test_a_batched_model_travels_with_its_functions():
    model = batched(UNGM)
    (arrived,) = models_made(by_value([model]))
    np.testing.assert_array_equal(*(simulate(e, HORIZON, range(5), 3).z for e in (arrived, model)))


def test_a_model_is_sent_while_modules_are_imported(monkeypatch):
    """Another thread imports, which the collector of garbage does here whenever it runs."""
    many = {f"module{k}": sys for k in range(5000)}  # more than CPython keeps free tuples
    monkeypatch.setattr(sys, "modules", {**sys.modules, **many})
    model, threshold = batched(UNGM), gc.get_threshold()

    def importing(*_: object) -> None:
        sys.modules[f"imported{len(sys.modules)}"] = sys

    gc.callbacks.append(importing)
    gc.set_threshold(10)
    try:
        by_value([model])
    finally:
        gc.set_threshold(*threshold)
        gc.callbacks.remove(importing)
    assert any(name.startswith("imported") for name in sys.modules)


@in_turn(
    ("fields", "message"),
    [
        ({"version": ""}, "version: String should have at least 1 character, got ''"),
        ({"together": 0}, "together must be at least 1, got 0"),
        ({"files": ("missing.csv",)}, r"files must be readable, got .*missing.csv"),
        ({"libraries": ("no-such-thing",)}, "libraries must be installed, got 'no-such-thing'"),
    ],
)
def test_a_wrong_declaration_is_one_line(fields, message):
    with pytest.raises(ModelError, match=message):
        batched(UNGM, **fields)


def test_a_copy_declares_all_its_functions_alike():
    model = batched(UNGM)
    copy = dataclasses.replace(model, version="2", coupled=True)
    for name in ("initial", "transition", "log_likelihood"):
        assert getattr(copy, name).declaration == "version 2, coupled"
        assert getattr(copy, name).function is getattr(model, name).function
    assert model.transition.declaration == "version 1"


def test_the_filters_model_must_declare_other_functions_as_another_version():
    """Otherwise it would be taken for the truth."""

    def model_with(factor, version="1"):
        return batched(UNGM, transition=lambda x, t, w, p: factor * x + w, version=version)

    recorded_evaluator(model_with(0.5), model_with(0.5), horizon=HORIZON)
    with pytest.raises(ModelError, match="must have another version, because its transition gives"):
        recorded_evaluator(model_with(0.5), model_with(-0.5), horizon=HORIZON)
    other = recorded_evaluator(model_with(0.5), model_with(-0.5, "2"), horizon=HORIZON)
    assert other.believed != other.model


def test_a_filter_of_one_system_calls_a_batched_model():
    found = Filter(batched(UNGM), 50).update(2, 1.0).mean
    np.testing.assert_allclose(found, Filter(UNGM, 50).update(2, 1.0).mean, rtol=1e-9)
    with pytest.raises(TraceError, match="the engine 'batched' calls its functions"):
        Filter(batched(UNGM), 50, engine="compiled")


def test_the_engine_compiled_refuses_a_batched_model():
    model, estimation = batched(UNGM), Estimation(10)
    evaluator = recorded_evaluator(model, model, horizon=HORIZON, engine="compiled")
    with pytest.raises(TraceError, match="is a batched model, which is not traced"):
        evaluator.compile(estimation)
    Evaluator(model, HORIZON, engine="batched").compile(estimation)
