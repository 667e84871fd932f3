"""The worth of each measurement, and how exactly it must be kept (``pfdist why``)."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pfdist.common.formatted_times import formatted_time, measurement_of
from pfdist.common.parts import Block, Cell, Figures, Page, Section, Table, Text
from pfdist.common.percent import infinite_if_none
from pfdist.common.rounding import with_error
from pfdist.questions.subject import Subject, number_of
from pfdist.results.sampling_windows import STRICT, WIDE, sentences, windows_of

_HEAD = ("t", "if removed", "if one instant earlier", "if one instant later")
_WINDOWS_HEAD = ("t", f"within {STRICT} %", f"within {WIDE} %")
_WINDOWS = (
    "A sampling window holds the instants to which a measurement alone can be moved at a loss of "
    f"at most {STRICT} or {WIDE} % of the expected error: the one-sided 95 % upper limit of the "
    "loss is at most that. The limit holds for each instant alone, not for all together. Open "
    "instants need more draws."
)
_CHANGES = ("removed", "earlier", "later")
_ROUNDING = 1e-12  # relative to the expected MSE: rounding errors of doubles are smaller
Rows = Iterable[Mapping[Any, Any]]


def worth(subject: Subject) -> Section | None:
    """The worth of each measurement of a run's sets, where ``pfdist why`` has run."""
    run = subject.run
    if not {"worth", "sampling_windows"} <= {*run.tables}:
        return None
    rises, windows = run.table("worth"), run.table("sampling_windows")
    tables = list[Block]()
    for name, group in rises.groupby("name", sort=False):
        parts = (group, windows[windows["name"] == name])
        tables += _of_set(str(name), *(part.to_dict("records") for part in parts), detail=True)
    figures = Figures(["why", "sampling_windows", "filters"], subject.shown)
    draws = int(rises["draws"].max())
    return Section(
        "What each measurement is worth", [Text(_meaning(draws)), figures, *tables, Text(_WINDOWS)]
    )


def why_page(answer: Mapping[str, Any]) -> Page:
    """The answer of `pfdist.why`.

    Parameters
    ----------
    answer : mapping
        As of `pfdist.questions.why.Why.as_json`.
    """
    blocks = list[Block]()
    sets = sorted(
        answer["sets"].items(), key=lambda item: infinite_if_none(item[1]["expected_mse"])
    )
    for name, each in sets:  # the best first
        mse = with_error(infinite_if_none(each["expected_mse"]), each["standard_error"])
        blocks.append(Text(f"{name}: expected MSE {mse}", prominent=True))
        rises, windows = each["worth"], each["sampling_windows"]
        blocks += _of_set(name, rises, windows, mse=each["expected_mse"] or 0.0)
    draws = answer["draws"]
    how = f"on {draws:,} fresh draws; ± standard error" if draws else "exact"
    line = f"what each measurement of {answer['run']} is worth, {how}"
    meaning = [Text(_meaning(draws), detail=True), Text(_WINDOWS, detail=True)]
    return Page("", line, [Section("", [*blocks, *meaning])])


def _meaning(draws: int) -> str:
    how = f"on {number_of(draws, 'fresh draw')}" if draws else "exactly"
    return (
        f"By how much the expected error rises if a measurement is left out or moved, {how}. A "
        "measurement whose loss changes little may be left out; the others should be kept. A value "
        "below 0 means that the change would lower the error."
    )


def _of_set(
    name: str,
    worth: Rows,
    windows: Rows,
    *,
    detail: bool = False,
    mse: float = 0.0,
) -> list[Block]:
    """The rises and the sampling windows of a set, and what follows from the windows."""
    rises = [_rises(row, mse) for row in worth]
    blocks: list[Block] = [
        Table(f"Rise of the expected error, times of {name}", _HEAD, rises, detail)
    ]
    rows = list(windows)
    if not rows:
        return blocks
    levels = (windows_of(rows, STRICT), windows_of(rows, WIDE))
    cells = [
        [Cell(formatted_time(strict.measurement), strict.t), Cell(strict.text), Cell(wide.text)]
        for strict, wide in zip(*levels, strict=True)
    ]
    table = Table(f"Sampling windows, times of {name}", _WINDOWS_HEAD, cells, detail)
    said = sentences(rows) or ["nothing can move."]
    return [*blocks, table, Text(f"{name}: {' '.join(said)}")]


def _rises(measurement: Mapping[Any, Any], mse: float) -> list[Cell]:
    cells = [Cell(formatted_time(measurement_of(measurement)), measurement["t"])]
    for change in _CHANGES:
        rise, error = measurement[change], measurement[f"{change}_error"]
        if rise is None or math.isnan(rise):  # the shift is impossible
            cells.append(Cell(""))
            continue
        if error == 0.0 and abs(rise) < _ROUNDING * abs(mse):
            rise = 0.0
        cells.append(Cell(with_error(rise, error, sign=True), rise))
    return cells
