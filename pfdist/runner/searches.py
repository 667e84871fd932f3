"""The searches of a job: the optimisers, and the settings of their evaluations."""

import os
from dataclasses import dataclass, replace

from pfdist.errors import JobError
from pfdist.filters.criterion import Criterion
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import BLOCK, Estimation
from pfdist.kernels.estimators import (
    ESTIMATORS,
    FILTER_VARIANCE,
    SQUARED_ERROR,
    TWO_CLOUDS,
)
from pfdist.problem.job import Job
from pfdist.problem.methods import METHODS
from pfdist.problem.search_section import EvaluationSettings, SearchSection
from pfdist.runner.design import linearized_of
from pfdist.runner.study import Study
from pfdist.search import Optimiser
from pfdist.search.linearized import LinearizedDesign

_POLISH_DRAWS = 4096  # at most
_RACE_DRAWS = 1000  # of the first round
_NOTHING_OWN = EvaluationSettings()
_BYTES_A_DRAW = 32  # index and MSE of a draw, in a worker's answer and in the table
_BYTES_A_SET = 1000  # the times, the evaluation and the row of a set
_SETS = {"population": 1, "chains": 2}
"""Settings for the number of sets in a generation, with the sets of each unit."""


@dataclass(frozen=True)
class Settings:
    """The settings with which sets of times are evaluated."""

    draws: int  # of an evaluation
    common_noise: bool  # whether all sets share draws and filter noise
    degenerate_policy: str  # "continue" or "kill"
    estimation: Estimation

    @classmethod
    def from_job(
        cls,
        job: Job,
        own: EvaluationSettings = _NOTHING_OWN,
        variance_is_error: bool = False,
    ) -> "Settings":
        """The settings of the job, replaced by those of a search where it has any.

        If the variance of the particles estimates the error, a search that prefers to do so does.
        """
        deciding = deciding_of(job)
        estimator = ESTIMATORS[deciding.estimator]
        if own.by_variance and variance_is_error and estimator is SQUARED_ERROR:
            estimator = TWO_CLOUDS if job.problem.instants_of_lag else FILTER_VARIANCE
        # An aspect has its own scheme: sides of a number stand beside the truth.
        scheme = None if job.criterion.aspects else own.resampling
        return cls(
            own.draws or job.evaluation.draws,
            (own.noise or job.evaluation.noise) == "common",
            own.degenerate_draws or job.evaluation.degenerate_draws,
            replace(
                deciding,
                particles=own.particles_of(deciding.particles, deciding.proposal),
                resampling=scheme or deciding.resampling,
                estimator=estimator.name,
            ),
        )


def shortlist_of(name: str) -> str:
    """Name of the phase that decides between sets of one name."""
    return f"{name}.shortlist"


RANKING = "evenly_spaced.ranking"
"""Name of the phase that evaluates the windows by which evenly spaced sets are ranked."""


def coarse_of(name: str) -> str:
    """Name of the phase that evaluates evenly spaced sets from coarse to fine."""
    return f"{name}.coarse"


def polish_of(name: str) -> str:
    """Name of the phase of exchanges that polish a set of this name."""
    return f"{name}.polish"


@dataclass(frozen=True)
class NamedSearch:
    """An optimiser with its name in the tables and the settings of its evaluations."""

    name: str
    optimiser: Optimiser
    settings: Settings
    is_polished: bool  # whether exchanges polish the best set
    polishing: Settings  # of exchanges
    racing: Settings  # of the race, which the job's own filter decides by the squared error
    additive: bool  # whether the optimiser adds errors of instants; then errors must be means
    criterion: Criterion

    @property
    def polish(self) -> str:
        """Name of the phase of exchanges that polish the best set."""
        return polish_of(self.name)

    @property
    def polishes(self) -> tuple[str, ...]:
        """Names of all phases of exchanges: for the mean, then for a criterion that is none."""
        of_mean = () if self.criterion.additive else (f"{self.name}.polish_mean",)
        return *of_mean, self.polish

    @property
    def every(self) -> str:
        """Name of the phase that looks at all sets, where they are few."""
        return f"{self.name}.every"

    @property
    def shortlist(self) -> str:
        """Name of the phase that decides between the final sets of the search."""
        return shortlist_of(self.name)

    @property
    def phases(self) -> tuple[str, ...]:
        """Names of all phases that the search may have."""
        return self.name, self.every, *self.polishes, self.shortlist

    @property
    def all_settings(self) -> tuple[Settings, ...]:
        """Settings of all phases."""
        return self.settings, self.racing, *(self.polishing,) * self.is_polished


