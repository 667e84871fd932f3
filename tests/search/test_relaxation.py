"""The relaxation: which window a set is in, and its errors, by brute force."""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from oracles.systems import SYSTEMS
from oracles.windows import (
    BUDGET,
    FEASIBLE,
    HORIZON,
    Array,
    Case,
    affordable,
    cases,
    counted,
    counted_errors,
    ends_of,
    longest_end,
    relaxed_errors,
    satisfying,
    with_each,
)
from pfdist import StateSpaceModel
from pfdist.common.measurement_times import Times
from pfdist.filters.kalman import expected_errors, expected_mse
from pfdist.problem.constraints import Constraints
from pfdist.runner.proof import Sums, prove
from pfdist.search.first_windows import relaxation_with
from pfdist.search.programme import Programme
from pfdist.search.relaxation import NOTHING, START, Relaxation, Window

ROUNDING = 1e-12
systems = pytest.mark.parametrize("model", SYSTEMS.values(), ids=list(SYSTEMS))


# --- which window a set is in ---


@cases
def test_a_set_is_in_the_longest_known_window_that_it_ends_with(case: Case) -> None:
    """Aho and Corasick's automaton against a search among all ends."""
    relaxation, _ = case.make()
    for times in satisfying(relaxation.constraints):
        found = [relaxation.windows[number] for number in relaxation.windows_of(times)]
        beginnings = (times[:size] for size in range(len(times) + 1))
        assert found == [longest_end(relaxation.index, beginning) for beginning in beginnings]


@pytest.mark.parametrize(
    ("times", "windows"),
    [
        ((2,), [(-1,), (-1, 2)]),  # nothing is added as long as there are fewer than 3
        ((2, 4, 5), [(-1,), (-1, 2), (-1, 2, 4), (2, 4, 5)]),
        ((2, 4, 5, 6), [(-1,), (-1, 2), (-1, 2, 4), (2, 4, 5), (4, 5, 6)]),
        ((2, 7, 8), [(-1,), (-1, 2), (7,), (7, 8)]),  # a gap longer than 3
    ],
)
def test_the_windows_of_a_set(times: Times, windows: Sequence[Window]) -> None:
    relaxation = relaxation_with(Constraints(9, 4), window=3, longest_gap=3)
    assert [relaxation.windows[number] for number in relaxation.windows_of(times)] == windows


@cases
def test_a_window_leads_on_by_the_times_that_the_constraints_allow(case: Case) -> None:
    relaxation, _ = case.make()
    sets = satisfying(relaxation.constraints)
    pairs = {pair for times in sets for pair in pairwise((NOTHING, *times))}
    leads = {(int(relaxation.last[window]), time)
             for time in range(relaxation.end + 1)
             for window in relaxation.after.allowing(time).tolist()}  # fmt: skip
    assert leads == pairs
    assert relaxation.after.counts.sum() == sum(
        relaxation.after.allowing(time).size for time in range(relaxation.end + 1)
    )


@cases
def test_the_moves_are_those_of_the_automaton(case: Case) -> None:
    relaxation, _ = case.make()
    moves = {
        (before, moves.time, after)
        for moves in map(relaxation.moves, range(relaxation.end))
        for before, after in zip(moves.before.tolist(), moves.to.tolist(), strict=True)
    }
    assert moves == {
        (window, time, int(relaxation.after[window, time]))
        for time in range(relaxation.end + 1)
        for window in relaxation.after.allowing(time).tolist()
    }


def test_windows_that_none_continues_share_the_moves_of_their_last_time() -> None:
    relaxation = relaxation_with(Constraints(60, 12), window=2, longest_gap=20)
    assert len(relaxation.windows) > 1000
    assert len(relaxation.after.rows) == 62  # a row for each time, and one for the beginning


@cases
def test_the_filter_of_a_window_measures_whatever_a_set_in_it_has_measured(case: Case) -> None:
    relaxation, _ = case.make()
    allowed, sets_of = {*relaxation.constraints.allowed}, cache(relaxation.sets.__getitem__)
    for times in satisfying(relaxation.constraints):
        for number, window in enumerate(relaxation.windows_of(times)):
            filtered = sets_of(window)
            assert list(filtered) == sorted({*filtered})
            assert {*times[:number]} <= {*filtered} <= allowed
            assert max(filtered, default=NOTHING) == relaxation.last[window]


def test_every_beginning_of_a_window_is_known_with_it() -> None:
    relaxation = relaxation_with(Constraints(9, 4), 1, 3).grown([(2, 4, 5, 9), (NOTHING, 1, 7)])
    added = {*relaxation.windows} - {*relaxation_with(Constraints(9, 4), 1, 3).windows}
    assert added == {(2, 4), (2, 4, 5), (2, 4, 5, 9), (NOTHING, 1), (NOTHING, 1, 7)}


def test_what_begins_with_a_forgotten_window_is_forgotten_and_no_time_alone_is() -> None:
    relaxation = relaxation_with(Constraints(9, 4), 1, 3).grown([(2, 4, 5, 9), (NOTHING, 1, 7)])
    forgotten = relaxation.without({(2, 4, 5), (NOTHING, 1, 7), (3,), START})
    gone = {*relaxation.windows} - {*forgotten.windows}
    assert gone == {(2, 4, 5), (2, 4, 5, 9), (NOTHING, 1, 7)}
    assert relaxation.without(()) is relaxation


# --- its errors ---


