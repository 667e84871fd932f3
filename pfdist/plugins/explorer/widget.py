"""The widget for Jupyter, VS Code and marimo: the page of `server`, which the kernel answers."""

from functools import cache
from importlib.resources import files
from typing import Any

from pfdist.errors import MissingExtraError
from pfdist.plugins.explorer.session import ExplorerSession, reply
from pfdist.problem.problem import JobSource
from pfdist.results import Run


def explore(problem_or_run: JobSource | Run) -> Any:
    """Move the measurements by hand in a notebook, and see the error at once.

    The widget shows the plan of a run, its evenly spaced times and your own times. Times are
    dragged, added and removed; the error over time follows. The draws on which you play flatter the
    set that you choose by them. The button "Judge on fresh draws" compares it on others.

    Parameters
    ----------
    problem_or_run : Problem, Job, str, Path or Run
        A problem, a job, a job file, a run or the folder of a run. If the job has a finished run,
        its plan is shown.

    Returns
    -------
    anywidget.AnyWidget
        Its attribute ``session`` answers by its method ``answer``, too:
        `pfdist.plugins.explorer.session.ExplorerSession`.

    Raises
    ------
    PfdistError
        The job or a model is not possible, or anywidget is not installed.
    """
    return _widget_class()(ExplorerSession(problem_or_run))


@cache
def _widget_class() -> type[Any]:
    try:
        import anywidget  # noqa: PLC0415  an optional library
    except ModuleNotFoundError as error:
        raise MissingExtraError("explore", "explore", error.name) from error
    folder = files("pfdist.plugins.explorer")

    class Explorer(anywidget.AnyWidget):  # type: ignore[misc, unused-ignore]
        _esm = (folder / "explore.js").read_text("utf-8")
        _css = (folder / "explore.css").read_text("utf-8")

        def __init__(self, session: ExplorerSession) -> None:
            super().__init__()
            self.session = session
            self.on_msg(lambda _, message, __: self.send(reply(session, message)))

    return Explorer
