"""The worth of each measurement, where ``pfdist why`` has computed it."""

import math
from collections.abc import Hashable, Mapping
from typing import Any

from pfdist.common.rounding import with_error
from pfdist.reports.parts import Cell, Section, Table, Text
from pfdist.reports.pictures import pictures
from pfdist.reports.subject import Subject, number_of

_HEAD = ("measured at t", "if removed", "if one instant earlier", "if one instant later")
_CHANGES = ("removed", "earlier", "later")


def worth(subject: Subject) -> Section | None:
    """Give the rise of the expected error without each measurement."""
    if subject.run.has_budget or not subject.run.has("worth"):
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
    figures = pictures(subject.tables, ["why", "filters"], subject.shown)
    return Section("What each measurement is worth", [Text(meaning), *figures, *tables])


def _row(measurement: Mapping[Hashable, Any]) -> list[Cell]:
    cells = [Cell(f"{measurement['t']:.0f}", measurement["t"])]
    for change in _CHANGES:
        rise, error = measurement[change], measurement[f"{change}_error"]
        known = not math.isnan(rise)
        cells.append(Cell(with_error(rise, error, sign=True), rise) if known else Cell(""))
    return cells