def named_search(
    study: Study, job: Job, section: SearchSection, evaluator: Evaluator
) -> NamedSearch:
    """The optimiser of a section [[search]], with the settings of its evaluations.

    Raises `JobError` if the optimiser cannot search this problem, and `ModelError` if it needs
    linearized errors and there are none.
    """
    additive = METHODS[section.method].additive
    # The variance of particles has the mean of the errors, not their quantiles.
    by_variance = evaluator.variance_is_error and (additive or not job.criterion.needs_draws)
    settings = Settings.from_job(job, section.evaluation, by_variance)
    if not METHODS[section.method].online:  # it asks for errors of instants, block by block
        settings = replace(settings, draws=-(-settings.draws // BLOCK) * BLOCK)
    check_memory(job, section, settings.draws)
    optimiser = study.optimiser(section, settings.draws)
    if isinstance(optimiser, LinearizedDesign):
        optimiser = replace(optimiser, errors=linearized_of(job, evaluator))
    # Only the method itself may kill sets, as the paper says.
    counting = replace(settings, common_noise=True, degenerate_policy="continue")
    estimator = ESTIMATORS[settings.estimation.estimator]
    if estimator is FILTER_VARIANCE:  # it does not see that a cloud collapses
        estimator = TWO_CLOUDS if settings.estimation.moves else SQUARED_ERROR
    polishing = replace(
        counting,
        draws=_POLISH_DRAWS // estimator.filters,
        estimation=replace(settings.estimation, estimator=estimator.name),
    )
    racing = racing_of(job, _RACE_DRAWS)
    return NamedSearch(
        section.name, optimiser, settings, section.polish, polishing, racing, additive,
        job.criterion,
    )  # fmt: skip


def racing_of(job: Job, draws: int) -> Settings:
    """The settings of a race: the job's own filter, with so many draws in the first round."""
    draws = max(job.criterion.scenario_count * draws, job.criterion.fewest)
    return Settings(draws, True, "continue", deciding_of(job))


def deciding_of(job: Job) -> Estimation:
    """The estimation of the job's criterion by its own filter."""
    own, aspects = comparing_of(job), job.criterion.aspects
    return aspects[0].estimation(own) if aspects else own


def comparing_of(job: Job) -> Estimation:
    """The estimation of the comparison: the squared error of the job's own filter."""
    own = job.filter
    return Estimation(
        own.compared_particles, own.resampling, threshold=own.threshold, proposal=own.proposal,
        steps_a_particle=own.steps_a_particle,
    )  # fmt: skip


def check_memory(job: Job, section: SearchSection, draws: int) -> None:
    """Raise `JobError` if a generation of a search does not fit into this machine's memory."""
    for key, sets in _SETS.items():
        count = section.settings.get(key, 0)
        wanted = count * sets * (_BYTES_A_SET + _BYTES_A_DRAW * draws)
        present = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if wanted > present:
            raise JobError(
                f"search.{section.name}.{key} = {count} on {draws:,} draws each takes about "
                f"{wanted / 1e9:.3g} GB of memory, and this machine has {present / 1e9:.3g} GB: "
                f"take at most {present * count // wanted:,} ({job.path})"
            )
