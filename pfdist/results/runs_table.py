"""Many runs as one table: the keys in which they differ, and a row for each set."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pfdist.common.dotted_keys import leaves
from pfdist.common.percent import cost
from pfdist.results.run import Run
from pfdist.results.stored_run import version_of
from pfdist.results.summary import SetResult, Summary

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

_GAINS = ("gain_of_means", "mean_relative_gain", "positive_fraction")
_PROOF = {"bound": "bound", "bound_gap": "gap", "bound_gap_at_most": "gap_at_most"}
RESULTS = (
    "set", "state", "draws",
    "expected_mse", "standard_error",
    "reference", "reference_mse", "reference_standard_error",
    *(f"{gain}{end}" for gain in _GAINS for end in ("", "_low", "_high")),
    *_PROOF,
    "measurements", "measurement_times",
    "evaluations", "worker_seconds", "path",
)  # fmt: skip
"""Columns of a table of runs that follow the run and the differing keys."""
_NUMBERS = {
    "standard_error", "worker_seconds", *(name for name in RESULTS if "mse" in name),
    *(name for name in RESULTS if name.startswith((*_GAINS, "bound"))), "reference_standard_error",
}  # fmt: skip
Row = dict[str, Any]


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
    rows, units = list[Row](), set[str]()
    for number, run in enumerate(runs):
        summary = run.summary()
        units.add(summary.time_unit or "")
        head = {"run": names[number], **{key: values[number] for key, values in keys.items()}}
        rows += [head | row for row in _rows(run, summary)]
    columns = ("run", *keys, *RESULTS)
    frame = pd.DataFrame({name: _column(name, [row[name] for row in rows]) for name in columns})
    if len(units) == 1 and "" not in units:
        frame.attrs["time_unit"] = units.pop()
    return frame


def _rows(run: Run, summary: Summary) -> Iterator[Row]:
    """Yield the rows of a run; one if nothing is known of any set but the reference."""
    results, has_timings = summary.results, "timings" in run.tables
    shared = dict.fromkeys(RESULTS) | {
        "state": summary.state,
        "draws": summary.draws_compared,
        "evaluations": summary.evaluations,
        "worker_seconds": run.table("timings")["seconds"].sum() if has_timings else None,
        "path": str(run.path),
    }
    references = run.references if results else {}
    if not references:
        first = next(iter(results), None)
        yield shared | ({} if first is None else _reference(first, results[first]))
    for name, reference in references.items():
        result = results[name]
        yield (
            shared | _reference(reference, results[reference]) | _set(name, result) | _gains(result)
        )


def _set(name: str, result: SetResult) -> Row:
    """The values of a set alone."""
    error, standard_error = _error(result)
    proof = result.lower_bound or {}
    return {
        "set": name,
        "expected_mse": error,
        "standard_error": standard_error,
        **{column: proof.get(key) for column, key in _PROOF.items()},
        "measurements": result.measurements,
        "measurement_times": tuple(result.measurement_times),
    }


def _reference(name: str, result: SetResult) -> Row:
    error, standard_error = _error(result)
    values = {"reference_mse": error, "reference_standard_error": standard_error}
    return {"reference": name, **values}


def _error(result: SetResult) -> tuple[float | None, float | None]:
    """The expected MSE and the standard error; if an engine knows it exactly, with 0."""
    if result.exact_mse is not None:
        return result.exact_mse, 0.0
    if not result.is_compared:
        return None, None
    return cost(result.expected_mse), result.standard_error


def _gains(result: SetResult) -> Row:
    """The gains over the reference with the ends of their intervals."""
    row = Row()
    for gain in _GAINS:
        low, high = getattr(result, f"{gain}_interval")
        row |= {gain: getattr(result, gain), f"{gain}_low": low, f"{gain}_high": high}
    if result.exact_gain is not None:
        names = ("gain_of_means", "gain_of_means_low", "gain_of_means_high")
        row |= dict.fromkeys(names, result.exact_gain)
    return row


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
