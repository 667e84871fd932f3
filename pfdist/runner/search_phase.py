"""One search: its optimiser, exchanges that polish what it found, and a race between what is left.

Each phase is on draws of its own key; the race's winner is compared. A search by another estimator
than the squared error is probed before the race. If its estimator cannot be believed, all that it
found is left aside, and the search is done again by the squared error, under names of its own.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from pfdist.evaluation.estimate import (
    PROBE,
    SEARCH,
    SHORTLIST,
    Evaluation,
    ProbeEvaluation,
    SearchEvaluation,
    ShortlistEvaluation,
)
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.phase import Phase, run_phase
from pfdist.runner.progress import Progress, Report
from pfdist.runner.searches import NamedSearch
from pfdist.search import Candidate, Exchange, Probe, Race
from pfdist.search.base import FINALISTS
from pfdist.search.probe import PROBE_DRAWS
from pfdist.search.trust import (
    failed_probe,
    judged,
    misordered,
    unchecked_probe,
    wrong_order,
)
from pfdist.times.measurement_times import Times

_UNPOLISHED = 2  # that race all the same
_REACH = 2.5  # mean gaps: how far an exchange that polishes moves a time

E = TypeVar("E", bound=Evaluation)


@dataclass(frozen=True)
class Winner:
    """What a search returns: times, and what the search believed of them.

    Parameters
    ----------
    measurement_times : tuple of int
    believed : SearchEvaluation
        On the draws that chose them.
    """

    measurement_times: Times
    believed: SearchEvaluation


@dataclass(frozen=True)
class SearchEnd:
    """How a search ended.

    Parameters
    ----------
    winners : dict of str to Winner
        By the name under which it is compared: one, or one for each number of measurements. Empty
        where every set that the search, or its race, ended with had a degenerate draw.
    distrust : str or None
        Why the estimator was not believed, and the search was done again by the squared error.
    """

    winners: dict[str, Winner]
    distrust: str | None = None


@dataclass(frozen=True)
class _Attempt:
    """What a search has found with one estimator: sets, the best first, and those that led it."""

    found: list[SearchEvaluation]
    leaders: list[SearchEvaluation]

    @property
    def believed(self) -> dict[Times, SearchEvaluation]:
        """The evaluation of each set: where it was found twice, that of its polishing."""
        believed: dict[Times, SearchEvaluation] = {}
        for evaluation in self.found:
            believed.setdefault(evaluation.measurement_times, evaluation)
        return believed


@dataclass
class _Runner:
    """Runs phases one after another, and keeps how far the run is."""

    built: Built
    collector: Collector
    progress: Progress
    report: Report
    say: Callable[[str], Any]

    def run(self, phase: Phase[E]) -> list[E]:
        """Give what a phase ended with, without the sets that degenerate draws have killed."""
        found = run_phase(phase, self.collector, self.progress, self.report)
        self.progress = replace(self.progress, done=self.progress.done + phase.steps())
        return [evaluation for evaluation in found if np.isfinite(evaluation.cost)]

    def attempt(self, search: NamedSearch) -> _Attempt:
        """Search, and polish what was found."""
        searching = _searching(self.built, search)
        found, leaders = self.run(searching), searching.leaders
        if found and search.polishing:
            polished = self.run(_polishing(self.built, search, found[0].measurement_times))
            leaders = [*leaders, *polished[:1]]
            found = [*polished[: FINALISTS - _UNPOLISHED], *found[:_UNPOLISHED]]
        return _Attempt(found, leaders)

    def distrust(self, search: NamedSearch, attempt: _Attempt) -> str | None:
        """Say on which probe the estimator of a search failed, if on any."""
        led = [*attempt.leaders, *(attempt.found if self.built.numbers else ())]
        sought = dict.fromkeys(
            Candidate(evaluation.measurement_times, evaluation.end) for evaluation in led
        )
        phase = _probing(self.built, search, tuple(sought))
        probe = run_phase(phase, self.collector, self.progress, self.report)
        self.progress = replace(self.progress, done=self.progress.done + phase.steps())
        if probe and not judged(*probe).known:
            by = f"{search.settings.estimation.estimator} could not be checked"
            self.say(f"search {search.name}: {by}: {unchecked_probe(*probe)}")
            return None
        return failed_probe(*probe) if probe else None

    def race(self, search: NamedSearch, attempt: _Attempt) -> list[ShortlistEvaluation]:
        """Let the sets that were found race, if there are several; give all, the winner first."""
        sets = tuple(attempt.believed)
        if self.built.numbers or len(sets) < 2:
            return []
        return self.run(_racing(self.built, search, sets))

    def winners(
        self, name: str, attempt: _Attempt, raced: Sequence[ShortlistEvaluation]
    ) -> dict[str, Winner]:
        """Give what is to be compared: for each number of measurements, or what won the race."""
        believed = attempt.believed
        if self.built.numbers:
            return {
                self.built.named(name, number): Winner(times, believed[times])
                for number, times in sorted((len(times), times) for times in believed)
            }
        sets = (
            [evaluation.measurement_times for evaluation in raced]
            if len(believed) > 1
            else list(believed)
        )
        return {name: Winner(sets[0], believed[sets[0]])} if sets else {}


def run_search(
    built: Built,
    search: NamedSearch,
    collector: Collector,
    progress: Progress,
    report: Report,
    say: Callable[[str], Any],
) -> SearchEnd:
    """Run a search to its end and let what it has found race, replaying what the store holds.

    Parameters
    ----------
    built : Built
    search : NamedSearch
    collector : Collector
    progress : Progress
        How far the run was before this search.
    report : callable
    say : callable
        Told, in a line, why the search's estimator is not believed.

    Returns
    -------
    SearchEnd

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    runner = _Runner(built, collector, progress, report, say)
    attempt = runner.attempt(search)
    again = search.again
    distrust = runner.distrust(search, attempt) if again else None
    if again is None or distrust is None:
        raced = runner.race(search, attempt)
        wrong = misordered(attempt.believed, raced) if again else None
        if again is None or wrong is None:
            return SearchEnd(runner.winners(search.name, attempt, raced))
        distrust = wrong_order(*wrong)
    by = search.settings.estimation
    distrust = f"{by.estimator} of {by.particles} particles cannot be believed: {distrust}"
    say(f"search {search.name}: {distrust}; searching again by the squared error")
    total = runner.progress.total + steps(built, again)
    runner.progress = replace(runner.progress, total=total)
    attempt = runner.attempt(again)
    raced = runner.race(again, attempt)
    return SearchEnd(runner.winners(search.name, attempt, raced), distrust)


