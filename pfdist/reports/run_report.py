"""The report of a run: one HTML file in its folder, made from its tables alone."""

from pathlib import Path

from pfdist.analysis import Run
from pfdist.common.percent import heavy_tail_warning
from pfdist.errors import StoreError
from pfdist.reports.parts import Page
from pfdist.reports.render import write_page
from pfdist.reports.sections.answer import answer
from pfdist.reports.sections.budget import budget
from pfdist.reports.sections.compared import compared
from pfdist.reports.sections.computed import citation, computed, tables
from pfdist.reports.sections.gains import gains
from pfdist.reports.sections.online import online
from pfdist.reports.sections.problem import problem
from pfdist.reports.sections.proof import proof
from pfdist.reports.sections.searches import searches
from pfdist.reports.sections.worth import worth
from pfdist.reports.subject import Subject, number_of, without_folder
from pfdist.store import remove_file
from pfdist.store.folder import REPORT, check_page_replaceable

_END = (searches, computed, tables, citation)
_OF_ONE_NUMBER = (answer, compared, problem, gains, proof, worth, online, *_END)
_OF_A_CURVE = (budget, problem, *_END)


def write_report(run: Run, seconds: int = 0) -> Path:
    """Write the report of a run into its folder.

    Parameters
    ----------
    run : Run
        Finished or not.
    seconds : int
        After so many seconds the page reloads itself; 0 for never.

    Returns
    -------
    Path
        The file ``report.html``.

    Raises
    ------
    StoreError
        A table cannot be read, the file cannot be written, or it is no earlier report.
    """
    path = run.path / REPORT
    write_page(page_of(run, seconds), path)
    return path


def remove_report(path: Path) -> None:
    """Remove the report of the run in a folder, if there is an earlier report.

    Raises
    ------
    StoreError
        The report cannot be removed. If it stayed, nobody would make a new one.
    """
    try:
        check_page_replaceable(path / REPORT)
    except StoreError:  # it is the user's own file
        return
    remove_file(path / REPORT)


def page_of(run: Run, seconds: int = 0) -> Page:
    """Give the report of a run as a page; see `write_report`."""
    subject = Subject(run)
    parts = _OF_A_CURVE if run.has_budget else _OF_ONE_NUMBER
    sections = [section for make in parts if (section := make(subject)) is not None]
    name = without_folder(subject.run.job["model"]["name"])
    compared = number_of(subject.summary["draws_compared"], "draw")
    unfinished = (
        f"This run is not finished. So far {compared} are compared, and all figures may change."
    )
    warnings = [] if subject.summary["state"] == "finished" else [unfinished]
    for times, result in subject.results.items():
        warnings += [f"{times}: {warning}" for warning in result.get("warnings", ())]
    shares = {name: each.get("top_percent_share") for name, each in subject.results.items()}
    if heavy_tail := heavy_tail_warning(shares):
        warnings.append(f"{heavy_tail}.")
    return Page(f"When to measure: {name}", f"Run {run.path.name}", sections, warnings, seconds)
