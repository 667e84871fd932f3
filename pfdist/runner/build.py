"""From the names in a job to objects: model, evaluator, optimisers, pool."""

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

from pfdist.checks.contract import check_compiled, check_formulas, few_draws
from pfdist.common.component_names import check_estimate_columns
from pfdist.common.streams import stream_key
from pfdist.errors import CompileError, EngineWarning, JobError, ModelError
from pfdist.evaluation.compiling import compile_evaluator, libm_functions
from pfdist.evaluation.engines import AUTO, COMPILED, NUMPY, NUMPY_TIMES_SLOWER
from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Estimation
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import KERNEL_VERSION
from pfdist.filters.settings import check_fits, check_lengths
from pfdist.job.job import Job
from pfdist.job.sections import Execution
from pfdist.meaning.chosen import Choose, ChosenModel
from pfdist.pools.base import Pool
from pfdist.pools.kinds import POOLS
from pfdist.runner.chooser import chooser_of, models_of
from pfdist.runner.online_planning import planning_of
from pfdist.runner.searches import NamedSearch, Settings, named_search
from pfdist.runner.study import Study, study_of
from pfdist.sequential.planning import check_plannable
from pfdist.times.clock import Time
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class EvaluatorSource:
    """An evaluator as data, from which each worker makes the evaluator itself.

    Parameters
    ----------
    model, filter_model : ChosenModel
    horizon : int
    dtype, engine : str
    estimations : tuple of Estimation
        Estimations that the run uses; the comparison's first.
    clock : tuple of float, (T+1,), optional
        The time of each instant, which formulas read; None if the job has no clock.
    weights : tuple of float, (T+1,), optional
        Weight of each instant's error in the MSE, with mean 1; None if all are 1.
    """

    model: ChosenModel
    filter_model: ChosenModel
    horizon: int
    dtype: str
    engine: str
    estimations: tuple[Estimation, ...]
    clock: tuple[float, ...] | None = None
    weights: tuple[float, ...] | None = None

    @property
    def truth(self) -> "EvaluatorSource":
        """The same evaluator with a filter that knows the true model."""
        return replace(self, filter_model=self.model)

    def make(self) -> Evaluator:
        """The evaluator with its models loaded and every estimation checked."""
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
        if self.clock is not None:
            model, filter_model = model.on_clock(self.clock), filter_model.on_clock(self.clock)
        for each in (model, filter_model):
            check_lengths(each, self.horizon)
        check_fits(filter_model, model)
        filter_model = filter_model.named_as(model)
        evaluator = Evaluator(
            model, self.horizon, filter_model, self.dtype, self.engine, weights=self.weights
        )
        for estimation in self.estimations:
            evaluator.check(estimation)
        return evaluator

    def compiled(self) -> Evaluator:
        """The evaluator with everything compiled that the estimations need."""
        evaluator = self.make()
        if self.engine != NUMPY.name:
            for estimation in self.estimations:
                compile_evaluator(evaluator, estimation)
        return evaluator

    def libm_functions(self) -> tuple[str, ...]:
        """Functions of the C library that the compiled formulas call."""
        if self.engine == NUMPY.name:
            return ()
        evaluator = self.compiled()
        found = (libm_functions(evaluator, estimation) for estimation in self.estimations)
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
            *(part for part in (self.clock, self.weights) if part is not None),
            *parts,
        )
        return f"{key:016x}"


@dataclass(frozen=True)
class Built:
    """A job and the objects made of it; see `build`."""

    job: Job
    study: Study
    source: EvaluatorSource
    searches: tuple[NamedSearch, ...] = field(repr=False)

    @cached_property
    def evaluator(self) -> Evaluator:
        """The evaluator, made in this process."""
        return self.source.make()

    def instants(self, sets: Mapping[str, Sequence[Time]]) -> dict[str, Times]:
        """Give the instants of sets of times on the job's clock."""
        clock = self.job.problem.clock
        return {name: clock.instants(times) for name, times in sets.items()}

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
        """Names of the compared sets: those that the job gives, then those that searches find."""
        found = [name for search in self.searches for name in self.study.names(search.name)]
        return [*self.study.given, *found]

    @property
    def unjudged(self) -> Collection[str]:
        """Names of the sets whose gaps may be large: given sets, or the references alone.

        In a run without a search, the given sets take the place of the found sets.
        """
        return self.study.given if self.searches else self.study.references


def build(job: Job, choose: Choose | None = None) -> Built:
    """Make the objects of a job, and check that they fit each other.

    Parameters
    ----------
    job : Job
    choose : callable, optional
        Chooses the job's models. The default chooses the objects that were given with the job, and
        the models that the job names, because the user has named the job. If the job lies in a
        run's folder, the default runs no model file of that folder that the user has not run
        before.

    Raises
    ------
    StoreError
        The job lies in a run's folder, and the user has not run its model's file before.
    ModelError
        The model cannot be loaded, a parameter is unknown or out of its range, or an estimator or
        a resampling scheme does not fit.
    """
    model, filter_model = models_of(job, choose or chooser_of(job))
    source = EvaluatorSource(
        model=model,
        filter_model=filter_model,
        horizon=job.problem.feasible.horizon,
        dtype=job.filter.dtype,
        engine=job.filter.engine,
        estimations=(_comparing(job), Settings.from_job(job).estimation),
        clock=job.problem.clock.times if job.problem.has_clock else None,
        weights=job.problem.weights,
    )
    evaluator, study = source.make(), study_of(job)
    guide = evaluator.guiding_estimator
    searches = tuple(named_search(study, job, section, guide) for section in job.search)
    wanted = [settings.estimation for search in searches for settings in search.all_settings]
    if job.online is not None:
        check_plannable(evaluator)
        wanted.append(planning_of(job, evaluator.cheapest_estimator).estimation)
    source = replace(source, estimations=tuple(dict.fromkeys([*source.estimations, *wanted])))
    draws = _checked_formulas(source)
    source = replace(source, engine=_compiled_or_numpy(source))
    if draws and source.engine == "compiled":
        check_compiled(draws.model, draws)
    built = Built(job, study, source, searches)
    check_estimate_columns(built.names, evaluator.model.named("z"))
    return built


def _checked_formulas(source: EvaluatorSource) -> Draws | None:
    """Refuse wrong formulas of the user's models; return a few draws of a user's true model."""
    draws, evaluator = None, source.make()
    if not _ships(source.model):
        draws = few_draws(evaluator.model, source.horizon)
        check_formulas(evaluator.model, draws)
    if source.filter_model.meaning != source.model.meaning and not _ships(source.filter_model):
        try:
            believed_draws = few_draws(evaluator.believed, source.horizon)
        except ModelError:  # its simulation may diverge: measurements guide the particles
            return draws
        try:
            check_formulas(evaluator.believed, believed_draws)
        except ModelError as error:
            raise ModelError(f"model.filter: {error}") from error
    return draws


def _ships(model: ChosenModel) -> bool:
    return model.source.package.partition(".")[0] == "pfdist"


def _comparing(job: Job) -> Estimation:
    return Estimation(job.filter.particles, job.filter.resampling)


def _compiled_or_numpy(source: EvaluatorSource) -> str:
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


def _worker(source: EvaluatorSource) -> Callable[[Any], Any]:
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
