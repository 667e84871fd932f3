"""From the sections [[search]] to optimisers, and to how each evaluates."""

from dataclasses import dataclass, replace

from pfdist.errors import JobError
from pfdist.evaluation.engines import KALMAN
from pfdist.evaluation.work import Estimation
from pfdist.job.job import Job
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.runner.memory import check_memory
from pfdist.search import BudgetCurve, SearchOptimiser
from pfdist.search.methods import METHODS
from pfdist.search.section import AUTO, EvaluationSettings, SearchSection

_POLISH_DRAWS = 4096  # at most
_RACE_DRAWS = 1000  # of the first round
_NOTHING_OWN = EvaluationSettings()


@dataclass(frozen=True)
class Settings:
    """How sets of times are evaluated.

    Parameters
    ----------
    draws : int
        K.
    common_noise : bool
        Whether all sets have the same draws and noise.
    degenerate_policy : str
    estimation : Estimation
    """

    draws: int
    common_noise: bool
    degenerate_policy: str
    estimation: Estimation

    @classmethod
    def of(
        cls, job: Job, own: EvaluationSettings = _NOTHING_OWN, cheapest: str = AUTO
    ) -> "Settings":
        """The job's, but for what a search has of its own; `cheapest` stands for "auto"."""
        estimator = own.estimator or job.evaluation.estimator
        return cls(
            own.draws or job.evaluation.draws,
            (own.noise or job.evaluation.noise) == "common",
            job.evaluation.degenerate_draws,
            Estimation(
                own.particles_of(job.filter.particles),
                own.resampling or job.filter.resampling,
                cheapest if estimator == AUTO else estimator,
            ),
        )


@dataclass(frozen=True)
class NamedSearch:
    """An optimiser under its name in the tables, and how it evaluates.

    Parameters
    ----------
    name : str
    optimiser : SearchOptimiser
    settings : Settings
        Of the search.
    polishing : Settings or None
        Of the exchanges that polish the best it has found, if there are to be any.
    racing : Settings
        Of the race between what was found: the squared error of the job's own filter decides.
    again : NamedSearch or None
        The same search by the squared error, with as many particles as the job's own filter has:
        what takes its place if its estimator cannot be believed. None if it has no other estimator.
    """

    name: str
    optimiser: SearchOptimiser
    settings: Settings
    polishing: Settings | None
    racing: Settings
    again: "NamedSearch | None" = None

    @property
    def probe(self) -> str:
        """Name of the phase that decides whether the estimator can be believed."""
        return f"{self.name}.probe"

    @property
    def polish(self) -> str:
        """Name of the phase of exchanges."""
        return f"{self.name}.polish"

    @property
    def shortlist(self) -> str:
        """Name of the phase that decides between what was found."""
        return f"{self.name}.shortlist"

    @property
    def phases(self) -> tuple[str, ...]:
        """Names of all that there may be."""
        own = self.name, self.polish, self.shortlist
        return own if self.again is None else (*own, self.probe, *self.again.phases)

    @property
    def all_settings(self) -> tuple[Settings, ...]:
        """Of all phases."""
        own = self.settings, self.racing  # what polishes estimates as the search
        return own if self.again is None else (*own, *self.again.all_settings)


def _optimiser(job: Job, section: SearchSection, draws: int) -> SearchOptimiser:
    try:
        return METHODS[section.method].make(job.problem.feasible, draws, section.settings)
    except JobError as error:
        raise JobError(f"search.{section.name}: {error} ({job.path})") from error


def named_search(job: Job, section: SearchSection, cheapest: str) -> NamedSearch:
    """Make the optimiser of a section, and find out how it evaluates.

    Parameters
    ----------
    job : Job
    section : SearchSection
    cheapest : str
        The estimator that "auto" stands for.

    Raises
    ------
    JobError
        The optimiser cannot search this problem.
    """
    settings = Settings.of(job, section.evaluation, cheapest)
    check_memory(job, section, settings.draws)
    if job.budget is None:
        optimiser = _optimiser(job, section, settings.draws)
    else:
        most = job.feasible(job.budget.most)
        optimiser = BudgetCurve(most, job.budget.least, **section.settings)
    search = _with_settings(job, section, section.name, optimiser, settings)
    estimation = settings.estimation
    if (
        estimation.estimator == SQUARED_ERROR.name or job.filter.engine == KALMAN.name
    ):  # which is exact
        return search
    estimation = replace(estimation, estimator=SQUARED_ERROR.name, particles=job.filter.particles)
    settings = replace(settings, estimation=estimation)
    again = _with_settings(job, section, f"{section.name}.again", optimiser, settings)
    return replace(search, again=again)


def _with_settings(
    job: Job, section: SearchSection, name: str, optimiser: SearchOptimiser, settings: Settings
) -> NamedSearch:
    own = Estimation(job.filter.particles, job.filter.resampling)
    polishing = replace(settings, draws=_POLISH_DRAWS, common_noise=True)
    racing = replace(settings, draws=_RACE_DRAWS, common_noise=True, estimation=own)
    polishes = section.polish and job.budget is None
    return NamedSearch(name, optimiser, settings, polishing if polishes else None, racing)