def steps(built: Built, search: NamedSearch) -> float:
    """About how many particle-steps a search takes, with all that follows it.

    That it may be done again by the squared error is not foreseen.
    """
    start = built.job.problem.feasible.regular()
    phases: list[Phase[Any]] = [_searching(built, search)]
    if search.polishing:
        phases.append(_polishing(built, search, start))
        phases.append(_racing(built, search, (start,) * FINALISTS))
    if search.again:
        phases.append(_probing(built, search, ()))
    return sum(phase.steps() for phase in phases)


def _searching(built: Built, search: NamedSearch) -> Phase[SearchEvaluation]:
    return Phase(search.name, search.optimiser, SEARCH, search.settings, built)


def _polishing(built: Built, search: NamedSearch, start: Times) -> Phase[SearchEvaluation]:
    """Exchanges, on draws of their own: those of the search flatter what it has found."""
    feasible, settings = built.job.problem.feasible, search.polishing or search.settings
    reach = math.ceil(_REACH * (feasible.horizon + 1) / len(start))
    exchange = Exchange(feasible, settings.draws, start, reach)
    return Phase(search.polish, exchange, SEARCH, settings, built)


def _probing(
    built: Built, search: NamedSearch, sought: tuple[Candidate, ...]
) -> Phase[ProbeEvaluation]:
    settings = replace(search.settings, draws=PROBE_DRAWS, common_noise=True)
    dearer = built.comparing.steps_an_instant / settings.estimation.steps_an_instant
    probe = Probe(built.job.problem.feasible, sought, dearer)
    return Phase(search.probe, probe, PROBE, settings, built)


def _racing(
    built: Built, search: NamedSearch, sets: tuple[Times, ...]
) -> Phase[ShortlistEvaluation]:
    race = Race(sets, search.racing.draws)
    return Phase(search.shortlist, race, SHORTLIST, search.racing, built)
