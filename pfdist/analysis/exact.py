"""Expected MSEs that a run's tables hold exactly, because its engine needs no draws."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd

from pfdist.evaluation.engines import is_exact

if TYPE_CHECKING:
    from pfdist.analysis.stored_run import Run


def exact_costs(run: "Run") -> dict[str, float]:
    """The exact expected MSE of each compared set whose tables hold it, by name.

    The searches know it of the sets that they have found. That of the reference is known once
    ``pfdist bound`` or ``pfdist why`` has computed it.

    Parameters
    ----------
    run : Run
        Its searches are done. If its engine needs draws, nothing is known exactly.
    """
    if not is_exact(run.job["filter"]["engine"]):
        return {}
    rows = run.compared()
    costs = dict(zip(rows["name"], rows["search_cost"], strict=True))
    if "exact_mse" in rows:  # a run with sets that its job names
        given = rows[rows["exact_mse"].notna()]
        costs |= dict(zip(given["name"], given["exact_mse"], strict=True))
    if run.has("profile"):
        profile = run.profile()
        counts = profile["weight"] != 0.0  # an error that does not count may be infinite
        profile["error"] = (profile["error"] * profile["weight"]).where(counts, 0.0)
        costs |= profile.groupby("name")["error"].mean().to_dict()
    if run.has("bound"):
        proved = run.bounds().drop_duplicates("name", keep="last")
        costs |= dict(zip(proved["name"], proved["expected_mse"], strict=True))
    return {str(name): float(cost) for name, cost in costs.items() if pd.notna(cost)}


def names_by_error(summary: Mapping[str, Any]) -> list[str]:
    """The names of the found sets, or of all sets in a run without a search, the best first.

    Exact errors decide if the engine knows them, and else the errors on the compared draws. Sets
    whose error is unknown or infinite come last.

    Parameters
    ----------
    summary : mapping
        As of `pfdist.analysis.Run.summary`, of a run with one number of measurements.
    """
    key = "exact_mse" if summary["is_exact"] else "expected_mse"
    results = summary["results"]
    found = {name: each for name, each in results.items() if each["search_cost"] is not None}
    errors = {name: result.get(key) for name, result in (found or results).items()}
    return sorted(errors, key=lambda name: (errors[name] is None, errors[name] or 0.0))


def add_exact_results(run: "Run", results: dict[str, dict[str, Any]]) -> None:
    """Add ``exact_mse`` to the results of a run, and ``exact_gain`` to those of found sets.

    Parameters
    ----------
    run : Run
    results : dict
        Results of each compared set by name, changed in place; see `exact_costs`.
    """
    costs = exact_costs(run)
    for name, cost in costs.items():
        results[name]["exact_mse"] = cost
    for name, reference in run.references.items():
        if costs.get(reference):
            results[name]["exact_gain"] = 1 - costs[name] / costs[reference]