@with_each(FEASIBLE)
def test_more_windows_never_lower_the_bound(model: StateSpaceModel, name: str) -> None:
    """Longer windows, and errors that count for longer, add fewer measurements."""
    feasible = FEASIBLE[name]
    sets, rng = list(feasible.every()), np.random.default_rng(7)
    relaxations = [relaxation_with(feasible, 1, 3)]
    for number in (2, 4, 8, 16):
        longer = relaxations[-1].grown(ends_of(sets, rng, number))
        of_a_set = sets[int(rng.integers(len(sets)))]
        relaxations += [longer, longer.grown((), longer.overreached(of_a_set))]
    optimum = expected_mse(model, HORIZON, sets).min()
    bounds = [
        float(Programme(each, counted_errors(model, each), feasible.total).mse[-1])
        for each in relaxations
    ]
    assert all(lower <= higher * (1 + ROUNDING) for lower, higher in pairwise(bounds))
    assert bounds[-1] <= optimum * (1 + ROUNDING)
    # With the whole beginnings of all paths it is the optimum.
    paths = affordable(relaxations[-1], feasible.total)
    every = relaxations[-1].grown((NOTHING, *times) for times in paths)
    every = every.grown((), [window for times in paths for window in every.overreached(times)])
    bound = Programme(every, counted_errors(model, every), feasible.total).mse[-1]
    assert bound == pytest.approx(optimum, rel=ROUNDING)


@with_each(FEASIBLE)
def test_the_relaxed_error_is_at_most_the_sets_own_at_every_instant(
    model: StateSpaceModel, name: str
) -> None:
    """Whatever windows are known."""
    feasible = FEASIBLE[name]
    sets = list(feasible.every())
    own = expected_errors(model, HORIZON, sets)
    relaxations = [Case(name, list(FEASIBLE).index(name), 1).make()[0]]
    relaxations += [relaxation_with(feasible, *sizes) for sizes in ((1, 4), (2, 3), (3, 10))]
    for relaxation in relaxations:
        errors = counted_errors(model, relaxation)
        relaxed = np.array([relaxed_errors(relaxation, errors, times) for times in sets])
        assert (relaxed <= own * (1 + ROUNDING)).all()


def test_each_resample_of_the_draws_has_a_programme_of_its_own() -> None:
    relaxation = relaxation_with(FEASIBLE["required"], 2, 4)
    errors = np.random.default_rng(1).exponential(size=(3, int(relaxation.offsets[-1])))
    own = np.ones((3, 1, relaxation.horizon + 1))
    sums, known = Sums(errors, own, np.ones(3)), FEASIBLE["required"].regular()
    resamples = sums.means()[0]
    whole, *without = (Programme(relaxation, row, BUDGET).mse[BUDGET] for row in resamples)
    bound = prove(relaxation, sums, [known], BUDGET).bounds[BUDGET]
    assert bound.value == whole
    jackknifed = np.std(without) * np.sqrt(2)
    assert bound.standard_error == pytest.approx(jackknifed, rel=1e-9)


def test_errors_of_a_far_window_count_to_the_horizon() -> None:
    """And in the place of those of its last time alone, if nothing more is measured."""
    near = relaxation_with(Constraints(HORIZON, 2), 3, 2)
    window = (1, 2, 4)
    number = near.index[window]
    assert (near.first[number], near.ends[number]) == (4, 5)
    far = near.grown((), {window})
    assert (far.first[number], far.ends[number]) == (4, HORIZON)
    assert (np.delete(far.ends, number) == np.delete(near.ends, number)).all()
    times = (0, 1, 2, 4)
    assert near.overreached(times) == [window]
    assert far.overreached(times) == []


def test_a_window_that_grows_from_a_far_one_is_far() -> None:
    """Else its errors would end sooner, and lower ones would count in their place."""
    near = relaxation_with(Constraints(HORIZON, 2), 2, 2)
    far = near.grown((), {(2, 4)})
    grown = far.grown([(0, 1, 2, 4), (NOTHING, 3, 4)])
    assert grown.far == {(2, 4), (0, 1, 2, 4)}
    both = near.grown([(0, 1, 2, 4)], {(2, 4)})  # at once, too
    assert both.far == {(2, 4), (0, 1, 2, 4)}


@systems
def test_a_set_whose_windows_are_whole_beginnings_has_its_own_error(model: StateSpaceModel) -> None:
    """However many instants: nothing is lost in sums over the windows, but for rounding."""
    horizon = 60
    start = relaxation_with(Constraints(horizon, 10), 2, 4)
    sets = [tuple(range(3, 60, 6)), (0, 1, 2, 3, 4, 56, 57, 58, 59, 60)]
    whole = start.grown((NOTHING, *times) for times in sets)
    relaxation = whole.grown((), [far for times in sets for far in whole.overreached(times)])
    errors = counted_errors(model, relaxation)
    own = expected_mse(model, horizon, sets)
    for times, expected in zip(sets, own, strict=True):
        alone = relaxation.restricted([times])
        (found,) = Programme(alone, _of(relaxation, errors, alone), 10).mse[-1:]
        assert found == pytest.approx(expected, rel=ROUNDING)


def _of(relaxation: Relaxation, errors: Array, other: Relaxation) -> Array:
    """Those of the errors that count in another relaxation with the same windows."""
    t = np.arange(relaxation.horizon + 1)
    every = np.full((len(relaxation.windows), t.size), np.nan)
    every[(relaxation.first[:, None] <= t) & (t <= relaxation.ends[:, None])] = errors
    found = counted(other, every)
    assert np.isfinite(found).all()
    return found
