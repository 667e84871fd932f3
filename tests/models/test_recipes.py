"""Recipes of docs/simulators.md: models of other libraries have the errors of the same formulas.

Each system is written once as formulas, which have references of their own.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pfdist import BatchedModel, StateSpaceModel, load_model, ode
from pfdist.filters.particle_filter import filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation

HORIZON, TIMES, STREAM = 10, (0, 2, 5, 9), 5
UNGM = load_model("ungm")


def errors_of(formulas: StateSpaceModel, *others: StateSpaceModel) -> list[Any]:
    """The errors of the draws of the formulas, by each model's filter under the same noise."""
    draws = simulate(formulas, HORIZON, range(100), 3)
    for each in others:
        np.testing.assert_allclose(simulate(each, HORIZON, range(100), 3).z, draws.z, rtol=1e-6)
    given = draws, (TIMES,), (HORIZON,), STREAM, Estimation(64)
    return [filter_checked_sets(each, *given)[0] for each in (formulas, *others)]


def growth(xp: Any, jit: Any = lambda function: function, **libraries: Any) -> BatchedModel:
    """The growth model by the functions of a library."""
    drift = jit(lambda x, t: x / 2 + 25 * x / (1 + x**2) + 8 * xp.cos(1.2 * t))
    fit = jit(lambda y, x, sd: -0.5 * ((y[0] - x[0] ** 2 / 20) / sd) ** 2)

    def sd(t: int, p: Any) -> float:
        return p.measurement_sd * (np.sin(0.25 * t) + 2)

    return BatchedModel(
        "growth",
        lambda w, p: p.initial_sd * w,
        lambda x, t, w, p: np.asarray(drift(x, float(t))) + p.process_sd * w,
        measurement=lambda x, t, v, p: x**2 / 20 + sd(t, p) * v,
        log_likelihood=lambda y, x, t, p: fit(y, x, sd(t, p)),
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        parameters=UNGM.parameters,
        version="1",
        **libraries,
    )


def test_numpy_functions_of_arrays() -> None:
    expected, found = errors_of(UNGM, growth(np))
    np.testing.assert_allclose(found, expected, rtol=1e-7)


@pytest.mark.recipes
@pytest.mark.needs("bench")
def test_jax_functions() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    expected, found = errors_of(UNGM, growth(jax.numpy, jax.jit, libraries=("jax", "jaxlib")))
    np.testing.assert_allclose(found, expected, rtol=1e-7)


@pytest.mark.recipes
@pytest.mark.needs("bench")
def test_pytorch_functions() -> None:
    import torch

    def in_torch(function: Any) -> Any:
        def call(*arguments: Any) -> Any:
            given = (
                torch.tensor(each) if isinstance(each, np.ndarray) else each for each in arguments
            )
            return function(*given).numpy()

        return call

    class Torch:
        cos = staticmethod(lambda x: torch.cos(torch.tensor(x, dtype=torch.float64)))

    expected, found = errors_of(UNGM, growth(Torch, in_torch, libraries=("torch",)))
    np.testing.assert_allclose(found, expected, rtol=1e-7)


# --- solvers --------------------------------------------------------------------------------------


def tank(transition: Any, **fields: Any) -> Any:
    """A tank that empties through its outlet, with an unknown inflow."""
    kind = BatchedModel if "version" in fields else StateSpaceModel
    return kind(
        "tank",
        lambda w, p: (4.0 + 0.3 * w[0], 1.0 + 0.2 * w[1]),
        transition,
        measurement=lambda x, t, v, p: (x[0] + 0.1 * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / 0.1) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=("normal",),
        measurement_noise=("normal",),
        **fields,
    )


def outflow(level: Any) -> Any:
    return 0.5 * np.sqrt(np.maximum(level, 0.0))


def flow_of_formulas() -> Any:
    steps = ode(lambda x, t, p: (x[1] - outflow(x[0]), 0.0), substeps=20)
    return lambda x, t, w, p: (steps(x, t, (), p)[0], x[1] + 0.1 * w[0])


