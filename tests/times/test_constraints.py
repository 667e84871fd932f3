"""Which constraints a set of times breaks, in sentences."""

from typing import Any

import pytest

from pfdist.times.feasible import Feasible

GIVEN: dict[str, Any] = {"forbidden": (3, 4), "required": (6,), "minimum_spacing": 2}
COUNTED = Feasible(10, 3, **GIVEN)
PAID = Feasible(10, cost=(2,) * 11, total_cost=7, **GIVEN)


@pytest.mark.parametrize(
    ("feasible", "times", "sentences"),
    [
        (COUNTED, (1, 6, 8), []),
        (PAID, (6,), []),  # money that is left over breaks nothing
        (COUNTED, (6, 8), ["measurement_budget is 3, got 2 times"]),
        (COUNTED, (0, 3, 6), ["forbidden: 3 is measured"]),
        (COUNTED, (0, 2, 8), ["required: 6 is not measured"]),
        (COUNTED, (5, 6, 7), ["minimum_spacing is 2, got 5 and 6, 6 and 7"]),
        (PAID, (0, 6, 8, 10), ["total_cost is 7, got times that cost 8"]),
        (
            COUNTED,
            (3, 4, 0, 9),
            [
                "measurement_budget is 3, got 4 times",
                "forbidden: 3, 4 are measured",
                "required: 6 is not measured",
                "minimum_spacing is 2, got 3 and 4",
            ],
        ),
    ],
)
def test_every_broken_constraint_is_named_with_what_breaks_it(
    feasible: Feasible, times: tuple[int, ...], sentences: list[str]
) -> None:
    assert feasible.broken(times) == sentences
