"""Run a job: compute what the run lacks, prove a lower bound if wanted, then draw the figures."""

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Unpack

from pfdist.common.arguments import paths_argument
from pfdist.common.section import checked
from pfdist.errors import JobError, ModelError, TaskError, relative
from pfdist.filters.constants import constants_of
from pfdist.filters.formulas import operations_of
from pfdist.filters.proposals import PROPOSALS
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.at_work import at_work, noted
from pfdist.questions.options import Chosen, Options, following, with_options
from pfdist.questions.report import try_report
from pfdist.questions.run_of_job import folder_of
from pfdist.questions.subject import Subject
from pfdist.results import Run, open_run
from pfdist.results.sets import publish_sets
from pfdist.results.stored_run import measured_of, problem_of
from pfdist.runner.bound_settings import BoundSettings, DrawsOrNone
from pfdist.runner.build import Built, build, check_pool, say_model_files
from pfdist.runner.door import RunSession, WorkBatch, complete, lent_by
from pfdist.runner.driver import core_steps, drive, looks, prover_of
from pfdist.runner.evenly_spaced import compare_evenly_spaced, is_known
from pfdist.runner.identity import is_sealed, opened
from pfdist.runner.opponent import SHARE
from pfdist.runner.progress import Detail, Say, Show, heard
from pfdist.runner.provenance import lender, note_machine
from pfdist.runner.prover import Prover
from pfdist.runner.searches import RANKING
from pfdist.store import (
    EVEN_PHASE,
    add_to_provenance,
    forget_pages,
    listed_pages,
    read_run,
    record_pages,
)
from pfdist.store.folder import REPORT

_OF_FIGURES = ("pfdist.questions.pictures", "pfdist.pages.html", "scipy.special")
PATIENCE = 5  # minutes of one core that a bound may take where nobody asked for it alone
_OPERATIONS = 2e10  # of compiled formulas in a second of a quick core, about


@with_options
@checked
def run(
    job: JobSource,
    results: str | Path | None = None,
    *,
    reuse: str | Path | Iterable[str | Path] = (),
    changes: Iterable[str] = (),
    bound_draws: DrawsOrNone = 0,
    **options: Unpack[Options],
) -> Run:
    """Run the searches of a job and compare the found times with evenly spaced ones.

    The same call resumes where it was stopped.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``.
    reuse : str, Path or iterable of these, optional
        Folders of other runs, whose evaluations are taken, not computed again; give it once for
        each.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    bound_draws : int
        Number of draws of a lower bound of the expected MSE of all feasible times, which is proved
        after the comparison unless the run has one; 0 for no bound.
    options
        See `Options`.

    Returns
    -------
    Run

    Raises
    ------
    PfdistError
        Anything went wrong. All committed results are kept, and the same call resumes the run.
    """
    chosen = Chosen(**options)
    settings = BoundSettings(draws=bound_draws) if bound_draws else None
    job = as_job(job, changes, settings={"execution": chosen.execution})
    check_pool(job.execution)
    path = folder_of(job, results)
    others = paths_argument("reuse", reuse)
    with following(chosen.progress, chosen.say) as (show, tell):
        say_model_files([job], tell)
        built = build(job, path, *others)
        if job.filter.is_automatic:
            tell(f"filter.particles: {built.job.filter.particles:,} are enough at regular times")
        if built.taken:
            tell(built.taken)
        return run_built(built, path, chosen, show, tell, settings, others)


def run_built(
    built: Built,
    path: Path,
    chosen: Chosen,
    show: Show,
    say: Say,
    bound: BoundSettings | None = None,
    reuse: Iterable[Path] = (),
) -> Run:
    """Compute what a run in a folder lacks, and make its figures and its report.

    Parameters
    ----------
    built : Built
    path : Path
        The run's own folder.
    chosen : Chosen
        Whether figures are drawn and a report is written.
    show, say : callable
        Receive the progress and the messages.
    bound : BoundSettings, optional
        Settings of the lower bound; by default there is no bound.
    reuse : iterable of Path
        Folders of other runs whose evaluations this run takes.

    Raises
    ------
    PfdistError
        As `run` raises.
    """
    if is_sealed(path, built):
        heard(say, f"{path} cannot be written: its figures and its report stay as they are")
        return Run(path, built.job)
    lenders = [lender(open_run(other).path, built) for other in reuse]

    made = list[Path]()  # pages of the tables as they are now, which are listed at the end

    def draw(run: Run) -> None:
        if chosen.figures:
            from pfdist.pages.plots import draw_missing_figures  # noqa: PLC0415  Matplotlib loads if a figure is drawn

            made.extend(draw_missing_figures(run, listed_pages(path).union(made)))

    def finish(run: Run) -> Run:
        draw(run)
        if chosen.has_report and path / REPORT not in listed_pages(path) and try_report(run, say):
            made.append(path / REPORT)
        return run

    # Figures are drawn in a thread, beside the proof, and while the pool is left. One that fails
    # beside the proof is still missing at the end: it is drawn again, and raises its error.
    with opened(path, built) as store, ThreadPoolExecutor(1) as beside:

        def driver() -> Generator[WorkBatch, None, Future[Run]]:
            run = Run(path, built.job)
            if (chosen.figures or chosen.has_report) and run.state != "finished":
                for module in _OF_FIGURES:  # otherwise they would be waited for later
                    beside.submit(import_module, module)
            session = RunSession(built, store, show, say)
            yield from compute(session, run, bound, partial(beside.submit, draw, run))
            return beside.submit(finish, run)

        pool = at_work(built.job.execution, [built.evaluator.engine], say)
        try:
            run: Run = complete(driver(), pool, lent_by(lenders)).result()
        finally:
            record_pages(path, made, locked=True)
    return run