@pytest.mark.slow
def test_a_solver_for_all_particles() -> None:
    """SciPy's solver chooses its steps for all particles of a draw: they are coupled."""

    def transition(x: Any, t: int, w: Any, p: Any) -> Any:
        level, inflow = x
        solved = solve_ivp(
            lambda _, x: inflow - outflow(x), (0.0, 1.0), level, rtol=1e-9, atol=1e-9
        )
        return (solved.y[:, -1], inflow + 0.1 * w[0])

    formulas = tank(flow_of_formulas())
    batched = tank(transition, version="1", coupled=True, libraries=("scipy",))
    expected, found = errors_of(formulas, batched)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.slow
def test_a_class_with_its_own_steps_as_formulas() -> None:
    """A class that a user has for a single system; it is traced as it is."""

    class Tank:
        def rate(self, s: Any) -> Any:
            return np.array([s[1] - outflow(s[0]), 0.0 * s[1]])

        def after(self, x: Any, t: Any, w: Any, p: Any) -> Any:
            s, h = np.array(x), 1 / 20
            for _ in range(20):
                k1 = self.rate(s)
                k2 = self.rate(s + h / 2 * k1)
                k3 = self.rate(s + h / 2 * k2)
                k4 = self.rate(s + h * k3)
                s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            return s + np.array([0.0, 0.1 * w[0]])

    expected, found = errors_of(tank(flow_of_formulas()), tank(Tank().after))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


# --- models of other packages ---------------------------------------------------------------------


@pytest.mark.recipes
@pytest.mark.needs("bench")
def test_a_transition_of_stone_soup() -> None:
    """A constant velocity, whose transition is a matrix and its noise a covariance."""
    from datetime import timedelta

    from stonesoup.models.transition import linear

    theirs, step = linear.ConstantVelocity(0.05), timedelta(seconds=1)
    matrix = np.array(theirs.matrix(time_interval=step), float)
    factor = np.linalg.cholesky(np.array(theirs.covar(time_interval=step), float))

    def model(kind: Any, transition: Any, **fields: Any) -> Any:
        return kind(
            "constant velocity",
            lambda w, p: (w[0], w[1]),
            transition,
            measurement=lambda x, t, v, p: (x[0] + 0.5 * v[0],),
            log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / 0.5) ** 2,
            quantity_of_interest=lambda x, t, p: (x[0],),
            initial_noise=("normal", "normal"),
            process_noise=("normal", "normal"),
            measurement_noise=("normal",),
            **fields,
        )

    formulas = model(StateSpaceModel, lambda x, t, w, p: matrix @ x + factor @ w)
    batched = model(BatchedModel, lambda x, t, w, p: matrix @ x + factor @ w, version="1")
    expected, found = errors_of(formulas, batched)
    np.testing.assert_allclose(found, expected, rtol=1e-7)


@pytest.mark.recipes
@pytest.mark.needs("bench")
def test_a_model_of_particles() -> None:
    """A class of the package `particles`: its distributions give draws and log-densities."""
    from particles import distributions, state_space_models
    from scipy.special import ndtr

    class Walk(state_space_models.StateSpaceModel):  # type: ignore[misc, name-defined]
        def PX0(self) -> Any:  # noqa: N802
            return distributions.Normal(scale=2.0)

        def PX(self, t: int, xp: Any) -> Any:  # noqa: N802
            return distributions.Normal(loc=0.9 * xp, scale=0.5)

        def PY(self, t: int, xp: Any, x: Any) -> Any:  # noqa: N802
            return distributions.Normal(loc=x, scale=0.3)

    theirs = Walk()
    batched = BatchedModel(
        "walk",
        lambda w, p: theirs.PX0().ppf(ndtr(w)),
        lambda x, t, w, p: theirs.PX(t + 1, x).ppf(ndtr(w)),
        measurement=lambda x, t, v, p: theirs.PY(t, None, x).ppf(ndtr(v)),
        log_likelihood=lambda y, x, t, p: theirs.PY(t, None, x[0]).logpdf(y[0]),
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        version="1",
        libraries=("particles",),
    )
    formulas = dataclasses.replace(
        load_model("random_walk"),
        initial=lambda w, p: (2.0 * w[0],),
        transition=lambda x, t, w, p: (0.9 * x[0] + 0.5 * w[0],),
        measurement=lambda x, t, v, p: (x[0] + 0.3 * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / 0.3) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        linear_gaussian=False,
    )
    expected, found = errors_of(formulas, batched)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
