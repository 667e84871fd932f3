"""The report of a sweep: one HTML file in the folder that holds the folders of the runs."""

from pathlib import Path

from pfdist.analysis.listed_run import DAMAGED, FINISHED
from pfdist.errors import one_line
from pfdist.reports.judged_section import judged
from pfdist.reports.parts import Page
from pfdist.reports.render import write_page
from pfdist.reports.subject import number_of
from pfdist.reports.sweep_sections import answer, computed, figures, points
from pfdist.reports.sweep_subject import SweepSubject
from pfdist.store.folder import REPORT

_SECTIONS = (answer, points, judged, figures, computed)
_LINKS = "Its links lead to the reports of the points, in the folders beside it."


def write_sweep_report(path: Path) -> Path:
    """Write the report of a sweep into its folder.

    Parameters
    ----------
    path : Path
        A folder that is no run but has runs in it, finished or not. A run that cannot be read has
        a row that says why.

    Returns
    -------
    Path
        The file ``report.html``.

    Raises
    ------
    StoreError
        The folder cannot be listed, the file cannot be written, or it is no earlier report.
    """
    file = path / REPORT
    write_page(_page(SweepSubject(path)), file)
    return file


def _page(subject: SweepSubject) -> Page:
    sections = [section for make in _SECTIONS if (section := make(subject)) is not None]
    name = one_line(subject.path.resolve().name)
    told = number_of(len(subject.points), "point")
    models = f" of {', '.join(subject.models)}" if subject.models else ""
    links = _LINKS if any(point.link for point in subject.points) else ""
    return Page(f"Sweep: {name}", f"{told}{models}", sections, _warnings(subject), links=links)


def _warnings(subject: SweepSubject) -> list[str]:
    total, damaged = len(subject.points), subject.count(DAMAGED)
    unfinished = total - damaged - subject.count(FINISHED)
    told = number_of(total, "point")
    warnings = []
    if unfinished:
        warnings.append(f"Not finished: {unfinished:,} of {told}. Results may change.")
    if damaged:
        warnings.append(f"Cannot be read: {damaged:,} of {told}. The table says why.")
    if subject.judged_fault:
        warnings.append(f"The judged times cannot be read: {subject.judged_fault}.")
    return warnings
