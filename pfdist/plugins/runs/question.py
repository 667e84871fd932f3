"""Many runs as one table, also as a file: CSV or Parquet."""

import os
import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from pfdist.common.arguments import path_argument
from pfdist.errors import ArgumentError, PfdistWarning, reason_of, relative, shown
from pfdist.plugins.runs.runs_table import (
    CRITERION,
    RESULTS,
    formatted_value,
    is_missing,
    runs_table,
)
from pfdist.results import Run, open_run
from pfdist.store import holds_run, write_file
from pfdist.store.files import check_replaceable
from pfdist.store.folder import runs_below
from pfdist.store.tables import holds_table, write_table
from pfdist.store.user_tables import csv_of

_MARK = b"runs"  # the metadata "table" of a Parquet file
_ENDS = ",".join(RESULTS), ",".join((*RESULTS, *CRITERION))
_HEAD = re.compile(rf"run,([^\n]*,)?({'|'.join(_ENDS)})\n".encode())
_LONGEST_HEAD = 100_000  # bytes of the first line of a CSV file


Runs = Run | str | Path | list["Runs"] | tuple["Runs", ...]
"""A run, its folder, a folder with runs in it, or several of these."""

_DEPTH = 2  # a folder with sweeps in it


def table(*runs: Runs, out: str | Path | None = None) -> pd.DataFrame:
    """Put many runs into one table: what differs between them, and what they found.

    The runs are only read: no model is loaded, and nothing is computed.

    Parameters
    ----------
    runs : Run, str, Path, or list of these
        Folders of runs, finished or not, or folders with runs or sweeps in them, in the order of
        their names. A run in such a folder that cannot be read is left out, with a warning.
    out : str or Path, optional
        Also write the table to this ``.csv`` or ``.parquet`` file. An earlier table of runs is
        replaced; another file is not.

    Returns
    -------
    DataFrame
        A row for each run and each compared set other than the reference. A run without such sets
        has one row. Unknown values are NaN or None. The columns are:

        - run: name of the folder; equal names follow as much of the path as distinguishes them.
        - A column for each key in which the jobs of the runs differ, such as ``seed`` or
          ``problem.measurement_budget``, and ``pfdist`` if their versions differ.
        - set; state (``searching``, ``comparing`` or ``finished``); draws (compared so far).
        - expected_mse and standard_error, and the same of the reference, whose name is in
          ``reference``. If an expected MSE is exact, its error is 0. In a run of
          several numbers of measurements, the reference has as many as the set.
        - gain_of_means, mean_relative_gain and positive_fraction over the reference, each with
          ``_low`` and ``_high`` (95 %); see `pfdist.results.Gain`.
        - bound (lower bound of the expected MSE of any feasible times), bound_gap and
          bound_gap_at_most; see `pfdist.bound`.
        - measurements (their number) and measurement_times (a tuple, on the clock of the run).
        - evaluations, and worker_seconds (of all tasks together): of the whole run.
        - path: the folder of the run.
        - criterion (of the job), judged (its number: of the information, in nats), judged_gain, and
          their ``_low`` and ``_high``, only if a run minimises another number than the expected
          MSE.

        ``attrs["time_unit"]`` is the unit of times, if all runs have the same.

    Raises
    ------
    ArgumentError
        There is no run, or the ending of `out` is wrong.
    StoreError
        A folder holds no run, a run cannot be read, or the file cannot be written.
    """
    path = None if out is None else path_argument("out", out)
    if path is not None and path.suffix.lower() not in _KINDS:
        rule = f"a file of a table must end in one of {', '.join(_KINDS)}, got {shown(str(path))}"
        raise ArgumentError(rule, argument="out")
    try:
        frame = runs_table(_opened(runs))
    except Exception:  # runs that were found in folders may come from elsewhere, and hold anything
        frame = runs_table(_opened(runs, _can_be_read))
    frame["path"] = pd.Series([*map(relative, frame["path"])], dtype=object)
    if path is not None:
        write, is_earlier = _KINDS[path.suffix.lower()]
        check_replaceable(path, is_earlier)
        write_file(path, lambda temporary: write(frame, temporary))
    return frame


def _opened(runs: Iterable[Runs], wanted: Callable[[Path], bool] = lambda path: True) -> list[Run]:
    """Each run once; of those that are found in a folder, those that are wanted."""
    opened = {os.path.abspath(run.path): run for run in _each(runs, wanted)}
    if not opened:
        raise ArgumentError("table needs at least one run, got none")
    return list(opened.values())


def _each(runs: Iterable[Runs], wanted: Callable[[Path], bool]) -> Iterator[Run]:
    for run in runs:
        if isinstance(run, Run):
            yield run
        elif isinstance(run, list | tuple):
            yield from _each(run, wanted)
        else:
            path = path_argument("run", run)
            below = [] if holds_run(path) or not path.is_dir() else [*runs_below(path, _DEPTH)]
            yield from map(open_run, filter(wanted, below) if below else [path])


def _can_be_read(path: Path) -> bool:
    try:
        runs_table([open_run(path)])
    except Exception as error:
        warnings.warn(f"{path} is left out: {reason_of(error)}", PfdistWarning, stacklevel=2)
        return False
    return True


# --- the table in a file --------------------------------------------------------------------------


def _write_csv(frame: pd.DataFrame, path: Path) -> None:
    plain = frame.copy()
    for name in frame.select_dtypes(object):
        texts = [formatted_value(cell) if isinstance(cell, tuple) else cell for cell in frame[name]]
        plain[name] = pd.Series(texts, dtype=object)
    path.write_bytes(csv_of(plain))


def _write_parquet(frame: pd.DataFrame, path: Path) -> None:
    columns = {str(name): _arrow(frame[name]) for name in frame}
    metadata = {"table": _MARK, "time_unit": frame.attrs.get("time_unit", "")}
    write_table(pa.table(columns).replace_schema_metadata(metadata), path)


def _arrow(column: "pd.Series[Any]") -> pa.Array:
    if pd.api.types.is_float_dtype(column):
        return pa.array(column.to_numpy(), from_pandas=True)
    values = [None if is_missing(value) else value for value in column.tolist()]
    try:
        return pa.array(values)
    except (pa.ArrowInvalid, pa.ArrowTypeError, UnicodeEncodeError):  # a path need not be UTF-8
        texts = [None if value is None else formatted_value(value) for value in values]
        return pa.array([text and text.encode(errors="replace").decode() for text in texts])


def _is_earlier_csv(path: Path) -> bool:
    with path.open("rb") as file:
        return _HEAD.match(file.readline(_LONGEST_HEAD)) is not None


_KINDS: dict[str, tuple[Callable[[pd.DataFrame, Path], None], Callable[[Path], bool]]] = {
    ".csv": (_write_csv, _is_earlier_csv),
    ".parquet": (_write_parquet, partial(holds_table, name=_MARK)),
}
"""The function that writes a table, and the one that recognises an earlier table, by ending."""
