"""The runs of a sweep that a report is about, and which of them is best."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote_from_bytes

import pandas as pd

from pfdist.common.dotted_keys import short_names
from pfdist.errors import PfdistError, one_line, relative, shown_text
from pfdist.questions.subject import without_folder
from pfdist.results import Run, open_run
from pfdist.results.judged import JUDGED, NOTHING_JUDGED, judged_table, times_by_search
from pfdist.results.listed_run import DAMAGED, FINISHED, ListedRun, listed_run
from pfdist.results.runs_table import RESULTS, runs_table
from pfdist.results.studies import (
    SEED,
    SET,
    Average,
    averages,
    formatted_point,
    in_order,
    selected,
    still_varying,
    values_of,
)
from pfdist.results.table_cells import keys_of
from pfdist.store import holds_run
from pfdist.store.folder import REPORT, has_report, runs_below

_SAFE = "=,+"  # characters of a folder's name that a link holds as they are


@dataclass(frozen=True)
class Point:
    """A run of a sweep.

    Parameters
    ----------
    path : Path
    listed : ListedRun
        How far it is, as `pfdist.list_runs` says it; damaged if a table cannot be read.
    """

    path: Path
    listed: ListedRun

    @property
    def name(self) -> str:
        """Name of the folder, on one line."""
        return one_line(self.path.name)

    @property
    def link(self) -> str:
        """Address of the point's report, from the folder of the sweep; empty if there is none."""
        if not has_report(self.path):
            return ""
        return f"{quote_from_bytes(os.fsencode(self.path.name), safe=_SAFE)}/{REPORT}"


class SweepSubject:
    """The runs in the folder of a sweep, and their table.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    points : list of Point
        In the order of their names.
    runs : list of Run
        Those that can be read.
    frame : DataFrame
        As `pfdist.table` gives it of these runs.
    judged : DataFrame
        As `Sweep.judged` gives it of the finished comparisons; empty if there is none.
    judged_fault : str
        Why the comparisons cannot be read; empty if they can.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.points = [Point(each, listed_run(each, each.name)) for each in runs_below(path, 1)]
        self.runs, self.frame = self._read()
        self.judged_fault = ""
        try:
            self.judged = self._read_judged()
        except Exception as error:  # a report of many runs must not fail because of one of them
            self.judged, self.judged_fault = NOTHING_JUDGED, _reason(error)

    @cached_property
    def by_path(self) -> Mapping[str, Point]:
        """The points by their folders, as the table names them."""
        return {str(point.path): point for point in self.points}

    @cached_property
    def keys(self) -> list[str]:
        """Keys in which the jobs differ."""
        return keys_of(self.frame)

    @cached_property
    def short(self) -> Mapping[str, str]:
        """The short name of each key."""
        return short_names(self.keys)

    @cached_property
    def varying(self) -> list[str]:
        """Keys in which the jobs differ, other than the seed and those that change with others."""
        keys = list[str]()
        for name in self.keys:
            if name != SEED and name in still_varying(self.frame, keys):
                keys.append(name)
        return keys

    @cached_property
    def columns(self) -> list[str]:
        """The varying keys, and the set if it tells rows apart, too."""
        return [*self.varying, *({SET} & {*still_varying(self.frame, self.varying)})]

    @property
    def models(self) -> list[str]:
        """Names of the models, without folders of this machine."""
        return list(dict.fromkeys(without_folder(run.job["model"]["name"]) for run in self.runs))

    @property
    def rows(self) -> list[dict[Any, Any]]:
        """The rows of the table in the order of their values, the seed last."""
        return in_order(self.frame, [*self.varying, SET, *({SEED} & {*self.keys})])

    def count(self, state: str) -> int:
        """The number of points in a state."""
        return sum(point.listed.state == state for point in self.points)

    def ranked(self, value: str, *, is_best_low: bool) -> list[Average]:
        """The averages over seeds of a result that are known and finite, the best first."""
        finite_averages = [
            each for each in averages(self.frame, self.columns, value) if math.isfinite(each.mean)
        ]
        return sorted(finite_averages, key=lambda each: each.mean if is_best_low else -each.mean)

    def best(self) -> dict[str, Any]:
        """The values of the columns with the least expected MSE; if unknown, the first."""
        ranked = self.ranked("expected_mse", is_best_low=True)
        if ranked:
            return dict(zip(self.columns, ranked[0].point, strict=True))
        return {name: values_of(self.frame, name)[0] for name in self.columns}

    def phrase(self, names: Sequence[str], values: Sequence[Any]) -> str:
        """Values of columns as a phrase."""
        return formatted_point(names, tuple(values), self.keys, " = ")

    def held(self, free: Sequence[str], most: int) -> tuple[pd.DataFrame, dict[str, Any]]:
        """The rows for a figure, with the last columns held at their best values.

        Parameters
        ----------
        free : sequence of str
            Columns that are not held.
        most : int
            Most combinations of values of the others.

        Returns
        -------
        (DataFrame, dict of str to object)
            The rows, and the values that are held.
        """
        frame, held, best = self.frame, dict[str, Any](), self.best()
        others = [name for name in (SET, *self.varying) if name in self.columns]
        others = [name for name in others if name not in free]
        while others and len(averages(frame.assign(_any=0.0), others, "_any")) > most:
            name = others.pop()
            held[name] = best[name]
            frame = selected(self.frame, held)
        return frame, held

    def _read_judged(self) -> pd.DataFrame:
        """Read the finished comparisons of finished points; if points were added, the latest."""
        runs = {run.path.name: run for run in self.runs if run.state == FINISHED}
        found_sets = {times for sets in times_by_search(runs).values() for times in sets.values()}
        best, most = dict[str, Run](), (0, 0)
        for folder in sorted(self.path.glob(f"{JUDGED}/*/")):
            judges = {name: folder / name for name in runs if holds_run(folder / name)}
            opened = {name: open_run(path) for name, path in judges.items()}
            finished = {name: run for name, run in opened.items() if run.state == FINISHED}
            sets = set(next(iter(finished.values())).sets.values()) if finished else set()
            if (len(found_sets & sets), len(finished)) > most:
                best, most = finished, (len(found_sets & sets), len(finished))
        return judged_table(runs, best)

    def _read(self) -> tuple[list[Run], pd.DataFrame]:
        """Read all runs; those that cannot be read become damaged points."""
        try:
            return self._read_points()
        except Exception:  # a report of many runs must not fail because of one of them
            self.points = [_tried(point) for point in self.points]
            return self._read_points()

    def _read_points(self) -> tuple[list[Run], pd.DataFrame]:
        runs = [open_run(point.path) for point in self.points if point.listed.fault is None]
        return runs, runs_table(runs) if runs else pd.DataFrame(columns=["run", *RESULTS])


def _tried(point: Point) -> Point:
    """A point with the reason why it cannot be read, if it cannot."""
    try:
        if point.listed.fault is None:
            runs_table([open_run(point.path)])
    except Exception as error:
        fault = _reason(error).replace(relative(f"{point.path}/"), "")
        return replace(point, listed=replace(point.listed, state=DAMAGED, fault=fault))
    return point


def _reason(error: Exception) -> str:
    """An error on one line; an error that pfdist does not expect has the name of its type."""
    text = str(error) if isinstance(error, PfdistError) else f"{type(error).__name__}: {error}"
    return one_line(shown_text(text))
