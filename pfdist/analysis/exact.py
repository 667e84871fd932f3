"""Expected MSEs that a run's tables hold exactly, because its engine needs no draws."""

import math
from typing import TYPE_CHECKING

from pfdist.filters.engines import is_exact

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
    return {str(name): float(cost) for name, cost in costs.items() if not math.isnan(cost)}
