"""How the times were found: the searches, what they believed, and what they cost."""

from collections.abc import Mapping
from typing import Any

from pfdist.common.percent import percent
from pfdist.common.rounding import with_error
from pfdist.reports.parts import Cell, Section, Table, Text, without_empty_columns
from pfdist.reports.pictures import pictures
from pfdist.reports.subject import Subject
from pfdist.search.methods import METHODS

_HEAD = ("search", "method", "sets evaluated", "error it believed", "above fresh draws by", "why")
_MEANING = (
    "A search chooses the set with the least of many estimated errors, so what it believes of this "
    "set is usually too good. The errors above are of fresh draws."
)

_EXACT = (
    "The filter is exact, so each search knew the expected error of its set. The errors above are "
    "averages over simulated draws, and differ from it by chance."
)


def searches(subject: Subject) -> Section | None:
    """Give each search of a run, and the curve of costs against evaluations."""
    job, evaluated = subject.run.job["search"], _evaluated(subject)
    if not evaluated:
        return None
    rows = [_row(subject, search, evaluated.get(search["name"], 0)) for search in job]
    meaning = Text(_EXACT if subject.is_exact else _MEANING)
    table = without_empty_columns(Table("Searches", _HEAD, rows))
    return Section(
        "How the times were found",
        [table, meaning, *pictures(subject.tables, ["cost"])],
    )


def _evaluated(subject: Subject) -> dict[str, int]:
    """Number of sets that each search has evaluated, in all its phases."""
    if not subject.run.has("evaluations"):
        return {}
    rows = subject.run.evaluations()
    searches = rows["phase"].astype(str).str.partition(".")[0]
    return {str(name): int(count) for name, count in rows.groupby(searches)["copies"].sum().items()}


def _row(subject: Subject, search: Mapping[str, Any], count: int) -> list[Cell]:
    name, method = str(search["name"]), str(search["method"])
    about = METHODS[method].description if method in METHODS else method
    cells = [Cell(name), Cell(about.rstrip(".")), Cell(f"{count:,}", count)]
    result = subject.results.get(name, {})
    believed = result.get("search_cost")
    if believed is None:
        return [*cells, Cell(""), Cell(""), Cell("")]
    cells.append(Cell(with_error(believed, result["search_standard_error"]), believed))
    if subject.is_exact:
        return [*cells, Cell(""), Cell("exact")]
    excess = result.get("search_excess")
    why = result.get("search_distrust") or result.get("search_cause") or ""
    why = why.replace(str(subject.run.path), subject.run.path.name)  # the report may be sent
    return [*cells, Cell("" if excess is None else percent(excess, 1), excess), Cell(why)]
