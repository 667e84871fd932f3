"""A run as a list of runs shows it: its state, age and size, and what it found."""

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from pfdist.errors import StoreError, one_line, relative, shown_text
from pfdist.results.columns import Row, rows_of
from pfdist.results.run import Run, open_run
from pfdist.results.sets import best_first
from pfdist.store import is_held
from pfdist.store.folder import extent

RUNNING, FINISHED, UNFINISHED, DAMAGED = "running", "finished", "unfinished", "damaged"


@dataclass(frozen=True)
class ListedRun:
    """A line of a list of runs.

    Parameters
    ----------
    run : str
        Path of the folder, relative to the listed folder.
    state : str
        ``running`` (a process computes it), ``finished``, ``unfinished`` or ``damaged`` (it cannot
        be read).
    draws, draws_wanted : int
        Draws that every set has filtered, and draws that the job demands at most.
    changed : datetime
        When a file of the run changed last, UTC.
    bytes : int
        Sum of the lengths of all files.
    best : str or None
        Name of the found set with the lowest expected MSE. In a run without a search it is the
        best set other than the reference. None before the comparison has begun, and in a run of
        several numbers of measurements.
    reference : str or None
        Name of the set over which it gains.
    gain_of_means : float
        The gain of the best set; NaN if there is none.
    has_budget : bool
        Whether the run has times of several numbers of measurements.
    fault : str or None
        Why the run cannot be read.
    """

    run: str
    state: str
    draws: int
    draws_wanted: int
    changed: datetime
    bytes: int
    best: str | None = None
    reference: str | None = None
    gain_of_means: float = math.nan
    has_budget: bool = False
    fault: str | None = None


def listed_run(path: Path, name: str) -> ListedRun:
    """The line of a list for a run in a folder.

    Parameters
    ----------
    path : Path
        The folder. Whatever it holds, there is no error.
    name : str
        The path as the list shows it.
    """
    size, seconds = extent(path)
    changed = datetime.fromtimestamp(seconds, UTC)
    try:
        run = open_run(path)
        listed = ListedRun(
            name,
            _state(run),
            run.draws_compared,
            run.job["comparison"]["draws"],
            changed,
            size,
            has_budget="budget" in run.job,
        )
        best = _best(run)
    except Exception as error:  # a list of many runs must not end because of one of them
        fault = _in_few_words(error, path)
        return ListedRun(name, DAMAGED, 0, 0, changed, size, fault=fault)
    if best is None:
        return listed
    return replace(
        listed,
        best=best.name,
        reference=best.reference,
        gain_of_means=math.nan if best.gain_of_means is None else best.gain_of_means,
    )


def _state(run: Run) -> str:
    if is_held(run.path):
        return RUNNING
    return FINISHED if run.state == "finished" else UNFINISHED


def _best(run: Run) -> Row | None:
    """The best set other than the reference, once draws are compared."""
    if "budget" in run.job or not run.draws_compared:
        return None
    sets = run.table("sets")
    rows = {row.name: row for row in rows_of(sets) if row.reference is not None}
    return next((rows[name] for name in best_first(sets) if name in rows), None)


def _in_few_words(error: Exception, path: Path) -> str:
    """The error without its remedy, and with names of files relative to the run's folder."""
    if not isinstance(error, StoreError):
        return one_line(shown_text(f"{type(error).__name__}: {error}"))
    shown_path = relative(str(path))
    text = str(error).replace(f"{shown_path}/", "").replace(f"{shown_path} ", "")
    return one_line(shown_text(text.partition("; ")[0]))
