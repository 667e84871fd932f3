"""The clock of a problem: times are turned into instants, and instants into times."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfdist.errors import MeasurementTimesError
from pfdist.times.clock import Clock
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import regular
from pfdist.times.spacing import Spacing
from pfdist.times.written import instants_of

UNEVEN = Clock((0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0), "h")


def test_the_times_of_a_regular_clock_are_multiples_of_the_step() -> None:
    assert Clock.regular(1.2, 0.1).times[3] == 0.3
    assert Clock.regular(1.2, 0.1).horizon == 12


@pytest.mark.parametrize("off", [0.0, 4e-10, -4e-10])
def test_a_time_means_an_instant_if_it_differs_by_at_most_a_billionth(off: float) -> None:
    assert UNEVEN.instant(4.0 + off) == 4


WRONG = [
    (3.0, r"^forbidden must be times of the clock, got 3; the nearest are 2 and 4 h$"),
    (4.00001, r"the nearest are 4 and 8 h$"),
    (12.5, r"^forbidden must lie in 0\.\.12 h, got 12\.5$"),
    (-1, r"^forbidden must lie in 0\.\.12 h, got -1$"),
    (True, r"^forbidden must be times, got True$"),
    ("noon", r"^forbidden must name times, as 20, and ranges, .* got 'noon'$"),
    ("2:12:3", r"^forbidden must be times of the clock, got 5; the nearest are 4 and 8 h$"),
    ("8:4", r"^forbidden must have ranges from a number to a larger one"),
    ("4:20", r"^forbidden must lie in 0\.\.12 h, got 20$"),
]


@pytest.mark.parametrize(("written", "message"), WRONG)
def test_a_time_that_is_none_of_the_clocks_is_named_with_the_nearest(
    written: object, message: str
) -> None:
    with pytest.raises(MeasurementTimesError, match=message):
        instants_of(written, UNEVEN, "forbidden") if isinstance(written, str) else UNEVEN.instant(
            written, "forbidden"
        )  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("written", "instants"),
    [
        ([0, 0.5, 12], [0, 1, 6]),
        ("0.5:4", [1, 2, 3, 4]),
        ("0.5-4", [1, 2, 3, 4]),
        ("0:12:4", [0, 4, 5, 6]),
        (["0, 1", 8], [0, 2, 5]),
    ],
)
def test_times_are_written_as_numbers_and_ranges(written: object, instants: list[int]) -> None:
    assert instants_of(written, UNEVEN) == instants


def test_the_horizon_must_be_a_multiple_of_the_step() -> None:
    with pytest.raises(MeasurementTimesError, match=r"0\.25, got 1\.1; .* 1 and 1\.25$"):
        Clock.regular(1.1, 0.25)


@pytest.mark.parametrize("times", [(0.0, 2.0, 1.0), (0.0, 1.0, 1.0), (0.0, np.nan)])
def test_the_times_of_a_clock_ascend(times: tuple[float, ...]) -> None:
    with pytest.raises(MeasurementTimesError, match=r"^times must be"):
        Clock(times)


clocks = st.lists(st.integers(1, 12), min_size=1, max_size=12).map(
    lambda steps: Clock(tuple(np.cumsum([0, *steps]) / 4.0))
)


@given(clocks, st.integers(1, 24))
def test_two_instants_are_far_enough_apart_if_their_times_are(clock: Clock, quarters: int) -> None:
    least = quarters / 4
    spacing = Spacing(clock.successors(least))
    for a, earlier in enumerate(clock.times):
        for b, later in enumerate(clock.times[a + 1 :], start=a + 1):
            assert spacing.apart((a, b)) == (later - earlier >= least)
            assert (a <= spacing.before(b)) == (later - earlier >= least)


@given(clocks, st.integers(1, 16), st.integers(1, 4))
def test_the_feasible_sets_of_a_clock_are_those_of_brute_force(
    clock: Clock, quarters: int, number: int
) -> None:
    from itertools import combinations, pairwise

    least, instants = quarters / 4, range(clock.horizon + 1)
    expected = [
        times
        for times in combinations(instants, number)
        if all(clock.times[b] - clock.times[a] >= least for a, b in pairwise(times))
    ]
    try:
        feasible = Feasible(clock.horizon, number, minimum_spacing=least, clock=clock)
    except MeasurementTimesError:
        assert not expected
        return
    assert list(feasible.every()) == expected
    assert feasible.size == len(expected)
    assert feasible.regular() in expected
    drawn = feasible.random(20, np.random.default_rng(1))
    assert set(drawn) <= set(expected)


def test_regular_times_of_an_even_clock_are_those_of_the_paper() -> None:
    clock = Clock.regular(15.0, 0.25, "h")
    assert Feasible(60, 21, clock=clock, minimum_spacing=0.0).regular() == regular(60, 21)


def test_regular_times_of_an_uneven_clock_are_nearest_to_evenly_spaced_times() -> None:
    assert UNEVEN.times_of(UNEVEN.regular_times(4)) == [0.0, 4.0, 8.0, 12.0]
    assert UNEVEN.regular_times(7) == tuple(range(7))  # every instant once


def test_trapezoids_integrate_straight_lines_exactly() -> None:
    times, parts = np.array(UNEVEN.times), np.array(UNEVEN.trapezoids)
    assert parts.sum() == 12.0
    assert parts @ (3 * times + 1) == pytest.approx(1.5 * 12.0**2 + 12.0)


def test_a_broken_constraint_is_told_in_times_of_the_clock() -> None:
    feasible = Feasible(6, 2, forbidden=(5,), minimum_spacing=1.0, clock=UNEVEN)
    assert feasible.broken((0, 1, 5)) == [
        "measurement_budget is 2, got 3 times",
        "forbidden: 8 is measured",
        "minimum_spacing is 1.0, got 0 and 0.5",
    ]
