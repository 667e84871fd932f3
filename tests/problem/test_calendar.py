"""Dates of a clock: instants against Python's own arithmetic with time zones.

The oracle adds elapsed time in UTC, and looks at the local date of each instant.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime, time, timedelta
from typing import Any
from zoneinfo import ZoneInfo

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracles.in_turn import in_turn
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.problem.calendar import calendar_of
from pfdist.problem.clock import Clock
from pfdist.problem.job import Job, job_toml
from pfdist.problem.points import Points
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.written import instants_written

ZONE = "Europe/Brussels"
SPRING, AUTUMN = "2026-03-27T09:00", "2026-10-23T09:00"  # two days before the clocks change
DAYS = 240  # half-hours of five days
Matches = Callable[[datetime], bool]


def section(start: str = "2026-04-01", step: str = "1 d", zone: str = "", **keys: Any) -> Any:
    clock = {"start": start, "step": step} | ({"timezone": zone} if zone else {})
    return ProblemSection(**{"horizon": 30, "measurement_budget": 2, "clock": clock, **keys})


def half_hours(start: str, zone: str) -> Clock:
    clock: Clock = section(start, "30 min", zone, horizon=30 * DAYS).clock
    return clock


def local_dates(start: str, zone: str) -> list[datetime]:
    """The local dates of the half-hours, by addition in UTC."""
    own = ZoneInfo(zone) if zone else UTC
    first = datetime.fromisoformat(start).replace(tzinfo=own).astimezone(UTC)
    dates = [(first + k * timedelta(minutes=30)).astimezone(own) for k in range(DAYS + 1)]
    return [each.replace(tzinfo=None) for each in dates]


def between(first: str, last: str) -> Matches:
    low, high = time.fromisoformat(first), time.fromisoformat(last)
    return lambda moment: low <= moment.time() <= high


WORDS: dict[str, Matches] = {
    "sat": lambda moment: moment.isoweekday() == 6,
    "mon..fri": lambda moment: moment.isoweekday() <= 5,
    "SUN..tue": lambda moment: moment.isoweekday() in (7, 1, 2),
    "08:00..18:00": between("08:00", "18:00"),
    "02:00..03:00": between("02:00", "03:00"),  # an hour that is skipped, and one that occurs twice
    "22:00..06:00": lambda moment: not 6 * 60 < 60 * moment.hour + moment.minute < 22 * 60,
    "sat..sun 22:00..06:00": lambda moment: (
        moment.isoweekday() > 5 and (moment.hour >= 22 or moment.time() <= time(6))
    ),
    "mon..fri 08:00..09:30, sun": lambda moment: (
        moment.isoweekday() == 7
        or (moment.isoweekday() <= 5 and time(8) <= moment.time() <= time(9, 30))
    ),
}


@in_turn("zone", [ZONE, "", "America/New_York"])
@in_turn("start", [SPRING, AUTUMN])
@in_turn("text", WORDS)
def test_a_text_means_the_instants_whose_local_date_matches(
    text: str, start: str, zone: str
) -> None:
    dates, matches = local_dates(start, zone), WORDS[text]
    found = instants_written(text, half_hours(start, zone))
    assert sorted(found) == [k for k, moment in enumerate(dates) if matches(moment)]


@pytest.mark.parametrize("start", [SPRING, AUTUMN])
@settings(max_examples=10)
@given(ends=st.tuples(st.integers(0, DAYS), st.integers(0, DAYS)).map(sorted))
def test_a_range_of_dates_has_both_ends(start: str, ends: list[int]) -> None:
    clock, (first, last) = half_hours(start, ZONE), ends
    written = Points(clock).written_of(range(DAYS + 1))
    assert instants_written(f"{written[first]}..{written[last]}", clock) == [
        *range(first, last + 1)
    ]
    days = [moment.date() for moment in local_dates(start, ZONE)]
    found = instants_written(f"{days[first]}..{days[last]}", clock)
    assert found == [k for k, day in enumerate(days) if days[first] <= day <= days[last]]


@pytest.mark.parametrize("start", [SPRING, AUTUMN])
@pytest.mark.parametrize("zone", [ZONE, ""])
def test_each_instant_has_one_date_also_in_the_hour_that_occurs_twice(
    start: str, zone: str
) -> None:
    clock = half_hours(start, zone)
    written = Points(clock).written_of(range(DAYS + 1))
    assert len({*written}) == DAYS + 1
    assert [clock.instant(text) for text in written] == [*range(DAYS + 1)]
    assert list(Points(clock).read(written)) == [*range(DAYS + 1)]
    fresh = replace(clock)  # read by the grammar, not as written before
    assert [t for text in written for t in fresh.dated(f" {text}")] == [*range(DAYS + 1)]
    assert [text[:16] for text in written] == [
        f"{each:%Y-%m-%dT%H:%M}" for each in local_dates(start, zone)
    ]


def test_the_hour_that_occurs_twice_has_its_offset_and_the_skipped_one_does_not_exist() -> None:
    clock = half_hours(AUTUMN, ZONE)
    twice = [text for text in Points(clock).written_of(range(DAYS + 1)) if "T02:" in str(text)]
    assert "2026-10-25T02:30+02:00" in twice
    assert "2026-10-25T02:30+01:00" in twice
    early, late = (clock.instant(f"2026-10-25T02:30+0{hour}:00") for hour in (2, 1))
    assert late - early == 2
    with pytest.raises(MeasurementTimesError, match=r"write 2026-10-25T02:30\+02:00 or"):
        clock.instant("2026-10-25T02:30")
    with pytest.raises(MeasurementTimesError, match="must exist in Europe/Brussels"):
        half_hours(SPRING, ZONE).instant("2026-03-29T02:30")


@given(
    start=st.datetimes(datetime(1950, 1, 1), datetime(2100, 1, 1)).map(
        lambda each: each.replace(second=0, microsecond=0)
    ),
    step=st.sampled_from(["1 d", "30 min", "2 w", "90 s", "6 h", "0.5 h"]),
    zone=st.sampled_from([ZONE, "Asia/Kathmandu", "UTC"]),
)
def test_a_unit_names_its_start_and_zone(start: datetime, step: str, zone: str) -> None:
    number, name = float(step.split(maxsplit=1)[0]), step.split()[1]
    moment = start.replace(tzinfo=UTC).astimezone(ZoneInfo(zone))
    clock = section(moment.isoformat(timespec="minutes"), step, zone, horizon=number * 50).clock
    calendar = calendar_of(clock.time_unit)
    assert calendar == clock.calendar
    assert calendar is not None
    assert (clock.unit, calendar.unit, calendar.start) == (name, name, moment)
    length = {"s": 1, "min": 60, "h": 3600, "d": 86400, "w": 604800}[name] * number
    later = moment.astimezone(UTC) + timedelta(seconds=50 * length)
    assert clock.dates[50].astimezone(UTC) == later


def test_days_from_midnight_are_written_without_an_hour() -> None:
    clock = section().clock
    assert Points(clock).written_of([0, 10]) == ["2026-04-01", "2026-04-11"]
    assert clock.formatted(30) == "2026-05-01"
    assert section("2026-04-01", "6 h").points.written(0) == "2026-04-01T00:00"
    assert section("2026-04-01", zone=ZONE).points.written(0) == "2026-04-01T00:00"
    assert section("2026-04-01T08:00").points.written(1) == "2026-04-02T08:00"


def test_times_may_be_numbers_texts_and_objects_of_python_and_pandas() -> None:
    clock = section("2026-04-01T08:00", "12 h", horizon=36).clock
    moment = datetime(2026, 4, 2, 20)
    for written in (36, 36.0, "36", "2026-04-02 20:00", "2026-04-02T20:00:00", moment):
        assert instants_written([written], clock) == [3]
    assert instants_written([pd.Timestamp(moment), date(2026, 4, 2)], clock) == [3, 2, 3]


def test_allowed_entries_are_united_words_of_an_entry_intersected() -> None:
    problem = section(allowed=["mon 00:00..12:00", "2026-04-02"], forbidden=["2026-04-13"])
    assert problem.points.written_of(problem.feasible.allowed) == [
        "2026-04-02", "2026-04-06", "2026-04-20", "2026-04-27",
    ]  # fmt: skip
    counted = ProblemSection(horizon=9, measurement_budget=2, allowed=[0, "4:6"])
    assert counted.feasible.allowed == (0, 4, 5, 6)


def test_sensors_follow_the_dates_of_their_entry() -> None:
    sensors = {"ct": {"allowed": ["sat..sun"]}, "x-ray": {"forbidden": ["2026-04-02"]}}
    problem = section(sensors=sensors, required=["2026-04-04 ct, mon 2026-04-01..2026-04-08 x-ray"])
    points = problem.points
    assert points.written_of(problem.feasible.required) == ["2026-04-04 ct", "2026-04-06 x-ray"]
    assert points.read("2026-04-04, 2026-04-05 ct") == (6, 8)
    barred = points.written_of(problem.feasible.forbidden)
    assert "2026-04-02 x-ray" in barred
    assert "2026-04-03 ct" in barred
    assert "2026-04-04 ct" not in barred


@in_turn(
    ("cell", "message"),
    [
        ("24/10/2026 08:00", "^t must be a date, as 2026-04-01 or 2026-04-01T08:00, got '24/10/20"),
        ("mon..fri", "^t must be a date"),
        ("2026-04-02 8:00 PM", "^t must be a date"),
        ("1792821600", "^t must lie in 2026-04-01..2026-05-01, got 1792821600$"),
    ],
)
def test_a_cell_of_a_table_is_a_date_or_a_number_of_the_horizon(cell: str, message: str) -> None:
    read = section().clock.readers()["t"]
    assert read("2026-04-03") == read("2") == 2
    with pytest.raises(MeasurementTimesError, match=message):
        read(cell)


def test_the_horizon_and_the_times_of_a_clock_may_be_dates() -> None:
    assert section(horizon="2026-04-11").clock.horizon == 10
    uneven = section(horizon=None, times=["2026-04-01", "2026-04-08", 10])
    assert uneven.points.written_of([0, 1, 2]) == ["2026-04-01", "2026-04-08", "2026-04-11"]
    assert uneven.horizon is None


def test_a_job_without_dates_has_no_new_key_and_one_with_dates_is_read_again() -> None:
    plain = Job(seed=1, problem={"horizon": 9, "measurement_budget": 2})
    assert not {"clock", "dates", "allowed"} & {*plain.identity()["problem"]}
    clock = {"start": datetime(2026, 4, 1, 8), "step": "30 min", "timezone": ZONE}
    keys = {"horizon": "2026-04-02", "measurement_budget": 2, "required": [date(2026, 4, 2)]}
    job = Job(seed=1, problem={**keys, "clock": clock})
    identity = job.identity()
    assert identity["problem"]["clock"]["start"] == "2026-04-01T08:00:00"
    assert identity["problem"]["horizon"] == 960
    assert 'timezone = "Europe/Brussels"' in job_toml(identity)
    assert Job(**identity).identity() == identity
    assert job.with_changes(["seed=2"]).problem == job.problem


def test_a_whole_float_is_an_instant() -> None:
    clock = Clock.counting(9)
    assert instants_written([2.0, "3.0", "4.0:6.00"], clock) == [2, 3, 4, 5, 6]
    for wrong in (2.5, "2.5", float("inf")):
        with pytest.raises(MeasurementTimesError):
            instants_written([wrong], clock)


BOTH = r"2026-04-01\.\.2026-05-01, hours of the day, as 08:00\.\.18:00"


@in_turn(
    ("keys", "message"),
    [
        ({"required": ["20:30"]}, f"problem.required must name dates, .*{BOTH}.*'20:30'"),
        ({"required": ["2026-06-01"]}, "must lie in the horizon, 2026-04-01..2026-05-01, got 2026"),
        ({"required": ["2026-04-02T09:00"]}, "must be times of the clock, got 2026-04-02T09:00; the"
         " nearest are 2026-04-02 and 2026-04-03"),
        ({"required": [31]}, r"must lie in 2026-04-01\.\.2026-05-01, got 2026-05-02"),
        ({"allowed": ["08:00..09:00"]}, "allowed must name instants of the clock, got none in '08"),
        ({"allowed": ["mon..fri"], "required": ["2026-04-04"]}, "problem.allowed or problem.forbid"
         "den and required must have no time in common, got 2026-04-04 in both"),
        ({"required": ["2026-04-31"]}, "dates and hours that exist, got 2026-04-31"),
        ({"required": ["2026-04-02T00:00+02:00"]}, "must be a local time"),
        ({"time_step": 2}, "problem.time_step must be left out, because clock.step"),
        ({"clock": None, "time_unit": "d since 2026-04-01"}, "time_unit must have no start"),
        ({"clock": None, "required": ["2026-04-02"]}, "because clock.start is not given"),
        ({"horizon": "soon"}, "problem.horizon must be a date"),
        ({"horizon": "2026-04-01T12:00"}, "must be 1 to 32,000 steps of clock.step"),
        ({"horizon": 8, "clock": None, "time_step": 30}, "= 30, got 8: did you mean 240?"),
        ({"clock": {"start": "2026-04-01"}}, "problem.clock.step must be given"),
        ({"clock": {"start": "1 April", "step": "1 d"}}, "problem.clock.start must be a date"),
        ({"clock": {"start": "9999-12-20", "step": "1 d"}}, "must lie in the years 1000 to 90"),
        ({"clock": {"start": "2026-04-01", "step": "1 month"}}, "problem.clock.step must be a num"),
        ({"clock": {"start": "2026-04-01", "step": "1 d", "timezone": "Mars"}}, "timezone must be"),
    ],
)  # fmt: skip
def test_a_mistake_is_an_error_of_one_line(keys: dict[str, Any], message: str) -> None:
    problem = {
        "horizon": 30,
        "measurement_budget": 2,
        "clock": {"start": "2026-04-01", "step": "1 d"},
        **keys,
    }
    filled = {key: value for key, value in problem.items() if value is not None}
    with pytest.raises(JobError) as error:
        Job(seed=1, problem=filled)
    assert re.search(message, str(error.value)), str(error.value)
    assert "\n" not in str(error.value)


def test_a_date_may_have_a_space_before_its_hour_everywhere() -> None:
    """As `start`, `required` and options have it."""
    texts = [f"2026-04-03{mark}08:00" for mark in ("T", " ")]
    first, second = (
        section("2026-04-01 08:00", "2 h", horizon=text, required=[text]) for text in texts
    )
    assert first.clock == second.clock
    assert first.feasible.required == second.feasible.required == (24,)
