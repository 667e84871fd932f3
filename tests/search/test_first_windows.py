"""The windows with which a proof and a search begin, within a memory."""

import math
from dataclasses import replace

import numpy as np
import pytest

from oracles.searched import exactly
from oracles.systems import SYSTEMS
from pfdist import StateSpaceModel
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.filters.criterion import MEAN
from pfdist.problem.constraints import Constraints
from pfdist.problem.feasible import Feasible
from pfdist.search import StateSpaceRelaxation
from pfdist.search.first_windows import (
    MOST_UNITS,
    relaxation_for,
    relaxation_with,
    relaxation_within,
)
from pfdist.search.programme import Programme
from pfdist.search.state_space_relaxation import MOST_CELLS


@pytest.mark.parametrize(
    ("horizon", "number", "longest"),
    [(300, 4, 2), (365, 6, 2), (500, 10, 2), (1000, 20, 1), (1000, 4, 1), (60, 21, 2), (9, 1, 2)],
)
def test_a_search_has_first_windows_for_every_horizon(
    horizon: int, number: int, longest: int
) -> None:
    """Also where few measurements lie so far apart that a proof is refused."""
    relaxation = relaxation_within(Constraints(horizon, number), number, MOST_CELLS)
    assert max(map(len, relaxation.windows)) == longest
    assert relaxation.offsets[-1] <= MOST_CELLS
    mean_gap = (horizon + 1) / (number + 1)
    assert 1.2 * mean_gap <= relaxation.longest_gap <= 3 * mean_gap + 1 or longest == 1


def test_a_search_begins_as_a_proof_where_the_memory_is_enough() -> None:
    constraints = Constraints(60, 21)
    proof = relaxation_for(constraints, 2, 21, MOST_CELLS)
    assert relaxation_within(constraints, 21, MOST_CELLS) == proof


@pytest.mark.parametrize(("horizon", "number"), [(20, 4), (60, 21)])
@pytest.mark.parametrize("window", [1, 2, 3])
def test_a_relaxation_has_no_more_errors_than_it_may(
    horizon: int, number: int, window: int
) -> None:
    constraints = Constraints(horizon, number)
    instants = horizon + 1
    mean_gap = instants / (number + 1)
    for most in (10**5, 10**6, 10**7):
        try:
            relaxation = relaxation_for(constraints, window, number, most)
        except JobError:
            assert instants * (2 * mean_gap) ** window + instants**2 > most
        else:
            assert relaxation.offsets[-1] <= most
            assert 2 * mean_gap <= relaxation.longest_gap <= 3 * mean_gap + 1


def test_a_proof_that_needs_more_memory_is_refused_with_what_helps() -> None:
    with pytest.raises(
        JobError, match=r"^window = 3 needs .* allowed: 1,000; take a smaller window"
    ) as refused:
        relaxation_for(Constraints(60, 21), 3, 21, 1000)
    assert refused.value.argument == "window"
    for name in ("window", "longest_gap"):
        with pytest.raises(MeasurementTimesError, match=f"{name} must be at least 1, got 0"):
            relaxation_with(Constraints(9, 4), **{"window": 2, "longest_gap": 3, name: 0})


@pytest.mark.parametrize("cells", [1, 15_000])
def test_from_few_windows_a_search_finds_nearly_the_best_times(
    cells: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, feasible = SYSTEMS["sharp now and then"], Feasible(60, 5)
    whole = StateSpaceRelaxation(feasible, 320)
    every, best = whole.init().relaxation, _found(whole, model)
    monkeypatch.setattr("pfdist.search.state_space_relaxation.MOST_CELLS", cells)
    few = StateSpaceRelaxation(feasible, 320)
    assert few.init().relaxation.offsets[-1] < every.offsets[-1] / 2
    assert _found(few, model) <= best * 1.02


def _found(search: StateSpaceRelaxation, model: StateSpaceModel) -> float:
    """The cost that a search finds which does not know that its costs are exact."""
    state, rng = search.init(), np.random.default_rng(0)
    while not search.done(state):
        told = exactly(model, search.feasible.horizon, list(search.ask(state, rng)))
        state = search.tell(
            state,
            [replace(each, mse=np.full(320, each.expected_mse), criterion=MEAN) for each in told],
        )
    return search.finalists(state)[0].expected_mse


def _priced(total: int) -> Feasible:
    cost = tuple(np.random.default_rng(1).integers(101, 997, 25).tolist())
    return Feasible(24, price=cost, total_price=total)


def test_money_is_counted_in_as_many_units_as_a_programme_may_have() -> None:
    feasible = _priced(4001)
    for relaxation in (
        relaxation_for(feasible, 2, feasible.measurements, MOST_CELLS),
        relaxation_within(feasible, feasible.measurements, MOST_CELLS),
    ):
        assert relaxation.unit == math.ceil(feasible.total / MOST_UNITS) > 1
        assert relaxation.total <= MOST_UNITS
        programme = Programme(relaxation, np.zeros(relaxation.offsets[-1]), relaxation.total)
        assert programme.mse.shape == (relaxation.total + 1,)


def test_with_coarse_units_a_search_still_finds_sets_that_can_be_paid_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Though the best paths cost too much, because their prices are rounded down."""
    model, feasible = SYSTEMS["random walk"], _priced(4001)
    costs = []
    for units in (10_000, 60):
        monkeypatch.setattr("pfdist.search.first_windows.MOST_UNITS", units)
        search = StateSpaceRelaxation(feasible, 320)
        costs.append(_found(search, model))
    (regular,) = exactly(model, 24, [search.ask(search.init(), np.random.default_rng(0))[-1]])
    assert costs[1] <= costs[0] * 1.05
    assert costs[1] < regular.expected_mse
