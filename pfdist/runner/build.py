"""From the names in a job to objects: model, problem, optimisers, pool."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

from pfdist.checks.contract import check_compiled, check_formulas, few_draws
from pfdist.common.streams import stream_key
from pfdist.errors import CompileError, EngineWarning, JobError, ModelError
from pfdist.evaluation.compiling import compile_problem, libm_functions
from pfdist.evaluation.engines import AUTO, COMPILED, NUMPY, NUMPY_TIMES_SLOWER
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Estimation
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import KERNEL_VERSION
from pfdist.job.job import Job
from pfdist.job.sections import Execution
from pfdist.meaning import chosen
from pfdist.meaning.chosen import Choose, ChosenModel
from pfdist.pools.base import Pool
from pfdist.pools.kinds import POOLS
from pfdist.runner.online_planning import planning_of
from pfdist.runner.searches import NamedSearch, Settings, named_search
from pfdist.runner.study import Study, study_of
from pfdist.sequential.planning import check_plannable
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class ProblemSource:
    """A problem as data, from which each worker makes the problem itself.

    Parameters
    ----------
    model, filter_model : ChosenModel
    horizon : int
    dtype, engine : str
    estimations : tuple of Estimation
        Estimations that the run uses; the comparison's first.
    """

    model: ChosenModel
    filter_model: ChosenModel
    horizon: int
    dtype: str
    engine: str
    estimations: tuple[Estimation, ...]

    @property
    def truth(self) -> "ProblemSource":
        """The same problem with a filter that knows the true model."""
        return replace(self, filter_model=self.model)

    def make(self) -> Problem:
        """The problem with its models loaded and every estimation checked."""
        try:
            model = self.model.load()
        except ModelError as error:
            if error.argument:  # the key of the job that is wrong
                raise ModelError(f"model.{error.argument}: {error}") from error
            raise
        try:
            filter_model = self.filter_model.load()
        except ModelError as error:
            raise ModelError(f"model.filter: {error}") from error
        problem = Problem(model, self.horizon, filter_model, self.dtype, self.engine)
        for estimation in self.estimations:
            problem.check(estimation)
        return problem

    def compiled(self) -> Problem:
        """The problem with everything compiled that the estimations need."""
        problem = self.make()
        if self.engine != NUMPY.name:
            for estimation in self.estimations:
                compile_problem(problem, estimation)
        return problem

    def libm_functions(self) -> tuple[str, ...]:
        """Functions of the C library that the compiled formulas call."""
        if self.engine == NUMPY.name:
            return ()
        problem = self.compiled()
        found = (libm_functions(problem, estimation) for estimation in self.estimations)
        return tuple(sorted(set().union(*found)))

    def evaluation_id(self, times: Times, end: int, stream: int, estimation: Estimation) -> str:
        """Id of an evaluation: a hash of everything on which its per-draw MSE depends."""
        return self._id(estimation, times, end, stream)

    def sums_id(
        self,
        sets: Sequence[Times],
        instants: Sequence[tuple[int, int]],
        stream: int,
        estimation: Estimation,
    ) -> str:
        """Id of sums of errors: a hash of everything on which they depend but their draws.

        Parameters
        ----------
        sets : sequence of tuples of int
        instants : sequence of pairs of int
            First and last instant at which the errors of each set count.
        stream : int
        estimation : Estimation
        """
        return self._id(estimation, sets, instants, stream, "sums")

    def _id(self, estimation: Estimation, *parts: Any) -> str:
        key = stream_key(
            KERNEL_VERSION,
            self.model.content,
            self.filter_model.content,
            self.horizon,
            self.dtype,
            self.engine,
            vars(estimation),
            *parts,
        )
        return f"{key:016x}"


@dataclass(frozen=True)
class Built:
    """A job and the objects made of it; see `build`."""

    job: Job
    study: Study
    source: ProblemSource
    searches: tuple[NamedSearch, ...] = field(repr=False)

    @cached_property
    def problem(self) -> Problem:
        """The problem, made in this process."""
        return self.source.make()

    @property
    def phases(self) -> list[str]:
        """Names of all phases of the searches."""
        return [phase for search in self.searches for phase in search.phases]

    @property
    def comparing(self) -> Estimation:
        """The estimation of the comparison: the squared error of the job's own filter."""
        return _comparing(self.job)

    @property
    def names(self) -> list[str]:
        """Names of the compared sets: the references, then the sets that the searches find."""
        found = [name for search in self.searches for name in self.study.names(search.name)]
        return [*self.study.references, *found]


