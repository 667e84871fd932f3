"""The commands `list` and `table`, whose answers are pages."""

from dataclasses import dataclass
from functools import wraps
from typing import Any

import pandas as pd

from pfdist.common.parts import Page, Section, Text
from pfdist.common.shown import Shown
from pfdist.plugins.runs import listing, question
from pfdist.plugins.runs.pages import list_page, table_page
from pfdist.results.columns import records_of


@dataclass(frozen=True, repr=False)
class Tabled(Shown):
    """A table of runs: where it was written, or its rows."""

    frame: pd.DataFrame
    page: Page
    name: str

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        known = {key: self.frame.attrs[key] for key in ("time_unit",) if key in self.frame.attrs}
        return known | {self.name: records_of(self.frame)}

    def _page(self) -> Page:
        return self.page


@wraps(listing.list_runs)
def list_runs(folder: str = "results") -> Tabled:
    """The command; its help is that of the function."""
    frame = listing.list_runs(folder)
    return Tabled(frame, list_page(frame, folder), "runs")


@wraps(question.table)
def table(*runs: question.Runs, out: str | None = None) -> Tabled:
    """The command; its help is that of the function."""
    frame = question.table(*runs, out=out)
    page = table_page(frame) if out is None else Page("", "", [Section("", [Text(out)])])
    return Tabled(frame, page, "rows")
