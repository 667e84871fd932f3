"""The feasible sets of the measurements that are left, over what is left of the horizon."""

from dataclasses import replace
from functools import partial

from pfdist.common.measurement_times import Times
from pfdist.problem.constraints import Limit
from pfdist.problem.feasible import Feasible
from pfdist.problem.spacing import Spacing


def rest_of(feasible: Feasible, taken: Times, first: int) -> Feasible | None:
    """The feasible sets of what is left after the measurements that were taken.

    `taken` is sorted, and need not be the start of a feasible set. `first` is the first instant
    that may still be measured, and the times of the result count from it. The result is None if no
    measurement is left or fits. If fewer fit than are left, the sets have as many as fit. A
    required time that can no longer be measured is left out.

    >>> rest = rest_of(Feasible(horizon=9, measurement_budget=3, minimum_spacing=3), (4,), 5)
    >>> rest.allowed, rest.total  # 7, 8 and 9 may be measured, and no two of them
    ((2, 3, 4), 1)
    """
    if first > feasible.horizon:
        return None
    start = first * feasible.sensors
    left = range(start, feasible.possible)
    barred = feasible.spacing.near(taken).union(feasible.forbidden)
    limits = list[Limit]()
    for sensor, limit in enumerate(feasible.limits):
        own, spacing = feasible.of_sensor(sensor, taken), limit.spacing
        if spacing is not None:
            barred |= {t * feasible.sensors + sensor for t in spacing.near(own)}
            spacing = Spacing(tuple(t - first for t in spacing.successors[first:]))
        most = None if limit.most is None else max(0, limit.most - len(own))
        limits.append(Limit(most, spacing))
    required = [time for time in feasible.required if time in left and time not in barred]
    make = partial(
        replace,
        feasible,
        horizon=feasible.horizon - first,
        forbidden=tuple(time - start for time in left if time in barred),
        clock=None if feasible.clock is None else feasible.clock.since(first),
        limits=tuple(limits),
    )
    if feasible.price is not None and feasible.total_price is not None:
        money, price = feasible.total_price - feasible.price_of(taken), feasible.price[start:]
        required = required if feasible.price_of(required) <= money else []
        least = min((feasible.price[time] for time in left if time not in barred), default=None)
        if least is None or least > money:
            return None
        return make(
            required=tuple(time - start for time in required), price=price, total_price=money
        )
    number = max(0, feasible.total - len(taken))
    times = tuple(time - start for time in required[:number])
    capacity = make(required=times, measurement_budget=len(times)).capacity(())
    number = min(number, capacity)
    return make(required=times, measurement_budget=number) if number else None
