"""Pages as files; the report of a run, once or again while the run continues."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from pfdist.common import stopping
from pfdist.common.arguments import path_argument
from pfdist.common.parts import Page
from pfdist.errors import PfdistError, reason_of
from pfdist.questions.run_page import page_of
from pfdist.results import Run, open_run
from pfdist.runner.progress import Say, heard, silent
from pfdist.store import is_held, record_pages, write_file
from pfdist.store.folder import REPORT, check_page_replaceable

SECONDS = 5.0
"""Between two reports of a run that continues."""


def report(run: Run | str | Path, *, watch: bool = False, say: Say = silent) -> Path:
    """Write the report of a run: one HTML file that can be sent to anybody.

    The report is made from the tables of the run alone; no model is run.

    Parameters
    ----------
    run : Run, str or Path
        Folder of a run; it need not be finished.
    watch : bool
        Write the report of a run again every few seconds while the run continues; the page reloads
        itself.
    say : callable, optional
        Receives a line if the report is to be written again.

    Returns
    -------
    Path
        The file ``report.html`` in the folder.

    Raises
    ------
    StoreError
        The folder holds no run, a table cannot be read, or the file cannot be written.
    """
    path = run.path if isinstance(run, Run) else path_argument("run", run)
    opened = open_run(path)
    if watch and opened.state != "finished":
        _watch(path, say)
    elif watch:
        say(f"{path} is finished")
    return write_report(open_run(path))


def write_report(run: Run, seconds: int = 0, target: float | None = None) -> Path:
    """Write the report of a run.

    Parameters
    ----------
    run : Run
    seconds : int
        After so many seconds the page reloads itself; 0 is never.
    target : float, optional
        An expected MSE: how many measurements reach it, in a run for several numbers.
    """
    from pfdist.questions.pictures import with_pictures  # noqa: PLC0415  Matplotlib loads if a page is made

    record_pages(run.path, [], without=REPORT)
    path = run.path / REPORT
    check_page_replaceable(path)  # before the page is made, which takes longer
    write_page(with_pictures(page_of(run, seconds, target), run), path)
    record_pages(run.path, [path])
    return path


def _watch(path: Path, say: Say) -> None:
    """Write the report again and again, until the run is finished or no process computes it."""
    say(f"Writing {path / REPORT} again every {SECONDS:.0f} s while the run continues")
    try:
        while is_held(path) and open_run(path).state != "finished":
            write_report(open_run(path), round(SECONDS))
            stopping.sleep(SECONDS)
    except KeyboardInterrupt:
        stopping.answered()
        write_report(open_run(path))  # a page that is left must not reload for ever
        raise
    state = open_run(path).state
    if state != "finished":
        say(f"{path} is not finished ({state}), and no process computes it: resume it")


@contextlib.contextmanager
def tried(what: str, command: str, say: Say) -> Iterator[None]:
    """A context in which an error becomes one line.

    The results are stored already. So no error of what is made from them ends the command that has
    computed them, not even a mistake in pfdist.

    Parameters
    ----------
    what : str
        The thing that is made, as the line names it.
    command : str
        The words of a command that makes it again.
    say : callable
        Receives a line if it is not made.
    """
    try:
        yield
    except Exception as error:
        is_expected = isinstance(error, PfdistError)
        hint = "" if is_expected else f" (`pfdist {command} --debug` shows where)"
        heard(say, f"there is no {what}: {reason_of(error)}{hint}")


def try_report(run: Run, say: Say, target: float | None = None) -> bool:
    """Write the report of a run as `write_report` does; an error becomes one line.

    The result is whether it was written.
    """
    with tried("report", f"report {run.path}", say):
        write_report(run, target=target)
        return True
    return False


def renew_report(path: Path, say: Say) -> None:
    """Write the report of a run again, if there is one.

    Parameters
    ----------
    path : Path
        Folder of the run.
    say : callable
        Receives a line if the report cannot be written.
    """
    if (path / REPORT).exists():
        try_report(open_run(path), say)


def write_page(page: Page, path: Path) -> None:
    """Write a page to an HTML file, atomically.

    Parameters
    ----------
    page : Page
    path : Path
        The file. An earlier page of pfdist is replaced, and nothing else.

    Raises
    ------
    StoreError
        The file cannot be written, or a file of another kind has this name.
    """
    from pfdist.pages.html import as_html  # noqa: PLC0415  Jinja loads if a page is made

    check_page_replaceable(path)
    html = as_html(page)
    write_file(path, lambda file: file.write_text(html, encoding="utf-8", errors="replace"))
