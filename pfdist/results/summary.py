"""The summary of a run: its table of sets in a file, so that looking at many runs takes no time.

The file has a fingerprint of the tables from which it was made. If the run's tables are others now,
the file counts for nothing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import partial
from operator import methodcaller
from typing import Any, NamedTuple

import numpy as np

from pfdist import __version__
from pfdist.common.parsing import parse_json
from pfdist.common.plugins import hooked
from pfdist.problem.set_key import labels_of_sets
from pfdist.results.columns import COLUMNS, Row
from pfdist.results.stored_run import StoredRun, evaluations_of
from pfdist.store import QUESTIONS, WHY_PHASE, record_pages, write_file
from pfdist.store.files import begins_with, check_replaceable, read_if_hashed
from pfdist.store.folder import SUMMARY
from pfdist.store.listing import read_listing

_NAME = "sets of a run"
_MARK = f'{{"table": "{_NAME}"'.encode()
_MOST_BYTES = 10_000_000
_TYPES: dict[str, Any] = {
    "float64": float | None, "int64": int, "Int64": int | None, "object": str | list | bool | None,
}  # fmt: skip


class Summary(NamedTuple):
    """The results of a run that a list and a table of runs show."""

    sets: list[Row]  # the rows of the table ``sets``, the reference first
    evaluations: int
    worker_seconds: float | None

    @property
    def draws(self) -> int:
        """Number of draws that every set has filtered."""
        return int(self.sets[0].draws)

    def state_of(self, run: StoredRun) -> str:
        """The state of the run to which the summary belongs."""
        is_plain = run.job.keys().isdisjoint(hooked("sections"))
        is_whole = is_plain and self.draws == run.job["comparison"]["draws"]
        return "finished" if is_whole else run.state


def summary_of(run: StoredRun) -> Summary | None:
    """The summary of a run as its tables are now; None if there is none that can be used."""
    try:
        return read_summary(run)
    except Exception:  # whatever is wrong with the file, the tables are there
        return None


def read_summary(run: StoredRun) -> Summary | None:
    """The same; raises any error if the file is the listed one, and cannot be used."""
    listing, path = read_listing(run.path), run.path / SUMMARY
    if listing is None or SUMMARY not in listing.pages or not path.exists():
        return None
    if (size := path.lstat().st_size) > _MOST_BYTES:
        raise ValueError(f"it must have at most {_MOST_BYTES:,} bytes, got {size:,}")
    content = read_if_hashed(path, listing.pages[SUMMARY], _MOST_BYTES)
    known = None if content is None else _parsed(content, _fingerprint(run))
    if known:  # labels are words of this version
        labels = labels_of_sets([row.name for row in known.sets], run.job)
        for row in known.sets:
            row.label = labels[row.name]
    return known


def _parsed(content: bytes, made_of: str) -> Summary | None:
    data = parse_json(content, finite=False)
    if not made_of or data["made_of"] != made_of:
        return None
    rows = [Row(**dict.fromkeys(COLUMNS) | row) for row in data["sets"]]
    names = {row.name for row in rows}
    are_right = all(
        isinstance(getattr(row, name), _TYPES[column.dtype])
        for row in rows
        for name, column in COLUMNS.items()
    )
    if not (are_right and rows and all(row.reference in {None, *names} for row in rows)):
        raise ValueError("its rows are not those of a table of sets")
    evaluations, seconds = int(data["evaluations"]), data["worker_seconds"]
    return Summary(rows, evaluations, None if seconds is None else float(seconds))


def keep_summary(run: StoredRun, sets: Sequence[Row]) -> None:
    """Write the summary of a run, with its table of sets; the caller holds the run's lock."""
    if not (made_of := _fingerprint(run)):
        return
    summary = {
        "table": _NAME,
        "made_of": made_of,
        "evaluations": evaluations_of(run),
        "worker_seconds": worker_seconds_of(run),
        "sets": [*map(vars, sets)],
    }
    text, path = json.dumps(summary, default=methodcaller("item")), run.path / SUMMARY
    check_replaceable(path, partial(begins_with, mark=_MARK, most=len(_MARK)))
    record_pages(run.path, [], locked=True, without=SUMMARY)  # so a kill leaves no wrong hash
    write_file(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    record_pages(run.path, [path], locked=True)


def worker_seconds_of(run: StoredRun) -> float | None:
    """Seconds that all tasks have taken, or None if that is not known."""
    has = run._store.has("timings")
    return float(np.sum(run._store.rows("timings")["seconds"])) if has else None


def _fingerprint(run: StoredRun) -> str:
    """A hash of the tables from which this version describes sets; empty if a phase goes on."""
    listing = read_listing(run.path)
    if listing is None or run._store.has_parts(without=QUESTIONS):
        return ""
    files = (file for file in sorted(listing.files) if f"/{WHY_PHASE}-" not in file)
    text = "\n".join((__version__, *files))
    return hashlib.sha256(text.encode()).hexdigest()
