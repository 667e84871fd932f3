"""From the names in a job to objects: model, evaluator, optimisers, pool."""

import os
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.checks.contract import check_formulas, few_draws
from pfdist.common.component_names import Component
from pfdist.errors import EngineWarning, JobError, ModelError, TraceError, shown
from pfdist.filters.engines import AUTO, COMPILED, NUMPY, NUMPY_TIMES_SLOWER, WITHOUT_FMA
from pfdist.filters.evaluator import Evaluator, carried_evaluator
from pfdist.filters.work import Estimation
from pfdist.job.job import ONLINE, Job
from pfdist.job.sections import Execution, FilterModel, Model
from pfdist.kernels.lowering import has_fused_multiply_add
from pfdist.models import PYTHON, CarriedModel, carried_model, installed_models
from pfdist.models.twin import twin_of
from pfdist.pools.base import Pool
from pfdist.pools.kinds import AUTO as AUTO_POOL
from pfdist.pools.kinds import POOLS, cluster_at_hand
from pfdist.runner.searches import (
    NamedSearch,
    Settings,
    Study,
    comparing_of,
    named_search,
    planning_of,
)
from pfdist.sequential.planning import check_plannable
from pfdist.times.clock import Time
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class Built:
    """A job and the objects made of it; see `build`.

    `feasible` has smaller sets if measurements cost money and the filter's model is not the truth.
    """

    job: Job
    feasible: Feasible
    study: Study
    evaluator: Evaluator
    searches: tuple[NamedSearch, ...] = field(repr=False)

    def instants(self, sets: Mapping[str, Sequence[Time]]) -> dict[str, Times]:
        """The instants of sets of times on the job's clock; with sensors, the measurements."""
        clock = self.job.problem.clock
        return {name: clock.measurements(times) for name, times in sets.items()}

    @property
    def is_worst(self) -> bool:
        """Whether the cost of a set is the expected MSE of its worst scenario."""
        return self.job.scenarios is not None and self.job.scenarios.is_worst

    def exact_costs(
        self, sets: Sequence[Times], ends: Sequence[int] | None = None, *, additive: bool = False
    ) -> NDArray[np.float64]:
        """The cost of each set up to its end, (S,), from an exact engine.

        If `additive`, it is the mean over scenarios even if the worst scenario decides.
        """
        if additive or not self.is_worst:
            return self.evaluator.expected_mse(sets, ends)
        costs = [each.expected_mse(sets, ends) for each in self.evaluator.of_scenarios]
        worst: NDArray[np.float64] = np.max(costs, axis=0)
        return worst

    @property
    def phases(self) -> list[str]:
        """Names of all phases of the searches."""
        return [phase for search in self.searches for phase in search.phases]

    @property
    def comparing(self) -> Estimation:
        """The estimation of the comparison: the squared error of the job's own filter."""
        return comparing_of(self.job)

    @property
    def names(self) -> list[str]:
        """Names of the compared sets: those that the job gives, then those that searches find."""
        searched = [name for search in self.searches for name in self.study.names(search.name)]
        return [*self.study.unsearched, *searched]

    @property
    def unjudged(self) -> Collection[str]:
        """Sets that the demanded gap ignores: all given sets with searches, else the references."""
        return self.study.unsearched if self.searches else self.study.references


def build(job: Job) -> Built:
    """Make the objects of a job, and check that they fit each other.

    Raises `ModelError` if the model cannot be loaded, if a parameter is unknown or out of its
    range, or if an estimator or a resampling scheme does not fit. Raises `JobError` if the job
    wants a number of particles that is enough, and none is.
    """
    if job.filter.is_automatic:
        return build(_with_enough_particles(job))
    model, filter_model = models_of(job)
    evaluator = evaluator_of(job, model, filter_model)
    model, filter_model = evaluator.carried
    # To a filter that is wrong about the truth, one more measurement may do harm.
    feasible = job.problem.feasible
    is_wrong = filter_model.key != model.key or evaluator.truth.told != evaluator.told
    smaller = feasible.smaller or (is_wrong and not feasible.counted)
    feasible = replace(feasible, smaller=smaller)
    study = Study(job, feasible)
    guide = evaluator.guiding_estimator
    searches = tuple(named_search(study, job, section, guide) for section in job.search)
    wanted = [settings.estimation for search in searches for settings in search.all_settings]
    if job.online is not None:
        check_plannable(evaluator)
        wanted.append(planning_of(job, evaluator.cheapest_estimator).estimation)
    wanted = [*evaluator.estimations, *wanted]
    evaluator = replace(evaluator, estimations=tuple(dict.fromkeys(wanted)))
    _check_formulas(evaluator)
    evaluator = replace(evaluator, engine=_compiled_or_numpy(evaluator))
    built = Built(job, feasible, study, evaluator, searches)
    sets = built.names if job.online is None else [*built.names, ONLINE]
    check_estimate_columns(sets, evaluator.model.named("z"))
    return built


