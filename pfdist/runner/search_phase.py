"""One search: its optimiser, exchanges that polish what it found, and a race between what is left.

Each phase is on draws of its own key; the race's winner is compared.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pfdist.evaluation import (
    SEARCH,
    SHORTLIST,
    Evaluation,
    SearchEvaluation,
    ShortlistEvaluation,
)
from pfdist.measurement_times import Times
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.phase import Phase, run_phase
from pfdist.runner.progress import Progress, Report
from pfdist.runner.searches import NamedSearch
from pfdist.search import Exchange, Race
from pfdist.search.base import FINALISTS

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


def run_search(
    built: Built, search: NamedSearch, collector: Collector, progress: Progress, report: Report
) -> dict[str, Winner]:
    """Run a search to its end and let what it has found race, replaying what the store holds.

    Parameters
    ----------
    built : Built
    search : NamedSearch
    collector : Collector
    progress : Progress
        How far the run was before this search.
    report : callable

    Returns
    -------
    dict of str to Winner
        By the name under which it is compared: one, or one for each number of measurements. Empty
        where every set that it, or its race, ended with had a degenerate draw.

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """

    def run(phase: Phase[E]) -> Sequence[E]:
        nonlocal progress
        found = run_phase(phase, collector, progress, report)
        progress = replace(progress, done=progress.done + phase.steps())
        return [one for one in found if np.isfinite(one.cost)]

    found = run(_searching(built, search))
    if built.numbers:  # nothing is to be decided between
        return {
            built.named(search.name, len(one.measurement_times)): Winner(one.measurement_times, one)
            for one in sorted(found, key=lambda one: len(one.measurement_times))
        }
    if found and search.polishing:
        polished = run(_polishing(built, search, found[0].measurement_times))
        found = [*polished[: FINALISTS - _UNPOLISHED], *found[:_UNPOLISHED]]
    believed: dict[Times, SearchEvaluation] = {}
    for one in found:  # of a set that was found twice, what its polishing has seen
        believed.setdefault(one.measurement_times, one)
    best = list(believed)
    if len(believed) > 1:
        best = [one.measurement_times for one in run(_racing(built, search, tuple(believed)))]
    return {search.name: Winner(best[0], believed[best[0]])} if best else {}


def steps(built: Built, search: NamedSearch) -> float:
    """About how many particle-steps a search takes, with all that follows it."""
    start = built.job.problem.feasible.regular()
    phases = [_searching(built, search)]
    if search.polishing:
        phases.append(_polishing(built, search, start))
    return sum(phase.steps() for phase in phases)


def _searching(built: Built, search: NamedSearch) -> Phase[SearchEvaluation]:
    return Phase(search.name, search.optimiser, SEARCH, search.settings, built)


def _polishing(built: Built, search: NamedSearch, start: Times) -> Phase[SearchEvaluation]:
    """Exchanges, on draws of their own: those of the search flatter what it has found."""
    feasible, settings = built.job.problem.feasible, search.polishing or search.settings
    reach = math.ceil(_REACH * (feasible.horizon + 1) / len(start))
    exchange = Exchange(feasible, settings.draws, start, reach)
    return Phase(search.polish, exchange, SEARCH, settings, built)


def _racing(
    built: Built, search: NamedSearch, sets: tuple[Times, ...]
) -> Phase[ShortlistEvaluation]:
    race = Race(sets, search.racing.draws)
    return Phase(search.shortlist, race, SHORTLIST, search.racing, built)