def build(job: Job, choose: Choose | None = None) -> Built:
    """Make the objects of a job, and check that they fit each other.

    Parameters
    ----------
    job : Job
    choose : callable, optional
        Chooses the job's models. The default chooses the models that the job names, because the
        user has named the job. If the job lies in a run's folder, the default runs no model file of
        that folder that the user has not run before.

    Raises
    ------
    StoreError
        The job lies in a run's folder, and the user has not run its model's file before.
    ModelError
        The model cannot be loaded, a parameter is unknown or out of its range, or an estimator or
        a resampling scheme does not fit.
    """
    choose = choose or _chooser(job)
    try:
        model = choose("model", job.model.name, job.path.parent, job.model.parameters)
    except ModelError as error:
        raise ModelError(f"model.name: {error}") from error
    source = ProblemSource(
        model=model,
        filter_model=_filter_model(job, model, choose),
        horizon=job.problem.horizon,
        dtype=job.filter.dtype,
        engine=job.filter.engine,
        estimations=(_comparing(job), Settings.from_job(job).estimation),
    )
    problem, study = source.make(), study_of(job)
    guide = problem.guiding_estimator
    searches = tuple(named_search(study, job, section, guide) for section in job.search)
    wanted = [settings.estimation for search in searches for settings in search.all_settings]
    if job.online is not None:
        check_plannable(problem)
        wanted.append(planning_of(job, problem.cheapest_estimator).estimation)
    source = replace(source, estimations=tuple(dict.fromkeys([*source.estimations, *wanted])))
    draws = _checked_formulas(source)
    source = replace(source, engine=_compiled_or_numpy(source))
    if draws and source.engine == "compiled":
        check_compiled(draws.model, draws)
    return Built(job, study, source, searches)


def _chooser(job: Job) -> Choose:
    """The function that chooses a job's models; a careful function for the job of a run."""
    if not (job.path.parent / "run.json").exists():
        return chosen.choose
    # Imported here, so that workers, which choose no model, need no pyarrow.
    from pfdist.runner.named_by_a_run import of_a_runs_job  # noqa: PLC0415

    return of_a_runs_job(job)


def _checked_formulas(source: ProblemSource) -> Draws | None:
    """Refuse wrong formulas of the user's models; return a few draws of a user's true model."""
    draws = None
    if not _ships(source.model):
        model = source.model.load()
        draws = few_draws(model, source.horizon)
        check_formulas(model, draws)
    if source.filter_model.meaning != source.model.meaning and not _ships(source.filter_model):
        believed = source.filter_model.load()
        try:
            believed_draws = few_draws(believed, source.horizon)
        except ModelError:  # its simulation may diverge: measurements guide the particles
            return draws
        try:
            check_formulas(believed, believed_draws)
        except ModelError as error:
            raise ModelError(f"model.filter: {error}") from error
    return draws


def _ships(model: ChosenModel) -> bool:
    return model.source.package.partition(".")[0] == "pfdist"


def _comparing(job: Job) -> Estimation:
    return Estimation(job.filter.particles, job.filter.resampling)


def _filter_model(job: Job, model: ChosenModel, choose: Choose) -> ChosenModel:
    """The model that the filter uses: the job's model, unless [model.filter] names another."""
    section = job.model.filter
    if section.name:
        try:
            return choose("filter_model", section.name, job.path.parent, section.parameters)
        except ModelError as error:
            raise ModelError(f"model.filter.name: {error}") from error
    return replace(model, parameters={**model.parameters, **section.parameters})


def _compiled_or_numpy(source: ProblemSource) -> str:
    """Name of the engine: NumPy where Numba fails, unless the job demands another engine.

    The formulas are compiled here, and workers on this machine find the result on disk.
    """
    try:
        source.compiled()  # for every engine, so that a wrong model is found at once
    except CompileError as error:
        if source.engine != AUTO:
            raise
        warnings.warn(
            f"{error}: computing in NumPy instead, about {NUMPY_TIMES_SLOWER} times slower "
            f'(filter.engine = "{NUMPY.name}" says that you know)',
            EngineWarning,
            stacklevel=4,
        )
        return NUMPY.name
    return COMPILED.name if source.engine == AUTO else source.engine


def _worker(source: ProblemSource) -> Callable[[Any], Any]:
    # Compiled before the first task: the time of a task is limited.
    return source.compiled().results


def check_pool(execution: Execution) -> None:
    """Refuse an [execution] whose pool cannot have the workers or the address that it asks for.

    Raises
    ------
    JobError
        The pool is one worker, but several workers or an address are given.
    """
    name, workers, address = execution.pool, execution.workers, execution.address
    if POOLS[name].distributed or (workers <= 1 and not address):
        return
    both = ", ".join(repr(other) for other, kind in POOLS.items() if kind.distributed)
    raise JobError(
        f"execution.pool = {name!r} is one worker {POOLS[name].description}, got workers = "
        f"{workers}, address = {address!r}; pools that take both: {both}"
    )


def make_pool(built: Built, execution: Execution) -> Pool:
    """The pool that [execution] names; the pool starts when the caller enters it."""
    make_function = partial(_worker, built.source)
    return POOLS[execution.pool].make(make_function, execution.workers, execution.address)
