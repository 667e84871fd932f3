"""Possible measurements: pairs of a time and a sensor, with constraints on each sensor."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

from oracles.in_turn import in_turn
from pfdist.constraints.spacing import Spacing
from pfdist.errors import MeasurementTimesError
from pfdist.problem.clock import Clock
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.problem.shared import Limit, OfSensors

POINTS = Points(Clock.counting(4), ("ct", "x-ray"))
FREE = Feasible(4, 3, minimum_spacing=0, points=POINTS)
ONE, TWO, FAR = Limit(most=1), Limit(most=2), Limit(spacing=Spacing.constant(2, 4))
LIMITS = {
    OfSensors.on(POINTS, limits): limits
    for limits in [(ONE, FAR), (TWO, Limit()), (TWO, ONE), (FAR, Limit())]
}
ONE_FAR, TWO_FREE, TWO_ONE, FAR_FREE = LIMITS
LIMITED = replace(FREE, shared=(ONE_FAR,), forbidden=(3,))
PRICED = Feasible(
    4, None, minimum_spacing=0, points=POINTS, price=(1, 3) * 5, total_price=5, cheapest=0
)
LIMITED_MONEY = replace(PRICED, shared=(TWO_FREE,), smaller=True)


def _by_definition(feasible: Feasible, times: tuple[int, ...]) -> bool:
    """Whether a set keeps the constraints, from their definitions, with pairs (t, sensor)."""
    pairs = [divmod(time, 2) for time in times]
    if {*times} & {*feasible.forbidden} or not {*feasible.required} <= {*times}:
        return False
    far = feasible.minimum_spacing
    if any(abs(a - b) < far for (a, _), (b, _) in combinations(pairs, 2)):
        return False
    limits = (limit for each in feasible.shared for limit in LIMITS[each])
    for sensor, limit in enumerate(limits):
        own = [t for t, s in pairs if s == sensor]
        if limit.most is not None and len(own) > limit.most:
            return False
        if limit.spacing and any(b - a < 2 for a, b in combinations(own, 2)):
            return False
    if feasible.counted:
        return len(times) == feasible.total
    return sum((1, 3)[s] for _, s in pairs) <= (feasible.total_price or 0)


ALL = [times for size in range(6) for times in combinations(range(10), size)]
EACH = {
    "free": FREE,
    "apart": replace(FREE, minimum_spacing=1),
    "limited": LIMITED,
    "limited and required": replace(LIMITED, required=(1,)),
    "limited money": LIMITED_MONEY,
    "limited money, one sensor at a time": replace(LIMITED_MONEY, minimum_spacing=1),
    "limited money, all apart": replace(
        LIMITED_MONEY, minimum_spacing=2, shared=(TWO_ONE,), total_price=6
    ),
    "spaced money, one sensor at a time": replace(
        LIMITED_MONEY, minimum_spacing=1, shared=(FAR_FREE,)
    ),
}


@in_turn("name", EACH)
def test_the_feasible_sets_are_those_of_the_definition(name: str) -> None:
    feasible = EACH[name]
    wanted = {times for times in ALL if _by_definition(feasible, times)}
    assert {*feasible.every()} == wanted
    assert feasible.size == len(wanted)
    assert {times for times in ALL if feasible.accepts(times)} == wanted


@in_turn("name", EACH)
def test_every_way_to_a_set_leads_to_feasible_sets_alone(name: str) -> None:
    """Prefixes, additions, exchanges, removals, repairs and random sets all stay feasible."""
    feasible, rng = EACH[name], np.random.default_rng(1)
    wanted = {*feasible.every()}
    reached, front = set(), [()]
    while front:
        prefix = front.pop()
        reached |= {prefix} & wanted
        front += [(*prefix, t) for t in feasible.extensions(prefix)]
        dead_end = prefix not in wanted and not feasible.extensions(prefix)
        assert not dead_end, prefix
    assert reached == wanted
    for times in wanted:
        assert {*feasible.exchanges(times)} <= wanted - {times}
    assert {*feasible.random(50, rng)} <= wanted
    assert {feasible.repair(times, rng) for times in ALL[::7]} <= wanted
    smaller = {times[:1] for times in wanted if times}
    for times in smaller:
        for larger in feasible.additions(times):
            assert any({*larger} <= {*each} for each in wanted)
    for times in feasible.removals(tuple(range(10))):
        assert any({*each} <= {*times} for each in wanted)
    assert feasible.regular() in wanted


def test_one_sensor_alone_and_rotation_are_references() -> None:
    """Two ticks of each at regular times; a sensor that cannot make them has no set."""
    references = FREE.references
    assert references == {
        "alone_ct": (0, 4, 8), "alone_x_ray": (1, 5, 9), "rotation": (0, 5, 8)
    }  # fmt: skip
    assert FREE.regular() == (0, 4, 8)
    assert replace(FREE, cheapest=1).regular() == (1, 5, 9)
    assert "alone_ct" not in LIMITED.references  # it may measure once, and 3 are wanted
    assert PRICED.references["alone_x_ray"] == (5,)  # 5 pays for one measurement of 3


@in_turn("sensors", [(), ("ct", "x-ray"), ("a", "b", "c")])
def test_the_table_lists_the_sensors_of_each_instant_one_after_another(
    sensors: tuple[str, ...],
) -> None:
    """All that the table says of a point, from an enumeration of instants and sensors."""
    points = Points(Clock.counting(4), sensors)
    table = [*product(range(5), sensors or ("",))]
    assert points.number == len(table)
    for point, (t, sensor) in enumerate(table):
        assert (points.instant(point), points.sensor(point)) == (t, sensor)
        assert point in points.at(t)
        assert points.first(t) <= point < points.first(t + 1)
        assert [*points.alike(point)] == [k for k, each in enumerate(table) if each[1] == sensor]
        assert points.of_way(points.way(point), [point]) == (t,)
    later = points.since(2)
    assert later.number == len([t for t, _ in table if t >= 2])
    assert later.written(0) == points.written(points.first(2))


@in_turn(("t", "sensor"), [*product(range(5), range(2))])
def test_a_measurement_is_read_as_it_is_written(t: int, sensor: int) -> None:
    number = 2 * t + sensor
    written = POINTS.written(number)
    assert written == f"{t} {POINTS.sensors[sensor]}"
    assert POINTS.read([written]) == (number,)


@pytest.mark.parametrize(
    ("written", "numbers"),
    [("0, 2:4 ct, 1 x-ray", [0, 4, 6, 8, 3]), (["0:4:2 x-ray", "1 ct"], [1, 5, 9, 2]), ("", [])],
)
def test_several_times_may_precede_their_sensor(written: object, numbers: list[int]) -> None:
    assert POINTS.read(written) == tuple(numbers)


def test_times_without_a_sensor_mean_all_sensors_where_this_is_meant() -> None:
    assert POINTS.read([1, "3 ct"], of_all=True) == (2, 3, 6)
    assert POINTS.read(["3 ct", 1], of_all=True) == (6, 2, 3)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("3", "must name times and then their sensor, as '12 ct', got '3'"),
        ("3 cat", "got '3 cat'; sensors: ct, x-ray"),
        ("9 ct", "must lie in 0..4, got 9"),
        ("0 ct 0 ct", ""),
    ],
)
def test_a_wrong_measurement_is_named(written: str, said: str) -> None:
    if not said:
        assert POINTS.read(written) == (0, 0)  # a set is checked for repetitions
        return
    with pytest.raises(MeasurementTimesError, match=said.replace(".", r"\.")):
        POINTS.read(written)


@pytest.mark.parametrize("written", ["x ct", "ct", "0 ct x-ray", "3 cat", "3", 3])
def test_a_measurement_without_a_time_or_a_sensor_is_named(written: str | int) -> None:
    with pytest.raises(
        MeasurementTimesError, match="must name times and then their sensor, as '12 ct'"
    ):
        POINTS.read([written])


@pytest.mark.parametrize(
    "points", [POINTS, Points(Clock.counting(9))], ids=["sensors", "one sensor"]
)
def test_several_sets_where_a_set_is_expected_are_refused(points: Points) -> None:
    """They would be one set of all their measurements."""
    with pytest.raises(MeasurementTimesError, match="sets have names"):
        points.checked([[1, 2], [3, 4]])


def test_n_measurements_under_limits_and_a_spacing_of_all_are_refused() -> None:
    with pytest.raises(MeasurementTimesError, match="minimum_spacing must be left out"):
        replace(LIMITED, minimum_spacing=1)
