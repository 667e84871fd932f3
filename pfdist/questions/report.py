"""Pages as files; the report of a run or a sweep, once or again while a run continues."""

from collections.abc import Callable
from pathlib import Path

from pfdist.common import stopping
from pfdist.common.arguments import path_argument
from pfdist.common.parts import Page
from pfdist.errors import ArgumentError, PfdistError, reason_of
from pfdist.questions.run_page import page_of
from pfdist.results import Run, open_run
from pfdist.runner.progress import Say, heard, silent
from pfdist.store import holds_run, is_held, record_pages, write_file
from pfdist.store.folder import REPORT, check_page_replaceable, runs_below

SECONDS = 5.0
"""Between two reports of a run that continues."""


def report(run: Run | str | Path, *, watch: bool = False, say: Say = silent) -> Path:
    """Write the report of a run or a sweep: one HTML file that can be sent to anybody.

    The report is made from the tables of the run alone; no model is run.

    Parameters
    ----------
    run : Run, str or Path
        Folder of a run or of a sweep; it need not be finished. The report of a sweep has all its
        runs, and links to their reports.
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
    ArgumentError
        `watch` is given with the folder of a sweep.
    """
    path = run.path if isinstance(run, Run) else path_argument("run", run)
    if is_sweep(path):
        if watch:
            raise ArgumentError(
                f"watch needs the folder of a run, got that of a sweep: {path}", argument="watch"
            )
        return write_sweep_report(path)
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
    file = _write(lambda: with_pictures(page_of(run, seconds, target), run), run.path)
    record_pages(run.path, [file])
    return file


def write_sweep_report(path: Path) -> Path:
    """Write the report of the sweep in a folder."""
    from pfdist.questions.sweep_page import sweep_page  # noqa: PLC0415  Matplotlib loads if a page is made

    return _write(lambda: sweep_page(path), path)


def _write(make: Callable[[], Page], folder: Path) -> Path:
    """Write the report of a run or a sweep into its folder."""
    path = folder / REPORT
    check_page_replaceable(path)  # before the page is made, which takes longer
    write_page(make(), path)
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


def is_sweep(path: Path) -> bool:
    """Whether a folder is not a run but has runs in it."""
    if holds_run(path) or not path.is_dir():
        return False
    return next(runs_below(path, 1), path) != path


def try_report(run: Run | Path, say: Say, target: float | None = None) -> bool:
    """Write the report of a run or a sweep; an error becomes one line. Whether it was written.

    The results are stored already. So no error of the report ends the command that has computed
    them, not even a mistake in pfdist.

    Parameters
    ----------
    run : Run or Path
        A run, or the folder of a sweep.
    say : callable
        Receives a line if there is no report.
    target : float, optional
        As for `write_report`.
    """
    path = run.path if isinstance(run, Run) else run
    try:
        if isinstance(run, Run):
            write_report(run, target=target)
        else:
            write_sweep_report(path)
    except Exception as error:
        is_expected = isinstance(error, PfdistError)
        hint = "" if is_expected else f" (`pfdist report {path} --debug` shows where)"
        heard(say, f"there is no report: {reason_of(error)}{hint}")
        return False
    return True


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
