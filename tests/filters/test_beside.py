"""Errors beside that of the job: a declaration and a line, and nothing else names one."""

import re
from pathlib import Path

import pytest

import pfdist
from pfdist.filters.aspects import ErrorBeside
from pfdist.filters.beside import BESIDE, errors_beside
from pfdist.store.schema import KEYS, schema

PACKAGE = Path(pfdist.__file__).parent


@pytest.mark.parametrize("lag", [0, 3, 12, (2, 1, 0)])
def test_a_job_shows_one_other_estimate(lag: int | tuple[int, ...]) -> None:
    shown = [each.named for each in errors_beside(lag, None, ())]
    assert shown == ["filtered" if lag else "smoothed"]


@pytest.mark.parametrize("error", BESIDE, ids=lambda each: each.named)
def test_a_declared_error_has_its_table_and_its_column_and_no_module_names_it(
    error: ErrorBeside,
) -> None:
    assert error.table in KEYS
    assert error.exact_column in schema("compared", error.exact_column).names
    own = re.compile(rf"\b({error.mse}|{error.error}|{error.table}|{error.exact_column})\b")
    knowing = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if own.search(path.read_text(encoding="utf-8"))
    }
    declared = {"filters/other_estimate.py", "filters/beside.py"}
    assert knowing == declared | {"store/schema.py"}


def test_where_only_the_last_instant_counts_no_other_estimate_is_shown() -> None:
    """The filtered and the smoothed estimate of z(T) are the same, unless a value arrives later."""
    last = (0.0, 0.0, 1.0)
    assert errors_beside(0, last, ()) == errors_beside(2, last, ()) == []
    assert [each.named for each in errors_beside(2, last, (1,))] == ["filtered"]
    assert len(errors_beside(0, (0.0, 1.0, 1.0), ())) == 1
