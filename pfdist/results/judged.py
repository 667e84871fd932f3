"""How good the times found at each point of a sweep are at every point."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from pfdist.common.measurement_times import Times
from pfdist.results.moments import Gain, controlled_mse, relative_gain
from pfdist.results.run import Run
from pfdist.results.runs_table import RESULTS, runs_table
from pfdist.results.stored_run import blocks_of, filter_is_wrong, found_sets, problem_of

JUDGED = "judged"
"""Subfolder of a sweep's folder, with a folder of comparisons for each choice of judged sets."""
PLAN = ("found_at", "set")
"""Columns that identify a plan: the point at which a search found times, and the search."""
REGRET = ("regret", "regret_low", "regret_high")
UNKNOWN = (math.nan,) * 3
NOTHING_JUDGED = pd.DataFrame(columns=["run", "found_at", *RESULTS, *REGRET])

Regret = tuple[float, float, float]
"""A regret, and its 95 % interval."""
TimesByPoint = Mapping[str, Mapping[str, Times]]


def times_by_search(runs: Mapping[str, Run]) -> dict[str, dict[str, Times]]:
    """The times that the searches of each run have found, by name of the run and search."""
    return {
        name: {search: run.sets[search] for search in found_sets(run)} for name, run in runs.items()
    }


def judged_table(runs: Mapping[str, Run], judges: Mapping[str, Run]) -> pd.DataFrame:
    """A row for each point, and each set of times found at any point.

    Parameters
    ----------
    runs, judges : mapping of str to Run
        The run of each point, and the comparison that judges there, by the name of the point, if
        there is one.

    Returns
    -------
    DataFrame
        The result of `pfdist.table` for the judges, but ``set`` is the name of the search. Further
        columns are ``found_at``, the point at which the times were found, and ``regret`` with
        ``regret_low`` and ``regret_high``, its 95 % interval: how far the expected MSE lies above
        that of the best times that were found at any point, as a fraction. It is NaN for times that
        are not feasible at the judging point.

    Raises
    ------
    StoreError
        A table of a run cannot be read.
    """
    if not judges:
        return NOTHING_JUDGED.copy()
    found, frame = times_by_search(runs), runs_table(list(judges.values()))
    smaller = any(filter_is_wrong(judge) for judge in judges.values())
    regrets = {
        str(judge.path): _regrets(judge, found, point, smaller) for point, judge in judges.items()
    }
    rows = [
        row
        | {"found_at": point, "set": search}
        | dict(zip(REGRET, regrets[row["path"]].get(times, UNKNOWN), strict=True))
        for row in frame.to_dict("records")
        for point, sets in found.items()
        for search, times in sets.items()
        if times == row["measurement_times"]
    ]
    before = list(frame.columns).index("set")
    columns = [*frame.columns[:before], "found_at", *frame.columns[before:], *REGRET]
    kinds = {name: frame[name].dtype for name in frame.columns}
    judged = pd.DataFrame(rows, columns=columns).astype(kinds | dict.fromkeys(REGRET, float))
    judged.attrs.update(frame.attrs)
    return judged


def least_regret(judged: pd.DataFrame) -> dict[Any, Any] | None:
    """The plan of least regret: its largest regret at any point is smaller than that of others.

    Parameters
    ----------
    judged : DataFrame
        The result of `judged_table`.

    Returns
    -------
    dict or None
        The row in which its regret is largest. None if no plan has a regret at every point.
    """
    plans = [
        max(rows.to_dict("records"), key=lambda row: row["regret"])
        for _, rows in judged.groupby(list(PLAN), sort=False)
        if rows["regret"].notna().all()
    ]
    return min(plans, key=lambda row: row["regret"], default=None)


def _regrets(judge: Run, found: TimesByPoint, point: str, smaller: bool) -> dict[Times, Regret]:
    """The regret, with its interval, of all times that can be compared at a point.

    With prices, `smaller` allows sets to which a measurement could be added.
    """
    names = {times: name for name, times in judge.sets.items()}
    results = judge.table("sets").set_index("name")
    mse = {times: results["expected_mse"][name] for times, name in names.items()}
    best = _best(judge, found, point, mse, smaller)
    if not results["standard_error"].any():  # all are exact
        exact = {times: np.array(mse[times]) for times in names}
        gains = {times: float(relative_gain(exact[times], exact[best[times]])) for times in best}
        return {times: (0.0 - gain,) * 3 for times, gain in gains.items()}
    drawn = {times: Gain() for times in best}
    has_control = judge.job.get("comparison", {}).get("control")
    for block in blocks_of(judge):
        for times, gain in drawn.items():
            own, other = (controlled_mse(block, names[each]) for each in (times, best[times]))
            gain.add(own, other, (own, other) if has_control else None)
    return {times: _regret(gain) for times, gain in drawn.items()}


def _best(
    judge: Run, found: TimesByPoint, point: str, mse: Mapping[Times, float], smaller: bool
) -> dict[Times, Times]:  # fmt: skip
    """The best set for each feasible set of times: of as many times, if their number is fixed.

    Times of the same number were found at the point.
    """
    problem = problem_of(judge)
    feasible, best = replace(problem.feasible, smaller=smaller), dict[Times, Times]()
    numbers = {len(times) for times in found[point].values()}
    judged = {times for sets in found.values() for times in sets.values() if times in mse}
    for number in numbers if feasible.counted else {0}:
        if feasible.counted:
            feasible = replace(feasible, measurement_budget=number)
        alike = [times for times in judged if feasible.accepts(problem.clock.measurements(times))]
        best |= {times: min(alike, key=lambda each: (mse[each], each)) for times in alike}
    return best


def _regret(gain: Gain) -> Regret:
    low, high = gain.of_means_interval
    return 0.0 - gain.of_means, 0.0 - high, 0.0 - low  # 0, not -0, for the same times
