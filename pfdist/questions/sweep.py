"""A job at many points: every point is a separate run, and all share the same workers."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Unpack

import pandas as pd

from pfdist.common.arguments import path_argument
from pfdist.common.parts import Page, Section, Text
from pfdist.common.section import checked
from pfdist.errors import ArgumentError, JobError, SweepError
from pfdist.problem.job import Job
from pfdist.problem.points import Values
from pfdist.problem.problem import JobSource
from pfdist.problem.sweep import Part, SweepJob, check_comparable, judging, read_sweep
from pfdist.questions.at_work import at_work
from pfdist.questions.model_checks import seconds_a_step
from pfdist.questions.options import Chosen, Options, following, with_options
from pfdist.questions.points_at_work import Points, PointsAtWork
from pfdist.questions.report import try_report
from pfdist.questions.runs import least_regret_text, lowest_text, table_page
from pfdist.questions.subject import Subject
from pfdist.questions.table import table
from pfdist.results import Run, open_run, read_recorded
from pfdist.results.columns import records_of
from pfdist.results.judged import JUDGED, judged_table, times_by_search
from pfdist.runner.bound_settings import BoundSettings, DrawsOrNone
from pfdist.runner.build import Built, build, check_pool, say_model_files
from pfdist.runner.comparison_phase import comparison_steps
from pfdist.runner.door import Driver, Loop
from pfdist.runner.driver import foreseen_steps
from pfdist.runner.progress import Progress, Say, Show, heard, silent
from pfdist.store import holds_run, listed_pages
from pfdist.store.folder import REPORT, has_report

_SHOWN = 3  # failures in an error
_NOTHING: Mapping[str, object] = {}


@dataclass(frozen=True)
class Sweep:
    """The finished runs of a sweep.

    Parameters
    ----------
    path : Path
        The folder of the sweep, in which each run has its folder.
    runs : dict of str to Run
        The run of each point, by the point's name.
    judges : dict of str to Run
        The run that compares, at each point, the times found at all points, by the point's name;
        empty if the sweep does not judge.
    busy : tuple of str
        Points that other processes compute at this moment: they are left out.
    """

    path: Path
    runs: Mapping[str, Run] = field(repr=False)
    judges: Mapping[str, Run] = field(default_factory=dict, repr=False)
    busy: tuple[str, ...] = ()

    def table(self) -> pd.DataFrame:
        """All runs as one tidy table; see `pfdist.table`."""
        return table(*self.runs.values())

    @property
    def files(self) -> tuple[Path, ...]:
        """The folder of the sweep, and its report if it has one."""
        return self.path, *([self.path / REPORT] if has_report(self.path) else [])

    def as_json(self) -> dict[str, Any]:
        """The table of all runs, and that of the judged times, as values for JSON."""
        return {
            "rows": records_of(self.table()) if self.runs else [],
            "judged": records_of(self.judged()) if self.judges else [],
        }

    def _page(self) -> Page:
        busy = [f"other processes compute {', '.join(self.busy)}"] if self.busy else []
        if not self.runs:
            return Page("", "", [Section("", [Text("No point is finished.")])], busy)
        frame = self.table()
        said = least_regret_text(self.judged()) if self.judges else lowest_text(frame)
        answer = Section("", [Text(said, prominent=True)] if said else [])
        doubts = ((name, Subject(run).alarms) for name, run in self.runs.items())
        alarms = [f"{name}: {said[0]}" for name, said in doubts if said][:1]
        return Page("", "", [answer, *table_page(frame).sections], busy, alarms=alarms)

    def judged(self) -> pd.DataFrame:
        """The regret of the times found at each point, at every point.

        Returns
        -------
        DataFrame
            A row for each point and each set of times found at any point. The columns are those of
            `pfdist.table`; ``run`` is the point at which the times are judged, and ``set`` the
            search that found them. Further columns are ``found_at``, the point where they were
            found, and ``regret`` with ``regret_low`` and ``regret_high``, its 95 % interval: how
            far the expected MSE lies above that of the best times found at any point, as a
            fraction. It is NaN for times that are not feasible at the judging point, or are not as
            many as those found there.

        Raises
        ------
        ArgumentError
            The sweep does not judge.
        """
        if not self.judges:
            raise ArgumentError("judged needs a sweep that judges, got one with judge = false")
        return judged_table(self.runs, self.judges)


@with_options
@checked
def sweep(
    job: JobSource,
    over: Values = _NOTHING,
    *,
    parallel: Sequence[Values] = (),
    points: Sequence[Values] = (),
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    bound_draws: DrawsOrNone = 0,
    judge: bool | None = None,
    part: Part | None = None,
    **options: Unpack[Options],
) -> Sweep:
    """Run a job at every point of a sweep, or resume the sweep where it stopped.

    Every point is an ordinary run in its own folder, with the same bytes as if it were run alone.
    All points share the workers, so that no worker idles while the last tasks of a point are done.
    The first points go first. Evaluations that several points need are computed once. Points that
    another process computes are left out, so several processes may share the points of a sweep.
    With `report`, every run has a report, and the sweep has one with links to them. A sweep draws
    no other figures.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A sweep file, or a problem, a job or the path of a job file.
    over : mapping of str to sequence
        Values of keys of the job, as ``{"seed": range(1, 11)}``; every combination is a point.
    parallel : sequence of mappings of str to sequence
        Groups of keys whose values change together.
    points : sequence of mappings of str to object
        Further points, with a value for each key.
    results : str or Path, optional
        The folder of the sweep; by default ``results/<the sweep file's stem>``, or
        ``results/<the job file's stem>-sweep``.
    changes : iterable of str, optional
    bound_draws : int
        Number of draws of the lower bound that is proved at each point; 0 for no bound.
    judge : bool, optional
        Whether the times found at each point are judged at every point, too, by comparisons in the
        folder ``judged``; the default is judge of the sweep file.
    part : tuple of two int, optional
        ``(k, n)`` computes every n-th point, from the k-th, and no other. The sweep is then neither
        judged nor reported: that needs all points.
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
    sweep_job = read_sweep(job, over, parallel, points, changes, execution)
    path, judges_points = checked_folder(sweep_job, results, judge)
    check_pool(sweep_job.execution)
    bound = BoundSettings(draws=bound_draws) if bound_draws else None
    own = sweep_job.part(part)
    with following(chosen.progress, chosen.say) as (show, tell):
        say_model_files(own.jobs.values(), tell)
        searched, refused = PointsAtWork(own, path, bound, show, tell), None
        stages = [searched]

        def drivers() -> Iterator[Driver | None]:
            yield from searched.drivers()
            if judges_points and (judged := _judged(sweep_job, searched.points().runs, tell)):
                folder = path / JUDGED / judged.name
                stages.append(PointsAtWork(judged, folder, None, show, tell))
                yield from stages[-1].drivers()

        engines = [each.filter.engine for each in own.jobs.values()]
        workers_at_work = at_work(sweep_job.execution, engines, tell)
        try:
            Loop(workers_at_work, searched.at_once, searched.begun()).serve(drivers())
        except JobError as error:  # the points are finished, and get their reports
            refused = error
        searches, judges = [*(stage.points() for stage in stages), Points({}, {}, [])][:2]
        if chosen.has_report:
            for position, run in enumerate(searches.runs.values(), 1):
                if run.path / REPORT not in listed_pages(run.path):
                    tell(f"Writing reports {position}/{len(searches.runs)}")
                    try_report(run, tell)
            if part is None:
                try_report(path, tell)
    if refused is not None:
        raise refused
    if failed := searches.failed | judges.failed:
        first = "; ".join(f"{name}: {reason}" for name, reason in [*failed.items()][:_SHOWN])
        more = f"; {len(failed) - _SHOWN} more" * (len(failed) > _SHOWN)
        raise SweepError(
            f"{len(failed)} of {len(own.points)} points failed, the others are finished in "
            f"{path}: {first}{more}",
            failed,
        )
    busy = (*searches.busy, *judges.busy)
    return Sweep(path, searches.runs, {} if judges.busy else judges.runs, busy)


