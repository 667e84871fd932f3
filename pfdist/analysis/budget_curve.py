"""Expected MSE against the number of measurements, and the least number that reaches a target."""

import math
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from pfdist.analysis.gains import Comparison
from pfdist.analysis.moments import CONFIDENCE, Moments

REGULAR, FOUND = "regular", "found"


def budget_table(
    compared: pd.DataFrame, statistics: Comparison, blocks: Iterable[Any], reference: str
) -> pd.DataFrame:
    """Say what each number of measurements costs, with regular times and with those found.

    Parameters
    ----------
    compared : DataFrame
        The table of that name.
    statistics : Comparison
        Of every set compared.
    blocks : iterable of tables
        Per-draw MSE, block by block, in columns ``mse_<name>``.
    reference : str
        With which the names of the regular times begin.

    Returns
    -------
    DataFrame
        By kind and number; see `pfdist.analysis.Run.budget`.
    """
    rows = []
    for entry in compared.to_dict("records"):
        name, times = str(entry["name"]), [int(time) for time in entry["measurement_times"]]
        known, (low, high) = statistics.mse[name], statistics.mse[name].interval
        rows.append(
            {
                "kind": REGULAR if name.startswith(f"{reference}_") else FOUND,
                "measurements": len(times),
                "name": name,
                "measurement_times": times,
                "expected_mse": known.mean,
                "standard_error": known.standard_error,
                "low": low,
                "high": high,
                "draws": known.count,
                "degenerate_draws": statistics.draws - known.count,
                "search_cost": float(entry["search_cost"]),
                "search_standard_error": float(entry["search_standard_error"]),
            }
        )
    table = pd.DataFrame(rows)
    worse = _worse(table, blocks)
    table["worse_than"] = pd.array([worse.get(name) for name in table["name"]], dtype="Int64")
    return table


def _worse(table: pd.DataFrame, blocks: Iterable[Any]) -> dict[str, int]:
    """Sets that are worse than one of fewer measurements, and the number of the best of those.

    On common draws the interval of the difference must lie above 0. Which number is the best of
    the fewer was seen on the same draws: so any two sets might have been compared, and all these
    intervals together are to hold with 95 % (Bonferroni).
    """
    than, apart = {}, defaultdict[str, Moments](Moments)
    for _, sets in table.groupby("kind"):
        for name, measurements in zip(sets["name"], sets["measurements"], strict=True):
            fewer = sets[sets["measurements"] < measurements].dropna(subset="expected_mse")
            if len(fewer):
                than[name] = fewer.loc[fewer["expected_mse"].idxmin()]
    pairs = sum(math.comb(len(sets), 2) for _, sets in table.groupby("kind"))
    for rows in blocks:
        for name, best in than.items():
            difference = rows[f"mse_{name}"].to_numpy() - rows[f"mse_{best['name']}"].to_numpy()
            apart[name].add(difference[~np.isnan(difference)])
    confidence = 1 - (1 - CONFIDENCE) / max(1, pairs)
    return {
        name: int(best["measurements"])
        for name, best in than.items()
        if apart[name].interval_of(confidence)[0] > 0
    }


def reaching(table: pd.DataFrame, target: float) -> dict[str, dict[str, Any]]:
    """Give the least number of measurements whose expected MSE is at most a target.

    Parameters
    ----------
    table : DataFrame
        As of `budget_table`.
    target : float

    Returns
    -------
    dict
        By kind, ``regular`` and ``found``, the fields of `pfdist.analysis.Run.reaching`.
    """
    answer = {}
    for kind in (REGULAR, FOUND):
        rows = table[table["kind"] == kind].set_index("measurements")
        # The least of many numbers is sure where the intervals of all hold (Bonferroni).
        quantile = stats.t.isf((1 - CONFIDENCE) / 2 / len(rows), rows["draws"] - 1)
        half = quantile * rows["standard_error"]
        low, high = rows["expected_mse"] - half, rows["expected_mse"] + half
        least = _least(rows["expected_mse"], target)
        above = rows.index[(low > target) & (rows.index > (least or np.inf))]
        answer[kind] = {
            "measurements": least,
            "interval": [_least(low, target), _least(high, target)],
            "measurement_times": None if least is None else rows.loc[least, "measurement_times"],
            "larger_that_do_not": [int(number) for number in above],
        }
    return answer


def _least(costs: "pd.Series[float]", target: float) -> int | None:
    return next((int(number) for number, cost in costs.items() if cost <= target), None)  # type: ignore[call-overload]
