"""The error over time of a run's sets, the worth of their measurements, and sampling windows.

Everything is computed on new draws, which neither chose the times nor compared them.
"""

from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from pfdist.common.measurement_times import validated
from pfdist.common.parts import Page
from pfdist.common.section import checked
from pfdist.common.shown import Shown
from pfdist.errors import ArgumentError
from pfdist.plugins.why.measured_worth import sampling_windows, worth_of
from pfdist.plugins.why.needs import WHY
from pfdist.plugins.why.page import why_page
from pfdist.problem.points import Points
from pfdist.problem.problem import JobSource
from pfdist.problem.sections import Execution
from pfdist.questions.at_work import release_the_lock
from pfdist.questions.options import Chosen, ComparedDraws, following
from pfdist.questions.report import renew_report
from pfdist.questions.run_of_job import own_store, run_and_job
from pfdist.questions.subject import Subject
from pfdist.results import Run, finite, open_run
from pfdist.results.export import checked_export
from pfdist.results.stored_run import check_one_number, measured_of
from pfdist.runner.build import make_pool
from pfdist.runner.door import RunSession, WorkBatch, complete
from pfdist.runner.progress import Say, Show, silent
from pfdist.store import WHY_PHASE, frame_of, schema
from pfdist.store.schema import with_sensors

DRAWS = 2000
FIGURES = ("why", "system")
_PARTS = ("profile", "worth", "sampling_windows")
_STEPS = 2  # for each set: worth, windows


