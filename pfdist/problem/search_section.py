"""A section [[search]] of a job file: the method, its settings, and how it evaluates sets."""

import re
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from pfdist.common.section import JobSection
from pfdist.filters.proposals import PROPOSALS
from pfdist.kernels.schemes import Resampling

_FEWEST_PARTICLES, _SHARE = 100, 5  # a search uses one fifth of the job's particles, at least 100
_FEWEST_MOVED = 20  # of particles that move, of which a search uses one half


def is_name(text: str) -> str:
    """A name of a search or a set, which is also one of columns and files."""
    if not re.fullmatch("[a-z][a-z0-9_]*", text):
        rule = "lower-case letters, digits and underscores, a letter first"
        raise PydanticCustomError("name", rule)
    return text


Name = Annotated[str, Field(max_length=40), AfterValidator(is_name)]
Degenerate = Literal["continue", "kill"]
Count = Annotated[int, Field(ge=1, lt=2**63)]
Even = Annotated[int, Field(ge=2, lt=2**63, multiple_of=2)]
Flag = Annotated[bool, Field()]
Fraction = Annotated[float, Field(gt=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class EvaluationSettings(JobSection):
    """Settings of a search that replace those of [evaluation] and [filter] of the job.

    Parameters
    ----------
    draws : int
        Number of draws on which the search evaluates a set.
    noise : str
        Whether each evaluation has fresh draws, or all share the same draws.
    particles : int
        Number of particles of the filters of the search. By default that of the job, or under
        common noise a fifth of it, at least 100.
    resampling : str
        The resampling scheme of the search.
    degenerate_draws : str
        With "kill", a degenerate draw makes the error of a set infinite.
    """

    draws: Annotated[int, Field(ge=2, le=10_000_000)] | None = None
    noise: Literal["fresh", "common"] | None = None
    particles: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    resampling: Resampling | None = None
    degenerate_draws: Degenerate | None = None

    # whether errors are estimated by the variance of the particles, where that is right
    by_variance: ClassVar[bool] = False

    def particles_of(self, job_particles: int, proposal: str) -> int:
        """Number of particles of the search, given that of the job."""
        if PROPOSALS[proposal].moves:
            return min(job_particles, self.particles or max(_FEWEST_MOVED, job_particles // 2))
        return self.particles or self._usual_particles(job_particles)

    def _usual_particles(self, job_particles: int) -> int:
        return job_particles


class CommonNoiseSettings(EvaluationSettings):
    """Default evaluation settings of searches that use common random numbers.

    The filter has a fifth of the job's particles, but at least 100 if the job has that many. With
    fewer particles, other sets would look best.
    """

    draws: Annotated[int, Field(ge=2, le=10_000_000)] = 300
    noise: Literal["fresh", "common"] = "common"
    resampling: Resampling = "systematic"
    degenerate_draws: Degenerate = "continue"

    by_variance: ClassVar[bool] = True

    def _usual_particles(self, job_particles: int) -> int:
        return min(job_particles, max(_FEWEST_PARTICLES, job_particles // _SHARE))


class SearchSection(JobSection):
    """Base of all sections [[search]]. The section of each method adds its settings.

    Parameters
    ----------
    name : str
        Name of the search in tables, and of its plan beside others; by default that of the method.
    evaluation : section
        How the search evaluates sets.
    polish : bool
        Whether exchanges of one time for another improve the best set at the end. Some methods
        have true as their default.
    method : str
        The search method.
    """

    name: Name = ""
    evaluation: EvaluationSettings = EvaluationSettings()
    polish: bool = False
    method: str = ""

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the search method."""
        return self.model_dump(exclude={"name", "method", "evaluation", "polish"})
