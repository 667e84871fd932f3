"""The feasible moves of a single measurement."""

from pfdist.common.measurement_times import Times
from pfdist.problem.constraints import Constraints


def moved(times: Times, t: int, to: int, constraints: Constraints) -> Times | None:
    """The set whose measurement at t is made at another instant; None if that is not allowed.

    A required measurement never moves, and two measurements need two instants.

    >>> apart = Constraints(horizon=9, measurement_budget=3, forbidden=(7,), minimum_spacing=2)
    >>> moved((0, 4, 6), 4, 2, apart), moved((0, 4, 6), 6, 9, apart)
    ((0, 2, 6), (0, 4, 9))
    >>> moved((0, 4, 6), 4, 5, apart), moved((0, 4, 6), 6, 7, apart)
    (None, None)
    """
    others = {*times} - {t}
    if to in others or to not in constraints.optional or t in constraints.required:
        return None
    changed = tuple(sorted(others | {to}))
    return changed if constraints.allows(changed) else None
