"""How good the times found at each point of a sweep are at every point."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from pfdist.common.measurement_times import Times
from pfdist.results.gains import Gain, relative_gain
from pfdist.results.run import Run
from pfdist.results.runs_table import RESULTS, runs_table
from pfdist.results.stored_run import blocks_of, filter_is_wrong, found_sets, problem_of

JUDGED = "judged"
"""Folder, in that of a sweep, with a folder of comparisons for each choice of judged sets."""
LOSS = ("loss", "loss_low", "loss_high")
UNKNOWN = (math.nan,) * 3
NOTHING_JUDGED = pd.DataFrame(columns=["run", "found_at", *RESULTS, *LOSS])

Loss = tuple[float, float, float]
"""A loss, and its 95 % interval."""


class FoundSet(NamedTuple):
    """Times that a search has found at a point of a sweep, on the clock of the job."""

    point: str
    search: str
    times: Times


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
        As `pfdist.table` gives it of the judges, but ``set`` is the name of the search. Further
        columns are ``found_at``, the point at which the times were found, and ``loss`` with
        ``loss_low`` and ``loss_high``, its 95 % interval: by how much the expected MSE is higher
        than with the best times that were found at the judging point, as a fraction. It is NaN for
        times that are not feasible there.

    Raises
    ------
    StoreError
        A table of a run cannot be read.
    """
    found_sets = [
        FoundSet(point, search, times)
        for point, sets in times_by_search(runs).items()
        for search, times in sets.items()
    ]
    if not judges:
        return NOTHING_JUDGED.copy()
    frame = runs_table(list(judges.values()))
    points = {str(judge.path): point for point, judge in judges.items()}
    smaller = any(filter_is_wrong(judge) for judge in judges.values())
    losses = {point: _losses(judge, found_sets, point, smaller) for point, judge in judges.items()}
    rows = [
        row
        | {"found_at": each.point, "set": each.search}
        | dict(zip(LOSS, losses[points[row["path"]]].get(each.times, UNKNOWN), strict=True))
        for row in frame.to_dict("records")
        for each in found_sets
        if each.times == row["measurement_times"]
    ]
    before = list(frame.columns).index("set")
    columns = [*frame.columns[:before], "found_at", *frame.columns[before:], *LOSS]
    kinds = {name: frame[name].dtype for name in frame.columns}
    judged = pd.DataFrame(rows, columns=columns).astype(kinds | dict.fromkeys(LOSS, float))
    judged.attrs.update(frame.attrs)
    return judged


def _losses(
    judge: Run, found_sets: Sequence[FoundSet], point: str, smaller: bool
) -> dict[Times, Loss]:
    """The loss with its interval of all times that can be compared at a point.

    With money, `smaller` says whether sets can be compared to which a measurement can be added.
    """
    names = {times: name for name, times in judge.sets.items()}
    results = judge.table("sets").set_index("name")
    mse = {times: results["expected_mse"][name] for times, name in names.items()}
    own = {each.times for each in found_sets if each.point == point and each.times in names}
    best = dict[Times, Times]()  # of those found at the point, for each set of times
    for times in {each.times for each in found_sets if each.times in names}:
        comparable = [each for each in own if _are_comparable(judge, times, each, smaller)]
        if comparable:
            best[times] = min(comparable, key=lambda each: (mse[each], each))
    if not results["standard_error"].any():  # all are exact
        exact = {times: np.array(mse[times]) for times in names}
        gains = {times: float(relative_gain(exact[times], exact[best[times]])) for times in best}
        return {times: (0.0 - gain,) * 3 for times, gain in gains.items()}
    drawn = {times: Gain() for times in best}
    for block in blocks_of(judge):
        for times, gain in drawn.items():
            columns = (f"mse_{names[each]}" for each in (times, best[times]))
            gain.add(*(block[column].to_numpy() for column in columns))
    return {times: _loss(gain) for times, gain in drawn.items()}


def _are_comparable(judge: Run, times: Times, own: Times, smaller: bool) -> bool:
    """Whether times are feasible at a point, and as many as those that were found there."""
    feasible = replace(problem_of(judge).feasible, smaller=smaller)
    if feasible.counted:
        feasible = replace(feasible, measurement_budget=len(own))
    return feasible.accepts(problem_of(judge).clock.measurements(times))


def _loss(gain: Gain) -> Loss:
    low, high = gain.of_means_interval
    return 0.0 - gain.of_means, 0.0 - high, 0.0 - low  # 0, not -0, for the same times