@dataclass(frozen=True, repr=False)
class Why(Shown):
    """Result of `why`.

    Parameters
    ----------
    run : Path
        Folder of the run.
    draws : int
        Number of draws, at least 2, computed in this process. An exact engine does not use it.
    sets : DataFrame
        A row for each set: name, measurement_times, expected_mse, standard_error and
        degenerate_draws.
    profile : DataFrame
        A row for each set and instant: position and name of the set, t, measured, draws, error (the
        expected error at t), standard_error, degenerate_draws (up to t) and effective_sample_size
        (after the measurement at t, mean over the draws with trajectories; NaN if t is not
        measured, or if the engine is exact), and weight (of the instant's error in the MSE; 1 if
        all weights are equal). The mean of a set's errors with these weights is the expected MSE of
        the set. An error of weight 0 is NaN.
    worth : DataFrame
        A row for each set and measurement: position, name, t, draws, and the rise of the expected
        MSE, or of what else the job minimises, if the measurement is removed, or made one instant
        earlier or later: removed, earlier, later. NaN if another measurement is made at that
        instant, or if the job does not allow the instant. The standard errors are removed_error,
        earlier_error and later_error.
    sampling_windows : DataFrame
        A row for each set, measurement and instant to which it alone is moved (also its own
        instant, where nothing moves): position, name, t, moved_to (the instant, or on a clock its
        time), moved_to_instant (its number), draws, loss (the expected MSE over that of the kept
        set, less 1; likewise of what else the job minimises), loss_error (its standard error),
        lower_limit and upper_limit (one-sided, 95 %). The states within_1 and within_5 are "inside"
        if the upper limit is at most 1 % or 5 %, "outside" if the lower limit is above, and
        otherwise "open". The instants lie between the neighbouring measurements, and end on each
        side with the first that is outside within_5.
    figures : list of Path
        The PNG files: ``why-<set>`` of each set but the reference, and ``system``, which has
        the sampling windows. Empty if no figures were wanted.
    """

    run: Path
    draws: int
    sets: pd.DataFrame
    profile: pd.DataFrame
    worth: pd.DataFrame
    sampling_windows: pd.DataFrame
    figures: list[Path]

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; a value that is not finite is None."""
        sets = {}
        frames: dict[str, pd.DataFrame] = {part: getattr(self, part) for part in _PARTS}
        for row in self.sets.to_dict("records"):
            name = row.pop("name")
            own = {key: frame[frame["name"] == name] for key, frame in frames.items()}
            parts = {
                key: frame.drop(columns=["position", "name", "draws"]).to_dict("records")
                for key, frame in own.items()
            }
            sets[str(name)] = row | parts
        values = {"run": str(self.run), "draws": self.draws, "sets": sets}
        return finite(values | {"figures": list(map(str, self.figures))})

    def _page(self) -> Page:
        frames = {part: getattr(self, part) for part in _PARTS}
        return why_page(Subject(open_run(self.run)), frames)


@checked
def why(
    job: JobSource | Run,
    draws: ComparedDraws = DRAWS,
    *,
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    export: str | Path | None = None,
    figures: bool = True,
    progress: Show | bool | None = None,
    say: Say = silent,
) -> Why:
    """Show what each measurement of a run is worth, and how exactly it must be kept.

    Both are judged by the criterion of the job.

    The model is run. The tables ``profile``, ``worth`` and ``sampling_windows``, and the figures
    ``why-SET`` and ``system`` are written into the folder of the run.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, whose run is meant, or the folder of a run.
    draws : int
        Number of draws, at least 2. They are computed in this process. Memory does not grow with
        their number, unless the job has another criterion. An exact engine does not use it.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    export : str or Path, optional
        Also write the plan, and how far each measurement may move, into this ``.csv`` or ``.ics``
        file.
    figures : bool
        Whether to draw the figures.
    progress : callable or bool, optional
        Whether to show progress and messages, or what receives each
        `pfdist.runner.progress.Progress`. By default a terminal and a notebook show the progress
        from the fifth second on.
    say : callable, optional
        Receives a line for each model file before the file is run.

    Returns
    -------
    Why

    Raises
    ------
    StoreError
        There is no finished run of the job; the run is of another job or of other models; or it has
        sets of several numbers of measurements.
    ArgumentError, ModelError
        There are too few draws for the criterion, or the model cannot be loaded.
    JobError
        The job has a section [budget], or asks for the least error in the worst scenario.
    """
    chosen = Chosen(figures=figures, progress=progress, say=say)
    with following(chosen.progress, chosen.say) as (show, tell):
        opened, built = run_and_job(job, results, changes, tell)
        check_one_number(opened)
        if export is not None:
            checked_export(export, built.job.problem.clock)
        WHY.check("why", built.job)
        criterion = built.job.criterion
        if draws < criterion.fewest and (criterion.needs_draws or not built.evaluator.exact):
            rule = f"draws must be at least {criterion.fewest:,}, so that errors of"
            raise ArgumentError(
                f"{rule} {criterion.label} are known, got {draws:,}", argument="draws"
            )
        with own_store(opened, built, tell, must_be=False) as store:
            session = RunSession(built, store, show, tell)
            session.reporter.foresee(_STEPS * len(opened.sets))
            driver = _examine(session, opened, draws)
            # Threads are done before the workers of another pool would have started.
            kind = "threads" if release_the_lock([built.evaluator.engine]) else "processes"
            answer: Why = complete(driver, make_pool(Execution(pool=kind)))
        files = _draw(opened) if chosen.figures else []
        renew_report(opened.path, tell)
    if export is not None:
        open_run(opened.path).export(export)
    return replace(answer, figures=files)


def _draw(run: Run) -> list[Path]:
    from pfdist.pages.plots import draw_figures  # noqa: PLC0415  Matplotlib loads if a figure is drawn

    return [file for name in FIGURES for file in draw_figures(run, name)]


def _examine(session: RunSession, run: Run, draws: int) -> Generator[WorkBatch, None, Why]:
    """Driver that computes all tables and publishes them at the end; it draws no figure."""
    built, store, rows = session.built, session.store, {part: list[Any]() for part in _PARTS}
    answers, drawn = list[dict[str, Any]](), draws
    points = built.job.problem.points
    for position, (name, numbers) in enumerate(measured_of(run).items()):
        session.reporter.note(phase=f"why {name}", done=_STEPS * position)
        times = validated(numbers, points.number - 1, f"{run.path}: {name}")
        summary, profile, worth = yield from worth_of(session, name, times, draws)
        drawn = profile[0]["draws"]
        windows = yield from sampling_windows(session, name, times, draws)
        answers.append({"name": name, "measurement_times": list(run.sets[name])} | summary)
        about = {"position": position, "name": name, "draws": drawn}
        for part, of_a_part in zip(_PARTS, (profile, worth, windows), strict=True):
            rows[part] += [about | _at_instant(row, part, points) for row in of_a_part]
    tables = {name: store.timed(_table(name, rows[name])) for name in rows}
    store.publish_together(WHY_PHASE, {name: [table] for name, table in tables.items()})
    frames = {name: frame_of(table) for name, table in tables.items()}
    return Why(run.path, drawn, pd.DataFrame(answers), **frames, figures=[])


def _at_instant(row: dict[str, Any], part: str, points: Points) -> dict[str, Any]:
    """A row of a table; one of a single measurement has its instants, and how it was measured."""
    if part not in ("worth", "sampling_windows"):
        return row
    moved = {key: points.made_at(row[key]) for key in row if key == "t" or key[:5] == "moved"}
    return row | moved | points.columns(row["t"])


def _table(name: str, rows: list[dict[str, Any]]) -> pa.Table:
    own = with_sensors(schema(name)) if rows and "sensor" in rows[0] else schema(name)
    return pa.Table.from_pandas(pd.DataFrame(rows), schema=own, preserve_index=False)
