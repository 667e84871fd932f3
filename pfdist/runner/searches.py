"""From a job to its sets and searches: what a run seeks and compares, and by which optimisers.

The axis of a `Study` has one number, unless the job has a section [budget].
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import psutil

from pfdist.common.measurement_times import Times
from pfdist.errors import JobError
from pfdist.filters.engines import is_exact
from pfdist.filters.work import BLOCK, Estimation
from pfdist.kernels.estimators import OWN_VARIANCE, SQUARED_ERROR
from pfdist.problem.feasible import Feasible
from pfdist.problem.job import Job
from pfdist.problem.methods import METHODS
from pfdist.problem.online_section import Online
from pfdist.problem.search_section import AUTO, EvaluationSettings, SearchSection
from pfdist.problem.set_key import SetKey
from pfdist.runner.planning import Planning
from pfdist.search import Optimiser, StateSpaceRelaxation
from pfdist.search.relaxation import relaxation_within
from pfdist.search.state_space_relaxation import MOST_CELLS


@dataclass(frozen=True)
class Study:
    """The sets that a run seeks and compares."""

    job: Job
    feasible: Feasible

    @cached_property
    def axis(self) -> dict[int, Feasible]:
        """Feasible sets by number of measurements, the smallest number first.

        If measurements have prices, the number is that of regular times.
        """
        if self.job.budget is None:
            return {self.feasible.measurements: self.feasible}
        return {number: self.job.feasible(number) for number in self.job.budget.each}

    @property
    def purpose(self) -> str:
        """The purpose of the comparison's draws."""
        return "comparison" if self.job.budget is None else "budget"

    @property
    def references(self) -> dict[str, Times]:
        """Times with which the sets of each number of measurements are compared, by name."""
        names = self.names(self.job.comparison.reference_name)
        return {name: self.unsearched[name] for name in names}

    @cached_property
    def unsearched(self) -> dict[str, Times]:
        """The references, then the sets that comparison.sets names."""
        return {
            self._name(name, number): feasible.regular() if times is None else times
            for name, times in self.job.given_sets.items()
            for number, feasible in self.axis.items()
        }

    @property
    def widest(self) -> Feasible:
        """The feasible sets of the largest number of measurements."""
        return self.axis[max(self.axis)]

    @property
    def usual(self) -> int:
        """The geometric mean of the least and the largest number of measurements."""
        return round(math.sqrt(min(self.axis) * max(self.axis)))

    def proved(self, sets: dict[str, Times]) -> dict[str, Times]:
        """The compared sets whose gaps are proved; a budget curve leaves out the references."""
        if self.job.budget is None:
            return sets
        return {name: times for name, times in sets.items() if name not in self.references}

    def names(self, search: str) -> list[str]:
        """Names of the sets that a search finds, one for each number of measurements."""
        return [self._name(search, number) for number in self.axis]

    def optimiser(self, section: SearchSection, draws: int) -> Optimiser:
        """Optimiser of a section [[search]] whose evaluations have so many draws.

        For a budget curve, state-space relaxation finds the sets of all numbers at once. Raises
        `JobError` if the optimiser cannot search this problem.
        """
        if self.job.budget is not None:
            start, sought = relaxation_within(self.widest, self.usual, MOST_CELLS), (*self.axis,)
            return StateSpaceRelaxation(
                self.widest, draws, sought=sought, start=start, **section.settings
            )
        try:
            made: Optimiser = METHODS[section.method].make(self.widest, draws, section.settings)
        except JobError as error:
            raise JobError(f"search.{section.name}: {error} ({self.job.path})") from error
        return made

    def racing(self, finalists: Iterable[Times]) -> tuple[Times, ...]:
        """The sets that race on fresh draws: all, if there are more of them than are sought."""
        sets = tuple(finalists)
        return sets if len(sets) > len(self.axis) else ()

    def winners(self, search: str, ranked: Sequence[Times]) -> dict[str, Times]:
        """The best set of each number of measurements, by name, from sets ranked best first."""
        best = dict[str, Times]()
        for times in ranked:
            best.setdefault(self._name(search, len(times)), times)
        return {name: best[name] for name in self.names(search) if name in best}

    def _name(self, name: str, number: int) -> str:
        """Name of a set of so many measurements; a budget curve adds the number."""
        if self.job.budget is None:
            return SetKey(name).column
        digits = len(str(self.job.problem.feasible.horizon + 1))
        return SetKey(name, f"{number:0{digits}}").column


_POLISH_DRAWS = 4096  # at most
_RACE_DRAWS = 1000  # of the first round
_NOTHING_OWN = EvaluationSettings()
_BYTES_A_DRAW = 32  # index and MSE of a draw, in a worker's answer and in the table
_BYTES_A_SET = 1000  # the times, the evaluation and the row of a set
_SETS = {"population": 1, "chains": 2}
"""Settings that give the number of sets in a generation, with the sets of each unit."""


@dataclass(frozen=True)
class Settings:
    """How sets of times are evaluated."""

    draws: int  # of an evaluation
    common_noise: bool  # whether all sets share draws and filter noise
    degenerate_policy: str  # "continue" or "kill"
    estimation: Estimation

    @classmethod
    def from_job(
        cls, job: Job, own: EvaluationSettings = _NOTHING_OWN, guide: str = AUTO
    ) -> "Settings":
        """Settings of the job, replaced where a search has its own.

        `guide` is the estimator that "auto" stands for.
        """
        estimator = own.estimator or job.evaluation.estimator
        return cls(
            own.draws or job.evaluation.draws,
            (own.noise or job.evaluation.noise) == "common",
            own.degenerate_draws or job.evaluation.degenerate_draws,
            Estimation(
                own.particles_of(job.filter.particles),
                own.resampling or job.filter.resampling,
                guide if estimator == AUTO else estimator,
                job.filter.threshold,
                dtype=job.filter.dtype,
            ),
        )


