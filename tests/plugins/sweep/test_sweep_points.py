"""The points of a sweep: which, in which order, under which names."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oracles.in_turn import in_turn
from pfdist.errors import JobError
from pfdist.plugins.sweep.sweep_points import MOST_POINTS, points_of, values_in
from pfdist.problem.job import override


def test_every_combination_is_a_point_and_the_last_key_changes_fastest() -> None:
    points = points_of({"seed": [1, 2], "problem": {"measurement_budget": [10, 15]}})
    assert [point.name for point in points] == [
        "seed=1_measurement_budget=10",
        "seed=1_measurement_budget=15",
        "seed=2_measurement_budget=10",
        "seed=2_measurement_budget=15",
    ]
    assert points[1].changes == ["seed=1", "problem.measurement_budget=15"]


def test_points_may_be_added() -> None:
    together = {"model.parameters.sd": 0.5, "model.filter.parameters.sd": 1}
    points = points_of({"seed": "1:2"}, [together, {"seed": 9}])
    assert [tuple(point.chosen.values()) for point in points] == [(1,), (2,), (0.5, 1), (9,)]
    # The last words of both keys are alike, so the name has the whole keys.
    assert points[2].name == "model.parameters.sd=0.5_filter.parameters.sd=1"


@in_turn(
    ("text", "key", "values"),
    [
        ("seed=1:4", "seed", [1, 2, 3, 4]),
        ("seed=1:7:3, 20", "seed", [1, 4, 7, 20]),
        ("problem.measurement_budget=10,15,21", "problem.measurement_budget", [10, 15, 21]),
        ("model.parameters.sd=0.5,1e-3", "model.parameters.sd", [0.5, 1e-3]),
        ("model.name=ungm,ungm_gordon", "model.name", ["ungm", "ungm_gordon"]),
        ('model.name="mine.py:model","a,b"', "model.name", ["mine.py:model", "a,b"]),
        ("problem.forbidden=[1,2],[]", "problem.forbidden", [[1, 2], []]),
        ("problem.forbidden=['20:30'],['1:2']", "problem.forbidden", [["20:30"], ["1:2"]]),
    ],
)
def test_values_are_read_as_they_are_typed(text: str, key: str, values: list[Any]) -> None:
    assert values_in(text) == (key, values)


VALUES = st.one_of(
    st.integers(-(2**53), 2**53),
    st.floats(allow_nan=False, allow_infinity=False),
    st.booleans(),
    st.text(st.characters(codec="utf-8", exclude_characters="\x7f"), max_size=60),
    st.lists(st.integers(0, 99), max_size=5),
)


@settings(max_examples=20)
@given(st.lists(VALUES, min_size=1, max_size=6, unique_by=repr))
def test_every_value_reaches_the_job_as_it_is_and_names_are_those_of_folders(
    values: list[Any],
) -> None:
    points = points_of({"a.b": values})
    assert len({point.name for point in points}) == len(values)
    for point, value in zip(points, values, strict=True):
        data: dict[str, Any] = {}
        for change in point.changes:
            override(data, change)
        assert data == {"a": {"b": value}}
        assert type(data["a"]["b"]) is type(value)
        assert Path(point.name).name == point.name
        assert len(point.name) < 200
        assert point.name.isascii()


def test_numbers_of_numpy_are_numbers() -> None:
    points = points_of({"seed": np.arange(2), "filter.particles": [np.int64(50)]})
    assert [point.changes for point in points] == [
        ["seed=0", "filter.particles=50"],
        ["seed=1", "filter.particles=50"],
    ]


@in_turn(
    ("arguments", "words"),
    [
        (({},), "a sweep must have 1.."),
        (({"seed": []},), "values of seed must be a list, or a range such as '1:10', got []"),
        (({"seed": "3:1"},), "values of seed must have ranges FIRST:LAST"),
        (({"seed": [1, 1]},), "each point of a sweep must be given once, got seed=1 twice"),
        (
            ({"a": {"b": [1]}, "a.b": [2]},),
            "each key of a sweep must be given once, got 'a.b' twice",
        ),
        (({"execution.workers": [1, 2]},), "all points share the workers"),
        (({"seed": range(MOST_POINTS + 1)},), f"1..{MOST_POINTS} points, got 10001"),
        (({}, [{"a": None}]), "a value of a must be a number, a text, true, false or a list"),
    ],
)
def test_wrong_values_are_told_in_one_line(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(JobError) as caught:
        points_of(*arguments)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["seed", "=1", "seed= "])
def test_text_without_key_or_values_is_refused(text: str) -> None:
    with pytest.raises(JobError, match=r"a sweep goes over KEY=VALUES, for instance seed=1:10"):
        values_in(text)
