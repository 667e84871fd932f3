"""How many evenly spaced measurements do as well as other times, on common draws."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.set_key import set_key_of
from pfdist.results.moments import Moments, controlled_mse
from pfdist.results.stored_run import StoredRun, blocks_of, exact_errors

AS_WELL = 0.02
"""Evenly spaced times whose error lies this share above that of other times do as well."""

Differences = Mapping[int, Estimate]
"""Expected MSE of evenly spaced times, less that of other times, by the number of the former."""


def sign_of(difference: Estimate, error: float, confidence: float = CONFIDENCE) -> int:
    """1 if evenly spaced times do worse, -1 if they do as well, 0 if this is undecided.

    They do as well if the interval of the paired difference ends at most 2 % of the other error
    above it, and worse if it begins further above. An exact difference has no interval.

    >>> sign_of(Estimate(5.0, 1.0), 100.0), sign_of(Estimate(0.5, 0.5), 100.0)
    (1, -1)
    >>> sign_of(Estimate(1.0, 1.0), 100.0), sign_of(Estimate(2.0), 100.0)
    (0, -1)
    """
    low, high = difference.interval(confidence)
    return int(low > AS_WELL * error) - int(high <= AS_WELL * error)


def doing_as_well(differences: Differences, error: float) -> dict[str, Any]:
    """The columns ``evenly_spaced``, of numbers of evenly spaced measurements.

    Parameters
    ----------
    differences : mapping of int to Estimate
    error : float
        The expected MSE of the other times.

    Examples
    --------
    >>> differences = {36: Estimate(0.9), 37: Estimate(0.2, 0.1), 38: Estimate(-0.3, 0.1)}
    >>> doing_as_well({**differences, 40: Estimate(0.8, 0.1)}, 10.0)
    {'evenly_spaced': 38, 'evenly_spaced_undecided': [37], 'evenly_spaced_worse': [40]}
    """
    signs = {number: sign_of(each, error) for number, each in sorted(differences.items())}
    first = min((number for number, sign in signs.items() if sign < 0), default=None)
    undecided = [number for number, sign in signs.items() if first and number < first and not sign]
    worse = [number for number, sign in signs.items() if first and number > first and sign > 0]
    return {
        "evenly_spaced": first,
        "evenly_spaced_undecided": undecided,
        "evenly_spaced_worse": worse,
    }


def columns_of_even_times(run: StoredRun, errors: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """The columns about evenly spaced times, by the name of the set, if there are any.

    In a run of several numbers of measurements, each found set is compared with the references of
    all larger numbers. Otherwise the only found set is compared with those in the table
    ``evenly_spaced``.

    Parameters
    ----------
    run : StoredRun
    errors : mapping of str to float
        The expected MSE of each found set.
    """
    if has_amounts(run.job):
        on_the_curve = _on_the_curve(run)
        return {name: doing_as_well(on_the_curve[name], error) for name, error in errors.items()}
    if not (errors and run._store.has("evenly_spaced")):
        return {}
    rows = run.table("evenly_spaced")
    each = zip(rows["difference"], rows["difference_error"], strict=True)
    differences = dict(zip(rows["measurements"], (Estimate(*own) for own in each), strict=True))
    return {next(iter(errors)): doing_as_well(differences, float(rows["plan_mse"].iloc[0]))}


def _on_the_curve(run: StoredRun) -> Mapping[str, Differences]:
    """The differences of each found set from the references of as many or more measurements."""
    numbers = {name: int(set_key_of(name, run.job).number) for name in run.sets}
    pairs = {
        (name, other): Moments()
        for name in run.references
        for other in dict.fromkeys(run.references.values())
        if numbers[other] >= numbers[name]
    }
    exact, found = exact_errors(run), defaultdict[str, dict[int, Estimate]](dict)
    for rows in () if exact else blocks_of(run):
        errors = {name: controlled_mse(rows, name) for name in run.names}
        for (name, other), moments in pairs.items():
            gap = errors[other] - errors[name]
            moments.add(gap[~np.isnan(gap)])
    for (name, other), moments in pairs.items():
        difference = Estimate(exact[other] - exact[name]) if exact else moments.estimate
        found[name][numbers[other]] = difference
    return found
