"""A search: its optimiser, exchanges that polish the best set, and a race between the finalists.

Each phase has separate draws. The set that the exchanges prefer is compared with the reference,
unless the race contradicts; without exchanges it is the winner of the race. A search may estimate
errors by the variance of the particles, which is tiny if these collapse onto a wrong state. So
exchanges judge by the squared error, or by two clouds, whose distance then grows. The race judges
by the squared error.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.criterion import MEAN
from pfdist.filters.estimate import Evaluation
from pfdist.kernels.estimators import FILTER_VARIANCE, TWO_CLOUDS
from pfdist.problem.feasible import Feasible
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.phase import Phase, run_phase
from pfdist.runner.progress import heard
from pfdist.runner.searches import NamedSearch, polish_of
from pfdist.search import Exchange, Race
from pfdist.search.exchange import FEWEST

_POLISHED, _UNPOLISHED = 3, 1  # polished sets in the race, and sets of the search itself
_CONTRADICTED = 2.0  # standard errors
_FEW_SETS, _KEPT = 5000, 12  # sets that may all be looked at; of these, the last that race
_FEWEST_OF_ALL = 8  # draws of the first round
_REACH = 2.5  # mean gaps by which an exchange that polishes may move a time
MOST_STEPS = 2e11  # particle-steps of exchanges: minutes of a core. They grow as the horizon cubed
TOO_LONG = "search {}: exchanges would take too long and are skipped"


@dataclass(frozen=True)
class _Found:
    """Finalists of a search, the best first, and whether the best were polished."""

    finalists: list[Evaluation]
    polished: bool

    @property
    def believed(self) -> dict[Times, Evaluation]:
        """The search's evaluation of each set; for a polished set, that of the exchanges."""
        believed: dict[Times, Evaluation] = {}
        for evaluation in self.finalists:
            believed.setdefault(evaluation.measurement_times, evaluation)
        return believed


def _found(
    session: RunSession, search: NamedSearch, others: tuple[Times, ...]
) -> Generator[WorkBatch, None, _Found]:
    """The finalists of a search, of which the best are polished, or of others that are better."""
    finalists = yield from _finalists(session, _searching(session.built, search))
    polishes = search.is_polished and not is_too_long(session.built, search)
    race = _race_of_all(session.built, search) if finalists else None
    if race is not None:  # nothing is left to exchange
        every = yield from _finalists(session, race)
        finalists = [*every[:_POLISHED], *finalists[:_UNPOLISHED]]
    elif finalists and search.is_polished and not polishes:
        heard(session.say, TOO_LONG.format(search.name))
    elif finalists and polishes:
        start, ends = finalists[0].measurement_times, list[Evaluation]()
        for name in search.polishes:
            phase = polishing(session.built, search, start, name, others=others)
            polished = yield from _finalists(session, phase)
            start = polished[0].measurement_times if polished else start
            ends = [*polished[:_POLISHED], *ends[:1]]
        finalists = [*ends, *finalists[:_UNPOLISHED]]
    # Whichever set wins, its error in the search is that of the job's criterion. Errors of draws do
    # not give that of instants; then the race gives it.
    canonical = session.built.feasible.canonical
    judged_alike = [
        replace(
            each.judged_by(session.built.job.criterion),
            measurement_times=canonical(each.measurement_times),
        )
        for each in finalists
    ]
    return _Found(judged_alike, polishes or race is not None)


def _finalists(session: RunSession, phase: Phase) -> Generator[WorkBatch, None, list[Evaluation]]:
    """Finalists of a phase whose error is finite: no degenerate draw has killed them."""
    finalists = yield from run_phase(phase, session)
    return [evaluation for evaluation in finalists if np.isfinite(evaluation.expected_mse)]


def _uncontradicted(ranked: Sequence[Times], raced: Sequence[Evaluation]) -> list[Evaluation]:
    """The sets that raced, the winner first.

    Exchanges have seen the best set of the search on many draws. So this set wins, unless the race
    finds it clearly worse than its own winner.
    """
    if not raced:
        return []
    order, own = list(raced), {evaluation.measurement_times: evaluation for evaluation in raced}
    best = next((own[times] for times in ranked if times in own), order[0])
    if best.difference(order[0]).is_positive(_CONTRADICTED):
        return order
    return [best, *(evaluation for evaluation in order if evaluation is not best)]


def run_search(
    session: RunSession, search: NamedSearch, rivals: Sequence[Times]
) -> Generator[WorkBatch, None, dict[str, Evaluation]]:
    """The search's own evaluation of each compared set, by name, on draws that chose the set.

    Rivals, the best opponent and the linearized design, race with a polished set, which is then not
    clearly worse. Empty if every set at the end of the search or of the race has an infinite error.
    """
    built, reporter = session.built, session.reporter
    start, total = reporter.progress.done, reporter.progress.total
    joining = [*filter(built.feasible.accepts, rivals)] * search.is_polished
    found = yield from _found(session, search, tuple(t for t in joining if t in rivals[1:]))
    believed, raced = found.believed, None
    joining *= bool(believed)
    if sets := built.study.racing(dict.fromkeys((*believed, *joining))):
        raced = yield from _finalists(session, _racing(built, search, sets))
    ranked = list(believed)
    if raced is not None:
        order = _uncontradicted(ranked, raced) if found.polished else raced
        ranked = [evaluation.measurement_times for evaluation in order]
    # Searches may end sooner or later than foreseen: progress goes on from the forecast, which has
    # grown where they ended later.
    foreseen = search_steps(built, search, usual=True)
    reporter.note(done=start + foreseen + reporter.progress.total - total)
    known = {t for t, each in believed.items() if math.isfinite(each.expected_mse)}
    believed |= {t: each for each in raced or () if (t := each.measurement_times) not in known}
    return {
        name: believed[times] for name, times in built.study.winners(search.name, ranked).items()
    }