def evaluator_of(job: Job, model: CarriedModel, filter_model: CarriedModel) -> Evaluator:
    """The evaluator of a job and its models, which is not compiled; errors as of `build`."""
    _check_sensors(job, model)
    evaluator = carried_evaluator(
        model,
        filter_model,
        horizon=job.problem.feasible.horizon,
        engine=job.filter.engine,
        estimations=(comparing_of(job), Settings.from_job(job).estimation),
        clock=job.problem.clock.times if job.problem.has_clock else None,
        weights=job.problem.weights,
    )
    if job.scenarios is None:
        return evaluator
    told = job.scenarios.filter == "told"
    try:
        return replace(evaluator, scenarios=job.scenarios.each, told=told)
    except ModelError as error:
        raise ModelError(f"scenarios.parameters: {error}", argument="scenarios") from error


def _check_sensors(job: Job, model: CarriedModel) -> None:
    """Raise a `JobError` unless the job names the sensors of the model, in their order."""
    named, sensors = job.problem.clock.sensors, tuple(model.model.sensors)
    if named != sensors:
        raise JobError(
            f"problem.sensors must name the sensors of the model {model.name}, in their order: "
            f"{shown(list(sensors)) if sensors else 'it has none'}, got {shown(list(named))}"
        )


def _with_enough_particles(job: Job) -> Job:
    """The job with a number in the place of ``filter.particles = "auto"``.

    The number is enough for the regular times and the filter's own model. The job is built with few
    particles first, so whatever else is wrong is named first.
    """
    # Imported here, so that workers, which know the number, need no pandas.
    from pfdist.analysis.particle_loss import SMALL, SMALL_AT_MOST  # noqa: PLC0415
    from pfdist.checks.particles import (  # noqa: PLC0415
        NUMBERS,
        enough_particles,
        has_particle_loss,
    )

    def with_number(particles: int) -> Job:
        return job.with_changes(settings={"filter": {"particles": particles}})

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EngineWarning)  # it comes again with the number
        built = build(with_number(NUMBERS[0]))
    evaluator, times = built.evaluator.self_consistent, job.problem.feasible.regular()
    must = "filter.particles must be a number, got 'auto'"
    if not has_particle_loss(evaluator):
        raise JobError(
            f"{must}: it needs an engine with particles, and the squared error ({job.path})"
        )
    loss = enough_particles(evaluator, times, job.seed, built.comparing)
    if not loss.is_small:
        none = (
            f"no number up to {loss.particles:,} loses at most {SMALL:.0%} by two filters and less "
            f"than {SMALL_AT_MOST:.0%} at most; {loss.particles:,} lose {loss.text}"
        ) * (loss.particles == NUMBERS[-1])  # else rare failures have ended the search
        found = ". ".join(filter(None, (none, loss.rare)))
        raise JobError(f"{must}: {found} ({job.path})")
    return with_number(loss.particles)


def models_of(job: Job) -> tuple[CarriedModel, CarriedModel]:
    """The model of a job, and the model that its filter uses.

    A model is the object that was handed over with the job, or has the name that the job gives.
    """
    folder, believed = folder_of_models(job), job.model.filter
    model = _model_of(job, "model", job.model, folder)
    if not believed.name:
        try:
            return model, model.with_parameters(believed.parameters)
        except ModelError as error:
            raise ModelError(f"model.filter: {error}") from error
    return model, _model_of(job, "filter_model", believed, folder)


def _model_of(job: Job, part: str, section: Model | FilterModel, folder: Path) -> CarriedModel:
    given = job.origin.models.get(part)
    try:
        if given is not None and given.name == section.name:
            return given.with_parameters(section.parameters)
        return carried_model(section.name, folder, section.parameters)
    except ModelError as error:
        key = "model" if part == "model" else "model.filter"
        raise ModelError(f"{key}.{error.argument or 'name'}: {error}") from error


def folder_of_models(job: Job) -> Path:
    """The folder to which the paths of a job's models are relative.

    This is the folder of the job file. If the file is the job.toml of a run, the paths are still
    relative to the folder of the job file with which the run was started.
    """
    # Imported here, so that workers, which need no model file, need no pyarrow.
    from pfdist.store import is_job_of_run, read_run  # noqa: PLC0415

    folder = job.path.parent
    if not is_job_of_run(job.path):
        return folder
    return Path(folder, read_run(folder)[0].get("provenance", {}).get("folder", ""))


def say_model_files(jobs: Iterable[Job], say: Callable[[str], Any]) -> None:
    """Say which model files jobs name, before they are run."""
    files = dict.fromkeys(
        folder_of_models(job) / name.rpartition(":")[0]
        for job in jobs
        for name in (job.model.name, job.model.filter.name)
        if ".py:" in name and not name.startswith(PYTHON)
    )
    for file in files:
        say(f"runs the model file {file}, which your job names")


