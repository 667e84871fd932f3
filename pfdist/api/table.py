"""Many runs as one table."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import pandas as pd

from pfdist.analysis import Run, open_run
from pfdist.analysis.runs_table import runs_table
from pfdist.api.table_file import table_path, write_table_of_runs
from pfdist.errors import ArgumentError
from pfdist.store import holds_run
from pfdist.store.folder import runs_below

Runs = Run | str | Path | list["Runs"] | tuple["Runs", ...]
"""A run, its folder, a folder with runs in it, or several of these."""

_DEPTH = 2  # a folder with sweeps in it; comparisons that judge the points of sweeps lie deeper


def table(*runs: Runs, out: str | Path | None = None) -> pd.DataFrame:
    """Many runs as one tidy table: what differs between them, and what they found.

    The runs are read; no model is loaded, and nothing is computed anew.

    Parameters
    ----------
    runs : Run, str, Path, or list of these
        Runs or their folders, finished or not. A folder that is no run but has runs or sweeps in
        it stands for all these runs, in the order of their names; numbers in names are ordered as
        numbers. A run that is given twice counts once.
    out : str or Path, optional
        Also write the table to this file, whose name ends in ``.csv``, ``.parquet`` or ``.tex``.
        An earlier table of runs is replaced; another file is not.

    Returns
    -------
    DataFrame
        A row for each run and each compared set other than the reference. A run without such sets
        has one row. Unknown values are NaN or None. The columns are:

        - run: name of the folder, after as much of its path as tells equal names apart.
        - A column for each key in which the jobs of the runs differ, such as ``seed`` or
          ``problem.measurement_budget``, and ``pfdist`` if their versions differ.
        - set; state (``searching``, ``comparing`` or ``finished``); draws (compared so far).
        - expected_mse and standard_error, and the same of the reference, whose name is in
          ``reference``. If an engine knows an expected MSE exactly, the error is 0. In a run of
          several numbers of measurements, the reference has as many as the set.
        - gain_of_means, mean_relative_gain and positive_fraction over the reference, each with
          ``_low`` and ``_high`` (95 %); see `pfdist.analysis.GainSummary`.
        - bound (lower bound of the expected MSE of any feasible times), bound_gap and
          bound_gap_at_most; see `pfdist.bound`.
        - measurements (their number) and measurement_times (a tuple, on the clock of the run).
        - evaluations, and worker_seconds (of all tasks together): of the whole run.
        - path: the folder of the run.

        ``attrs["time_unit"]`` is the unit of times, if all runs have the same.

    Raises
    ------
    ArgumentError
        There is no run, or the ending of `out` is wrong.
    StoreError
        A folder holds no run, a run cannot be read, or the file cannot be written.
    """
    path = None if out is None else table_path(out)
    opened = {os.path.abspath(run.path): run for run in _opened(runs)}
    if not opened:
        raise ArgumentError("table needs at least one run, got none")
    frame = runs_table(list(opened.values()))
    if path is not None:
        write_table_of_runs(frame, path)
    return frame


def _opened(runs: Iterable[Runs]) -> Iterator[Run]:
    for run in runs:
        if isinstance(run, Run):
            yield run
        elif isinstance(run, list | tuple):
            yield from _opened(run)
        else:
            yield from map(open_run, _folders(run))


def _folders(run: str | Path) -> list[Path]:
    """The folder of a run, or those of the runs in a folder."""
    if not isinstance(run, str | Path) or holds_run(Path(run)) or not Path(run).is_dir():
        return [run]  # type: ignore[list-item]  # whatever it is, open_run says what is wrong
    return list(runs_below(Path(run), _DEPTH)) or [Path(run)]
