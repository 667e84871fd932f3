"""Ways to write a formula: the compiled engine computes what NumPy computes from the formula."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import pfdist
from oracles.model_text import MEASURED
from oracles.satellite import Satellite, model_of
from pfdist.errors import ModelError, RunMismatchError
from pfdist.filters import particle_filter, plain, simulation
from pfdist.models import StateSpaceModel, load_model
from pfdist.models.recorded import differences, recorded
from pfdist.models.tracing import MODES
from pfdist.models.twin import traced

MODEL = (
    """
import numpy as np
import pfdist
from pfdist import StateSpaceModel
{before}

def transition(x, t, w, p):
    {body}

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=transition,
"""
    + MEASURED
    + """    parameters={{"sigma": 0.9}},
)
"""
)
WAYS = {  # `test_tracing.py` has more of them; these are compiled in different ways
    "a regime by a table": (
        "GAINS = [0.9, -0.5, 0.1]",
        "return (pfdist.take(GAINS, np.clip(np.abs(x[0]), 0, 2).astype(int)) * x[0] + w[0],)",
    ),
    "a branch on t": ("", "return (x[0] + w[0] if t % 3 else 0.5 * x[0],)"),
}


@pytest.fixture
def as_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have plain NumPy call the formulas as they stand, and not their programs."""
    monkeypatch.setattr(plain, "twin_of", lambda model, instants: model)


def assert_same_filters(model: StateSpaceModel, horizon: int = 12) -> None:
    """Compiled simulation and filter give what plain NumPy gives."""
    draws = simulation.simulate(model, horizon, range(20), 1)
    slow = plain.simulate(model, horizon, range(20), 1)
    np.testing.assert_allclose(draws.x, slow.x, rtol=1e-9, atol=1e-12)
    fast, slow = (
        engine.filter_draws(model, draws, (0, 4, 8), 100, 2) for engine in (particle_filter, plain)
    )
    np.testing.assert_allclose(fast.mse, slow.mse, rtol=1e-7)


@pytest.mark.usefixtures("as_written")
@pytest.mark.parametrize("way", WAYS)
def test_a_formula_may_be_written_in_many_ways(way, tmp_path):
    before, body = WAYS[way]
    (tmp_path / "mine.py").write_text(MODEL.format(before=before, body=body))
    assert_same_filters(load_model("mine.py:model", tmp_path))


# --- objects --------------------------------------------------------------------------------------


def test_methods_compute_what_their_formulas_written_out_compute():
    """A satellite by a class with Runge-Kutta steps, whose methods give arrays and sum over x."""
    satellite = Satellite(steps=3)
    by_methods = model_of(satellite)
    by_hand = replace(by_methods, transition=satellite.transition_by_hand)
    np.testing.assert_allclose(
        simulation.simulate(by_methods, 12, range(20), 1).x,
        plain.simulate(by_hand, 12, range(20), 1).x,
        rtol=1e-9,
        atol=1e-12,
    )
    assert_same_filters(by_methods)


class Position:
    """A callable object as a formula."""

    def __init__(self, components: int) -> None:
        self.components = components

    def __call__(self, x, t, p):
        return x[: self.components]


class Missing:
    """A callable object that lacks arguments."""

    def __call__(self, x):
        return x


def quantity(x, t, p, components):
    return x[:components]


def test_callable_objects_and_partial_functions_are_formulas():
    for formula in (Position(2), partial(quantity, components=2)):
        model = replace(model_of(Satellite()), quantity_of_interest=formula)
        assert model.components == (4, 1, 2)
        assert_same_filters(model)


@pytest.mark.parametrize("wrong", [5, "f", Missing()])
def test_what_cannot_be_called_as_a_formula_is_refused(wrong):
    with pytest.raises(ModelError, match=r"quantity_of_interest must be a function of \(x, t, p\)"):
        replace(model_of(Satellite()), quantity_of_interest=wrong)


def test_a_model_of_objects_travels_and_is_known_by_its_programs(tmp_path):
    problem = pfdist.Problem(model_of(Satellite()), horizon=8, measurement_budget=3, particles=50)
    draws = {"comparison": {"draws": 100}, "evaluation": {"draws": 20}}
    draws["search"] = [{"method": "random", "evaluations": 3}]
    run = partial(pfdist.run, results=tmp_path / "run")
    job = problem.job(**draws)
    first, same = run(job, pool="threads"), run(job, pool="threads")  # it is resumed
    assert first.best == same.best
    other = pfdist.Problem(model_of(Satellite(pull=1.1)), horizon=8, measurement_budget=3)
    with pytest.raises(RunMismatchError, match=r"model.transition: the constant "):
        run(other.with_changes(particles=50).job(**draws), pool="threads")


class Switched:
    """A formula that computes something else where a parameter is large."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def __call__(self, x, t, w, p):
        return (x[0] * (self.factor if p.a > 1 else 0.5) + w[0],)


def test_the_programs_of_scenarios_count_too():
    def known(factor: float, *scenarios):
        walk = pfdist.load_model("random_walk")
        given = {**walk.parameters, "a": 0.5}
        changes = {"transition": Switched(factor), "linear_gaussian": False}
        return recorded(replace(walk, parameters=given, **changes), range(4), scenarios)

    assert not [*differences(known(0.6), known(0.9))]
    first, second = (known(factor, {"a": 2.0}) for factor in (0.6, 0.9))
    assert dict(differences(first, second)) == {"transition": "the constant 0.6 -> 0.9"}


def test_threads_may_trace_an_object_that_keeps_values_while_it_computes():
    class Keeping:
        def __call__(self, x, t, w, p):
            self.x = np.array(x)
            return tuple(self.x + w[0])

    model = replace(pfdist.load_model("random_walk"), transition=Keeping(), linear_gaussian=False)
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as threads:
            made = threads.map(lambda t: traced(model, "transition", range(t, t + 9)), range(40))
            assert {each.mode for each in made} == {MODES[0]}
    finally:
        sys.setswitchinterval(before)


# --- the twin -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ungm", "bearings_only", "xray_tumour", "lotka_volterra"])
def test_programs_give_on_arrays_what_formulas_give(name, monkeypatch):
    model = pfdist.load_model(name)
    by_programs = plain.simulate(model, 10, range(5), 1)
    monkeypatch.setattr(plain, "twin_of", lambda model, instants: model)
    by_formulas = plain.simulate(model, 10, range(5), 1)
    for key in "xyz":
        pair = (getattr(draws, key) for draws in (by_programs, by_formulas))
        np.testing.assert_allclose(*pair, rtol=1e-10)
