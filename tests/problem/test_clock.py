"""The clock of a problem: times are turned into instants, and instants into times."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfdist.common.measurement_times import regular
from pfdist.constraints.spacing import Spacing
from pfdist.errors import MeasurementTimesError
from pfdist.problem.calendar import Calendar
from pfdist.problem.clock import Clock
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.written import clock_of, instants_written

UNEVEN = Clock((0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0), "h")


def test_the_times_of_a_regular_clock_are_multiples_of_the_step() -> None:
    assert Clock.regular(1.2, 0.1).times[3] == 0.3
    assert Clock.regular(1.2, 0.1).horizon == 12


@pytest.mark.parametrize("off", [0.0, 4e-10, -4e-10])
def test_a_time_means_an_instant_if_it_differs_by_at_most_a_billionth(off: float) -> None:
    assert UNEVEN.instant(4.0 + off) == 4


@pytest.mark.parametrize(
    ("horizon", "steps"), [(24, 1440), (200, 600), (240, 2880), (1.0, 32_000), (1e-8, 10)]
)
def test_a_clock_of_equal_steps_is_even_and_every_multiple_is_an_instant(
    horizon: float, steps: int
) -> None:
    """The times are rounded to 12 digits: neither the steps nor typed times notice it."""
    clock = Clock.regular(horizon, horizon / steps)
    assert clock.is_even
    assert clock.since(1).is_even
    assert clock.since(clock.horizon).is_even  # a single instant
    assert [clock.instant(k * horizon / steps) for k in range(steps + 1)] == [*range(steps + 1)]
    assert clock.successors(2 * horizon / steps)[:-1] == (*range(2, steps + 1), steps + 1)
    assert len(Clock.regular(24, 0.0166666666667).times) == 1441  # as a person types 1/60
    assert not Clock((0.0, 1.0, 2.0, 3.001)).is_even


FAR = [(1.7e9, 1.0), (1.7e9, 0.25), (2_460_000.5, 1 / 86_400), (0.0, 1e-9)]


@pytest.mark.parametrize(("begin", "step"), FAR)
def test_the_tolerance_is_a_part_of_the_step_and_not_of_the_time(begin: float, step: float) -> None:
    """Seconds since 1970, Julian dates in steps of a second, and steps of a nanosecond."""
    clock = Clock(tuple(begin + k * step for k in range(20)))
    for k in (0, 1, 10, 19):
        assert clock.instant(begin + k * step) == k
    assert clock.between(clock.times[5], clock.times[9]) == range(5, 10)
    with pytest.raises(MeasurementTimesError, match="the nearest are"):
        clock.instant(begin + 5.01 * step)
    with pytest.raises(MeasurementTimesError, match="must lie in"):
        clock.instant(begin + 19.01 * step)
    assert clock.successors(step)[:3] == (1, 2, 3)


def test_whole_numbers_alone_count_instants() -> None:
    clock = Clock.counting(12)
    assert Points(clock).read([3, 4.0, np.int64(20), np.float64(5)]) == (3, 4, 20, 5)
    for wrong in (0.7, np.nan, np.inf):
        with pytest.raises(MeasurementTimesError, match=r"must name times, as 20, .*, got "):
            Points(clock).read([wrong])
    with pytest.raises(MeasurementTimesError, match="must be times, got '3'"):
        clock.instant("3")


def test_a_range_of_a_clock_may_span_many_units_but_no_clock_has_so_many_instants() -> None:
    clock = Clock.regular(5_000_000, 1_000_000, "s")
    assert instants_written("0:5000000", clock) == [0, 1, 2, 3, 4, 5]
    with pytest.raises(MeasurementTimesError, match="at most 1,000,000 numbers"):
        clock_of("0:5000000")


@pytest.mark.parametrize("text", ["0:2.5", "0:1:0.3"])
def test_the_end_of_a_range_is_a_time_of_the_clock(text: str) -> None:
    with pytest.raises(
        MeasurementTimesError, match=r"^times must have ranges .* steps lead from F"
    ):
        clock_of(text)
    assert clock_of("0:0.3:0.1").times == (0.0, 0.1, 0.2, 0.3)
    assert clock_of("0.5:2.5").times == (0.5, 1.5, 2.5)


WRONG = [
    (3.0, r"^forbidden must be times of the clock, got 3; the nearest are 2 and 4 h$"),
    (12.5, r"^forbidden must lie in 0\.\.12 h, got 12\.5$"),
    (True, r"^forbidden must be times, got True$"),
    ("noon", r"^forbidden must name times, as 20, and ranges, .* got 'noon'$"),
    ("8:4", r"^forbidden must have ranges FIRST:LAST with FIRST <= LAST"),
    ("4:20", r"^forbidden must lie in 0\.\.12 h, got 20$"),
]


@pytest.mark.parametrize(("written", "message"), WRONG)
def test_a_time_that_is_none_of_the_clocks_is_named_with_the_nearest(
    written: object, message: str
) -> None:
    with pytest.raises(MeasurementTimesError, match=message):
        instants_written(written, UNEVEN, "forbidden") if isinstance(
            written, str
        ) else UNEVEN.instant(written, "forbidden")  # type: ignore[arg-type]


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
    assert instants_written(written, UNEVEN) == instants


def test_a_clock_may_have_one_step_and_has_at_least_one() -> None:
    once = ProblemSection(horizon=0.5, time_step=0.5, measurement_budget=1)
    assert once.clock.times == (0.0, 0.5)
    with pytest.raises(ValueError, match="must be 1 to 32,000 steps"):
        ProblemSection(horizon=0.5, time_step=2.0, measurement_budget=1)


def test_the_horizon_must_be_a_multiple_of_the_step() -> None:
    with pytest.raises(MeasurementTimesError, match=r"0\.25, got 1\.1; .* 1 and 1\.25$"):
        Clock.regular(1.1, 0.25)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ((0.0, 1.0, 1.0), "^times must be in ascending order, got 1 before 1$"),
        ((1.7e9, 1.7e9 + 60, 1.7e9 + 30), "got 1700000060 before 1700000030$"),
        ((0.0, np.nan), "^times must be finite numbers, got nan$"),
    ],
)
def test_the_times_of_a_clock_ascend(times: tuple[float, ...], words: str) -> None:
    with pytest.raises(MeasurementTimesError, match=words):
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
            assert spacing.allows((a, b)) == (later - earlier >= least)
            assert (a <= spacing.before(b)) == (later - earlier >= least)


@given(clocks, st.integers(1, 16), st.integers(1, 4))
def test_the_feasible_sets_of_a_clock_are_those_of_brute_force(
    clock: Clock, quarters: int, number: int
) -> None:
    least, instants = quarters / 4, range(clock.horizon + 1)
    expected = [
        times
        for times in combinations(instants, number)
        if all(clock.times[b] - clock.times[a] >= least for a, b in pairwise(times))
    ]
    try:
        feasible = Feasible(clock.horizon, number, minimum_spacing=least, points=Points(clock))
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
    assert Feasible(60, 21, points=Points(clock), minimum_spacing=0.0).regular() == regular(60, 21)


def test_regular_times_of_an_uneven_clock_are_nearest_to_evenly_spaced_times() -> None:
    assert UNEVEN.times_of(UNEVEN.regular_times(4)) == [0.0, 4.0, 8.0, 12.0]
    assert UNEVEN.regular_times(7) == tuple(range(7))  # every instant once
    nearest = min(range(7), key=lambda t: abs(UNEVEN.times[t] - UNEVEN.times[-1] / 2))
    assert UNEVEN.regular_times(1) == Feasible(6, 1, points=Points(UNEVEN)).regular() == (nearest,)


def test_trapezoids_integrate_straight_lines_exactly() -> None:
    times, parts = np.array(UNEVEN.times), np.array(UNEVEN.trapezoids)
    assert parts.sum() == 12.0
    assert parts @ (3 * times + 1) == pytest.approx(1.5 * 12.0**2 + 12.0)


def test_a_broken_constraint_is_told_in_times_of_the_clock() -> None:
    feasible = Feasible(6, 2, forbidden=(5,), minimum_spacing=1.0, points=Points(UNEVEN))
    assert feasible.broken((0, 1, 5)) == [
        "measurement_budget is 2, got 3 times",
        "forbidden: 8 is measured",
        "minimum_spacing is 1.0, got 0 and 0.5",
    ]


def test_times_of_a_sensor_that_is_always_on_are_a_range() -> None:
    """Published case: 41 times of a sonde hid those of three grab samples."""
    sonde, grab = [f"{t} sonde" for t in range(9)], ["3 grab", "7 grab"]
    assert (
        Clock.counting(9).listed([*sonde[:4], *grab, *sonde[4:]]) == "0 to 8 sonde, 3 grab, 7 grab"
    )
    assert Clock.counting(9).listed(["1 grab", "2 sonde"]) == "1 grab, 2 sonde"
    hours = Clock.regular(20, 0.5, "h")
    assert hours.listed([0, *(2 + k / 2 for k in range(8)), 8]) == "0, 2 to 5.5, 8 h"
    assert hours.listed([k / 2 for k in range(7)]) == "0, 0.5, 1, 1.5, 2, 2.5, 3 h"
    days = replace(Clock.regular(9, 1, "d"), calendar=Calendar.starting("2027-04-01", "d"))
    always = [f"2027-04-0{k} sonde" for k in range(1, 9)]
    assert days.listed([*always, "2027-04-05 grab"]) == (
        "2027-04-01T00:00 to 2027-04-08T00:00 sonde, 2027-04-05 grab"
    )
    assert [*days.ranges([*always, "2027-04-05 grab"])] == always
    long = Clock.counting(30_000)
    assert long.listed(range(30_001)) == "0 to 30000"  # the work grows with the number of times
