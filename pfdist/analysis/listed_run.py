"""A run as a list of runs shows it: its state, age and size, and what it found."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pfdist.analysis.gains import ComparisonStatistics
from pfdist.analysis.run import Run, open_run
from pfdist.analysis.stored_run import exact_costs, found_sets, statistics_of
from pfdist.errors import StoreError, one_line, shown_text
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
    size = extent(path)
    changed = datetime.fromtimestamp(size.changed, UTC)
    try:
        run = open_run(path)
        state, statistics = _state(run), _statistics(run)
        best, gain = _best(run, statistics) if statistics is not None else (None, math.nan)
    except Exception as error:  # a list of many runs must not end because of one of them
        fault = _in_few_words(error, path)
        return ListedRun(name, DAMAGED, 0, 0, changed, size.bytes, fault=fault)
    return ListedRun(
        name,
        state,
        0 if statistics is None else statistics.draws,
        run.job["comparison"]["draws"],
        changed,
        size.bytes,
        best,
        None if best is None else run.names[0],
        gain,
        "budget" in run.job,
    )


def _state(run: Run) -> str:
    if is_held(run.path):
        return RUNNING
    return FINISHED if run.state == "finished" else UNFINISHED


def _statistics(run: Run) -> ComparisonStatistics | None:
    """The statistics of the compared draws; None if no draw was compared."""
    if "compared" not in run.tables or "comparison" not in run.tables:
        return None
    return statistics_of(run)


def _best(run: Run, statistics: ComparisonStatistics) -> tuple[str | None, float]:
    """The best set and the gain of means; exact errors decide if the engine knows them."""
    names = found_sets(run) or run.names[1:]
    if "budget" in run.job or not names:
        return None, math.nan
    exact = exact_costs(run)
    are_exact = all(name in exact for name in names)
    errors = exact if are_exact else {name: statistics.mse[name].mean for name in names}
    best = min(names, key=lambda name: (math.isnan(errors[name]), errors[name]))
    if best in exact and exact.get(run.names[0]):
        return best, 1 - exact[best] / exact[run.names[0]]
    return best, statistics.gains[best].of_means


def _in_few_words(error: Exception, path: Path) -> str:
    """The error without its remedy, and with names of files relative to the run's folder."""
    if not isinstance(error, StoreError):
        return one_line(shown_text(f"{type(error).__name__}: {error}"))
    text = str(error).replace(f"{path}/", "").replace(f"{path} ", "")
    return one_line(shown_text(text.partition("; ")[0]))
