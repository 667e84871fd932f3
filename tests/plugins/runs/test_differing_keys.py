"""The keys in which jobs differ."""

from typing import Any

import pytest

from pfdist.common.dotted_keys import short_names
from pfdist.plugins.runs.runs_table import differing_keys

JOB: dict[str, Any] = {
    "seed": 1,
    "model": {"name": "ungm", "parameters": {"process_sd": 2.0}},
    "search": [{"name": "a", "method": "random", "evaluations": 3}],
    "comparison": {"draws": 10, "reference": "regular"},
}


def test_equal_jobs_differ_in_nothing() -> None:
    assert differing_keys([JOB, JOB, JOB]) == {}
    assert differing_keys([JOB]) == differing_keys([]) == {}


def test_a_key_that_differs_in_any_job_has_a_value_for_each() -> None:
    other = JOB | {"seed": 2, "model": {"name": "ungm", "parameters": {}}}
    assert differing_keys([JOB, other, JOB]) == {
        "seed": [1, 2, 1],
        "model.parameters.process_sd": [2.0, None, 2.0],
    }


def test_searches_are_known_by_their_names_whatever_their_order() -> None:
    first = {"name": "b", "method": "random", "evaluations": 3}
    other = JOB | {"search": [first, {**JOB["search"][0], "evaluations": 9}]}
    assert differing_keys([JOB, other]) == {
        "search.order": ["a", "b, a"],
        "search.a.evaluations": [3, 9],
        "search.b.method": [None, "random"],
        "search.b.evaluations": [None, 3],
    }
    assert "search" not in differing_keys([JOB, JOB | {"search": []}])


def test_lists_are_tuples_and_types_are_kept() -> None:
    other = JOB | {"comparison": {"draws": 10, "reference": [0, 3.5]}}
    assert differing_keys([JOB, other]) == {"comparison.reference": ["regular", (0, 3.5)]}


@pytest.mark.parametrize(
    ("keys", "short"),
    [
        (["seed", "filter.particles"], ["seed", "particles"]),
        (["filter.particles", "search.a.particles"], ["filter.particles", "a.particles"]),
        (["comparison.draws"], ["comparison.draws"]),
        (["search.order", "model.name"], ["search.order", "model.name"]),
        (["run", "set", "problem.set"], ["run", "set", "problem.set"]),
    ],
)
def test_a_short_name_is_the_shortest_end_that_only_this_key_has(
    keys: list[str], short: list[str]
) -> None:
    assert list(short_names(keys).values()) == short
