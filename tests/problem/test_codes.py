"""Codes of cells without a value: the same answers as with empty cells, but they are spent."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from pfdist import Problem
from pfdist.errors import JobError, MeasurementsError

pytestmark = pytest.mark.plugins("filter", "fit", "online")

CODES = {"failed": ["Ice"], "missing": ["Eqp", "***", "-999"]}
Y = ["1.0", "Ice", "Eqp", "***", "-999", "2.0"]
TIMES = [0, 2, 3, 5, 7, 8]


def problem(**others: Any) -> Problem:
    return Problem("random_walk", horizon=12, measurement_budget=6, engine="kalman", **others)


@pytest.mark.parametrize("kind", ["csv", "frame", "numbers"])
def test_codes_are_empty_cells_of_measurements_that_were_made(kind: str, tmp_path: Path) -> None:
    table: Any = pd.DataFrame({"t": TIMES, "y0": Y})
    if kind == "csv":
        table = tmp_path / "table.csv"
        pd.DataFrame({"t": TIMES, "y0": Y}).to_csv(table, index=False)
    elif kind == "numbers":
        table = pd.DataFrame({"t": TIMES, "y0": [1.0, *[-999] * 4, 2.0]})
    coded = problem(measurements=CODES)
    found = pfdist.filter_measurements(coded, table, report=False)
    empty = pd.DataFrame({"t": TIMES, "y0": [1.0, *[np.nan] * 4, 2.0]})
    same = pfdist.filter_measurements(problem(), empty, report=False)
    pd.testing.assert_frame_equal(found.table, same.table)
    assert (found.measured, found.failed) == ((0, 8), (2, 3, 5, 7))
    assert (same.measured, same.failed) == ((0, 8), ())  # nobody says that they were made
    left = [pfdist.next_time(coded, table).left, pfdist.next_time(problem(), empty).left]
    assert left == [0, 4]


def test_codes_are_not_part_of_a_run(tmp_path: Path) -> None:
    """A run that was planned without codes answers for a table with codes."""
    run = pfdist.plan(
        problem(), tmp_path / "run", changes=["comparison.draws=100"], bound_draws=0, figures=False
    )
    table, said = pd.DataFrame({"t": TIMES, "y0": Y}), list[str]()
    codes = (f"problem.measurements.{key}={json.dumps(each)}" for key, each in CODES.items())
    changes = ["comparison.draws=100", *codes]
    for job in (problem(), run.path):
        found = pfdist.filter_measurements(
            job, table, changes=changes, results=run.path, report=False, say=said.append
        )
        assert found.run == run.path
        assert found.failed == (2, 3, 5, 7)
    assert "measurements" not in (run.path / "job.toml").read_text()


def test_a_fit_reads_codes() -> None:
    rng = np.random.default_rng(1)
    rows = [
        (name, t, f"{y:.3f}") for name in "pqrs" for t in range(13) for y in rng.normal(0, 3, 1)
    ]
    table = pd.DataFrame(rows, columns=["id", "t", "y0"])
    gone = table.index % 5 == 2
    coded, empty = table.assign(y0=table["y0"].mask(gone, "***")), table[~gone]
    found, same = (
        pfdist.fit(problem(measurements=CODES), each, {"step_sd": (1, 1)}, replicate="id")
        for each in (coded, empty)
    )
    assert found.log_likelihood == same.log_likelihood


@pytest.mark.parametrize("codes", [{}, {"failed": ["No"]}])
def test_the_error_about_a_word_names_both_keys(codes: dict[str, Any]) -> None:
    given = problem(**({"measurements": codes} if codes else {}))
    table = pd.DataFrame({"t": [0, 2], "y0": ["1.0", "Ice"]})
    with pytest.raises(MeasurementsError) as error:
        pfdist.filter_measurements(given, table, report=False)
    for part in ("'Ice'", "row 2", "problem.measurements.failed", "problem.measurements.missing"):
        assert part in str(error.value)


def test_a_code_has_one_meaning() -> None:
    with pytest.raises(JobError, match="'Ice' in failed or in missing"):
        problem(measurements={"failed": ["Ice"], "missing": ["Eqp", "Ice"]})
