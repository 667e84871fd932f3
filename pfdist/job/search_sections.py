"""The sections [[search]] of a job file: a method each, its settings, and how it evaluates."""

from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

PLANNER: Final = "survivors"
AUTO: Final = "auto"
CLEAR_ERRORS: Final = 4.0
"""By so many standard errors two estimates differ where chance alone would not explain it."""
_FEWEST, _SHARE = 100, 5  # of the particles of a search's own filter

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Resampling = Literal["multinomial", "stratified", "systematic", "residual", "sorted_systematic"]
Estimator = Literal["squared_error", "filter_variance", "two_filters"]


class Section(BaseModel):
    """What every section of a job file is: frozen, strict, without keys of its own invention."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class SearchEvaluation(Section):
    """How a search's own evaluations differ from [evaluation] and [filter]."""

    draws: Annotated[int, Field(ge=2, le=10_000_000)] | None = None
    noise: Literal["fresh", "common"] | None = None
    particles: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    resampling: Resampling | None = None
    estimator: Estimator | Literal["auto"] | None = None

    def particles_of(self, job_particles: int) -> int:
        """Particles of the search's filter, by those of the job's."""
        return self.particles or job_particles


class CommonEvaluation(SearchEvaluation):
    """What a search takes that compares sets under common noise, if it is given nothing else.

    Its particles are then a fifth of the job's, but no fewer than 100 if the job has them: with
    too few, other sets are the best.
    """

    draws: Annotated[int, Field(ge=2, le=10_000_000)] = 300
    noise: Literal["fresh", "common"] = "common"
    resampling: Resampling = "systematic"
    estimator: Estimator | Literal["auto"] = AUTO

    def particles_of(self, job_particles: int) -> int:
        """Particles of the search's filter, by those of the job's."""
        return self.particles or min(job_particles, max(_FEWEST, job_particles // _SHARE))


class SearchSection(Section):
    """What every search has."""

    name: Name = ""
    evaluation: SearchEvaluation = SearchEvaluation()
    polish: bool = False

    @model_validator(mode="before")
    @classmethod
    def _named_after_its_method(cls, data: Any) -> Any:
        if isinstance(data, dict) and "method" in data and "name" not in data:
            return {**data, "name": data["method"]}
        return data

    @property
    def settings(self) -> dict[str, Any]:
        """The hyper-parameters of the optimiser."""
        return self.model_dump(exclude={"name", "method", "evaluation", "polish"})


class GeneticSearch(SearchSection):
    """The paper's genetic algorithm."""

    method: Literal["genetic"]
    population: Annotated[int, Field(ge=2, lt=2**63, multiple_of=2)] = 50
    generations: Annotated[int, Field(ge=1, lt=2**63)] = 25
    crossover_probability: Probability = 1.0
    mutation_probability: Probability = 0.003
    sigma_scaling: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] = 1.0
    share_copies: bool = False


class RandomSearch(SearchSection):
    """The paper's random trials."""

    method: Literal["random"]
    evaluations: Annotated[int, Field(ge=1, lt=2**63)] = 1250


class SurvivorSearch(SearchSection):
    """The survivor dynamic programme, which `pfdist plan` takes."""

    method: Literal["survivors"] = "survivors"
    name: Name = "survivors"
    evaluation: CommonEvaluation = CommonEvaluation()
    polish: bool = True
    survivors: Annotated[int, Field(ge=1, lt=2**63)] = 2
    by_previous: bool = False


class NeighbourSearch(SearchSection):
    """Greedy, by one time more or less a step; or exchange of one time for another."""

    method: Literal["greedy_forward", "greedy_backward", "exchange"]
    evaluation: CommonEvaluation = CommonEvaluation()


class AnnealingSearch(SearchSection):
    """Simulated annealing, a few chains side by side."""

    method: Literal["annealing"]
    evaluation: CommonEvaluation = CommonEvaluation()
    chains: Annotated[int, Field(ge=1, lt=2**63)] = 4
    steps: Annotated[int, Field(ge=1, lt=2**63)] = 500
    coldest: Annotated[float, Field(gt=0.0, le=1.0)] = 0.03


class CrossEntropySearch(SearchSection):
    """The cross-entropy method."""

    method: Literal["cross_entropy"]
    evaluation: CommonEvaluation = CommonEvaluation()
    population: Annotated[int, Field(ge=1, lt=2**63)] = 100
    generations: Annotated[int, Field(ge=1, lt=2**63)] = 50
    elite: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    smoothing: Annotated[float, Field(gt=0.0, le=1.0)] = 0.4


class ExhaustiveSearch(SearchSection):
    """Every set, where they are few."""

    method: Literal["exhaustive"]
    evaluation: CommonEvaluation = CommonEvaluation()
    limit: Annotated[int, Field(ge=1, lt=2**63)] = 100_000


SEARCHES: dict[str, type[SearchSection]] = {
    "genetic": GeneticSearch,
    "random": RandomSearch,
    "survivors": SurvivorSearch,
    "greedy_forward": NeighbourSearch,
    "greedy_backward": NeighbourSearch,
    "exchange": NeighbourSearch,
    "annealing": AnnealingSearch,
    "cross_entropy": CrossEntropySearch,
    "exhaustive": ExhaustiveSearch,
}
Search = Annotated[
    GeneticSearch
    | RandomSearch
    | SurvivorSearch
    | NeighbourSearch
    | AnnealingSearch
    | CrossEntropySearch
    | ExhaustiveSearch,
    Field(discriminator="method"),
]
