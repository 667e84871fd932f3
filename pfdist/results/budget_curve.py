"""The budget curve: lower bounds, and the numbers of measurements that reach a target."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from pfdist.common.estimate import CONFIDENCE, student_quantile
from pfdist.results.columns import Row
from pfdist.results.moments import Moments, controlled_mse
from pfdist.results.particle_loss import SMALL, SMALL_AT_MOST

if TYPE_CHECKING:
    import pandas as pd

FOUND, GIVEN = "found", "given"

BOUND_DEGREES = 19
"""Degrees of freedom of the error of a lower bound: a jackknife over 20 groups of draws."""


def add_bounds(rows: Collection[Row], proofs: Mapping[str, Mapping[str, Any]]) -> None:
    """Add the columns that begin with bound to the rows of the table of sets that have a bound.

    Parameters
    ----------
    rows : collection of Row
    proofs : mapping of str to mapping
        The result of `pfdist.results.stored_run.last_bounds`: the lower bound of each found set, by
        name. A proof that failed has a reason, and no bound.
    """
    proved = {name: proof for name, proof in proofs.items() if not proof["reason"]}
    # Sets with the same sum share a bound; a bound that failed still counts as one of a curve's.
    different = {proof["budget"] for proof in proved.values()}
    numbers = max(len(different), len({row.budget for row in rows if row.kind == FOUND}))
    for row in rows:
        if proof := proved.get(row.name):
            row.add({name: proof[name] for name in ("bound", "bound_error")})
            row.bound_low = _limit(proof, numbers)
            row.bound_gap, row.bound_gap_at_most = proof["gap"], proof["gap_at_most"]


def _limit(proof: Mapping[str, Any], numbers: int) -> float:
    """The one-sided lower limit of a bound; all different bounds hold together (Bonferroni)."""
    if not proof["particles"]:  # the engine is exact
        return float(proof["bound"])
    quantile = student_quantile((1 - proof["confidence"]) / numbers, BOUND_DEGREES)
    return float(proof["bound"] + quantile * proof["bound_error"])


def worse_than(rows: Iterable[Row], blocks: Iterable[Any]) -> dict[str, int]:
    """A better, smaller number of measurements of the same kind, by the name of the worse set.

    Kinds are regular and found. The smaller number is that of the best set with fewer measurements.
    The interval of the difference on common draws must lie above 0; a difference of two exact
    errors has no interval. The best set was chosen on the same draws, so each interval allows for
    all pairs of a kind (Bonferroni, 95 % together).

    Parameters
    ----------
    rows : iterable of Row
        With name, kind, measurements, expected_mse and standard_error of each set.
    blocks : iterable of tables
        Rows of the table ``comparison``, block by block.
    """
    kinds, best_of_fewer = defaultdict[str, list[Row]](list), dict[str, tuple[Row, Row]]()
    for row in rows:
        kinds[row.kind].append(row)
    for row in chain(*kinds.values()):
        known = [each for each in kinds[row.kind] if each.expected_mse is not None]
        fewer = [each for each in known if each.budget < row.budget]
        if fewer:
            best_of_fewer[row.name] = row, min(fewer, key=lambda each: each.expected_mse)
    if not best_of_fewer:
        return {}
    pairs = sum(math.comb(len(sets), 2) for sets in kinds.values())
    differences = {name: Moments() for name in best_of_fewer}
    for block in blocks:
        for name, (_, best) in best_of_fewer.items():
            difference = controlled_mse(block, name) - controlled_mse(block, best.name)
            differences[name].add(difference[~np.isnan(difference)])
    confidence = 1 - (1 - CONFIDENCE) / max(1, pairs)
    return {
        name: best.budget
        for name, (row, best) in best_of_fewer.items()
        if (
            row.expected_mse > best.expected_mse
            if row.standard_error == best.standard_error == 0.0
            else differences[name].estimate.interval(confidence)[0] > 0
        )
    }


def reaching(table: pd.DataFrame, target: float, error: float = 0.0) -> dict[str, dict[str, Any]]:
    """The least number of measurements whose expected MSE is at most a target, and its interval.

    Parameters
    ----------
    table : DataFrame
        The table ``sets`` of a run.
    target : float
    error : float
        Standard error of a target that is itself an estimate: a compared set's expected MSE.

    Returns
    -------
    dict
        For each kind of times, as ``regular`` and ``found``:

        - measurements: the least number; None if no number reaches the target.
        - interval, 95 %: the least number whose interval reaches the target, and the least number
          whose interval lies below it. The intervals of all numbers hold together.
        - measurement_times.
        - larger_that_do_not: larger numbers whose interval lies above the target. More regular
          times are not always better.
        - with_more_particles: a smaller number that may reach the target with more particles: the
          upper limit of its particle loss allows it, and the loss is not small; else None.
        - impossible, only for found times: the largest number of measurements with which no
          feasible times and no filter reach the target; None if nothing is proved. The one-sided
          limit of bound - target lies above 0. Their draws are independent, so their errors add in
          squares. Without a minimum spacing, all smaller numbers are impossible, too: more
          measurements never harm the exact filter of the true model.

        The least numbers leave out each number that is proved impossible.
    """
    answer = dict[str, dict[str, Any]]()
    for kind, sets in table.groupby("kind", sort=False):
        best = sets.sort_values("expected_mse", kind="stable").drop_duplicates("budget")
        rows = best.set_index("budget").sort_index()
        # The intervals of all numbers hold together (Bonferroni), and so does the least number.
        quantile = student_quantile(
            (1 - CONFIDENCE) / 2 / len(rows), rows["draws"].astype(float) - 1
        )
        half = -quantile * rows["standard_error"]
        low, high = rows["expected_mse"] - half, rows["expected_mse"] + half
        # A proof outranks an estimate that reaches the target by chance.
        own = student_quantile((1 - CONFIDENCE) / len(rows), BOUND_DEGREES) * error
        proved = rows["bound"] - target > np.hypot(rows["bound"] - rows["bound_low"], own)
        least = _least(rows["expected_mse"][~proved], target)
        fewer = _least(_with_most_particles(rows)[~proved], target)
        above = rows.index[(low > target) & (rows.index > (least or np.inf))]
        answer[str(kind)] = {
            "measurements": least,
            "interval": [_least(low[~proved], target), _least(high[~proved], target)],
            "measurement_times": None if least is None else rows.loc[least, "measurement_times"],
            "larger_that_do_not": [int(number) for number in above],
            "with_more_particles": None if fewer == least else fewer,
        }
        if kind == FOUND:
            impossible = rows.index[proved]
            answer[FOUND]["impossible"] = int(impossible.max()) if len(impossible) else None
    return answer


def _with_most_particles(rows: pd.DataFrame) -> pd.Series[float]:
    """The expected MSE without all that the particles may lose; a small loss counts as none."""
    limit = rows["particle_loss_limit"].fillna(0.0)
    is_small = (rows["particle_loss"] <= SMALL) & (limit < SMALL_AT_MOST)
    return rows["expected_mse"] * (1.0 - limit.mask(is_small, 0.0))


def _least(errors: pd.Series[float], target: float) -> int | None:
    return next((int(number) for number, error in errors.items() if error <= target), None)  # type: ignore[call-overload]
