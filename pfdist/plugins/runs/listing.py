"""All runs below a folder, with their state and what they found."""

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd

from pfdist.common.arguments import path_argument
from pfdist.common.changes import is_clear
from pfdist.common.percent import times_100
from pfdist.common.rounding import rounded
from pfdist.errors import StoreError, reason_of, relative
from pfdist.problem.added_sections import has_amounts
from pfdist.results import Run, open_run
from pfdist.results.columns import Row
from pfdist.results.sets import best_first, rows_of_sets
from pfdist.results.stored_run import criterion_of
from pfdist.results.summary import summary_of
from pfdist.store import is_held
from pfdist.store.folder import extent, runs_below

RUNNING, FINISHED, UNFINISHED, UNREADABLE = "running", "finished", "unfinished", "unreadable"
_LAST = datetime.max.timestamp() - 86_400.0  # whatever date a file may claim
_DEPTH = 3  # levels of folders below the listed folder
_COLUMNS = {
    "run": "object", "state": "object", "draws": "int64", "draws_wanted": "int64",
    "changed": "datetime64[us, UTC]", "bytes": "int64", "best": "object", "reference": "object",
    "gain_of_means": "float64", "has_budget": "bool", "found": "object", "fault": "object",
    "criterion": "object",
}  # fmt: skip


def list_runs(folder: str | Path = "results") -> pd.DataFrame:
    """List the runs in a folder: how far each is, and what it has found.

    Links are not followed, and hidden folders are skipped. A run that cannot be read has a row with
    the reason.

    Parameters
    ----------
    folder : str or Path
        Folder in which runs are listed, up to three levels deep; or the folder of a run.

    Returns
    -------
    DataFrame
        A row for each run, in the order of their names; numbers in names are ordered as numbers.
        The columns are:

        - run: path of the folder, relative to `folder`.
        - state: ``running`` (a process computes it), ``finished``, ``unfinished``, or
          ``unreadable`` (`fault` says why).
        - draws, draws_wanted: draws that all sets have filtered, and draws that the job demands.
        - changed: when a file of the run changed last. bytes: the size of all files.
        - best: the set that answers name first: the best found set by the job's criterion, or a
          given set or opponent that beats it. In a run without a search, the best set other than
          the reference. None before the comparison has begun, and in a run of several numbers of
          measurements.
        - reference, gain_of_means: over which set, and by how much the best set gains. A set that
          beats the search has no gain: the draws that show it have chosen it.
        - has_budget: whether the run has times of several numbers of measurements.
        - found: the gain of the best set, or the numbers of measurements, in words; None before
          the comparison has begun.
        - fault: why a run cannot be read, else None.
        - criterion: what the run minimises.

    Raises
    ------
    ArgumentError
        The folder is not a path.
    StoreError
        The folder cannot be listed.
    """
    path = path_argument("folder", folder)
    rows = [_listed(run, str(run.relative_to(path))) for run in runs_below(path, _DEPTH)]
    return pd.DataFrame(
        {
            name: pd.Series([getattr(row, name) for row in rows], dtype=kind)
            for name, kind in _COLUMNS.items()
        }
    )


def _listed(path: Path, name: str) -> Row:
    """The row of a list for a run in a folder, in which nothing raises an error.

    The name is the path as the list shows it.
    """
    size, seconds = extent(path)
    row: dict[str, Any] = dict.fromkeys(_COLUMNS) | {
        "run": name,
        "state": UNREADABLE,
        "draws": 0,
        "draws_wanted": 0,
        "changed": datetime.fromtimestamp(min(max(seconds, 0.0), _LAST), UTC),
        "bytes": size,
        "gain_of_means": math.nan,
        "has_budget": False,
    }
    try:
        found = _found(open_run(path))
    except Exception as error:  # a list of many runs must not end because of one of them
        found = {"fault": _in_few_words(error, path)}
    return Row(**row | found)


def _found(run: Run) -> dict[str, Any]:
    """How far a run is, and its best set."""
    known, form = summary_of(run), criterion_of(run)
    state, draws, rows = (
        (run.state, run.draws_compared, rows_of_sets(run))
        if known is None
        else (known.state_of(run), known.draws, known.sets)
    )
    found = {
        "state": _state(run, state),
        "draws": int(draws),
        "draws_wanted": int(run.job["comparison"]["draws"]),  # whatever the job.toml has
        "has_budget": has_amounts(run.job),
        "criterion": form.label,
    }
    if not draws:
        return found
    best = None if found["has_budget"] else _best(rows)
    if best is not None and best.beats_search:
        words = f"{best.label}: the search found nothing better"
        found |= {"best": best.name, "reference": best.reference, "found": words}
    elif best is not None:
        gain = math.nan if best.gain_of_means is None else best.gain_of_means
        is_mean = best.criterion_gain is None
        judged = "gain_of_means" if is_mean else "criterion_gain"
        own = gain if is_mean else best.criterion_gain
        share = f"{rounded(times_100(abs(own)), 3)} % {'above' if own < 0 else 'below'}"
        if form.unit:
            share = f"{rounded(abs(own), 3)} {form.unit} {'less' if own < 0 else 'more'} than"
        if not is_clear([getattr(best, f"{judged}_{end}") for end in ("low", "high")]):
            share = "no clear difference from"
        reference = next(row.label for row in rows if row.name == best.reference)
        words = f"{best.label}: {share} {reference}"
        if not form.is_mean and not form.unit:
            label = "mean over scenarios" if is_mean else form.label
            words += f" by the {label}"
        found |= {"best": best.name, "reference": best.reference}
        found |= {"gain_of_means": gain, "found": words}
    elif found["has_budget"]:
        numbers = [row.measurements for row in rows]
        ends = dict.fromkeys([min(numbers), max(numbers)])
        found["found"] = f"{' to '.join(map(str, ends))} measurements"
    return found


def _state(run: Run, state: str) -> str:
    if is_held(run.path):
        return RUNNING
    return FINISHED if state == "finished" else UNFINISHED


def _best(sets: list[Row]) -> Row | None:
    """The set that answers name first; without a search, the best other than the reference."""
    rows = {row.name: row for row in sets if row.reference is not None or row.beats_search}
    return next((rows[name] for name in best_first(sets) if name in rows), None)


def _in_few_words(error: Exception, path: Path) -> str:
    """The error without its remedy, and with names of files relative to the run's folder."""
    shown_path, text = relative(str(path)), reason_of(error)
    text = text.replace(f"{shown_path}/", "").replace(f"{shown_path} ", "")
    return text.partition("; ")[0] if isinstance(error, StoreError) else text
