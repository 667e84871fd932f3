"""The gaps programme: lower bounds for smoothers, by brute force over all sets.

Oracles are exact covariances of linear systems (`pfdist.filters.kalman`).
"""

from itertools import pairwise

import numpy as np
import pytest

from oracles.windows import (
    FEASIBLE,
    HORIZON,
    affordable,
    counted,
    ends_of,
    with_each,
)
from pfdist import StateSpaceModel, linear_gaussian
from pfdist.common.measurement_times import Times
from pfdist.filters.kalman import expected_errors, expected_mse
from pfdist.problem.feasible import Feasible
from pfdist.search.gaps import GapRelaxation, gaps_with
from pfdist.search.programme import Programme
from pfdist.search.relaxation import NOTHING, Array, Window

ROUNDING = 1e-12


def walk(factor: float, push: float, noise: float, spread: float) -> StateSpaceModel:
    """x' = factor x + push w with a prior of this spread, and measurements with this noise."""
    return linear_gaussian(
        "walk",
        initial_noise=[[spread]],
        transition=[[factor]],
        process_noise=[[push]],
        measurement=[[1.0]],
        measurement_noise=[[noise]],
        quantity_of_interest=[[1.0]],
    )


def programme_of(model: StateSpaceModel, relaxation: GapRelaxation, most: int) -> Programme:
    errors = expected_errors(model, relaxation.horizon, relaxation.sets, lag=relaxation.lag)
    return Programme(relaxation, counted(relaxation, errors), most)


def of_gaps(model: StateSpaceModel, relaxation: GapRelaxation, times: Times) -> Array:
    """The least and the largest relaxed expected MSE of a set, by definition, gap by gap.

    In a gap that is not known, each instant has its error in a known part of the gap.
    """
    horizon, allowed, index = relaxation.horizon, relaxation.constraints.allowed, relaxation.index

    def own(window: Window) -> Array:
        """The errors if all is measured until a window and after it, (T+1,)."""
        measured = {t for t in allowed if t <= window[0] or t >= window[-1]} | {*window[1:-1]}
        [errors] = expected_errors(model, horizon, [tuple(sorted(measured))], lag=relaxation.lag)
        return np.array(errors)

    def parts(last: int, time: int) -> Array:
        """The sums of the least and of the largest errors of each instant in a part of a gap."""
        errors = np.full((2, horizon + 1), own((0, 0)))
        for part in (each for each in index if len(each) == 2):
            if last <= part[0] and part[1] <= time:
                here, known = slice(max(part[0], 0), part[1]), own(part)
                errors[0, here] = np.minimum(errors[0, here], known[here])
                errors[1, here] = np.maximum(errors[1, here], known[here])
        sums: Array = errors[:, max(last, 0) : time].sum(axis=1)
        return sums

    whole, totals = (NOTHING, *times, horizon + 1), np.zeros(2)
    for place in range(1, len(whole)):
        ends = [whole[first : place + 1] for first in range(place)]
        last, time = ends[-1]
        known = next((window for window in ends if window in index), None)
        totals += own(known)[max(last, 0) : time].sum() if known else parts(last, time)
    return totals / (horizon + 1)


@pytest.mark.parametrize("lag", [1, 3, HORIZON])
@with_each(FEASIBLE)
def test_the_bound_is_the_least_sum_over_gaps_and_no_set_lies_below(
    model: StateSpaceModel, name: str, lag: int
) -> None:
    feasible, rng = FEASIBLE[name], np.random.default_rng(lag)
    sets = list(feasible.every())
    own = expected_mse(model, HORIZON, sets, lag=lag)
    relaxations = [gaps_with(feasible, longest_gap, lag) for longest_gap in (1, 3)]
    whole = [(*times, HORIZON + 1) for times in sets]
    for number in (4, 16):
        relaxations.append(relaxations[-1].grown(ends_of(whole, rng, number)))
    bounds = []
    for relaxation in relaxations:
        programme = programme_of(model, relaxation, feasible.total)
        relaxed = np.array([programme.of_set(times) for times in sets])
        assert (relaxed <= own * (1 + ROUNDING)).all()
        chosen = rng.choice(len(sets), 3)
        low, high = np.array([of_gaps(model, relaxation, sets[number]) for number in chosen]).T
        assert (low <= relaxed[chosen] * (1 + ROUNDING)).all()
        assert (relaxed[chosen] <= high * (1 + ROUNDING)).all()
        paths = affordable(relaxation, feasible.total)
        least = min(programme.of_set(times) for times in paths)
        bounds.append(float(programme.mse[feasible.total]))
        assert bounds[-1] == pytest.approx(least, rel=ROUNDING)
        path = programme.path(feasible.total)
        assert programme.of_set(path) == pytest.approx(least, rel=ROUNDING)
    assert all(lower <= higher * (1 + ROUNDING) for lower, higher in pairwise(bounds))


def test_an_instant_in_an_unknown_gap_has_its_error_in_the_known_gap_around_it() -> None:
    """A steady walk: at t, the error depends on the distances to the measurements beside alone.

    So a long gap has the left half of the longest known gap, the error at its middle as often as
    it takes, and the right half.
    """
    model, horizon, longest = walk(1.0, 1.0, 1e-9, 1e-9), 40, 6
    relaxation = gaps_with(Feasible(horizon, 3), longest, horizon)
    errors = expected_errors(model, horizon, relaxation.sets, lag=horizon)
    sums = relaxation.sums(counted(relaxation, errors))
    for last, time in ((10, 16), (10, 17), (10, 23), (5, 36)):
        everything = {*range(last + 1), *range(time, horizon + 1)}
        [own] = expected_errors(model, horizon, [tuple(sorted(everything))], lag=horizon)
        assert own[last:time] == pytest.approx(
            [k * (time - last - k) / (time - last) for k in range(time - last)], abs=1e-6
        )
        windows, times = np.array([relaxation.index[(last,)]]), np.array([time])
        known = [k * (longest - k) / longest for k in range(longest)]
        middle = [longest / 4] * (time - last - longest)
        expected = sum([*known[:3], *middle, *known[3:]])
        assert sums(windows, times)[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("model", "horizon", "budget", "optimum", "bound"),
    [
        pytest.param(walk(1.0, 0.05, 3.0, 1.0), 20, 18, 0.3429, 0.3127, id="slow walk"),
        pytest.param(walk(1.0, 0.0, 3.0, 1.0), 20, 16, 0.3600, 0.3044, id="constant"),
        pytest.param(walk(0.95, 0.5, 5.0, 2.0), 16, 12, 1.719, 1.539, id="AR"),
    ],
)
def test_only_a_bound_that_looks_ahead_to_the_end_lies_below_the_optimum(
    model: StateSpaceModel, horizon: int, budget: int, optimum: float, bound: float
) -> None:
    """Smoothers with two instants after a gap have a larger error: they drop measurements."""
    feasible = Feasible(horizon, budget)
    own = expected_mse(model, horizon, list(feasible.every()), lag=horizon)
    assert own.min() == pytest.approx(optimum, rel=5e-4)
    short, whole = (
        programme_of(model, gaps_with(feasible, horizon + 1, horizon, lookahead), budget).mse[
            budget
        ]
        for lookahead in (2, None)
    )
    assert whole < own.min() < short
    # The other sums have the error at a measurement in the gap before it, not in that after it.
    assert whole == pytest.approx(bound, rel=5e-3)
