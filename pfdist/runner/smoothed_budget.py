"""Plans of a smoothed estimate for each number of a budget: races and exchanges after the search.

The programme of gaps has errors that are too low, so its best plan of a number may be worse than
the evenly spaced set, or than the plan of a smaller number with any further measurement.
"""

from collections.abc import Generator, Iterator
from itertools import pairwise, product

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.opponent import best_evenly_spaced
from pfdist.runner.search_phase import run_search

_MOST_EXCHANGES = 5000  # sets with exact errors that are looked at together
_ADDED = 3  # gaps in whose middle a measurement is added to a smaller plan


def budget_of_smoothed(
    session: RunSession, given: dict[str, Times], tried: dict[str, int]
) -> Generator[WorkBatch, None, dict[str, Evaluation]]:
    """The plan of each number, after a race with its evenly spaced sets and larger smaller plans.

    It notes these evenly spaced sets, too.
    """
    built, (search,) = session.built, session.built.searches
    found = yield from run_search(session, search, next(iter(given.values())))
    plans, before = built.study.names(search.name), Times()
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
        if plan in found and built.evaluator.exact:
            found[plan] = _exchanged(session, feasible, found[plan])
        before = found[plan].measurement_times if plan in found else Times()
    return found


def _exchanged(session: RunSession, feasible: Feasible, best: Evaluation) -> Evaluation:
    """The set after exchanges of one measurement each, by exact errors, until none is better."""
    built, criterion = session.built, session.built.job.criterion
    while len(best.measurement_times) * len(feasible.allowed) <= _MOST_EXCHANGES:
        times = {*best.measurement_times}
        moved = (
            tuple(sorted(times - {out} | {point}))
            for out, point in product(times, feasible.allowed)
            if point not in times
        )
        sets = [*filter(feasible.accepts, moved)]
        errors = built.evaluator.expected_mse(sets, criterion=criterion) if sets else None
        if errors is None:
            break
        instants = len(sets) * (feasible.horizon + 1)
        session.count_exact(built.searches[0].name, "search", instants)
        least = int(np.argmin(errors))
        if not errors[least] < best.expected_mse * (1 - 1e-12):
            break
        best = Evaluation.exactly(sets[least], float(errors[least]), criterion)
    return best


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
