"""A run on disk, as Python and notebooks see it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from pfdist.common.arguments import path_argument
from pfdist.common.nearest import must_be
from pfdist.common.parts import Page
from pfdist.common.plugins import hooked
from pfdist.common.registry import Registry
from pfdist.common.section import Arguments, Whole
from pfdist.common.shown import Shown, as_fragment
from pfdist.errors import ArgumentError, PfdistError, StoreError
from pfdist.results.columns import Row, finite, records_of
from pfdist.results.export import export_plan
from pfdist.results.over_time import RANGE_SUMS, error_over_time
from pfdist.results.pairs import pairs_of, ranks_of
from pfdist.results.sets import recommended, sets_of
from pfdist.results.stored_run import (
    StoredRun,
    check_one_number,
    criterion_of,
    evaluations_of,
    gains_of,
    has_scenarios,
    named_sets,
    problem_of,
    scenarios_of,
    steps_by_part,
    unproved,
)
from pfdist.store.schema import KEYS

if TYPE_CHECKING:
    import pandas as pd


class _Rows(Arguments):
    draws: Annotated[Whole, Field(ge=1, le=2**62)]  # more than any table has


class Run(StoredRun, Shown):
    """A run on disk, finished or not; made by `open_run`.

    Attributes
    ----------
    path : Path
        Its folder.
    job : dict
        The resolved job.
    """

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables that the run has, those of its files first."""
        stored = super().tables
        computed = [
            name
            for name in COMPUTED
            if _FROM.get(name, "comparison") in stored
            and (name != "scenarios" or has_scenarios(self))
        ]
        return (*stored, *computed)

    def table(self, name: str, draws: int | None = None) -> pd.DataFrame:
        """A table of the run, by its name.

        The manual lists all tables and their columns under "Files and tables of a run".

        Parameters
        ----------
        name : str
            One of `tables`.
        draws : int, optional
            Read only so many first draws of a table that has a row for each draw.

        Returns
        -------
        DataFrame
            Its ``attrs["labels"]`` have labels of columns, and ``attrs["sets"]`` those of the
            compared sets by name, the reference first.

        Raises
        ------
        ArgumentError
            No table has this name, or the table has no rows of draws.
        StoreError
            The run has no such table yet, or a file cannot be read.
        """
        if name not in TABLES:
            rule = f"one of {', '.join(TABLES)}"
            raise ArgumentError(must_be("a table", rule, name, TABLES), argument="name")
        if draws is not None:
            draws = _Rows(draws=draws).draws
            if name != "gains" and "draw" not in KEYS.get(name, []):
                raise ArgumentError(f"the table {name} has no rows of draws", argument="draws")
        if name not in COMPUTED:
            return super().table(name, draws)
        if name not in self.tables:
            has = ", ".join(self.tables) or "none yet"
            raise StoreError(f"the run {self.path} has no table {name!r}; it has: {has}")
        table = gains_of(self, draws) if name == "gains" else COMPUTED[name](self)
        table.attrs["sets"] = self.labels
        return table

    @property
    def best(self) -> Row:
        """The times to measure at, and their results: a row of the table ``sets``.

        It is the found set with the lowest expected MSE, or with the lowest error in the worst
        scenario, if the job asks for it. A given set or an opponent that is clearly better takes
        its place; see the column beats_search. Without a search, it is the best of the job's sets.

        Raises
        ------
        StoreError
            The comparison has not begun, or the run has times of several numbers of measurements.
        """
        check_one_number(self)
        if not self.draws_compared:
            raise StoreError(f"{self.path} has compared no draws yet: it is {self.state}")
        return recommended(self)

    def export(self, path: str | Path) -> Path:
        """Write the times of `best` for a spreadsheet (``.csv``) or a diary (``.ics``).

        Each row or event has the time, its date if the clock has a start, the sensor, and how far
        this measurement alone may move at a loss of at most 1 and 5 % where `pfdist.why` was asked.

        Parameters
        ----------
        path : str or Path
            An earlier export is replaced.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ArgumentError
            The name has another ending, or the clock has no dates for a diary.
        StoreError
            The comparison has not begun, or the file cannot be written or is no earlier export.
        """
        return export_plan(self, self.best.name, path)

    def as_json(self) -> dict[str, Any]:
        """How far the run is, and what it has found, as JSON values.

        Returns
        -------
        dict
            - run (its folder), state and draws_compared, as the properties.
            - evaluations: their number, copies counted.
            - criterion: what the job minimises, and criterion_unit, as ``nats``; empty for that of
              errors.
            - time_unit: that of the job's clock; None without a clock.
            - instant_weights: the weight of each instant's error in the MSE, with mean 1, or None.
            - particle_steps: those computed so far, by what they are for.
            - unproved: why found sets have no lower bound, although one was asked for, and which
              command proves one; otherwise empty.
            - sets: the rows of the table ``sets``; empty before the searches have ended.
            - pairs, ranks: rows of these tables, if the job names sets; else None.
            - scenarios: rows of this table, if the job has scenarios; else None.
            - what plugins add in their summaries, or None, as ``online`` with the results of times
              that were chosen one after another.
        """
        problem, criterion, has = problem_of(self), criterion_of(self), self.tables
        named = "comparison" in has and bool(named_sets(self))
        return {
            "run": str(self.path),
            "state": self.state,
            "evaluations": evaluations_of(self),
            "draws_compared": self.draws_compared,
            "criterion": criterion.label,
            "criterion_unit": criterion.unit,
            "time_unit": problem.clock.time_unit if problem.has_clock else None,
            "instant_weights": [*problem.weights] if problem.weights else None,
            "particle_steps": steps_by_part(self),
            "unproved": unproved(self),
            "sets": records_of(self.table("sets")) if "sets" in has else [],
            "pairs": records_of(self.table("pairs")) if named else None,
            "ranks": records_of(self.table("ranks")) if named else None,
            "scenarios": records_of(self.table("scenarios")) if "scenarios" in has else None,
            **{key: finite(resolve_name(name)(self)) for key, name in hooked("summaries").items()},
        }

    def _page(self) -> Page:
        try:
            return SHOWN["answer"](self)
        except PfdistError:
            return Page("", f"run {self.path}: cannot be read", [])

    def _repr_html_(self) -> str:
        page = self._page()
        with suppress(PfdistError):  # a table of a picture is damaged
            page = SHOWN["pictures"](page, self)
        return as_fragment(page)


SHOWN: Registry[Callable[..., Page]] = Registry("pfdist.questions")
"""The answer of a run, and an answer with pictures, by modules of a higher floor."""
COMPUTED: dict[str, Callable[[StoredRun], pd.DataFrame]] = {
    "sets": sets_of,
    "gains": gains_of,
    "pairs": pairs_of,
    "ranks": ranks_of,
    "scenarios": scenarios_of,
    "error_over_time": error_over_time,
}
"""Tables that follow from others, by name; the docstring of each function lists its columns."""
_FROM = {"sets": "compared", "error_over_time": RANGE_SUMS}  # else from comparison
TABLES = (*KEYS, *COMPUTED)
"""Names of all tables that a run may have."""


def open_run(path: str | Path) -> Run:
    """A run in a folder, opened for reading.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Run

    Raises
    ------
    StoreError
        The folder holds no run, or one that cannot be read.
    """
    return Run(path_argument("run", path))