def exchanged(
    session: RunSession, search: NamedSearch, best: Evaluation, name: str, feasible: Feasible
) -> Generator[WorkBatch, None, Evaluation]:
    """The best of some feasible sets of this name, after exchanges that begin at another one."""
    phase = polishing(session.built, search, best.measurement_times, polish_of(name), feasible)
    polished = yield from _finalists(session, phase)
    canonical = feasible.canonical
    return next(
        (replace(each, measurement_times=canonical(each.measurement_times)) for each in polished),
        best,
    )


def search_steps(built: Built, search: NamedSearch, usual: bool = False) -> float:
    """Approximate particle-steps of a search and the phases after it; see `Phase.steps`."""
    start = built.job.problem.feasible.regular()
    phases, race = [_searching(built, search)], _race_of_all(built, search)
    if search.is_polished:
        if race is not None:
            phases.append(race)
        elif not is_too_long(built, search):
            phases += [polishing(built, search, start, name) for name in search.polishes]
        phases.append(_racing(built, search, (start,) * (_POLISHED + _UNPOLISHED + 1)))
    return sum(phase.steps(usual) for phase in phases)


def _race_of_all(built: Built, search: NamedSearch) -> Phase | None:
    """A race between all feasible sets, by the estimates of the search; None if they are many.

    It takes as much work as the search, at most. Criteria of draws need more.
    """
    may = search.is_polished and search.criterion.additive and not built.job.amounts
    if not may or built.evaluator.exact or not 1 < built.feasible.size <= _FEW_SETS:
        return None
    own = search.settings.estimation
    if own.estimator == FILTER_VARIANCE.name:  # it does not see that a cloud collapses
        own = replace(own, estimator=TWO_CLOUDS.name)
    settings, until = replace(search.polishing, estimation=own), search.settings.draws

    def race(draws: int) -> Phase:
        sets, of_race = tuple(built.feasible.every()), replace(settings, draws=draws)
        among = Race(sets, draws, _KEPT, until, tested_from=until)
        return Phase(search.every, among, "search", of_race, built, search.criterion)

    share = _searching(built, search).steps(usual=True) / race(FEWEST).steps()
    draws = min(FEWEST, int(share * FEWEST))
    return race(draws) if draws >= _FEWEST_OF_ALL else None


def _searching(built: Built, search: NamedSearch) -> Phase:
    criterion = search.criterion if search.criterion.additive or not search.additive else MEAN
    settings = search.settings
    if criterion.by_instant:  # sums over blocks of draws are of common draws, and kill no set
        settings = replace(settings, common_noise=True, degenerate_policy="continue")
    return Phase(search.name, search.optimiser, "search", settings, built, criterion)


def polishing(
    built: Built,
    search: NamedSearch,
    start: Times,
    name: str,
    feasible: Feasible | None = None,
    others: tuple[Times, ...] = (),
) -> Phase:
    """Exchanges on draws of their own: the draws of the search favour the set that it found.

    Exchanges for the worst scenario judge each scenario by its own draws. They may end in a local
    optimum, so they begin at the best mean, which races with their result. A number of a budget
    has its own feasible sets, and exact errors of the farthest exchanges, too. Other sets, such as
    the linearized design, may take the place of the first one.
    """
    own, settings = feasible or built.feasible, search.polishing
    far = feasible is not None and built.evaluator.exact
    reach = None if far else math.ceil(_REACH * (own.horizon + 1) / max(1, len(start)))
    criterion = MEAN if name in search.polishes[:-1] else search.criterion
    if not criterion.additive:  # few particles may have another worst scenario
        draws = criterion.scenario_count * settings.draws
        settings = replace(settings, draws=draws, estimation=built.comparing)
    fewest = max(criterion.scenario_count * FEWEST, criterion.fewest)
    exchange = Exchange(own, settings.draws, start, reach, fewest=fewest, others=others)
    return Phase(name, exchange, "search", settings, built, criterion)


def is_too_long(built: Built, search: NamedSearch) -> bool:
    """Whether the exchanges that polish would take too long; a criterion may need them."""
    phase = polishing(built, search, built.job.problem.feasible.regular(), search.polish)
    return search.criterion.additive and phase.steps() > MOST_STEPS


def _racing(built: Built, search: NamedSearch, sets: tuple[Times, ...]) -> Phase:
    race = Race(sets, search.racing.draws)
    return Phase(search.shortlist, race, "shortlist", search.racing, built, search.criterion)
