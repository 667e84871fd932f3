"""How many evenly spaced measurements do as well as other times, on common draws."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import REGULAR
from pfdist.problem.set_key import set_key_of
from pfdist.results.moments import Moments, controlled_mse
from pfdist.results.stored_run import StoredRun, blocks_of, exact_errors

Differences = Mapping[int, Estimate]
"""Expected MSE of evenly spaced times, less that of other times, by the number of the former."""


def sign_of(difference: Estimate) -> int:
    """1 if evenly spaced times are clearly worse, -1 if they are clearly better, else 0.

    The 95 % interval is that of a paired difference; an exact difference has no interval.

    >>> sign_of(Estimate(2.0, 0.5)), sign_of(Estimate(2.0, 1.5)), sign_of(Estimate(-0.1))
    (1, 0, -1)
    """
    low, high = difference.interval()
    return int(low > 0.0) - int(high < 0.0)


def doing_as_well(differences: Differences) -> tuple[list[int], bool]:
    """The numbers of evenly spaced measurements that do as well as other times.

    Returns
    -------
    (list of int, bool)
        The numbers whose error does not differ clearly, and False. If there are none, the two
        numbers between which the error lies, and True; or an empty list if no number reaches it.

    Examples
    --------
    >>> doing_as_well({36: Estimate(0.9, 0.1), 37: Estimate(0.0, 0.1), 38: Estimate(-0.3, 0.1)})
    ([37], False)
    >>> doing_as_well({36: Estimate(0.9, 0.1), 37: Estimate(-0.9, 0.1)})
    ([36, 37], True)
    """
    signs = {number: sign_of(each) for number, each in sorted(differences.items())}
    if as_good := [number for number, sign in signs.items() if sign == 0]:
        return as_good, False
    better = min((number for number, sign in signs.items() if sign < 0), default=0)
    worse = max((number for number in signs if number < better), default=0)
    return ([worse, better], True) if worse else ([], False)


def columns_of_even_times(run: StoredRun, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The columns about evenly spaced times, by the name of the set, if there are any.

    In a run of several numbers of measurements, each found set is compared with all regular times.
    Otherwise the only found set is compared with those in the table ``evenly_spaced``.
    """
    each: Mapping[str, Differences] = {}
    if "budget" in run.job:
        each = _on_the_curve(run)
    elif "evenly_spaced" in run.tables and (found := [*names]):
        rows = run.table("evenly_spaced").set_index("measurements")
        errors = zip(rows["difference"], rows["difference_error"], strict=True)
        each = {found[0]: dict(zip(rows.index, (Estimate(*own) for own in errors), strict=True))}
    columns = dict[str, dict[str, Any]]()
    for name, differences in each.items():
        numbers, is_between = doing_as_well(differences)
        columns[name] = {"evenly_spaced": numbers, "evenly_spaced_between": is_between}
    return columns


def _on_the_curve(run: StoredRun) -> Mapping[str, Differences]:
    """The differences of each found set from the regular times of as many or more measurements."""
    numbers = {name: len(times) for name, times in run.sets.items()}
    regular = [name for name in run.names if set_key_of(name, run.job).origin == REGULAR]
    pairs = {
        (name, other): Moments()
        for name in run.names
        if name not in regular
        for other in regular
        if numbers[other] >= numbers[name]
    }
    exact, found = exact_errors(run), defaultdict[str, dict[int, Estimate]](dict)
    for rows in () if exact else blocks_of(run):
        errors = {name: controlled_mse(rows, name) for name in run.names}
        for (name, other), moments in pairs.items():
            apart = errors[other] - errors[name]
            moments.add(apart[~np.isnan(apart)])
    for (name, other), moments in pairs.items():
        difference = Estimate(exact[other] - exact[name]) if exact else moments.estimate
        found[name][numbers[other]] = difference
    return found
