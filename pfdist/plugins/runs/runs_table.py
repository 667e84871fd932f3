"""Many runs as one table, with the keys in which they differ; and its cells as texts."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pfdist.common.dotted_keys import leaves, short_names
from pfdist.common.rounding import unrounded, with_error
from pfdist.results.columns import Results, Row, interval_cell
from pfdist.results.moments import GAINS
from pfdist.results.run import Run
from pfdist.results.sets import rows_of_sets
from pfdist.results.stored_run import criterion_of, evaluations_of, problem_of, version_of
from pfdist.results.summary import summary_of, worker_seconds_of

_TRUE, _FILTERS = "model.parameters.", "model.filter.parameters."
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
        ``search.order`` alone. A key that a job lacks is None. Lists are tuples.

    Examples
    --------
    >>> differing_keys([{"seed": 1, "filter": {"particles": 9}}, {"seed": 2, "filter": {}}])
    {'seed': [1, 2], 'filter.particles': [9, None]}
    """
    flat = [{key: _frozen(value) for key, value in leaves(job)} for job in jobs]
    columns = {
        key: [each.get(key) for each in flat]
        for key in dict.fromkeys(key for each in flat for key in each)
        # The key search.order has the same names.
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
_ENDS = ("", "_low", "_high")
CRITERION = ("criterion", *(f"judged{gain}{end}" for gain in ("", "_gain") for end in _ENDS))
"""Further columns, if a run minimises another number than the expected MSE."""
_NUMBERS = (
    {name for name in RESULTS if name.startswith((*GAINS, "bound", "worker"))}
    | {name for name in RESULTS if name.endswith(("_mse", "standard_error"))}
    | {*CRITERION[1:]}
)


def runs_table(runs: Sequence[Run]) -> pd.DataFrame:
    """A row for each run and each compared set other than the reference.

    Parameters
    ----------
    runs : sequence of Run
        Each folder once.

    Returns
    -------
    DataFrame
        The result of `pfdist.table`.

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
        units.add(problem.clock.time_unit if problem.has_clock else "")
        head = {"run": names[number], **{key: values[number] for key, values in keys.items()}}
        rows += [dict.fromkeys(RESULTS) | head | row for row in _rows(run)]
    has_criterion = any(row.get("criterion") for row in rows)
    columns = ("run", *keys, *RESULTS, *(CRITERION if has_criterion else ()))
    frame = pd.DataFrame({name: _column(name, [row.get(name) for row in rows]) for name in columns})
    if len(units) == 1 and "" not in units:
        frame.attrs["time_unit"] = units.pop()
    return frame


def _rows(run: Run) -> Iterator[Results]:
    """Yield the rows of a run; one without results if only the reference has any."""
    known = summary_of(run)
    shared = {
        "state": run.state if known is None else known.state_of(run),
        "draws": run.draws_compared if known is None else known.draws,
        "evaluations": evaluations_of(run) if known is None else known.evaluations,
        "worker_seconds": worker_seconds_of(run) if known is None else known.worker_seconds,
        "path": str(run.path),
    }
    sets = {row.name: row for row in (rows_of_sets(run) if known is None else known.sets)}
    others = [row for row in sets.values() if row.reference is not None]
    if not others:
        yield shared | (_reference(next(iter(sets.values()))) if sets else {})
    for row in others:
        own = {name: getattr(row, name) for name in _OF_A_SET}
        own |= {"set": row.name, "measurement_times": tuple(row.measurement_times)}
        yield shared | own | _reference(sets[row.reference]) | _judged(run, row)


def _judged(run: Run, row: Row) -> Results:
    """The number that the job of a run minimises, as answers print it, and its gain."""
    form = criterion_of(run)
    if form.is_mean:
        return {}
    value = row.criterion_value
    columns: Results = {"judged": None if value is None else value * form.sign}
    columns |= {f"judged{end}": vars(row).get(f"{form.name}{end}") for end in _ENDS[1:]}
    gains = {f"judged_gain{end}": getattr(row, f"criterion_gain{end}") for end in _ENDS}
    return columns | gains | {"criterion": run.job["problem"].get("criterion") or form.name}


def _reference(row: Row) -> Results:
    return {
        "reference": row.name,
        "reference_mse": row.expected_mse,
        "reference_standard_error": row.standard_error,
    }


def _differ(paths: Sequence[Path]) -> list[str]:
    """The name of each folder; equal names follow as much of the path as distinguishes them."""
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
    """A column whose values keep their types even if some are missing."""
    if name in _NUMBERS:
        return pd.Series([math.nan if value is None else value for value in values], dtype=float)
    entries = [value for value in values if value is not None]
    if entries and len(entries) < len(values) and all(type(value) is int for value in entries):
        return pd.Series(values, dtype="Int64")
    column = pd.Series(values, dtype=object)
    # A column of texts stays as it is: a path need not be UTF-8, as the texts of pandas must be.
    return column if any(isinstance(value, str) for value in entries) else column.infer_objects()


# --- its cells ------------------------------------------------------------------------------------


def keys_of_runs(frame: pd.DataFrame) -> list[str]:
    """The columns of a table of runs that hold differing keys."""
    columns = list(map(str, frame.columns))
    first, last = (columns.index(name) for name in ("run", "set"))
    return columns[first + 1 : last]


def shown_names(keys: Sequence[str]) -> dict[str, str]:
    """The name of each dotted key on pages.

    A parameter that varies in the true model and in that of the filter is called ``truth`` and
    ``filter``; another key has its short name.

    >>> [*shown_names(["model.parameters.sd", "model.filter.parameters.sd", "seed"]).values()]
    ['truth', 'filter', 'seed']
    """
    both = [key for key in keys if key.startswith(_TRUE) and key.replace(_TRUE, _FILTERS) in keys]
    names = short_names(keys)
    for key in both:
        word = f" {key.removeprefix(_TRUE)}" if len(both) > 1 else ""
        names |= {key: f"truth{word}", key.replace(_TRUE, _FILTERS): f"filter{word}"}
    return names


def formatted_value(value: Any) -> str:
    """The value of a key as text; empty if the job lacks it.

    Examples
    --------
    >>> [formatted_value(value) for value in (0.25, (0, 3.5), True, math.nan)]
    ['0.25', '0 3.5', 'true', '']
    """
    if isinstance(value, tuple | list):
        return " ".join(map(formatted_value, value))
    if is_missing(value):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return unrounded(value) if isinstance(value, float) else str(value)


def is_missing(value: Any) -> bool:
    """Whether a cell has no value."""
    return value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value))


def formatted_mse(row: Mapping[Any, Any]) -> str:
    """The expected MSE of a row with its standard error; empty if nothing was compared."""
    if math.isnan(row["expected_mse"]):
        return ""
    return with_error(row["expected_mse"], row["standard_error"])


def formatted_gain(row: Mapping[Any, Any]) -> str:
    """The gain of means of a row in per cent, with its 95 % interval."""
    numbers = [row[f"gain_of_means{end}"] for end in _ENDS]
    return interval_cell(*numbers, is_percent=True).text * all(map(math.isfinite, numbers))
