"""The worth of each measurement and its sampling windows, where ``pfdist why`` has run."""

import math
from collections.abc import Hashable, Mapping
from typing import Any

from pfdist.analysis.sampling_windows import STRICT, WIDE, sentences, windows_of
from pfdist.common.rounding import with_error
from pfdist.common.told_times import told_time
from pfdist.reports.parts import Block, Cell, Section, Table, Text
from pfdist.reports.pictures import pictures
from pfdist.reports.subject import Subject, number_of

_HEAD = ("measured at t", "if removed", "if one instant earlier", "if one instant later")
_WINDOWS_HEAD = ("measured at t", f"within {STRICT} %", f"within {WIDE} %")
_WINDOWS = (
    "A sampling window holds the instants to which a measurement alone can be moved at a loss of "
    f"at most {STRICT} or {WIDE} % of the expected error: the one-sided 95 % upper limit of the "
    "loss is at most that. The limit holds for each instant alone, not for all together. Open "
    "instants need more draws."
)
_CHANGES = ("removed", "earlier", "later")


def worth(subject: Subject) -> Section | None:
    """Give the rise of the expected error without each measurement."""
    if not subject.run.has("worth"):
        return None
    worth = subject.run.worth()
    tables = []
    for name, group in worth.groupby("name", sort=False):
        rows = [_row(measurement) for measurement in group.to_dict("records")]
        tables.append(Table(f"Rise of the expected error, times of {name}", _HEAD, rows, True))
    draws = int(worth["draws"].max())
    how = f"on {number_of(draws, 'fresh draw')}" if draws else "exactly"
    meaning = (
        f"By how much the expected error rises if a measurement is left out or moved, {how}. A "
        "measurement whose loss changes little may be left out; the others should be kept. A value "
        "below 0 means that the change would lower the error."
    )
    figures = pictures(subject.tables, ["why", "sampling_windows", "filters"], subject.shown)
    blocks = [Text(meaning), *figures, *tables, *_windows(subject)]
    return Section("What each measurement is worth", blocks)


def _windows(subject: Subject) -> list[Block]:
    """Give the sampling windows of each set, and what follows from them."""
    run = subject.run
    if not (run.has("sampling_windows") and run.has("jitter")):
        return []  # computed before there were sampling windows
    jitter, blocks = run.jitter(), list[Block]([Text(_WINDOWS)])
    for name, group in run.sampling_windows().groupby("name", sort=False):
        rows = group.to_dict("records")
        of_set = jitter[jitter["name"] == name].to_dict("records")
        said = sentences(rows, of_set, is_found=name in run.found)
        levels = (windows_of(rows, STRICT), windows_of(rows, WIDE))
        cells = [
            [Cell(told_time(strict.t), strict.t), Cell(strict.text), Cell(wide.text)]
            for strict, wide in zip(*levels, strict=True)
        ]
        blocks.append(Text(f"{name}: {' '.join(said)}" if said else f"{name}: nothing can move."))
        blocks.append(Table(f"Sampling windows, times of {name}", _WINDOWS_HEAD, cells, True))
    return blocks


def _row(measurement: Mapping[Hashable, Any]) -> list[Cell]:
    cells = [Cell(told_time(measurement["t"]), measurement["t"])]
    for change in _CHANGES:
        rise, error = measurement[change], measurement[f"{change}_error"]
        known = not math.isnan(rise)
        cells.append(Cell(with_error(rise, error, sign=True), rise) if known else Cell(""))
    return cells
