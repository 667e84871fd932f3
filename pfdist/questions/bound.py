"""A lower bound of the expected MSE of every feasible set, and the gap of a run's sets."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Unpack

from pfdist.common.parts import Page
from pfdist.common.shown import Shown
from pfdist.filters.criterion import MEAN, Criterion
from pfdist.problem.problem import JobSource
from pfdist.questions.at_work import at_work, noted
from pfdist.questions.bound_page import bound_page
from pfdist.questions.options import Chosen, Options, following, with_options
from pfdist.questions.report import renew_report
from pfdist.questions.run_of_job import finished_run, own_store, run_and_job
from pfdist.results import Run, finite
from pfdist.results.particle_loss import ParticleLoss, particle_losses_of
from pfdist.results.sets import publish_sets, recommended
from pfdist.runner.bound_settings import MEMORY, BoundSettings
from pfdist.runner.build import check_pool
from pfdist.runner.door import RunSession, complete
from pfdist.runner.driver import prover_of
from pfdist.runner.proof import Gap
from pfdist.runner.prover import Look
from pfdist.search.first_windows import WINDOW


@dataclass(frozen=True, repr=False)
class Bound(Shown):
    """Result of `bound`.

    Parameters
    ----------
    run : Path
    window, longest_gap, windows : int
        Largest number of measurements of the first windows; the largest number of instants, also
        on a clock, for which the error of a window counts; and the number of windows in the end.
    particles, draws : int
        Settings of the bound's filter; 0 if the engine is exact.
    confidence : float
        Confidence of the limit of each gap.
    within_reached : bool or None
        Whether the limits of all found sets are at most `within`; None without `within`.
    gaps : list of Gap
        One for each compared set of the run.
    losses : dict of str to ParticleLoss
        The particle loss of the job's filter with each compared set; empty if it is unknown, and
        for several numbers of measurements.
    is_constrained : bool
        Whether the job excludes some times, beside their number or price.
    relaxed : tuple of str
        The constraints that the bound relaxes.
    has_scenarios : bool
        Whether the job has scenarios. Then the bound is that of a filter with the parameters of
        each draw's scenario.
    shares : tuple of float
        Shares of the scenarios, or of the instants, in the bound, if the worst decides; else empty.
    within : float or None
        The demanded limit of the gaps.
    labels : mapping of str to str
        The labels of the sets on pages, by name.
    criterion : Criterion
        Its bound was computed. If it is maximised, the errors and bounds of gaps are minus it.
    has_fewer : bool
        Whether the budget of a gap is the largest number of measurements: sets may have fewer.
    plan : str
        Name of the set that the run recommends; empty with several numbers of measurements.
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
    relaxed: tuple[str, ...] = ()
    has_scenarios: bool = False
    shares: tuple[float, ...] = ()
    within: float | None = None
    labels: Mapping[str, str] = field(default_factory=dict, repr=False)
    criterion: Criterion = field(default=MEAN, repr=False)
    has_fewer: bool = False
    plan: str = ""

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; an unknown value is None."""
        other = ("run", "gaps", "losses", "within", "labels", "criterion")
        own = {key: value for key, value in vars(self).items() if key not in other}
        sets = {gap.name: gap.columns() for gap in self.gaps}
        for row in sets.values():
            del row["name"]
        for name, loss in self.losses.items():
            sets[name] |= loss.columns() | {"warning": loss.warning}
        own["criterion"] = self.criterion.name
        return finite({"run": str(self.run), **own, "sets": sets})

    def _page(self) -> Page:
        return bound_page(self.as_json(), self.labels, self.within, self.criterion)


@with_options
def bound(
    job: JobSource | Run,
    draws: int | None = None,
    *,
    within: float | None = None,
    particles: int | None = None,
    window: int = WINDOW,
    work: float | None = None,
    memory: int = MEMORY,
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Bound:
    """Prove how much lower the expected MSE of any other times can be.

    The model is run on draws that neither chose the times nor compared them, and the tables
    ``bound`` and ``error_sums`` of the run are written. The same call resumes where it was stopped.
    The figure of the bound, if figures are drawn, and an existing report are written again. With an
    exact engine the pool is not used.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, whose run is meant, or the folder of a run.
    draws : int, optional
        Draws of the bound, 480 to 100,000, rounded up to a multiple of 24; by default 1,920. With
        more draws the bound is higher, because the least of many noisy errors is too low. Exact
        engines ignore it.
    within : float, optional
        Double the draws until the upper limits of the gaps are at most this fraction, or until they
        are `draws`, by default 30,720. The gaps of references, and of other sets than found ones,
        do not count if there are searches, unless such a set beats them: then it alone counts.
    particles : int, optional
        Number of particles of the bound's filter; by default that of the job's filter, and at least
        1,000 if estimates use later measurements.
    window : int
        Largest number of measurements of the first windows, before windows grow. Estimates that use
        later measurements have gaps between two measurements instead.
    work : float, optional
        Particle-steps after which no window grows; 0 to keep the first windows. By default twice
        those of the first windows on 480 draws, or once for gaps; exact engines have no limit.
        Windows also stop growing when the relaxation has no set that is better than the run's by
        more than 0.1 %; with an exact engine, by anything.
    memory : int
        Memory that the relaxation may take, in MiB. Windows stop growing before they need more.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
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
        The model defines its own error; the relaxation is too large; or the model cannot be loaded.
    TaskError, PoolError
        A task failed, or no worker answers. All committed sums are kept.
    """
    chosen = Chosen(**options)
    settings = BoundSettings(
        draws=draws, within=within, particles=particles, window=window, work=work, memory=memory
    )
    with following(chosen.progress, chosen.say) as (show, tell):
        proved, built = run_and_job(job, results, changes, tell, chosen.execution)
        if not built.evaluator.has_particles:  # there is nothing to compute in a pool
            serial = built.job.with_changes(sections={"execution": {"pool": "serial"}})
            built = replace(built, job=serial)
        check_pool(built.job.execution)
        prover, written_of = prover_of(built, settings), built.job.problem.points.written_of
        with own_store(proved, built, tell) as store:
            session = RunSession(built, store, show, tell)
            session.reporter.foresee(prover.steps)
            finished = finished_run(proved)  # it may have been found damaged
            with noted(session):
                workers_at_work = at_work(built.job.execution, [built.evaluator.engine], tell)
                look: Look = complete(prover.prove(session, finished), workers_at_work)
            if store.path == proved.path:
                publish_sets(finished)
            session.reporter.finish()
        if chosen.figures and store.path == proved.path:
            from pfdist.pages.plots import draw_figures  # noqa: PLC0415  Matplotlib loads if a figure is drawn

            draw_figures(proved, "bound")
        if chosen.report is not False:
            renew_report(proved.path, tell)
    return Bound(
        proved.path,
        window,
        prover.sizes["longest_gap"],
        prover.sizes["windows"],
        prover.particles,
        look.draws,
        prover.confidence,
        None if within is None else look.is_within(within, prover.ignored),
        [
            replace(
                gap,
                measurement_times=tuple(written_of(gap.measurement_times)),
                path=tuple(written_of(gap.path)),
            )
            for gap in look.gaps
        ],
        {} if built.job.amounts else particle_losses_of(proved),  # a budget's run says them itself
        built.job.problem.is_constrained,
        built.feasible.relaxed,
        bool(built.evaluator.scenarios),
        prover.shares,
        within,
        proved.labels,
        built.job.criterion,
        built.feasible.has_fewer,
        "" if built.job.amounts else recommended(proved).name,
    )