@dataclass(frozen=True)
class NamedSearch:
    """An optimiser with its name in the tables and the settings of its evaluations."""

    name: str
    optimiser: Optimiser
    settings: Settings
    polishing: Settings | None  # of exchanges that polish the best set; None for no exchanges
    racing: Settings  # of the race, which the job's own filter decides by the squared error
    additive: bool  # whether the optimiser adds errors of instants; then errors must be means
    is_worst: bool  # whether the worst scenario decides
    # The same search by the squared error, with the particles of the job's own filter. It follows
    # if the estimator cannot be trusted. None if this search uses it.
    again: "NamedSearch | None" = None

    @property
    def probe(self) -> str:
        """Name of the phase that checks the estimator."""
        return f"{self.name}.probe"

    @property
    def polish(self) -> str:
        """Name of the phase of exchanges that polish the best set."""
        return f"{self.name}.polish"

    @property
    def polishes(self) -> tuple[str, ...]:
        """Names of all phases of exchanges; the worst scenario follows the mean."""
        return (f"{self.name}.polish_mean", self.polish) if self.is_worst else (self.polish,)

    @property
    def shortlist(self) -> str:
        """Name of the phase that decides between the sets at the end of the search."""
        return f"{self.name}.shortlist"

    @property
    def phases(self) -> tuple[str, ...]:
        """Names of all phases that the search may have."""
        own = self.name, *self.polishes, self.shortlist
        return own if self.again is None else (*own, self.probe, *self.again.phases)

    @property
    def all_settings(self) -> tuple[Settings, ...]:
        """Settings of all phases."""
        own = (self.settings, self.racing, *((self.polishing,) if self.polishing else ()))
        return own if self.again is None else (*own, *self.again.all_settings)


def named_search(study: Study, job: Job, section: SearchSection, guide: str) -> NamedSearch:
    """The optimiser of a section [[search]], with the settings of its evaluations.

    `guide` is the estimator that "auto" stands for. Raises `JobError` if the optimiser cannot
    search this problem.
    """
    settings = Settings.from_job(job, section.evaluation, guide)
    if not METHODS[section.method].online:  # it asks for errors of instants, block by block
        settings = replace(settings, draws=-(-settings.draws // BLOCK) * BLOCK)
    check_memory(job, section, settings.draws)
    optimiser = study.optimiser(section, settings.draws)
    search = _with_settings(job, section, section.name, optimiser, settings)
    estimation = settings.estimation
    # Neither the squared error nor an exact engine needs to be checked.
    if estimation.estimator == SQUARED_ERROR.name or is_exact(job.filter.engine):
        return search
    estimation = replace(estimation, estimator=SQUARED_ERROR.name, particles=job.filter.particles)
    settings = replace(settings, estimation=estimation)
    again = _with_settings(job, section, f"{section.name}.again", optimiser, settings)
    return replace(search, again=again)


def comparing_of(job: Job) -> Estimation:
    """The estimation of the comparison: the squared error of the job's own filter."""
    own = job.filter
    return Estimation(own.particles, own.resampling, threshold=own.threshold, dtype=own.dtype)


def _with_settings(
    job: Job, section: SearchSection, name: str, optimiser: Optimiser, settings: Settings
) -> NamedSearch:
    apart = job.judged_apart
    # Only the method itself may kill sets, as the paper says.
    counting = replace(settings, common_noise=True, degenerate_policy="continue")
    polishing = replace(counting, draws=_POLISH_DRAWS)
    if settings.estimation.estimator == OWN_VARIANCE.name:  # it may guide a search, not decide
        believed = replace(settings.estimation, estimator=SQUARED_ERROR.name)
        polishing = replace(polishing, estimation=believed)
    racing = replace(counting, draws=apart * _RACE_DRAWS, estimation=comparing_of(job))
    additive = METHODS[section.method].additive
    polishing_or_none = polishing if section.polish else None
    return NamedSearch(name, optimiser, settings, polishing_or_none, racing, additive, apart > 1)


def check_memory(job: Job, section: SearchSection, draws: int) -> None:
    """Raise a `JobError` if a generation of a search does not fit into this machine's memory."""
    for key, sets in _SETS.items():
        count = section.settings.get(key, 0)
        wanted = count * sets * (_BYTES_A_SET + _BYTES_A_DRAW * draws)
        present = psutil.virtual_memory().total
        if wanted > present:
            raise JobError(
                f"search.{section.name}.{key} = {count} on {draws:,} draws each takes about "
                f"{wanted / 1e9:.3g} GB of memory, and this machine has {present / 1e9:.3g} GB: "
                f"take at most {present * count // wanted:,} ({job.path})"
            )


def planning_of(job: Job, cheapest: str) -> Planning:
    """How the remaining measurements are planned, by the section [online] or its defaults.

    `cheapest` is the estimator that "auto" stands for.
    """
    online = job.online or Online()
    settings = Settings.from_job(job, online.search.evaluation, cheapest)
    return Planning(online.search, settings.draws, online.judging_draws, settings.estimation)
