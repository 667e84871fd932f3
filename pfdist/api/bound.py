"""A lower bound of the expected MSE of every feasible set, and the gap of a run's sets."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

from pfdist.analysis import Run, finite
from pfdist.analysis.particle_loss import ParticleLoss
from pfdist.analysis.stored_run import particle_losses_of
from pfdist.answers.bound import bound_page
from pfdist.api.at_work import at_work, noted
from pfdist.api.options import Chosen, Options, following, with_options
from pfdist.api.report import renew_report
from pfdist.api.run_of_job import finished_run, own_store, run_and_job
from pfdist.bounds.proof import Gap
from pfdist.documents.notebook import Shown
from pfdist.documents.parts import Page
from pfdist.errors import ArgumentError, shown
from pfdist.job.source import JobSource
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import check_pool
from pfdist.runner.door import Session, complete
from pfdist.runner.prover import Look, Prover

_DEFAULT = BoundSettings()


@dataclass(frozen=True, repr=False)
class Bound(Shown):
    """Result of `bound`.

    Parameters
    ----------
    run : Path
    window, longest_gap, windows : int
        Measurements of a window at first; the number of instants for which the error of a window
        counts at most (also on a clock); and how many windows the relaxation knows in the end.
    particles, draws : int
        Settings of the bound's filter; 0 where the engine is exact.
    confidence : float
        Confidence of the limit of each gap.
    within_reached : bool or None
        Whether the limits of all found sets are as small as demanded; None if nothing was demanded.
    gaps : list of Gap
        One for each compared set of the run.
    losses : dict of str to ParticleLoss
        The loss by the number of particles of the job's own filter, for each compared set; empty
        where it is not known.
    is_constrained : bool
        Whether the job excludes some times, beside their number or cost.
    leaves_out_limits : bool
        Whether sensors have limits of their own, which the bound leaves out.
    has_scenarios : bool
        Whether the job has scenarios. Then the bound is that of a filter that is told the scenario.
    shares : tuple of float
        Shares of the scenarios on the draws of the bound, if the worst scenario decides; else
        empty.
    within : float or None
        The limit of the gaps that was demanded.
    """

    run: Path
    window: int
    longest_gap: int
    windows: int
    particles: int
    draws: int
    confidence: float
    within_reached: bool | None
    gaps: list[Gap]
    losses: dict[str, ParticleLoss]
    is_constrained: bool = False
    leaves_out_limits: bool = False
    has_scenarios: bool = False
    shares: tuple[float, ...] = ()
    within: float | None = None

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; an unknown value is None."""
        apart = ("run", "gaps", "losses", "within")
        own = {key: value for key, value in vars(self).items() if key not in apart}
        sets = {gap.name: gap.columns() for gap in self.gaps}
        for row in sets.values():
            del row["name"]
        for name, loss in self.losses.items():
            sets[name] |= loss.columns() | {"warning": loss.warning}
        return finite({"run": str(self.run), **own, "sets": sets})

    def _page(self) -> Page:
        return bound_page(self.as_json(), self.within)


@with_options
def bound(
    job: JobSource | Run,
    settings: BoundSettings = _DEFAULT,
    *,
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Bound:
    """Prove how much lower the expected MSE of any other feasible times can be.

    The function runs the model, on draws that neither chose the times nor compared them, and
    writes the tables ``bound`` and ``error_sums`` of the run. The same call goes on where it was
    stopped.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A run or its folder; or a problem, a job, or the path of a job file, whose run is meant.
    settings : BoundSettings
        Draws, particles, windows and limits of the proof, and the gap that is demanded.
    results : str or Path, optional
        Folder of the run; by default the folder where `pfdist.run` and `pfdist.plan` put it.
    changes : iterable of str, optional
        Changes ``key=value`` of the job, as `pfdist.load_job` takes them.
    options
        See `Options`.

    Returns
    -------
    Bound

    Raises
    ------
    StoreError
        There is no finished run of the job, or the run is of another job or of other models.
    JobError, ModelError
        The model defines an error of its own; the relaxation is too large; or the model cannot be
        loaded.
    TaskError, PoolError
        A task failed, or no worker answers. All committed sums are kept.
    """
    chosen = Chosen(**options)
    if not isinstance(settings, BoundSettings):
        raise ArgumentError(
            f"settings must be a pfdist.BoundSettings, got {shown(settings)}", argument="settings"
        )
    with following(chosen.progress, chosen.say) as (show, tell):
        proved, built = run_and_job(job, results, changes, tell, chosen.execution)
        if built.evaluator.exact:  # there is nothing to compute in a pool
            serial = built.job.with_changes(sections={"execution": {"pool": "serial"}})
            built = replace(built, job=serial)
        check_pool(built.job.execution)
        prover, within, clock = Prover(built, settings), settings.within, built.job.problem.clock
        with own_store(proved, built, tell) as store:
            session = Session(built, store, show, tell)
            session.reporter.foresee(prover.steps)
            proof = prover.prove(session, finished_run(proved))  # it may have been found damaged
            with noted(session):
                workers_at_work = at_work(built.job.execution, [built.evaluator.engine], tell)
                look: Look = complete(proof, workers_at_work)
            session.reporter.finish()
            if chosen.figures and store.path == proved.path:
                from pfdist.plots import draw_figures  # noqa: PLC0415  Matplotlib loads if a figure is drawn

                draw_figures(proved, "bound")
        if chosen.report is not False:
            renew_report(proved.path, tell)
    return Bound(
        proved.path,
        settings.window,
        prover.relaxation.longest_gap,
        len(prover.relaxation.windows),
        prover.particles,
        look.draws,
        prover.confidence,
        None if within is None else look.is_within(within, built.unjudged),
        [
            replace(
                gap,
                measurement_times=tuple(clock.written_of(gap.measurement_times)),
                path=tuple(clock.written_of(gap.path)),
            )
            for gap in look.gaps
        ],
        particle_losses_of(proved),
        built.job.problem.is_constrained,
        bool(built.feasible.limits),
        built.job.scenarios is not None,
        prover.shares,
        within,
    )
