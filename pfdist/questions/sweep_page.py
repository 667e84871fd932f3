"""The results of the points of a sweep, and how their times do at the other points."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pfdist
from pfdist.common.formatted_times import (
    formatted_seconds,
    formatted_time,
    formatted_times,
    time_and_sensor,
)
from pfdist.common.parts import (
    Block,
    Cell,
    Facts,
    Page,
    Picture,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.common.rounding import rounded, with_interval
from pfdist.errors import one_line
from pfdist.pages.figure import Plot
from pfdist.pages.panel import height_of_rows
from pfdist.pages.plots import against, found_times, heat_map
from pfdist.pages.sweeps import ROW_OF_MAP
from pfdist.pages.times_axis import times_inches
from pfdist.questions.pictures import picture
from pfdist.questions.runs import value_cell
from pfdist.questions.subject import number_of
from pfdist.questions.sweep_subject import Point, SweepSubject
from pfdist.results.listed_run import DAMAGED, FINISHED
from pfdist.results.stored_run import problem_of, version_of
from pfdist.results.studies import (
    SEED,
    SET,
    Average,
    averages,
    is_numeric,
    plain,
    selected,
    values_of,
)
from pfdist.results.table_cells import formatted_gain, formatted_mse, formatted_value, is_missing

_LINKS = "Its links lead to the reports of the points, in the folders beside it."

_MOST_LINES = 6  # of a figure in a report
_MOST_KEYS = 6  # keys that have a figure
_MOST_CELLS = 24  # values of a key of the heat map
_BEST_OF_SEVERAL = (
    "The best of several points looks better than it is, the more so the more points there are."
)
_SEEDS = (
    "Each seed has draws of its own. So the interval of a mean, by Student's t over the seeds, "
    "holds the chance of the search and that of the draws together."
)
_BARS = "Bars are the 95 % intervals of each run."
_BARS_OF_MEANS = (
    "Small points are the runs of single seeds. Lines and cells show the means over the seeds, and "
    "bars are 95 % intervals of the means, by Student's t."
)
_LINES = "A result of all points against a key of their jobs, with 95 % intervals."
_MAP = "A result of all points as a heat map over two keys of their jobs."
_TIMES = "The found times of all points, a row for each run and set."
GAIN = "gain_of_means"
Row = Mapping[Any, Any]


def answer(subject: SweepSubject) -> Section | None:
    """Say which point has the lowest expected MSE, and which the highest gain."""
    sentences = [
        _best(subject, "expected_mse", "lowest", "expected MSE"),
        _best(subject, GAIN, "highest", "gain of means over the reference"),
    ]
    texts = [text for text in sentences if text]
    if not texts:
        return None
    blocks: list[Block] = [Text(" ".join(texts), prominent=True)]
    if subject.columns:
        blocks.append(Text(_BEST_OF_SEVERAL))
    return Section("The answer", blocks)


def means(subject: SweepSubject) -> Section | None:
    """A table of the means over the seeds; None if no runs differ in their seeds alone."""
    errors, gains = (
        averages(subject.frame, subject.columns, value) for value in ("expected_mse", GAIN)
    )
    if all(len(each.replicates) < 2 for each in errors):
        return None
    gain_of = {each.point: each for each in gains}
    rows = [
        [
            *(map(value_cell, each.point) if each.point else [Cell("all")]),
            Cell(str(len(each.replicates)), len(each.replicates)),
            _interval_cell(each),
            Cell(f"{rounded(min(each.replicates), 4)} to {rounded(max(each.replicates), 4)}"),
            _interval_cell(gain_of[each.point], 100.0) if each.point in gain_of else Cell(""),
        ]
        for each in errors
    ]
    head = [*(subject.short.get(name, name) for name in subject.columns)] or ["points"]
    head += ["seeds", "expected MSE (95 %)", "least to largest", "gain % (95 %)"]
    return Section(
        "What changes between seeds", [Text(_SEEDS), Table("Means over the seeds", head, rows)]
    )


def _interval_cell(average: Average, factor: float = 1.0) -> Cell:
    """A mean over seeds with its interval, in units of 1 / factor."""
    ends = (factor * x for x in (average.mean, average.low, average.high))
    value, low, high = with_interval(*ends)
    interval = "" if math.isnan(average.low) else f" ({low} to {high})"  # of a single seed
    return Cell(value + interval, average.mean)


def points(subject: SweepSubject) -> Section:
    """A table with a row for each point and set, and a table of the damaged points."""
    blocks: list[Block] = []
    keys = [*(key for key in subject.keys if key != SEED), *({SEED} & {*subject.keys})]
    rows = [_row(subject, keys, row) for row in subject.rows]
    if rows:
        head = [subject.short[key] for key in keys] or ["point"]
        head += [SET, "state", "expected MSE ± standard error", "gain % (95 %)", "seconds", "times"]
        is_linked = any(row[0].link for row in rows)
        links = "Each row begins with a link to the report of the point." * is_linked
        seconds = "The seconds are those of all workers, for all sets of a run together."
        blocks.append(Text(f"{links} {seconds}".strip()))
        blocks.append(without_empty_columns(Table("All points", head, rows)))
    damaged = [
        [Cell(point.name, None, point.link, _linked(point)), Cell(f"{DAMAGED}: {fault}")]
        for point in subject.points
        if (fault := point.listed.fault) is not None
    ]
    if damaged:
        blocks.append(Table("Points that cannot be read", ["point", "why"], damaged))
    return Section("All points", blocks)


def figures(subject: SweepSubject) -> Section | None:
    """The figures: a result against each key, a heat map, and the found times."""
    frame = subject.frame
    blocks: list[Block] = []
    if any(map(math.isfinite, frame["expected_mse"])):
        blocks += [_against(subject, key) for key in subject.varying[:_MOST_KEYS]]
        blocks += _heat_map(subject)
    title = "How the results depend on the keys" if blocks else "What was found"
    if blocks:
        points = averages(frame, subject.columns, "expected_mse")
        has_seeds = any(len(each.replicates) > 1 for each in points)
        blocks.insert(0, Text(_BARS_OF_MEANS if has_seeds else _BARS))
    if frame["measurement_times"].notna().any():
        blocks.append(_found_times(subject))
    return Section(title, blocks) if blocks else None


def computed(subject: SweepSubject) -> Section:
    """Say how many points are finished, how long all took, and with which versions."""
    per_run = subject.frame.drop_duplicates("path")["worker_seconds"]
    states = dict.fromkeys([FINISHED, *(point.listed.state for point in subject.points)])
    versions = dict.fromkeys(version_of(run) for run in subject.runs)
    facts = [
        ("points", f"{len(subject.points):,}"),
        *((state, f"{subject.count(state):,}") for state in states),
        ("time of all workers", f"{formatted_seconds(float(per_run.sum()))} s"),
        ("models", ", ".join(subject.models)),
        ("pfdist, of the runs", ", ".join(versions)),
        ("pfdist, of this page", pfdist.__version__),
    ]
    return Section("How it was computed", [Facts([fact for fact in facts if fact[1]])])


def _best(subject: SweepSubject, value: str, superlative: str, result: str) -> str:
    """Say which values have the best result, and how many others may be as good."""
    ranked = subject.ranked(value, is_best_low=superlative == "lowest")
    if not ranked:
        return ""
    best, *others = ranked
    point = subject.phrase(subject.columns, best.point) or subject.frame["run"].iloc[0]
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
    estimate = f"{number}{sign}{interval}{mean}."
    if seeds > 1 and not subject.columns:  # the seeds alone differ: there is nothing to choose
        return f"The {result} is {estimate}"
    text = f"The {superlative} {result} is that of {point}: {estimate}"
    rivals = sum(other.low <= best.high and best.low <= other.high for other in others)
    if rivals:
        number = f"{rivals:,} of the {len(others):,}" if rivals < len(others) else f"all {rivals:,}"
        text += f" The intervals of {number} others overlap this interval."
    return text


def _row(subject: SweepSubject, keys: list[str], row: Row) -> list[Cell]:
    point = subject.by_path[row["path"]]
    cells = [value_cell(row[key]) for key in keys] or [Cell(point.name)]
    cells[0] = Cell(cells[0].text or "none", cells[0].value, point.link, _linked(point))
    is_finished = all(each.listed.state in (FINISHED, DAMAGED) for each in subject.points)
    mse, gain = row["expected_mse"], row[GAIN]
    times = row["measurement_times"]
    unit = subject.frame.attrs.get("time_unit", "")
    return [
        *cells,
        Cell(formatted_value(row[SET])),
        Cell("" if is_finished else point.listed.state),
        Cell(formatted_mse(row), None if is_missing(mse) else mse),
        Cell(formatted_gain(row), None if is_missing(gain) else gain),
        Cell(formatted_seconds(row["worker_seconds"]), row["worker_seconds"]),
        Cell("" if is_missing(times) else formatted_times(times, unit)),
    ]


def _linked(point: Point) -> str:
    return f"report of {point.name}"


def _against(subject: SweepSubject, key: str) -> Picture:
    frame, held = subject.held([key], _MOST_LINES)
    plot = Plot(
        2.6, lambda panels: against(frame, key, ax=panels[0]),
        title=_title_of_lines(subject, key, held),
    )  # fmt: skip
    return picture(plot, f"against-{subject.keys.index(key)}", _LINES)


def _title_of_lines(subject: SweepSubject, key: str, held: Mapping[str, Any]) -> str:
    """Say what the least expected MSE does along a key."""
    points = averages(selected(subject.frame, held), subject.columns, "expected_mse")
    position = subject.columns.index(key)
    least = dict[Any, Average]()
    for each in points:
        value = each.point[position]
        if math.isfinite(each.mean) and (value not in least or each.mean < least[value].mean):
            least[value] = each
    name, order = subject.short[key], [v for v in values_of(subject.frame, key) if v in least]
    if not order:
        return f"Expected MSE against {name}."
    if is_numeric(values_of(subject.frame, key)) and len(order) > 1:
        first, last = (formatted_value(order[end]) for end in (0, -1))
        ends = (least[order[end]] for end in (0, -1))
        start, end = (with_interval(each.mean, each.low, each.high)[0] for each in ends)
        change = f"stays at {start}" if start == end else f"goes from {start} to {end}"
        text = f"From {name} = {first} to {last}, the lowest expected MSE {change}"
    else:
        best = min(order, key=lambda value: least[value].mean)
        text = f"The lowest expected MSE is that of {subject.phrase([key], [best])}"
    return f"{text}{_held_phrase(subject, held)}."


def _held_phrase(subject: SweepSubject, held: Mapping[str, Any]) -> str:
    if not held:
        return ""
    return f" (with {subject.phrase(list(held), list(held.values()))}, as at the best point)"


def _heat_map(subject: SweepSubject) -> list[Block]:
    if len(subject.varying) < 2:
        return []
    x, y = subject.varying[:2]
    if max(len(values_of(subject.frame, name)) for name in (x, y)) > _MOST_CELLS:
        return []
    frame, held = subject.held([x, y], 1)
    is_gain = any(map(math.isfinite, frame[GAIN]))
    value, result = (GAIN, "Gain of means") if is_gain else ("expected_mse", "Expected MSE")
    filled_cells = {
        each.point for each in averages(frame, [x, y], value) if math.isfinite(each.mean)
    }
    is_full = len(filled_cells) == math.prod(len(values_of(frame, name)) for name in (x, y))
    hatched = "" if is_full else "; hatched cells have no result"
    names = f"{subject.short[x]} and {subject.short[y]}"
    title = f"{result} by {names}{_held_phrase(subject, held)}{hatched}."
    plot = Plot(
        height_of_rows(len(values_of(frame, y)), ROW_OF_MAP),
        lambda panels: heat_map(frame, x, y, value, ax=panels[0]),
        title=title,
    )  # fmt: skip
    return [picture(plot, "map", _MAP)]


def _found_times(subject: SweepSubject) -> Picture:
    sets = subject.frame["measurement_times"].dropna()
    counts = Counter(t for times in sets for t in times)
    # The most frequent time, and the earliest of several.
    t = min(counts, key=lambda t: (-counts[t], time_and_sensor(t)), default=0)
    last = max(problem_of(run).clock.times[-1] for run in subject.runs)
    plot = Plot(
        times_inches(len(sets)),
        lambda panels: found_times(subject.frame, horizon=last, ax=panels[0]),
        title=f"t = {formatted_time(t)} was found most often, in {counts[t]} of {len(sets)} sets.",
    )  # fmt: skip
    return picture(plot, "times", _TIMES)


# --- times that are judged at every point --------------------------------------------------------

_LOSS = (
    "The loss is how much higher the expected MSE is at another point than with the best times "
    "found at that point, on the same draws. A negative loss means that the searches there found "
    "worse times. Times that are not feasible at a point, or have another number of measurements, "
    "have no loss there. The largest of several losses looks larger than it is."
)


class _Losses(NamedTuple):
    """The losses of times that a search found at a point, at all other points."""

    found_at: str
    search: str
    points: int
    mean: float
    worst: Row

    def largest(self, factor: float = 100.0) -> str:
        """The largest loss with its interval, in per cent; with the factor -100 as a gain."""
        loss, *ends = (factor * self.worst[name] for name in ("loss", "loss_low", "loss_high"))
        low, high = ends if factor > 0 else ends[::-1]
        number, least, most = with_interval(loss, low, high)
        return f"{number} ({least} to {most})" if low < high else number


def judged(subject: SweepSubject) -> Section | None:
    """Say which times lose least wherever they are used; None if nothing was judged."""
    losses = list(_losses_of(subject))
    if not losses:
        return None
    points = subject.judged["run"].nunique()
    blocks: list[Block] = []
    if answer := _safest(subject, losses):
        blocks.append(Text(answer))
    if points < len(subject.points):
        total = len(subject.points)
        blocks.append(Text(f"The times were judged at {points:,} of {total:,} points."))
    return Section(
        "The times of each point, judged at every point",
        [*blocks, Text(_LOSS), without_empty_columns(_losses_table(subject, losses))],
    )


def _safest(subject: SweepSubject, losses: list[_Losses]) -> str:
    """Say which times have the smallest largest loss; empty if none has losses at all points."""
    runs = set(subject.judged["run"])
    everywhere = [each for each in losses if each.points == len(runs - {each.found_at})]
    if not everywhere:
        return ""
    values = _values_by_run(subject)
    best = min(everywhere, key=lambda each: each.worst["loss"])
    search = f" by {best.search}" if len({each.search for each in losses}) > 1 else ""
    found_at, worst_at = (
        _phrase(subject, values[run]) for run in (best.found_at, best.worst["run"])
    )
    what, factor = ("smallest gain", -100.0) if best.worst["loss"] < 0 else ("largest loss", 100.0)
    return (
        f"The safest times are those found{search} at {found_at}: their {what} is "
        f"{best.largest(factor)} %, at {worst_at}."
    )


def _losses_table(subject: SweepSubject, losses: list[_Losses]) -> Table:
    several, values = len({each.search for each in losses}) > 1, _values_by_run(subject)
    keys = [subject.short[key] for key in subject.keys] or ["found at"]
    rows = [
        [
            *map(Cell, _key_values(subject, values[each.found_at])),
            Cell(each.search * several),
            Cell(rounded(100.0 * each.mean, 3), each.mean),
            Cell(each.largest(), each.worst["loss"]),
            Cell(", ".join(_key_values(subject, values[each.worst["run"]]))),
        ]
        for each in losses
    ]
    head = [*keys, "set", "mean loss %", "largest loss % (95 %)", "at"]
    return Table("Losses of the times found at each point, at the other points", head, rows)


def _losses_of(subject: SweepSubject) -> Iterator[_Losses]:
    """Yield the losses of all times whose losses are known, in the order of the table."""
    for (point, search), rows in subject.judged.groupby(["found_at", "set"], sort=False):
        others = [row for row in rows.to_dict("records") if row["run"] != point]
        rows_with_loss = [row for row in others if math.isfinite(row["loss"])]
        if rows_with_loss:
            worst = max(rows_with_loss, key=lambda row: row["loss"])
            mean = sum(row["loss"] for row in rows_with_loss) / len(rows_with_loss)
            yield _Losses(str(point), str(search), len(rows_with_loss), mean, worst)


def _values_by_run(subject: SweepSubject) -> dict[str, Row]:
    return {row["run"]: row for row in subject.frame.to_dict("records")}


def _key_values(subject: SweepSubject, row: Row) -> list[str]:
    """The values of a point's keys as texts; without keys, the point's name."""
    return [one_line(formatted_value(row[key])) for key in subject.keys] or [one_line(row["run"])]


def _phrase(subject: SweepSubject, row: Row) -> str:
    """The values of a point's keys as a phrase; without keys, the point's name."""
    phrase = subject.phrase(subject.keys, [plain(row[key]) for key in subject.keys])
    return one_line(phrase or row["run"])


_CHAPTERS = (answer, points, means, judged, figures, computed)


def sweep_page(path: Path) -> Page:
    """The report of a sweep, in a folder that is no run but has runs in it, finished or not.

    A run that cannot be read has a row that says why.

    Raises
    ------
    StoreError
        The folder cannot be listed.
    """
    subject = SweepSubject(path)
    sections = [section for make in _CHAPTERS if (section := make(subject)) is not None]
    name = one_line(subject.path.resolve().name)
    points = number_of(len(subject.points), "point")
    models = f" of {', '.join(subject.models)}" if subject.models else ""
    links = _LINKS if any(point.link for point in subject.points) else ""
    return Page(f"Sweep: {name}", f"{points}{models}", sections, _warnings(subject), links=links)


def _warnings(subject: SweepSubject) -> list[str]:
    total, damaged = len(subject.points), subject.count(DAMAGED)
    unfinished = total - damaged - subject.count(FINISHED)
    points = number_of(total, "point")
    warnings = []
    if unfinished:
        warnings.append(f"Not finished: {unfinished:,} of {points}. Results may change.")
    if damaged:
        warnings.append(f"Cannot be read: {damaged:,} of {points}. The table says why.")
    if subject.judged_fault:
        warnings.append(f"The judged times cannot be read: {subject.judged_fault}.")
    return warnings