def compute(
    session: RunSession,
    run: Run,
    settings: BoundSettings | None,
    compared: Callable[[], object] = lambda: None,
) -> Generator[WorkBatch, None, None]:
    """Compute what a run lacks, with its lower bound and its numbers of evenly spaced times.

    Figures and the report of fewer draws stay until new ones replace them, but are not listed.

    Parameters
    ----------
    session : RunSession
    run : Run
    settings : BoundSettings or None
        Settings of the lower bound; None for no bound.
    compared : callable
        Called when only the bound is missing. The curve of budgets waits, because it shows the
        bound.
    """
    built, say, path = session.built, session.say, run.path
    prover, unfinished = _prover(session, settings), run.state != "finished"
    # A plan has evenly spaced times beside its bound, or alone where no bound is known.
    is_alone = settings is not None and prover is None
    is_scanned = not is_known(built) or "evenly_spaced" in run.tables
    if not (unfinished or (is_alone and not is_scanned)) and (
        prover is None or prover.has_proved(run) or _is_long(session, run, prover)
    ):
        return
    forget_pages(path, *[] if unfinished else [REPORT])
    note_machine(path, built, say)
    foreseen = prover.steps if prover and minutes_of_bound(built, prover) <= PATIENCE else 0.0
    session.reporter.foresee(foreseen, foreseen)
    with noted(session):
        yield from drive(session)
        _note_what_is_left(built, run)
        proves = prover is not None and not _is_long(session, run, prover)
        proof = prover.steps if prover is not None and proves else 0.0
        session.reporter.foresee(proof - foreseen, -foreseen)
        if (proves or is_alone) and not is_scanned:
            yield from compare_evenly_spaced(session, run, SHARE * core_steps(built, prover))
            session.commit()
            for table in ("error_sums", "timings"):
                for phase in (EVEN_PHASE, RANKING):
                    session.store.settle(table, phase)
        if proves or is_alone:
            for each in looks():
                yield from each.look(session, run, SHARE * core_steps(built, prover))
        if prover is not None and proves:
            publish_sets(run)
            if has_amounts(run.job):
                found = f"`pfdist status {relative(str(run.path))}` shows the plans"
            else:
                subject = Subject(run)
                times = subject.rows[subject.by_error[0]].measurement_times
                found = f"Measure {problem_of(run).when(times)}"
                compared()
            say(f"{found}. The proof takes longer.")
            try:
                yield from prover.prove(session, run)
            except (JobError, ModelError, TaskError) as error:  # the results of the run stand
                _unproved(session, str(error))
    publish_sets(run)
    session.reporter.finish()


def _prover(session: RunSession, settings: BoundSettings | None) -> Prover | None:
    """A prover of the run's lower bound; None if no bound is wanted or possible."""
    if settings is None:
        return None
    try:
        return prover_of(session.built, settings)
    except (JobError, ModelError) as error:
        _unproved(session, str(error))
    return None


def _is_long(session: RunSession, run: Run, prover: Prover) -> bool:
    """Whether a bound would take too long beside other results; a message says so."""
    minutes = minutes_of_bound(session.built, prover)
    if minutes > PATIENCE and "bound" not in run.tables:
        folder = relative(str(run.path))
        command = f"`pfdist bound {folder} --draws {prover.settings.most_draws}`"
        _unproved(session, f"{command} takes about {minutes:,.0f} minutes of one core")
    return minutes > PATIENCE


def _note_what_is_left(built: Built, run: Run) -> None:
    """Keep what is left of particles for every answer of the run: of lines, and of constants."""
    evaluator, seed = built.evaluator, built.job.seed
    if not evaluator.has_particles:
        return
    from pfdist.runner.particles import (  # noqa: PLC0415  needs pandas
        LOST_DRAWS,
        fewest_lines,
        lost_constants,
        work_of_loss,
    )

    if constants_of(evaluator.believed, range(evaluator.horizon + 1)):
        lost = {
            name: lost_constants(evaluator, times, seed, built.comparing, LOST_DRAWS)
            for name, times in measured_of(run).items()
        }
        add_to_provenance(run.path, {"lost_constants": lost})
    if not evaluator.lag:
        return
    times = measured_of(run)[Subject(run).by_error[0]]
    work = work_of_loss(evaluator, times, built.job.seed, built.comparing, 24)
    text, is_few = fewest_lines(evaluator, work, built.job.problem.clock.formatted)
    if text:
        add_to_provenance(run.path, {"few_lines": text * is_few})


def _unproved(session: RunSession, reason: str) -> None:
    """Say why there is no lower bound, and keep the reason for every answer of the run."""
    if read_run(session.store.path)[0]["provenance"].get("unproved") != reason:
        add_to_provenance(session.store.path, {"unproved": reason})
        forget_pages(session.store.path, REPORT)
    heard(session.say, Detail(f"Not proved: {reason}."))  # the answer says so, too


def minutes_of_bound(built: Built, prover: Prover) -> float:
    """Minutes of one core that a bound takes, about: by counted work, the same on each machine."""
    evaluator, seconds = built.evaluator, built.evaluator.seconds_a_step
    if evaluator.has_particles and evaluator.computed_by.compiled:
        operations = operations_of(evaluator.believed, range(evaluator.horizon + 1))
        beside_truth = PROPOSALS[PROPOSALS[built.comparing.proposal].beside_truth]
        seconds = max(seconds, operations * beside_truth.cost / _OPERATIONS)
    return prover.steps * seconds / 60
