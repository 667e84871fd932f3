"""The section of a sweep's report on the times of each point, judged at every point."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from pfdist.analysis.studies import plain
from pfdist.analysis.table_cells import told_value
from pfdist.common.rounding import rounded, with_interval
from pfdist.errors import one_line
from pfdist.reports.parts import Block, Cell, Section, Table, Text, without_empty_columns
from pfdist.reports.sweep_subject import SweepSubject

_LOSS = (
    "The loss is how much higher the expected MSE is at another point than with the best times "
    "found at that point, on the same draws. A negative loss means that the searches there found "
    "worse times. Times that are not feasible at a point, or have another number of measurements, "
    "have no loss there. The largest of several losses looks larger than it is."
)
Row = Mapping[Any, Any]


class _Losses(NamedTuple):
    """The losses of times that a search found at a point, at all other points."""

    found_at: str
    search: str
    points: int
    mean: float
    worst: Row

    @property
    def largest(self) -> str:
        """The largest loss in per cent, with its interval."""
        loss, low, high = (100.0 * self.worst[name] for name in ("loss", "loss_low", "loss_high"))
        number, least, most = with_interval(loss, low, high)
        return f"{number} ({least} to {most})" if low < high else number


def judged(subject: SweepSubject) -> Section | None:
    """Say which times lose least wherever they are used; None if nothing was judged."""
    losses = list(_losses_of(subject))
    if not losses:
        return None
    points = subject.judged["run"].nunique()
    blocks: list[Block] = []
    if answer := _answer(subject, losses):
        blocks.append(Text(answer))
    if points < len(subject.points):
        total = len(subject.points)
        blocks.append(Text(f"The times were judged at {points:,} of {total:,} points."))
    return Section(
        "The times of each point, judged at every point",
        [*blocks, Text(_LOSS), without_empty_columns(_table(subject, losses))],
    )


def _answer(subject: SweepSubject, losses: list[_Losses]) -> str:
    """Say which times have the smallest largest loss; empty if none has losses at all points."""
    runs = set(subject.judged["run"])
    everywhere = [each for each in losses if each.points == len(runs - {each.found_at})]
    if not everywhere:
        return ""
    values = _values_by_run(subject)
    best = min(everywhere, key=lambda each: each.worst["loss"])
    search = f" by {best.search}" if len({each.search for each in losses}) > 1 else ""
    found_at, worst_at = (_told(subject, values[run]) for run in (best.found_at, best.worst["run"]))
    return (
        f"The safest times are those found{search} at {found_at}: their largest loss is "
        f"{best.largest} %, at {worst_at}."
    )


def _table(subject: SweepSubject, losses: list[_Losses]) -> Table:
    several, values = len({each.search for each in losses}) > 1, _values_by_run(subject)
    keys = [subject.short[key] for key in subject.keys] or ["found at"]
    rows = [
        [
            *map(Cell, _values(subject, values[each.found_at])),
            Cell(each.search * several),
            Cell(rounded(100.0 * each.mean, 3), each.mean),
            Cell(each.largest, each.worst["loss"]),
            Cell(", ".join(_values(subject, values[each.worst["run"]]))),
        ]
        for each in losses
    ]
    head = [*keys, "set", "mean loss %", "largest loss % (95 %)", "at"]
    return Table("Losses of the times found at each point, at the other points", head, rows)


def _losses_of(subject: SweepSubject) -> Iterator[_Losses]:
    """Yield the losses of all times whose losses are known, in the order of the table."""
    for (point, search), rows in subject.judged.groupby(["found_at", "set"], sort=False):
        others = [row for row in rows.to_dict("records") if row["run"] != point]
        known = [row for row in others if math.isfinite(row["loss"])]
        if known:
            worst = max(known, key=lambda row: row["loss"])
            mean = sum(row["loss"] for row in known) / len(known)
            yield _Losses(str(point), str(search), len(known), mean, worst)


def _values_by_run(subject: SweepSubject) -> dict[str, Row]:
    return {row["run"]: row for row in subject.frame.to_dict("records")}


def _values(subject: SweepSubject, row: Row) -> list[str]:
    """Give the values of a point's keys as texts; without keys, the point's name."""
    return [one_line(told_value(row[key])) for key in subject.keys] or [one_line(row["run"])]


def _told(subject: SweepSubject, row: Row) -> str:
    """Give the values of a point's keys as a phrase; without keys, the point's name."""
    told = subject.told(subject.keys, [plain(row[key]) for key in subject.keys])
    return one_line(told or row["run"])
