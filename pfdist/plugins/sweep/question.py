"""A job at many points: every point is a separate run, and all share the same workers."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

import pandas as pd

from pfdist.common.arguments import path_argument
from pfdist.common.formatted_sizes import formatted_seconds
from pfdist.common.parts import Cell, Page, Section, Table, Text
from pfdist.common.section import checked
from pfdist.common.shown import Shown
from pfdist.errors import ArgumentError, SweepError
from pfdist.plugins.runs.listing import FINISHED
from pfdist.plugins.runs.pages import lowest_text, table_page
from pfdist.plugins.runs.question import table
from pfdist.plugins.sweep.points_at_work import compute_points
from pfdist.plugins.sweep.sweep_file import SweepJob, SweepPart, parts_that_pay, read_sweep
from pfdist.plugins.sweep.sweep_points import Values
from pfdist.problem.job import Job
from pfdist.problem.problem import JobSource
from pfdist.questions.at_work import at_work
from pfdist.questions.foreseen import seconds_of_step
from pfdist.questions.options import Chosen, Options, following, with_options
from pfdist.questions.report import tried, try_report
from pfdist.questions.subject import Subject
from pfdist.results import Run, open_run, read_recorded
from pfdist.results.columns import records_of
from pfdist.runner.bound_settings import BoundSettings, DrawsOrNone
from pfdist.runner.build import build, check_pool, say_model_files
from pfdist.runner.driver import foreseen_steps
from pfdist.runner.progress import Progress, Say, Show, silent
from pfdist.store import holds_run, listed_pages
from pfdist.store.folder import REPORT, figures_in

TABLE = "points.csv"
"""Name of the file in a sweep's folder that has the table of its points."""
_SHOWN = 3  # failures in an error
_NOTHING: Mapping[str, object] = {}


@dataclass(frozen=True, repr=False)
class Sweep(Shown):
    """The finished runs of a sweep.

    Parameters
    ----------
    path : Path
        The folder of the sweep, in which each run has its folder.
    runs : dict of str to Run
        The run of each point, by the point's name.
    busy : tuple of str
        Points that other processes compute at this moment: they are left out.
    """

    path: Path
    runs: Mapping[str, Run]
    busy: tuple[str, ...] = ()

    def table(self) -> pd.DataFrame:
        """All runs as one tidy table, that of ``points.csv``; `pfdist.table` lists its columns."""
        return table(*self.runs.values())

    @property
    def files(self) -> tuple[Path, ...]:
        """The table of the sweep as a file, if there is one, or else the folder of the sweep."""
        return (file if (file := self.path / TABLE).exists() else self.path,)

    @property
    def figures(self) -> tuple[Path, ...]:
        """The files of the sweep's figure."""
        return tuple(sorted(figures_in(self.path)))

    def as_json(self) -> dict[str, Any]:
        """The table of all runs as values for JSON."""
        return {"rows": records_of(self.table()) if self.runs else []}

    def _page(self) -> Page:
        busy = [f"other processes compute {', '.join(self.busy)}"] if self.busy else []
        if not self.runs:
            return Page("", "", [Section("", [Text("No point is finished.")])], busy)
        frame = self.table()
        said = lowest_text(frame)
        answer = Section("", [Text(said, prominent=True)] if said else [])
        doubts = ((name, Subject(run).alarms) for name, run in self.runs.items())
        alarms = [f"{name}: {said[0]}" for name, said in doubts if said][:1]
        return Page("", "", [answer, *table_page(frame).sections], busy, alarms=alarms)


@dataclass(frozen=True, repr=False)
class ForeseenPoints(Shown):
    """The points of a sweep and the work of each.

    Parameters
    ----------
    points : DataFrame
        A row for each point: its name, its values, the state of its run ("none" if it has not
        begun, "other run" if its folder holds a different run), ``steps``, the particle-steps of
        the whole run, and ``seconds``, about how long a worker takes for them.
    """

    points: pd.DataFrame

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        return {"points": records_of(self.points)}

    def _page(self) -> Page:
        billion = 1e9
        rows = [
            [
                Cell(row["point"]),
                Cell(row["state"]),
                Cell(f"{row['steps'] / billion:.3f}", row["steps"]),
            ]
            for row in self.points.to_dict("records")
        ]
        left = self.points[["steps", "seconds"]].where(self.points["state"] != FINISHED, 0)
        steps = f"{left['steps'].sum() / billion:.3f} billion particle-steps"
        text = f"{len(self.points)} points; about {steps}"
        text += f" are left to do, in {formatted_seconds(left['seconds'].sum())} s of a core"
        text += " (without compiling, figures and reports)"
        table = Table("", ("point", "state", "billion steps"), rows)
        parts = parts_that_pay(left["seconds"].tolist())
        pays = f"up to {parts} parts are worthwhile, on a core each" if parts > 1 else "one part"
        return Page("", "", [Section("", [table, Text(text), Text(pays)])])


