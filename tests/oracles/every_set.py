"""Feasible sets of measurement times, written down as the README says them and tried one by one."""

from collections.abc import Sequence
from itertools import combinations, pairwise


def every_set(
    horizon: int,
    measurement_budget: int | None = None,
    forbidden: Sequence[int] = (),
    required: Sequence[int] = (),
    minimum_spacing: int = 1,
    price: Sequence[int] | None = None,
    total_price: int | None = None,
    smaller: bool = False,
) -> list[tuple[int, ...]]:
    """All feasible sets, in the order of words in a dictionary."""
    instants = range(horizon + 1)
    fitting = [
        times
        for number in range(horizon + 2)
        for times in combinations(instants, number)
        if not {*times} & {*forbidden}
        and {*required} <= {*times}
        and all(b - a >= minimum_spacing for a, b in pairwise(times))
    ]
    if price is None or total_price is None:
        return sorted(times for times in fitting if len(times) == measurement_budget)
    paid = {frozenset(times) for times in fitting if sum(price[t] for t in times) <= total_price}
    if smaller:  # the empty set is one of them, but money must pay for a measurement
        return sorted(tuple(sorted(times)) for times in paid) if any(paid) else []
    maximal = [s for s in paid if s and not any(s | {t} in paid for t in instants if t not in s)]
    return sorted(tuple(sorted(times)) for times in maximal)
