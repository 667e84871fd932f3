"""Windows that grow: along which sets, by how much, and where that ends."""

from itertools import pairwise

import numpy as np
import pytest

from oracles.in_turn import in_turn
from oracles.windows import (
    FEASIBLE,
    HORIZON,
    Case,
    affordable,
    cases,
    counted_errors,
    longest_end,
    relaxed_errors,
    with_each,
)
from pfdist import StateSpaceModel
from pfdist.filters.kalman import expected_mse
from pfdist.search.first_windows import relaxation_with
from pfdist.search.programme import Programme, longer, near_optimal
from pfdist.search.relaxation import NOTHING

ROUNDING = 1e-12


@cases
@in_turn("most", [1, 3, 100])
def test_each_set_is_the_best_through_windows_that_none_before_it_has_passed(
    case: Case, most: int
) -> None:
    relaxation, errors = case.make()
    spent = min(relaxation.total, 3)
    programme = Programme(relaxation, errors, relaxation.total)
    costs = {
        times: relaxed_errors(relaxation, errors, times).mean()
        for times in affordable(relaxation, spent)
    }
    below = float(np.median([*costs.values()])) if most == 3 and costs else np.inf
    found = near_optimal(programme, spent, most, below)
    assert len(found) == len({*found}) <= most
    passed: set[int] = set()
    left = dict(costs)
    for times in found:
        assert times in left  # it passes a window that is new
        assert left[times] == pytest.approx(min(left.values()), rel=ROUNDING)
        assert times == found[0] or left[times] < below
        passed.update(relaxation.windows_of(times))
        left = {
            other: cost
            for other, cost in costs.items()
            if not passed.issuperset(relaxation.windows_of(other))
        }
    assert len(found) == most or min(left.values(), default=np.inf) >= below


@cases
def test_a_window_grows_by_the_measurement_before_it_until_it_is_a_whole_beginning(
    case: Case,
) -> None:
    relaxation, _ = case.make()
    for times in affordable(relaxation, min(relaxation.total, 5)):
        beginnings = [times[:size] for size in range(len(times) + 1)]
        ends = [longest_end(relaxation.index, beginning) for beginning in beginnings]
        windows = {
            (NOTHING, *beginning)[-len(end) - 1 :]
            for beginning, end in zip(beginnings, ends, strict=True)
            if len(end) <= len(beginning)
        }
        far = frozenset(relaxation.overreached(times))
        assert longer(relaxation, [times]) == (windows, far)
        grown = relaxation.grown(*longer(relaxation, [times]))
        for beginning, end, number in zip(beginnings, ends, grown.windows_of(times), strict=True):
            assert len(grown.windows[number]) == min(len(end) + 1, len(beginning) + 1)


def test_what_several_sets_lack_is_given_at_once() -> None:
    relaxation = relaxation_with(FEASIBLE["free"], 1, 3)
    sets = [(1, 4, 6), (0, 4, 6)]
    (first, first_far), (second, second_far) = (longer(relaxation, [times]) for times in sets)
    windows, far = longer(relaxation, sets)
    assert windows == first | second
    assert far == first_far | second_far
    assert windows == {(NOTHING, 0), (NOTHING, 1), (0, 4), (1, 4), (4, 6)}


@with_each(FEASIBLE)
def test_windows_that_grow_along_the_best_set_prove_the_optimum(
    model: StateSpaceModel, name: str
) -> None:
    """Righini and Salani, 2008: the bound rises until the best set is whole, and then optimal."""
    feasible = FEASIBLE[name]
    relaxation, bounds = relaxation_with(feasible, 1, 2), []
    while True:
        programme = Programme(relaxation, counted_errors(model, relaxation), feasible.total)
        bounds.append(float(programme.mse[feasible.total]))
        best = programme.path(feasible.total)
        grown = relaxation.grown(*longer(relaxation, [best]))
        if grown == relaxation:
            break
        relaxation = grown
    assert all(lower <= higher * (1 + ROUNDING) for lower, higher in pairwise(bounds))
    optimum = expected_mse(model, HORIZON, list(feasible.every())).min()
    assert bounds[-1] == pytest.approx(optimum, rel=ROUNDING)
    assert expected_mse(model, HORIZON, [best])[0] == pytest.approx(optimum, rel=ROUNDING)
    assert all(relaxation.windows[n][0] == NOTHING for n in relaxation.windows_of(best))
