"""The report of a sweep: a table of its points, a figure, and the plan of least regret."""

import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import quote_from_bytes

import pandas as pd
from matplotlib.axes import Axes

import pfdist
from pfdist.common.formatted_times import formatted_seconds
from pfdist.common.parts import (
    Block,
    Cell,
    Facts,
    Page,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.errors import one_line, reason_of, relative
from pfdist.pages.figure import Plot
from pfdist.pages.panel import verbatim
from pfdist.pages.plots import against
from pfdist.questions.about_run import run_day
from pfdist.questions.list_runs import FINISHED, UNREADABLE, listed_run
from pfdist.questions.pictures import picture
from pfdist.questions.runs import least_regret_text, lowest_text, value_cell
from pfdist.questions.subject import number_of, without_folder
from pfdist.results import Run, open_run
from pfdist.results.columns import Row as ListedRow
from pfdist.results.judged import (
    JUDGED,
    NOTHING_JUDGED,
    PLAN,
    REGRET,
    judged_table,
    times_by_search,
)
from pfdist.results.runs_table import (
    RESULTS,
    formatted_gain,
    formatted_mse,
    formatted_value,
    keys_of,
    runs_table,
    shown_names,
)
from pfdist.results.stored_run import version_of
from pfdist.results.studies import (
    SEED,
    SET,
    averages,
    formatted_point,
    plain,
    still_varying,
    values_of,
)
from pfdist.store import holds_run
from pfdist.store.folder import REPORT, has_report, runs_below

_SAFE = "=,+"  # characters of a folder's name that a link holds as they are
_MOST_LINES = 5  # of a figure in a report
_REGRET = (
    "A plan is a set of times that was found at a point. Its regret at a point is how far its "
    "expected MSE lies above that of the best times found at any point, on the same draws. Times "
    "that are not feasible at a point have no regret there. A line is a plan, named by the values "
    "of its point: its largest regret at the points with the same value of the key. There are at "
    "most five; the first is the plan of least regret."
)
_BEST_OF_SEVERAL = "Picking the best of several points makes it look slightly better than it is."
_BARS = (
    "Small points are the runs of single seeds. Bars are 95 % intervals: by Student's t over the "
    "seeds if there are several, else those of each run."
)
Row = Mapping[Any, Any]


class SweepSubject:
    """The runs in the folder of a sweep, and their table.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    points : dict of Path to Row
        In the order of their names; damaged if a table cannot be read.
    runs : list of Run
        Those that can be read.
    frame, judged : DataFrame
        The table of these runs, and that of the finished comparisons, as `Sweep.judged`.
    judged_fault : str
        Why the comparisons cannot be read; empty if they can.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.points = {each: listed_run(each, one_line(each.name)) for each in runs_below(path, 1)}
        try:
            self.runs, self.frame = self._read()
        except Exception:  # a report of many runs must not fail because of one of them
            self.points = {each: _tried(each, listed) for each, listed in self.points.items()}
            self.runs, self.frame = self._read()
        self.judged_fault = ""
        try:
            self.judged = self._read_judged()
        except Exception as error:  # nor because of a comparison
            self.judged, self.judged_fault = NOTHING_JUDGED, reason_of(error)

    @cached_property
    def keys(self) -> list[str]:
        """Keys in which the jobs differ, the seed last."""
        return sorted(keys_of(self.frame), key=lambda name: name == SEED)

    @cached_property
    def columns(self) -> list[str]:
        """The set and the keys other than the seed, if they distinguish rows."""
        return still_varying(self.frame, [])

    @cached_property
    def axis(self) -> str | None:
        """The key of the figure's horizontal axis."""
        return next((name for name in (*self.columns, *self.keys) if name != SET), None)

    def count(self, state: str) -> int:
        """The number of points in a state."""
        return sum(listed.state == state for listed in self.points.values())

    def _read(self) -> tuple[list[Run], pd.DataFrame]:
        runs = [open_run(path) for path, listed in self.points.items() if listed.fault is None]
        return runs, runs_table(runs) if runs else pd.DataFrame(columns=["run", *RESULTS])

    def _read_judged(self) -> pd.DataFrame:
        """Read the finished comparisons of finished points; if points were added, the latest."""
        runs = {run.path.name: run for run in self.runs if run.state == FINISHED}
        found_sets = {times for sets in times_by_search(runs).values() for times in sets.values()}
        best, most = dict[str, Run](), (0, 0)
        for folder in sorted(self.path.glob(f"{JUDGED}/*/")):
            opened = [open_run(folder / name) for name in runs if holds_run(folder / name)]
            finished = {run.path.name: run for run in opened if run.state == FINISHED}
            sets = set(next(iter(finished.values())).sets.values()) if finished else set()
            if (len(found_sets & sets), len(finished)) > most:
                best, most = finished, (len(found_sets & sets), len(finished))
        return judged_table(runs, best)


def _tried(path: Path, listed: ListedRow) -> ListedRow:
    """A point with the reason why it cannot be read, if it cannot."""
    try:
        if listed.fault is None:
            runs_table([open_run(path)])
    except Exception as error:
        fault = reason_of(error).replace(relative(f"{path}/"), "")
        return ListedRow(**vars(listed) | {"state": UNREADABLE, "fault": fault})
    return listed


def answer(subject: SweepSubject) -> Section | None:
    """The plan of least regret or, if nothing was judged, the lowest expected MSE; and a figure."""
    if subject.judged["regret"].notna().any():
        points, total = subject.judged["run"].nunique(), len(subject.points)
        part = f"The times were judged at {points:,} of {total:,} points." * (points < total)
        texts, value = [least_regret_text(subject.judged), part, _REGRET], "regret"
    elif lowest := lowest_text(subject.frame):
        texts, value = [lowest, _BEST_OF_SEVERAL * bool(subject.columns), _BARS], "expected_mse"
    else:
        return None
    said, *notes = filter(None, texts)
    blocks: list[Block] = [Text(said, prominent=True)]
    if axis := subject.axis:
        shown = _plans(subject, axis) if value == "regret" else _lines(subject, axis)
        what = "The plans of least regret" if value == "regret" else "The expected MSE"
        name = shown_names(subject.keys)[axis]
        title = f"{what} against {name}."

        def draw(panels: Sequence[Axes]) -> None:
            against(shown, axis, value, ax=panels[0]).set_xlabel(verbatim(name))

        plot = Plot(2.6, draw, title=title)
        blocks.append(picture(plot, "points", title))
    return Section("The answer", [*blocks, *map(Text, notes)])


def _plans(subject: SweepSubject, axis: str) -> pd.DataFrame:
    """The largest regret of each plan at each value of a key, of the plans of least regret.

    A plan is named by the values of the keys at its point. The plan of least regret is the first.
    """
    largest = subject.judged.groupby(list(PLAN))["regret"].max()
    few = largest.nsmallest(_MOST_LINES).index.to_frame(index=False)
    worst = subject.judged.dropna(subset="regret").sort_values("regret")
    rows = few.merge(worst.drop_duplicates([*PLAN, axis], keep="last"))
    keys = subject.keys
    names = {
        row["run"]: formatted_point(keys, tuple(row[key] for key in keys), keys)
        for row in subject.frame.to_dict("records")
    }
    rows["found at"] = rows["found_at"].map(names)
    return rows[["run", axis, "found at", "set", *REGRET]]


def _lines(subject: SweepSubject, axis: str) -> pd.DataFrame:
    """The rows of the lines with the lowest expected MSEs, if there are many lines."""
    others = still_varying(subject.frame, [axis])
    means = averages(subject.frame, [axis, *others], "expected_mse")
    lines = dict.fromkeys(each.point[1:] for each in sorted(means, key=lambda each: each.mean))
    shown, rows = {*islice(lines, _MOST_LINES)}, subject.frame.to_dict("records")
    return subject.frame[[tuple(plain(row[name]) for name in others) in shown for row in rows]]


def points(subject: SweepSubject) -> Section | None:
    """A table with a row for each point and set."""
    order = sorted((*subject.keys, SET), key=lambda name: name == SEED)
    values = {name: values_of(subject.frame, name) for name in order}
    records = sorted(
        subject.frame.to_dict("records"),
        key=lambda row: [values[name].index(plain(row[name])) for name in order],
    )
    rows = [_row(subject, row) for row in records]
    if not rows:
        return None
    short = shown_names(subject.keys)
    head = [*(short[key] for key in subject.keys)] or ["point"]
    head += [SET, "state", "expected MSE ± standard error", "gain % (95 %)"]
    link = Text("Each row begins with a link to the report of the point.")
    table = without_empty_columns(Table("All points", head, rows))
    return Section("All points", [*([link] if any(row[0].link for row in rows) else []), table])


def _row(subject: SweepSubject, row: Row) -> list[Cell]:
    path = Path(row["path"])
    listed = subject.points[path]
    first, *others = [value_cell(row[key]) for key in subject.keys] or [Cell(listed.run)]
    return [
        Cell(first.text or "none", first.value, _link(path), f"report of {listed.run}"),
        *others,
        Cell(formatted_value(row[SET])),
        Cell("" if listed.state == FINISHED else listed.state),
        Cell(formatted_mse(row), plain(row["expected_mse"])),
        Cell(formatted_gain(row), plain(row["gain_of_means"])),
    ]


def _link(point: Path) -> str:
    """Address of a point's report, from the folder of the sweep; empty if there is none."""
    name = quote_from_bytes(os.fsencode(point.name), safe=_SAFE)
    return f"{name}/{REPORT}" if has_report(point) else ""


def computed(subject: SweepSubject) -> Section:
    """The number of finished points, the time of all workers, and the versions."""
    seconds = float(subject.frame.drop_duplicates("path")["worker_seconds"].sum())
    facts = [
        ("points", f"{len(subject.points):,}"),
        (FINISHED, f"{subject.count(FINISHED):,}"),
        ("time of all workers", f"{formatted_seconds(seconds)} s"),
        ("pfdist, of the runs", ", ".join(dict.fromkeys(map(version_of, subject.runs)))),
        ("pfdist, of this page", pfdist.__version__),
    ]
    return Section("How it was computed", [Facts([fact for fact in facts if fact[1]])])


def sweep_page(path: Path) -> Page:
    """The report of a sweep: of the runs in a folder, finished or not.

    A run that cannot be read has a warning with the reason.

    Raises
    ------
    StoreError
        The folder cannot be listed.
    """
    subject = SweepSubject(path)
    made = (answer(subject), points(subject), computed(subject))
    names = (without_folder(run.job["model"]["name"]) for run in subject.runs)
    models = ", ".join(dict.fromkeys(names))
    about = number_of(len(subject.points), "point") + (f" of {models}" if models else "")
    days = [run_day(run) for run in subject.runs]
    about += f", {days[0]}, pfdist {pfdist.__version__}" if days else ""
    links = "Its links lead to the reports of the points, in the folders beside it."
    return Page(
        f"Sweep: {one_line(path.resolve().name)}", about, [part for part in made if part],
        _warnings(subject), links=links if any(map(has_report, subject.points)) else "",
    )  # fmt: skip


def _warnings(subject: SweepSubject) -> list[str]:
    unfinished = len(subject.points) - subject.count(UNREADABLE) - subject.count(FINISHED)
    of_all = f"{unfinished:,} of {number_of(len(subject.points), 'point')}"
    warnings = [f"Not finished: {of_all}. Results may change."] if unfinished else []
    warnings += [
        f"{listed.run} cannot be read: {listed.fault}"
        for listed in subject.points.values()
        if listed.fault is not None
    ]
    if subject.judged_fault:
        warnings.append(f"The judged times cannot be read: {subject.judged_fault}.")
    return warnings
