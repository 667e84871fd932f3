"""Simulation: the paper's equations, from keyed noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from oracles.kalman import SCALAR, THREE
from pfdist import StateSpaceModel, load_model
from pfdist.errors import ModelError
from pfdist.filters import plain
from pfdist.filters.simulation import simulate


def test_compiled_and_plain_draws_are_the_same(ungm: StateSpaceModel) -> None:
    fast, slow = (f(ungm, 20, range(3, 8), 99) for f in (simulate, plain.simulate))
    for name in "xyz":
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), rtol=1e-12)


@pytest.mark.parametrize("name", ["lorenz63", "random_walk"])
def test_formulas_without_elementary_functions_have_the_bits_of_numpy(name: str) -> None:
    model = load_model(name)
    fast, slow = (f(model, 60, range(20), 99) for f in (simulate, plain.simulate))
    for array in "xyz":
        assert getattr(fast, array).tobytes() == getattr(slow, array).tobytes()


def test_any_numbers_of_components() -> None:
    draws = simulate(THREE.as_model(), 5, range(4), 1)
    assert (draws.x.shape, draws.y.shape, draws.z.shape) == ((4, 6, 3), (4, 6, 2), (4, 6, 1))
    np.testing.assert_allclose(draws.z, draws.x @ THREE.h.T, rtol=1e-12)


def test_a_draw_does_not_depend_on_the_others_simulated_with_it(ungm: StateSpaceModel) -> None:
    whole = simulate(ungm, 30, range(10), 5)
    parts = [simulate(ungm, 30, piece, 5) for piece in (range(3), range(3, 4), range(4, 10))]
    np.testing.assert_array_equal(whole.y, np.concatenate([part.y for part in parts]))


def test_the_initial_state_follows_its_distribution(ungm: StateSpaceModel) -> None:
    x0 = simulate(ungm, 1, range(20_000), 11).x[:, 0, 0]
    assert stats.kstest(x0, stats.norm(scale=5).cdf).pvalue > 1e-3  # x(0) ~ N(0, 5^2)


def test_the_stationary_variance_of_an_autoregression() -> None:
    x = simulate(SCALAR.as_model(), 60, range(4000), 3).x[:, -1, 0]
    exact = 1 / (1 - 0.9**2)  # b^2 / (1 - a^2)
    standard_error = exact * np.sqrt(2 / x.size)
    assert abs(np.var(x) - exact) < 4 * standard_error


def test_a_simulation_that_explodes_is_an_error_that_says_where(ungm: StateSpaceModel) -> None:
    exploding = StateSpaceModel(
        **{
            **{name: getattr(ungm, name) for name in ungm.__dataclass_fields__},
            "name": "exploding",
            "transition": lambda x, t, w, p: (1e200 * (1 + x[0] ** 2),),
        }
    )
    with pytest.raises(ModelError, match=r"exploding: a simulation must stay finite, got .* t = 2"):
        simulate(exploding, 5, range(1), 0)


SHIFTS = np.array([0.5, -1.0, 2.0])  # f_t of the paper is of t = 0..T-1


@pytest.mark.parametrize("engine", [simulate, plain.simulate], ids=["compiled", "plain"])
def test_the_transition_is_that_of_the_instants_but_the_last(engine, ungm: StateSpaceModel) -> None:
    shifted = replace(ungm, transition=lambda x, t, w, p: (x[0] + SHIFTS[t],))
    x = engine(shifted, 3, range(4), 1).x[:, :, 0]
    np.testing.assert_allclose(np.diff(x), np.tile(SHIFTS, (4, 1)), rtol=1e-12)
