"""The sections of a sweep's report: the answer, all points, the figures, how it was computed."""

import math
from collections import Counter
from collections.abc import Hashable, Mapping
from typing import Any

import pfdist
from pfdist.analysis.listed_run import DAMAGED, FINISHED
from pfdist.analysis.studies import SEED, SET, Average, averages, is_numeric, selected, values_of
from pfdist.analysis.table_cells import is_missing, told_gain, told_mse, told_value
from pfdist.common.rounding import with_interval
from pfdist.common.told_counts import told_seconds
from pfdist.common.told_times import told_time, told_times
from pfdist.errors import one_line
from pfdist.plots import against, found_times, heat_map
from pfdist.plots.figure import Plot
from pfdist.plots.panel import height_of_rows
from pfdist.plots.sweeps import ROW_OF_MAP
from pfdist.plots.times_axis import times_inches
from pfdist.reports.parts import (
    Block,
    Cell,
    Facts,
    Picture,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.reports.svg import as_svg
from pfdist.reports.sweep_subject import Point, SweepSubject

_MOST_LINES = 6  # of a figure in a report
_MOST_KEYS = 6  # keys that have a figure
_MOST_CELLS = 24  # values of a key of the heat map
_BEST_OF_SEVERAL = (
    "The best of several points looks better than it is, the more so the more points there are."
)
_LINES = "A result of all points against a key of their jobs, with 95 % intervals."
_MAP = "A result of all points as a heat map over two keys of their jobs."
_TIMES = "The found times of all points, a row for each run and set."
GAIN = "gain_of_means"
Row = Mapping[Hashable, Any]


def answer(subject: SweepSubject) -> Section | None:
    """Say which point has the lowest expected MSE, and which the highest gain."""
    told = [
        _best(subject, "expected_mse", "lowest", "expected MSE"),
        _best(subject, GAIN, "highest", "gain of means over the reference"),
    ]
    found = [text for text in told if text]
    if not found:
        return None
    blocks: list[Block] = [Text(" ".join(found), prominent=True)]
    if subject.columns:
        blocks.append(Text(_BEST_OF_SEVERAL))
    return Section("The answer", blocks)


def points(subject: SweepSubject) -> Section:
    """Give a table with a row for each point and set, and a table of the damaged points."""
    blocks: list[Block] = []
    keys = [*(key for key in subject.keys if key != SEED), *({SEED} & {*subject.keys})]
    rows = [_row(subject, keys, row) for row in subject.rows]
    if rows:
        head = [subject.short[key] for key in keys] or ["point"]
        head += [SET, "state", "expected MSE", "gain % (95 %)", "times", "seconds"]
        is_linked = any(row[0].link for row in rows)
        links = "Each row begins with a link to the report of the point." * is_linked
        seconds = "The seconds are those of all workers, for all sets of a run together."
        blocks.append(Text(f"{links} {seconds}".strip()))
        blocks.append(without_empty_columns(Table("All points", head, rows)))
    damaged = [
        [Cell(point.name, None, point.link, _linked(point)), Cell(f"{DAMAGED}: {point.fault}")]
        for point in subject.points
        if point.state == DAMAGED
    ]
    if damaged:
        blocks.append(Table("Points that cannot be read", ["point", "why"], damaged))
    return Section("All points", blocks)


def figures(subject: SweepSubject) -> Section | None:
    """Give the figures: a result against each key, a heat map, and the found times."""
    frame = subject.frame
    blocks: list[Block] = []
    if any(map(math.isfinite, frame["expected_mse"])):
        blocks += [_against(subject, key) for key in subject.varying[:_MOST_KEYS]]
        blocks += _heat_map(subject)
    title = "How the results depend on the keys" if blocks else "What was found"
    if blocks:
        blocks.insert(0, Text(_said_of_intervals(subject)))
    if frame["measurement_times"].notna().any():
        blocks.append(_found_times(subject))
    return Section(title, blocks) if blocks else None


def computed(subject: SweepSubject) -> Section:
    """Say how many points are finished, how long all took, and with which versions."""
    per_run = subject.frame.drop_duplicates("path")["worker_seconds"]
    states = dict.fromkeys([FINISHED, *(point.state for point in subject.points)])
    versions = dict.fromkeys(run.version for run in subject.runs)
    facts = [
        ("points", f"{len(subject.points):,}"),
        *((state, f"{subject.count(state):,}") for state in states),
        ("time of all workers", f"{told_seconds(float(per_run.sum()))} s"),
        ("models", ", ".join(subject.models)),
        ("pfdist, of the runs", ", ".join(versions)),
        ("pfdist, of this page", pfdist.__version__),
    ]
    return Section("How it was computed", [Facts([fact for fact in facts if fact[1]])])


def _best(subject: SweepSubject, value: str, superlative: str, told: str) -> str:
    """Say which values have the best result, and how many others may be as good."""
    ranked = subject.ranked(value, is_best_low=superlative == "lowest")
    if not ranked:
        return ""
    best, *others = ranked
    point = subject.told(subject.columns, best.point) or subject.frame["run"].iloc[0]
    factor, sign = (1.0, "") if value == "expected_mse" else (100.0, " %")
    number, low, high = with_interval(*(factor * x for x in (best.mean, best.low, best.high)))
    if best.low == best.high:
        interval = ", which is known exactly"
    elif math.isnan(best.low):
        interval = ""
    else:
        interval = f" (95 %: {low} to {high}{sign})"
    seeds = len(best.replicates)
    mean = f", the mean of {seeds} seeds" if seeds > 1 else ""
    if seeds == 1 and math.isnan(best.low):
        mean = ", of a single seed"
    known = f"{number}{sign}{interval}{mean}."
    if seeds > 1 and not subject.columns:  # the seeds alone differ: there is nothing to choose
        return f"The {told} is {known}"
    text = f"The {superlative} {told} is that of {point}: {known}"
    rivals = sum(_overlap(best, other) for other in others)
    if rivals:
        number = f"{rivals:,} of the {len(others):,}" if rivals < len(others) else f"all {rivals:,}"
        text += f" The intervals of {number} others overlap this interval."
    return text


def _overlap(best: Average, other: Average) -> bool:
    return other.low <= best.high and best.low <= other.high


def _row(subject: SweepSubject, keys: list[str], row: Row) -> list[Cell]:
    point = subject.by_path[row["path"]]
    cells = [_value(row[key]) for key in keys] or [Cell(point.name)]
    cells[0] = Cell(cells[0].text or "none", cells[0].value, point.link, _linked(point))
    is_finished = all(each.state in (FINISHED, DAMAGED) for each in subject.points)
    mse, gain = row["expected_mse"], row[GAIN]
    times = row["measurement_times"]
    unit = subject.frame.attrs.get("time_unit", "")
    return [
        *cells,
        Cell(told_value(row[SET])),
        Cell("" if is_finished else point.state),
        Cell(told_mse(row), None if is_missing(mse) else mse),
        Cell(told_gain(row), None if is_missing(gain) else gain),
        Cell("" if is_missing(times) else told_times(times, unit)),
        Cell(told_seconds(row["worker_seconds"]), row["worker_seconds"]),
    ]


def _linked(point: Point) -> str:
    return f"report of {point.name}"


def _value(value: Any) -> Cell:
    return Cell(one_line(told_value(value)), value if is_numeric([value]) else None)


def _said_of_intervals(subject: SweepSubject) -> str:
    several = any(
        len(each.replicates) > 1
        for each in averages(subject.frame, subject.columns, "expected_mse")
    )
    if several:
        return (
            "Small points are the runs of single seeds. Lines and cells show the means over the "
            "seeds, and bars are 95 % intervals of the means, by Student's t."
        )
    return "Bars are the 95 % intervals of each run."


def _against(subject: SweepSubject, key: str) -> Picture:
    frame, held = subject.held([key], _MOST_LINES)
    plot = Plot(
        2.6, lambda panels: against(frame, key, ax=panels[0]),
        title=_title_of_lines(subject, key, held),
    )  # fmt: skip
    return _picture(f"against-{subject.keys.index(key)}", plot, _LINES)


def _title_of_lines(subject: SweepSubject, key: str, held: Mapping[str, Any]) -> str:
    """Say what the least expected MSE does along a key."""
    found = averages(selected(subject.frame, held), subject.columns, "expected_mse")
    position = subject.columns.index(key)
    least = dict[Any, Average]()
    for each in found:
        value = each.point[position]
        if math.isfinite(each.mean) and (value not in least or each.mean < least[value].mean):
            least[value] = each
    name, order = subject.short[key], [v for v in values_of(subject.frame, key) if v in least]
    if not order:
        return f"Expected MSE against {name}."
    if subject.numeric(key) and len(order) > 1:
        first, last = (told_value(order[end]) for end in (0, -1))
        start, end = (_number(least[order[end]]) for end in (0, -1))
        told = (
            f"From {name} = {first} to {last}, the lowest expected MSE goes from {start} to {end}"
        )
    else:
        best = min(order, key=lambda value: least[value].mean)
        told = f"The lowest expected MSE is that of {subject.told([key], [best])}"
    return f"{told}{_told_held(subject, held)}."


def _number(average: Average) -> str:
    return with_interval(average.mean, average.low, average.high)[0]


def _told_held(subject: SweepSubject, held: Mapping[str, Any]) -> str:
    if not held:
        return ""
    return f" (with {subject.told(list(held), list(held.values()))}, as at the best point)"


def _heat_map(subject: SweepSubject) -> list[Block]:
    if len(subject.varying) < 2:
        return []
    x, y = subject.varying[:2]
    if max(len(values_of(subject.frame, name)) for name in (x, y)) > _MOST_CELLS:
        return []
    frame, held = subject.held([x, y], 1)
    is_gain = any(map(math.isfinite, frame[GAIN]))
    value, told = (GAIN, "Gain of means") if is_gain else ("expected_mse", "Expected MSE")
    known = {each.point for each in averages(frame, [x, y], value) if math.isfinite(each.mean)}
    is_full = len(known) == math.prod(len(values_of(frame, name)) for name in (x, y))
    hatched = "" if is_full else "; hatched cells have no result"
    names = f"{subject.short[x]} and {subject.short[y]}"
    title = f"{told} by {names}{_told_held(subject, held)}{hatched}."
    plot = Plot(
        height_of_rows(len(values_of(frame, y)), ROW_OF_MAP),
        lambda panels: heat_map(frame, x, y, value, ax=panels[0]),
        title=title,
    )  # fmt: skip
    return [_picture("map", plot, _MAP)]


def _found_times(subject: SweepSubject) -> Picture:
    sets = subject.frame["measurement_times"].dropna()
    often = [(count, -t) for t, count in Counter(t for times in sets for t in times).items()]
    most, t = max(often, default=(0, 0))
    last = max(run.problem.clock.times[-1] for run in subject.runs)
    plot = Plot(
        times_inches(len(sets)),
        lambda panels: found_times(subject.frame, horizon=last, ax=panels[0]),
        title=f"The time t = {told_time(-t)} was found most often, in {most} of {len(sets)} sets.",
    )  # fmt: skip
    return _picture("times", plot, _TIMES)


def _picture(name: str, plot: Plot, description: str) -> Picture:
    return Picture(plot.title, description, as_svg(plot, name, description))