def _judged(sweep_job: SweepJob, runs: Mapping[str, Run], say: Say) -> SweepJob | None:
    """The sweep that judges the found times; None if not all points are finished.

    Raises
    ------
    JobError
        The found times cannot be judged.
    """
    if len(runs) < len(sweep_job.points):
        heard(say, "The found times are not judged: not all points are finished.")
        return None
    judged = judging(sweep_job, times_by_search(runs))
    say(f"Judging the found times at all {len(sweep_job.points)} points...")
    return judged


def checked_folder(
    sweep_job: SweepJob, results: str | Path | None, judge: bool | None
) -> tuple[Path, bool]:
    """The folder of a sweep, and whether it judges.

    Raises
    ------
    ArgumentError
        The folder is a file or holds a run.
    JobError
        Points that are to be judged have different clocks.
    """
    path = path_argument(
        "results", Path("results") / sweep_job.name if results is None else results
    )
    wrong = "a run" if holds_run(path) else "a file" if path.is_file() else ""
    if wrong:
        raise ArgumentError(
            f"results must be a folder for the runs of the sweep, got {wrong}: {path}",
            argument="results",
        )
    judges = sweep_job.judge if judge is None else judge
    if judges:
        check_comparable(sweep_job)
    return path, judges


def foreseen(
    job: JobSource,
    over: Values = _NOTHING,
    *,
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    judge: bool | None = None,
    progress: Show | bool | None = None,
    say: Say = silent,
) -> pd.DataFrame:
    """The points of a sweep and the work of each, estimated from the speed of a few draws.

    Parameters
    ----------
    job, over, results, changes, judge, progress, say
        As for `sweep`.

    Returns
    -------
    DataFrame
        A row for each point: its name, its values, the state of its run ("none" if it has not
        begun, "other run" if its folder holds a different run), ``steps``, the particle-steps of
        the whole run, and ``seconds``, about how long a worker takes for them. If the sweep judges,
        ``judging_steps`` are those that judge all found times there, if all differ.

    Raises
    ------
    PfdistError
        The sweep is wrong, or the model of a point.
    """
    sweep_job = read_sweep(job, over, (), (), changes, {})
    path, judges = checked_folder(sweep_job, results, judge)
    rows, steps_a_set, number_of_sets = [], [], 0
    with following(progress, say) as (show, _):
        for done, point in enumerate(sweep_job.points):
            show(Progress("dry run", done, len(sweep_job.points), doing=f"measuring {point.name}"))
            folder = path / point.name
            built = build(sweep_job.jobs[point.name], folder)
            state = _state(folder, built.job)
            steps = foreseen_steps(built)
            work = {"steps": steps, "seconds": steps * _seconds_a_step(built)}
            rows.append({"point": point.name, **point.chosen, "state": state, **work})
            steps_a_set.append(comparison_steps(built) // len(built.names))
            number_of_sets += len(built.names) - len(built.study.unsearched)
    points_of_sweep = pd.DataFrame(rows)
    if judges:
        points_of_sweep["judging_steps"] = [steps * (number_of_sets + 1) for steps in steps_a_set]
    return points_of_sweep


def _seconds_a_step(built: Built) -> float:
    """Seconds of a particle-step, measured on a few draws; a guess for an exact engine."""
    if built.evaluator.exact:
        return built.evaluator.seconds_a_step
    return seconds_a_step(built.evaluator, built.feasible.regular(), built.comparing)


def _state(folder: Path, job: Job) -> str:
    """How far the run of a point is."""
    if not holds_run(folder):
        return "none"
    recorded, wanted = read_recorded(folder)[1], job.identity()
    comparison = recorded.get("comparison")
    if isinstance(comparison, dict):  # a run may get more draws
        comparison["draws"] = wanted["comparison"]["draws"]
    return open_run(folder).state if recorded == wanted else "other run"
