"""The summary of a budget says which numbers reach a target, which cannot, and the table."""

from typing import Any

import pytest

from pfdist.cli.budget_summary import budget_lines
from pfdist.cli.layout import COLUMNS


def _result(kind: str, measurements: int, mse: float, error: float, **changes: Any) -> Any:
    return {
        "kind": kind,
        "measurements": measurements,
        "expected_mse": mse,
        "low": mse - 2 * error,
        "high": mse + 2 * error,
        "worse_than": None,
        "search_excess": None,
        "top_percent_share": None,
        "bound": None,
        "bound_error": None,
        "bound_low": None,
    } | changes


def _summary(scale: float = 1.0, **bound: Any) -> dict[str, Any]:
    results = {"regular_16": _result("regular", 16, 34.207 * scale, 0.195 * scale)}
    results["found_16"] = _result("found", 16, 25.846 * scale, 0.187 * scale, **bound)
    return {"results": results}


BOUND = {"bound": 25.4371, "bound_error": 0.145, "bound_low": 24.9399}


def test_the_table_has_the_bound_and_the_limit_holds_as_it_is_printed() -> None:
    lines = budget_lines(_summary(**BOUND))
    assert lines[2].endswith("  regular times             found times         lower bound")
    assert lines[3] == ("   16  34.21 (33.82 to 34.60)  25.85 (25.47 to 26.22)  25.44 (from 24.93)")
    assert all(len(line) <= COLUMNS for line in lines)


def test_an_exact_bound_has_no_limit() -> None:
    lines = budget_lines(_summary(bound=25.4371, bound_error=0.0, bound_low=25.4371))
    assert lines[3].endswith("  25.437")


def test_without_a_bound_there_is_no_column() -> None:
    assert not any("bound" in line for line in budget_lines(_summary()))


def test_the_bound_is_left_out_where_the_table_is_too_wide() -> None:
    bound = {key: 1e-20 * value for key, value in BOUND.items()}
    lines = budget_lines(_summary(1e-20, **bound))
    assert "bound" not in lines[2]
    assert lines[3].endswith("2.585e-19 (2.547e-19 to 2.622e-19)")
    assert all(len(line) <= COLUMNS for line in lines)


def test_why_there_is_no_bound_is_said_with_the_numbers() -> None:
    summary = _summary(lower_bound={"reason": "a draw is degenerate"})
    assert budget_lines(summary)[-1] == "no lower bound for N = 16: a draw is degenerate"


REACHED = {"measurements": 17, "interval": [16, 18], "larger_that_do_not": []}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, "17 found times reach it (95 %: 16 to 18); no 15 times can (95 %)"),
        ({"impossible": None}, "17 found times reach it (95 %: 16 to 18)"),
        (
            {"interval": [16, None], "larger_that_do_not": [19, 20]},
            "17 found times reach it (95 %: 16 to more), but not 19, 20; no 15 times can (95 %)",
        ),
        (
            {"measurements": None},
            "none of these numbers of found times reaches it; no 15 times can (95 %)",
        ),
    ],
)
def test_a_line_says_which_number_reaches_a_target_and_which_cannot(
    changes: dict[str, Any], told: str
) -> None:
    found = REACHED | {"impossible": 15, "measurement_times": None} | changes
    lines = budget_lines(_summary() | {"target": 25.0, "reached": {"found": found}})
    assert lines[-1] == f"target 25: {told}"


def test_a_line_names_the_sets_whose_error_few_draws_carry() -> None:
    summary = _summary(top_percent_share=0.653)
    told = (
        "1 % of the draws carry 65 % of the error of found_16: 95 % intervals are too narrow; "
        "take more draws"
    )
    assert told in " ".join(" ".join(budget_lines(summary)).split())
    assert "carry" not in " ".join(budget_lines(_summary(top_percent_share=0.25)))