@with_options
@checked
def sweep(
    job: JobSource,
    over: Values = _NOTHING,
    *,
    points: Sequence[Values] = (),
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    bound_draws: DrawsOrNone = 0,
    part: SweepPart | None = None,
    **options: Unpack[Options],
) -> Sweep:
    """Run a job at every point of a sweep, or resume the sweep where it stopped.

    Every point is an ordinary run in its own folder, with the same bytes as if it were run alone.
    Points are computed one after another, with the same workers. Evaluations that several points
    need are computed once. Points that another process computes are left out, so several processes
    may share the points of a sweep.
    The folder of the sweep gets the table of all runs in it, ``points.csv``, and one figure, that
    of `pfdist.plots.against`. With `report`, every run has a report. Runs get no other figures.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A sweep file, or a problem, a job or the path of a job file.
    over : mapping of str to sequence
        Values of keys of the job, as ``{"seed": range(1, 11)}``; every combination is a point.
    points : sequence of mappings of str to object
        Further points, with a value for each key; so values of two keys may belong together.
    results : str or Path, optional
        The folder of the sweep; by default ``results/<the sweep file's stem>``, or
        ``results/<the job file's stem>-sweep``.
    changes : iterable of str, optional
    bound_draws : int
        Number of draws of the lower bound that is proved at each point; 0 for no bound.
    part : tuple of two int, optional
        ``(k, n)`` computes every n-th point, from the k-th, and no other. Table and figure need all
        points, and are not made.
    options
        See `Options`.

    Returns
    -------
    Sweep

    Raises
    ------
    SweepError
        Some points failed. All others are finished, and the same call tries the failed again.
    PfdistError
        The sweep is wrong, or no worker answers. The same call resumes the sweep.
    """
    chosen = Chosen(**options)
    execution = {"execution": chosen.execution}
    sweep_job = read_sweep(job, over, points, changes, execution)
    path = _folder(sweep_job, results)
    check_pool(sweep_job.execution)
    bound = BoundSettings(draws=bound_draws) if bound_draws else None
    own = sweep_job.part(part)
    with following(chosen.progress, chosen.say) as (show, tell):
        say_model_files(own.jobs.values(), tell)
        engines = [each.filter.engine for each in own.jobs.values()]
        pool = at_work(sweep_job.execution, engines, tell)
        runs, failed, busy = compute_points(own, path, bound, pool, show, tell)
        if chosen.has_report:
            for position, run in enumerate(runs.values(), 1):
                if run.path / REPORT not in listed_pages(run.path):
                    tell(f"Writing reports {position}/{len(runs)}")
                    try_report(run, tell)
        if part is None and runs:
            with tried("table or figure", f"plot {path}", tell):
                frame = table(path, out=path / TABLE)
                if chosen.figures and len(set(frame["run"])) > 1:
                    from pfdist.plugins.runs.figure import draw_points  # noqa: PLC0415  Matplotlib loads if a figure is drawn

                    draw_points(frame, path)
    if failed:
        first = "; ".join(f"{name}: {reason}" for name, reason in [*failed.items()][:_SHOWN])
        more = f"; {len(failed) - _SHOWN} more" * (len(failed) > _SHOWN)
        raise SweepError(
            f"{len(failed)} of {len(own.points)} points failed, the others are finished in "
            f"{path}: {first}{more}",
            failed,
        )
    return Sweep(path, runs, tuple(busy))


def _folder(sweep_job: SweepJob, results: str | Path | None) -> Path:
    """The folder of a sweep; an `ArgumentError` if it is a file or holds a run."""
    path = path_argument(
        "results", Path("results") / sweep_job.name if results is None else results
    )
    wrong = "a run" if holds_run(path) else "a file" if path.is_file() else ""
    if wrong:
        raise ArgumentError(
            f"results must be a folder for the runs of the sweep, got {wrong}: {path}",
            argument="results",
        )
    return path


def foreseen(
    job: JobSource,
    over: Values = _NOTHING,
    *,
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    progress: Show | bool | None = None,
    say: Say = silent,
) -> ForeseenPoints:
    """The points of a sweep and the work of each, estimated from the speed of a few draws.

    Parameters
    ----------
    job, over, results, changes, progress, say
        As for `sweep`.

    Returns
    -------
    ForeseenPoints

    Raises
    ------
    PfdistError
        The sweep is wrong, or the model of a point.
    """
    sweep_job = read_sweep(job, over, (), changes, {})
    path, rows = _folder(sweep_job, results), []
    with following(progress, say) as (show, _):
        for done, point in enumerate(sweep_job.points):
            show(Progress("dry run", done, len(sweep_job.points), doing=f"measuring {point.name}"))
            folder = path / point.name
            built = build(sweep_job.jobs[point.name], folder)
            state = _state(folder, built.job)
            steps = foreseen_steps(built)
            work = {"steps": steps, "seconds": steps * seconds_of_step(built)}
            rows.append({"point": point.name, **point.chosen, "state": state, **work})
    return ForeseenPoints(pd.DataFrame(rows))


def _state(folder: Path, job: Job) -> str:
    if not holds_run(folder):
        return "none"
    recorded, wanted = read_recorded(folder)[1], job.identity()
    comparison = recorded.get("comparison")
    if isinstance(comparison, dict):  # a run may get more draws
        comparison["draws"] = wanted["comparison"]["draws"]
    return open_run(folder).state if recorded == wanted else "other run"
