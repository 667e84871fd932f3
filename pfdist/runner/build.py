"""From a job's names to objects: model, problem, optimisers, pool."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

from pfdist.checks.contract import check_compiled, check_formulas, few_draws
from pfdist.common.streams import stream_key
from pfdist.errors import CompileError, EngineWarning, ModelError
from pfdist.evaluation.engines import AUTO, COMPILED, NUMPY, NUMPY_TIMES_SLOWER
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Estimation
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import KERNEL_VERSION
from pfdist.job.job import Job
from pfdist.job.sections import Execution
from pfdist.meaning import chosen
from pfdist.meaning.chosen import Choose, ChosenModel
from pfdist.pools.base import Pool, SerialPool
from pfdist.runner.searches import NamedSearch, Settings, named_search
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class ProblemSource:
    """A problem as data: it travels to a worker, which makes the problem of it.

    Parameters
    ----------
    model, filter_model : ChosenModel
    horizon : int
    dtype, engine : str
    estimations : tuple of Estimation
        Those that are wanted, the comparison's first.
    """

    model: ChosenModel
    filter_model: ChosenModel
    horizon: int
    dtype: str
    engine: str
    estimations: tuple[Estimation, ...]

    def make(self) -> Problem:
        """Load the models and give the problem, which is the function a worker applies."""
        model = self.model.load()
        try:
            filter_model = self.filter_model.load()
        except ModelError as error:
            raise ModelError(f"model.filter: {error}") from error
        problem = Problem(model, self.horizon, filter_model, self.dtype, self.engine)
        for estimation in self.estimations:
            problem.check(estimation)
        return problem

    def compiled(self) -> Problem:
        """The same with all that it needs compiled."""
        problem = self.make()
        if self.engine != NUMPY.name:
            for estimation in self.estimations:
                problem.compile(estimation)
        return problem

    def libm_functions(self) -> tuple[str, ...]:
        """Functions of the C library that the compiled formulas call."""
        if self.engine == NUMPY.name:
            return ()
        problem = self.compiled()
        found = (problem.libm_functions(estimation) for estimation in self.estimations)
        return tuple(sorted(set().union(*found)))

    def evaluation_id(self, times: Times, end: int, stream: int, estimation: Estimation) -> str:
        """Hash all that the per-draw MSE of these times depends on."""
        key = stream_key(
            KERNEL_VERSION,
            self.model.content,
            self.filter_model.content,
            self.horizon,
            self.dtype,
            self.engine,
            vars(estimation),
            times,
            end,
            stream,
        )
        return f"{key:016x}"


@dataclass(frozen=True)
class Built:
    """A job and the objects made of it; see `build`."""

    job: Job
    source: ProblemSource
    searches: tuple[NamedSearch, ...] = field(repr=False)

    @cached_property
    def problem(self) -> Problem:
        """The problem, made in this process."""
        return self.source.make()

    @property
    def phases(self) -> list[str]:
        """Phases of the searches."""
        return [phase for search in self.searches for phase in search.phases]

    @cached_property
    def references(self) -> dict[str, Times]:
        """Measurement times with which those found are compared, by name: for each N its own."""
        comparison = self.job.comparison
        if self.numbers:
            name = comparison.reference_name
            return {self.named(name, n): self.job.feasible(n).regular() for n in self.numbers}
        if isinstance(comparison.reference, str):
            return {comparison.reference_name: self.job.problem.feasible.regular()}
        return {comparison.reference_name: comparison.reference}

    @property
    def numbers(self) -> range:
        """Numbers of measurements for which times are wanted; empty if for one, or money, alone."""
        budget = self.job.budget
        return range(0) if budget is None else range(budget.least, budget.most + 1)

    @property
    def comparing(self) -> Estimation:
        """How sets are compared: by the squared error, however the searches estimate it."""
        return _comparing(self.job)

    @property
    def names(self) -> list[str]:
        """What is compared: the references first, then what the searches find."""
        found = [search.name for search in self.searches]
        if self.numbers:
            found = [self.named(name, number) for name in found for number in self.numbers]
        return [*self.references, *found]

    def named(self, name: str, number: int) -> str:
        """Name of a set of so many measurements, where there are sets of several numbers."""
        return f"{name}_{number:0{len(str(self.job.problem.horizon + 1))}}"


def build(job: Job, choose: Choose | None = None) -> Built:
    """Make the objects of a job.

    Parameters
    ----------
    job : Job
    choose : callable, optional
        Chooses the job's models. By default they are those that the job names, because the user
        has named the job; but where it is the job of a run, nothing of its folder is run unasked.

    Raises
    ------
    StoreError
        It is the job of a run, and names a model's file that the user has not run before.
    ModelError
        The model cannot be loaded, a parameter is unknown or out of its range, or an estimator or
        a resampling does not fit.
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
        estimations=(_comparing(job), Settings.of(job).estimation),
    )
    cheapest = source.make().cheapest_estimator
    searches = tuple(named_search(job, section, cheapest) for section in job.search)
    wanted = (settings.estimation for search in searches for settings in search.all_settings)
    source = replace(source, estimations=tuple(dict.fromkeys([*source.estimations, *wanted])))
    draws = _checked_formulas(source)
    source = replace(source, engine=_compiled_or_numpy(source))
    if draws and source.engine == "compiled":
        check_compiled(draws.model, draws)
    return Built(job, source, searches)


def _chooser(job: Job) -> Choose:
    """What chooses the models of a job: with more care where it is the job of a run."""
    if not (job.path.parent / "run.json").exists():
        return chosen.choose
    # Here and not above: a worker, which chooses nothing, then imports no pyarrow.
    from pfdist.runner.named_by_a_run import of_a_runs_job  # noqa: PLC0415

    return of_a_runs_job(job)


def _checked_formulas(source: ProblemSource) -> Draws | None:
    """Refuse formulas that are wrong, but for models that ship; give a few draws of the truth."""
    draws = None
    if not _ships(source.model):
        model = source.model.load()
        draws = few_draws(model, source.horizon)
        check_formulas(model, draws)
    if source.filter_model.meaning != source.model.meaning and not _ships(source.filter_model):
        believed = source.filter_model.load()
        try:
            believed_draws = few_draws(believed, source.horizon)
        except ModelError:  # it need not stay finite: measurements lead the particles
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
    """What the filter takes for the truth: the same model, unless [model.filter] names one."""
    section = job.model.filter
    if section.name:
        try:
            return choose("filter_model", section.name, job.path.parent, section.parameters)
        except ModelError as error:
            raise ModelError(f"model.filter.name: {error}") from error
    return replace(model, parameters={**model.parameters, **section.parameters})


def _compiled_or_numpy(source: ProblemSource) -> str:
    """The engine: what cannot be compiled is done in NumPy, unless the job says otherwise.

    It is compiled here and now, and workers on this machine find it on disk.
    """
    try:
        source.compiled()  # whatever the engine, so that a wrong model is found at once
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
    # Compiled before there is a task, which has its time to be done in.
    return source.compiled().results


def make_pool(built: Built, execution: Execution) -> Pool:
    """Make the pool that [execution] names; it starts when it is entered."""
    make_function = partial(_worker, built.source)
    if execution.pool == "serial":
        return SerialPool(make_function)
    # Here and not above: `--pool serial` then needs no Ray, and starts 0.3 s sooner.
    from pfdist.pools.ray_pool import RayPool  # noqa: PLC0415

    return RayPool(make_function, execution.workers, execution.address)
