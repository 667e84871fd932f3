"""From a job's names to objects: model, problem, optimisers, pool."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

from pfdist.job import Execution, Job
from pfdist.kernels.noise import stream_key
from pfdist.measurement_times import Times
from pfdist.models import ModelSource, find_model
from pfdist.monte_carlo import Problem
from pfdist.particle_filter import KERNEL_VERSION
from pfdist.runner.pool import Pool, SerialPool
from pfdist.search import GeneticAlgorithm, Optimiser, RandomTrials

_OPTIMISERS: dict[str, Callable[..., Optimiser]] = {
    "genetic": GeneticAlgorithm,
    "random": RandomTrials,
}


@dataclass(frozen=True)
class ProblemSource:
    """A problem as data: it travels to a worker, which makes the problem of it.

    Parameters
    ----------
    model : ModelSource
    parameters : mapping of str to float
        Overrides of the model's own.
    horizon, particles : int
    resampling : str
    """

    model: ModelSource
    parameters: Mapping[str, float]
    horizon: int
    particles: int
    resampling: str

    def make(self) -> Problem:
        """Load the model and give the problem, which is the function a worker applies."""
        model = self.model.load().with_parameters(self.parameters)
        return Problem(model, self.horizon, self.particles, self.resampling)

    def evaluation_id(self, times: Times, draws_stream: int, filter_stream: int) -> str:
        """Hash all that the per-draw MSE of these times depends on."""
        key = stream_key(
            KERNEL_VERSION,
            self.model.sha256,
            dict(self.parameters),
            self.horizon,
            self.particles,
            self.resampling,
            times,
            draws_stream,
            filter_stream,
        )
        return f"{key:016x}"


@dataclass(frozen=True)
class NamedSearch:
    """An optimiser under its name in the tables."""

    name: str
    optimiser: Optimiser


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
    def names(self) -> list[str]:
        """What is compared: the reference first, then the searches."""
        return [self.job.comparison.reference, *(search.name for search in self.searches)]


def build(job: Job) -> Built:
    """Make the objects of a job.

    Raises
    ------
    ModelError
        The model cannot be loaded, or a parameter is unknown or out of its range.
    """
    source = ProblemSource(
        model=find_model(job.model.name, job.path.parent),
        parameters=dict(job.model.parameters),
        horizon=job.problem.horizon,
        particles=job.filter.particles,
        resampling=job.filter.resampling,
    )
    searches = tuple(
        NamedSearch(
            section.name,
            _OPTIMISERS[section.method](
                job.problem.horizon, job.problem.measurement_budget, **section.settings
            ),
        )
        for section in job.search
    )
    built = Built(job, source, searches)
    built.problem  # noqa: B018  made here, so that a wrong model or parameter is found at once
    return built


def make_pool(built: Built, execution: Execution) -> Pool:
    """Make the pool that [execution] names; it starts when it is entered."""
    make_function: Callable[[], Callable[[Any], Any]] = partial(ProblemSource.make, built.source)
    if execution.pool == "serial":
        return SerialPool(make_function)
    # Here and not above: `--pool serial` then needs no Ray, and starts 0.3 s sooner.
    from pfdist.runner.ray_pool import RayPool  # noqa: PLC0415

    return RayPool(make_function, execution.workers, execution.address)
