"""Many runs as one table: the keys in which they differ, and a row for each set."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pfdist.common.dotted_keys import leaves
from pfdist.results.columns import Row, rows_of
from pfdist.results.gains import GAINS
from pfdist.results.run import Run
from pfdist.results.stored_run import evaluations_of, problem_of, version_of

_NO_SEARCH = "search"  # the leaf of an empty list


def differing_keys(jobs: Iterable[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """The keys in which jobs differ, each with the value of every job.

    Parameters
    ----------
    jobs : iterable of mapping
        Resolved jobs, as `pfdist.results.Run.job`.

    Returns
    -------
    dict of str to list
        The keys are dotted, in the order of the jobs' sections. The names of searches are in
        ``search.order`` alone. None stands for a key that a job lacks. Lists are tuples.

    Examples
    --------
    >>> differing_keys([{"seed": 1, "filter": {"particles": 9}}, {"seed": 2, "filter": {}}])
    {'seed': [1, 2], 'filter.particles': [9, None]}
    """
    flat = [{key: _frozen(value) for key, value in leaves(job)} for job in jobs]
    columns = {
        key: [each.get(key) for each in flat]
        for key in dict.fromkeys(key for each in flat for key in each)
        # The key search.order says what these say.
        if key != _NO_SEARCH and not (key.startswith("search.") and key.endswith(".name"))
    }
    return {
        key: values
        for key, values in columns.items()
        if any(value != values[0] for value in values[1:])
    }


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


# --- the table ------------------------------------------------------------------------------------

_OF_A_SET = (
    "expected_mse", "standard_error", "reference",
    *(f"{gain}{end}" for gain in GAINS[:3] for end in ("", "_low", "_high")),
    "bound", "bound_gap", "bound_gap_at_most", "measurements", "measurement_times",
)  # fmt: skip
RESULTS = (
    "set", "state", "draws", *_OF_A_SET[:3], "reference_mse", "reference_standard_error",
    *_OF_A_SET[3:], "evaluations", "worker_seconds", "path",
)  # fmt: skip
"""Columns of a table of runs that follow the run and the differing keys."""
_NUMBERS = {name for name in RESULTS if name.startswith((*GAINS, "bound", "worker"))} | {
    name for name in RESULTS if name.endswith(("_mse", "standard_error"))
}
Results = dict[str, Any]


def runs_table(runs: Sequence[Run]) -> pd.DataFrame:
    """A row for each run and each compared set other than the reference.

    Parameters
    ----------
    runs : sequence of Run
        Each folder once.

    Returns
    -------
    DataFrame
        As `pfdist.table` gives it.

    Raises
    ------
    StoreError
        A table of a run cannot be read.
    """
    keys = differing_keys([run.job for run in runs])
    versions = [version_of(run) or None for run in runs]
    if len(set(versions)) > 1:
        keys["pfdist"] = versions
    names = _differ([run.path for run in runs])
    rows, units = list[Results](), set[str]()
    for number, run in enumerate(runs):
        problem = problem_of(run)
        units.add(problem.clock.unit if problem.has_clock else "")
        head = {"run": names[number], **{key: values[number] for key, values in keys.items()}}
        rows += [dict.fromkeys(RESULTS) | head | row for row in _rows(run)]
    columns = ("run", *keys, *RESULTS)
    frame = pd.DataFrame({name: _column(name, [row[name] for row in rows]) for name in columns})
    if len(units) == 1 and "" not in units:
        frame.attrs["time_unit"] = units.pop()
    return frame


def _rows(run: Run) -> Iterator[Results]:
    """Yield the rows of a run; one if nothing is known of any set but the reference."""
    has_timings = "timings" in run.tables
    shared = {
        "state": run.state,
        "draws": run.draws_compared,
        "evaluations": evaluations_of(run),
        "worker_seconds": run.table("timings")["seconds"].sum() if has_timings else None,
        "path": str(run.path),
    }
    sets = {row.name: row for row in rows_of(run.table("sets"))} if "sets" in run.tables else {}
    others = [row for row in sets.values() if row.reference is not None]
    if not others:
        yield shared | (_reference(next(iter(sets.values()))) if sets else {})
    for row in others:
        own = {name: getattr(row, name) for name in _OF_A_SET}
        own |= {"set": row.name, "measurement_times": tuple(row.measurement_times)}
        yield shared | own | _reference(sets[row.reference])


def _reference(row: Row) -> Results:
    return {
        "reference": row.name,
        "reference_mse": row.expected_mse,
        "reference_standard_error": row.standard_error,
    }


def _differ(paths: Sequence[Path]) -> list[str]:
    """The name of each folder, after as much of the path as tells equal names apart."""
    parts = [path.absolute().parts for path in paths]
    depths = [1] * len(parts)
    while True:
        names = ["/".join(own[-depth:]) for own, depth in zip(parts, depths, strict=True)]
        again = [number for number, name in enumerate(names) if names.count(name) > 1]
        again = [number for number in again if depths[number] < len(parts[number])]
        if not again:
            return names
        for number in again:
            depths[number] += 1


def _column(name: str, values: list[Any]) -> "pd.Series[Any]":
    """A column whose values keep their types, also beside missing ones."""
    if name in _NUMBERS:
        return pd.Series([math.nan if value is None else value for value in values], dtype=float)
    entries = [value for value in values if value is not None]
    if entries and len(entries) < len(values) and all(type(value) is int for value in entries):
        return pd.Series(values, dtype="Int64")
    column = pd.Series(values, dtype=object)
    # A column of texts stays as it is: a path need not be UTF-8, as the texts of pandas must be.
    return column if any(isinstance(value, str) for value in entries) else column.infer_objects()
