"""Plans of a smoothed estimate for each number of a budget: races and exchanges after the search.

The programme of gaps has errors that are too low, so its best plan of a number may be worse than
the evenly spaced set, or than the plan of a smaller number with any further measurement. The best
of them is where exchanges begin.
"""

from collections.abc import Generator, Iterator
from itertools import pairwise

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.opponent import best_evenly_spaced
from pfdist.runner.phase import Phase
from pfdist.runner.progress import heard
from pfdist.runner.search_phase import MOST_STEPS, TOO_LONG, exchanged, polishing, run_search
from pfdist.runner.searches import polish_of

_MOST_EXACT = 5000  # sets with exact errors that are looked at together
_ADDED = 3  # gaps in whose middle a measurement is added to a smaller plan


def budget_of_smoothed(
    session: RunSession, given: dict[str, Times], tried: dict[str, int]
) -> Generator[WorkBatch, None, dict[str, Evaluation]]:
    """The plan of each number, after a race with its evenly spaced sets and larger smaller plans.

    It notes these evenly spaced sets, too.
    """
    built, (search,) = session.built, session.built.searches
    found = yield from run_search(session, search, [next(iter(given.values()))])
    plans, before = built.study.names(search.name), Times()
    exchanging = _exchanging(built)
    if not exchanging:
        heard(session.say, TOO_LONG.format(search.name))
    for plan, (even, feasible) in zip(plans, built.study.even.items(), strict=True):
        others = {f"{plan}.{k}": times for k, times in enumerate(_larger(built, feasible, before))}
        if plan in found:
            others[plan] = found[plan].measurement_times
        opponent = yield from best_evenly_spaced(session, even, others)
        given[even], tried[even] = opponent.times, opponent.tried
        best = opponent.evaluation
        if best is not None and (
            plan not in found or best.measurement_times != found[plan].measurement_times
        ):
            found[plan] = best
        if plan in found and plan in exchanging:
            found[plan] = yield from exchanged(session, search, found[plan], plan, feasible)
        before = found[plan].measurement_times if plan in found else Times()
    return found


def is_smoothed_budget(built: Built) -> bool:
    """Whether a study has a smoothed estimate, and opponents."""
    return bool(built.evaluator.lag and built.study.even)


def budget_steps(built: Built) -> float:
    """Usual number of particle-steps of the exchanges for all numbers of a smoothed budget."""
    phases = _exchanging(built).values() if is_smoothed_budget(built) else ()
    return sum(phase.steps(usual=True) for phase in phases)


def _exchanging(built: Built) -> dict[str, Phase]:
    """The exchanges of each plan, from regular times; none if all would take too long."""
    (search,), exact = built.searches, built.evaluator.exact
    phases = {
        plan: polishing(built, search, own.regular(), polish_of(plan), own)
        for plan, own in zip(built.study.names(search.name), built.study.each, strict=True)
        if not exact or len(own.regular()) * len(own.allowed) <= _MOST_EXACT
    }
    steps = sum(phase.steps(usual=True) for phase in phases.values())
    return phases if exact or steps <= MOST_STEPS else {}


def _larger(built: Built, feasible: Feasible, times: Times) -> Iterator[Times]:
    """Feasible sets with a measurement more than a smaller plan, and the plan itself."""
    points = feasible.points
    left = [point for point in feasible.allowed if times and point not in times]
    if not built.evaluator.exact:
        ends = (-1, *points.made(times), feasible.horizon + 1)
        gaps = sorted(pairwise(ends), key=lambda gap: gap[0] - gap[1])[:_ADDED]
        middles = [(first + last) / 2 for first, last in gaps]
        left = [min(left, key=lambda p: abs(points.made_at(p) - at)) for at in middles if left]
    larger = (tuple(sorted((*times, point))) for point in left)
    yield from filter(feasible.accepts, (times, *larger))
