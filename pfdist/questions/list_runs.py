"""All runs below a folder, with their state and what they found."""

from pathlib import Path

import pandas as pd

from pfdist.common.arguments import path_argument
from pfdist.results.listed_run import listed_run
from pfdist.store.folder import runs_below

_DEPTH = 3  # levels of folders below the listed folder
_COLUMNS = {
    "run": "object", "state": "object", "draws": "int64", "draws_wanted": "int64",
    "changed": "datetime64[us, UTC]", "bytes": "int64", "best": "object", "reference": "object",
    "gain_of_means": "float64", "has_budget": "bool", "fault": "object",
}  # fmt: skip


def list_runs(folder: str | Path = "results") -> pd.DataFrame:
    """List the runs in a folder: how far each is, and what it has found.

    Folders are looked into three levels deep. Links are not followed, and hidden folders are
    skipped. A run that cannot be read has a row that says why.

    Parameters
    ----------
    folder : str or Path
        Folder in which runs are listed, three levels deep; the folder of a run is listed alone.

    Returns
    -------
    DataFrame
        A row for each run, in the order of their names; numbers in names are ordered as numbers.
        The columns are:

        - run: path of the folder, relative to `folder`.
        - state: ``running`` (a process computes it), ``finished``, ``unfinished``, or ``damaged``
          (it cannot be read).
        - draws, draws_wanted: draws that all sets have filtered, and draws that the job demands.
        - changed: when a file of the run changed last. bytes: the size of all files.
        - best: the found set with the lowest expected MSE; in a run without a search, the best set
          other than the reference. None before the comparison has begun, and in a run of several
          numbers of measurements.
        - reference, gain_of_means: over which set, and by how much the best set gains.
        - has_budget: whether the run has times of several numbers of measurements.
        - fault: why a damaged run cannot be read, else None.

    Raises
    ------
    ArgumentError
        The folder is no path.
    StoreError
        The folder cannot be listed.
    """
    path = path_argument("folder", folder)
    rows = [listed_run(run, str(run.relative_to(path))) for run in runs_below(path, _DEPTH)]
    columns = {
        name: pd.Series([getattr(row, name) for row in rows], dtype=kind)
        for name, kind in _COLUMNS.items()
    }
    return pd.DataFrame(columns)