def _check_formulas(evaluator: Evaluator) -> None:
    """Raise a `ModelError` if formulas of a user's model are wrong, on a few draws."""
    model, filter_model = evaluator.carried
    if not _ships(model):
        for part in reversed(evaluator.model.parts):
            twin = twin_of(part.model, range(evaluator.horizon + 1))
            check_formulas(twin, few_draws(twin, evaluator.horizon))
    if filter_model.key != model.key and not _ships(filter_model):
        instants = range(evaluator.horizon + 1)
        sensors = [twin_of(part.model, instants) for part in evaluator.believed.parts]
        try:
            believed_draws = [few_draws(each, evaluator.horizon) for each in sensors]
        except ModelError:  # its simulation may diverge: measurements guide the particles
            return
        try:
            for each, some in zip(sensors, believed_draws, strict=True):
                check_formulas(each, some)
        except ModelError as error:
            raise ModelError(f"model.filter: {error}") from error


def _ships(model: CarriedModel) -> bool:
    home, _ = installed_models().get(model.name, ("", ""))
    return home.startswith("pfdist.")


def _compiled_or_numpy(evaluator: Evaluator) -> str:
    """Name of the engine: NumPy if a formula cannot be traced, unless the job demands another one.

    The formulas are compiled here, and workers on this machine find the result on disk.
    """
    try:
        # For every engine, so that a wrong model is refused at once.
        evaluator.compile(*evaluator.estimations)
    except TraceError as error:
        if evaluator.engine != AUTO:
            raise
        warnings.warn(
            f"{error}: computing in NumPy instead, about {NUMPY_TIMES_SLOWER} times slower "
            f'(filter.engine = "{NUMPY.name}" says that you know)',
            EngineWarning,
            stacklevel=4,
        )
        return NUMPY.name
    if not has_fused_multiply_add():
        warnings.warn(WITHOUT_FMA, EngineWarning, stacklevel=4)
    return COMPILED.name if evaluator.engine == AUTO else evaluator.engine


MOST_WORKERS = 1000  # on one machine; each is a thread, or a process of Ray


def check_pool(execution: Execution) -> None:
    """Raise a `JobError` if [execution] has settings that its pool does not take."""
    pool, cores = execution.pool, execution.wait_for_cores
    is_here = execution.address == "local" or not cluster_at_hand(execution.address)
    if execution.workers > MOST_WORKERS and (is_here or pool == "threads"):
        raise JobError(
            f"execution.workers must be at most {MOST_WORKERS:,} on one machine, got "
            f"{execution.workers:,}: 0 is one for each core"
        )
    if pool in (AUTO_POOL, "ray") and cores and not cluster_at_hand(execution.address):
        raise JobError(
            f"execution.wait_for_cores must be 0 without a Ray cluster that runs already, got "
            f"{cores}: give its execution.address, or set RAY_ADDRESS"
        )
    if pool == AUTO_POOL:
        return
    for name, without in (("workers", (0, 1)), ("address", ("",)), ("wait_for_cores", (0,))):
        got = getattr(execution, name)
        if got not in without and name not in POOLS[pool].takes:
            others = ", ".join(repr(other) for other, kind in POOLS.items() if name in kind.takes)
            raise JobError(
                f"execution.pool = {pool!r}, which computes {POOLS[pool].description}, takes no "
                f"{name}, got {got!r}; pools that do: {others}"
            )


def chosen_pool(execution: Execution, *, threaded: bool) -> tuple[Execution, str]:
    """[execution] with a pool in the place of ``auto``, and why it is this pool.

    `threaded` says whether tasks release Python's lock, so that threads of a process can work
    together. The reason is empty if [execution] names a pool.
    """
    if execution.pool != AUTO_POOL:
        return execution, ""
    address = execution.address or ("auto" if os.environ.get("RAY_ADDRESS") else "")
    if reason := cluster_at_hand(execution.address):
        return execution.model_copy(update={"pool": "ray", "address": address}), reason
    if threaded:
        return execution.model_copy(update={"pool": "threads"}), "no cluster is given"
    reason = "formulas in NumPy keep Python's lock"
    return execution.model_copy(update={"pool": "ray"}), reason


def make_pool(execution: Execution, *, threaded: bool = True) -> Pool:
    """The pool that [execution] names; the pool starts when the caller enters it.

    `threaded` is as of `chosen_pool`.
    """
    return POOLS[execution.pool].make(**execution.model_dump(), threaded=threaded)


def check_estimate_columns(sets: Sequence[str], components: Sequence[Component]) -> None:
    """Raise a `JobError` if the estimates of two sets would have columns of one name.

    For example, the set ``a`` with the component ``b_c`` and the set ``a_b`` with the component
    ``c``.
    """
    owners = dict[str, tuple[str, str]]()
    for name in sets:
        for each in components:
            column = f"estimate_{name}_{each.suffix}"
            if column in owners:
                other, other_suffix = owners[column]
                raise JobError(
                    "estimates must have different columns, got the column "
                    f"{column!r} for {other_suffix!r} of the set {other!r} and for {each.suffix!r} "
                    f"of the set {name!r}: give a search, or a set of comparison.sets, another name"
                )
            owners[column] = name, each.suffix
