"""Online times against the plan and the reference, all on the same fresh draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.problem.points import Points
from pfdist.results.moments import Array, Gain, Moments
from pfdist.results.stored_run import StoredRun, problem_of

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class OnlineDraws:
    """The draws whose times were chosen online, and their errors with three sets.

    Parameters
    ----------
    reference, plan : str
        Names of the reference, and of the set that the first search found.
    planned_times : tuple of int
        The times of that set.
    rows : DataFrame
        A row for each draw: draw, measurement_times, estimate, mse_online and degenerate, and
        mse_<name> and degenerate_<name> for the reference and the plan.
    points : Points
        The table of all possible measurements.
    """

    reference: str
    plan: str
    planned_times: Times
    rows: pd.DataFrame
    points: Points

    def mse(self, name: str) -> Array:
        """Per-draw MSE."""
        mse: Array = self.rows[f"mse_{name}"].to_numpy()
        return mse

    @property
    def differ(self) -> NDArray[np.bool_]:
        """Whether the times of each draw differ from those of the plan, (D,)."""
        times = self.rows["measurement_times"]
        return np.array([tuple(chosen) != self.planned_times for chosen in times], np.bool_)

    def summary(self) -> dict[str, Any]:
        """Errors, differences and gains.

        Returns
        -------
        dict
            draws, degenerate_draws (with the online times, the plan or the reference), expected_mse
            and standard_error of the online times, and differs_from_plan (share of draws whose
            times are not those of the plan). The plan is the set of the first search. ``plan`` and
            ``reference`` each have name, expected_mse and standard_error on these draws, difference
            (expected MSE of the online times, less that of the set) with difference_low and
            difference_high (95 %, Student's t, of the paired differences), and the gain of the
            online times over the set, in the columns of the table ``sets``.
        """
        degenerate = self.rows.filter(regex="^degenerate").any(axis=1)
        return {
            "draws": len(self.rows),
            "degenerate_draws": int(degenerate.sum()),
            **self._error("online"),
            "differs_from_plan": float(np.mean(self.differ)) if len(self.rows) else np.nan,
            "plan": self._against(self.plan),
            "reference": self._against(self.reference),
        }

    def _error(self, name: str) -> dict[str, Any]:
        mse = Moments.of_values(self.mse(name))
        return {"expected_mse": mse.mean, "standard_error": mse.standard_error}

    def _against(self, name: str) -> dict[str, Any]:
        with np.errstate(invalid="ignore"):  # two infinite errors
            difference = Moments.of_values(self.mse("online") - self.mse(name))
        low, high = difference.estimate.interval()
        return {
            "name": name,
            **self._error(name),
            "difference": difference.mean,
            "difference_low": low,
            "difference_high": high,
            **Gain.of_draws(self.mse("online"), self.mse(name)).columns(),
        }


def online_errors(run: StoredRun, draws: int | None) -> pd.DataFrame | None:
    """The draws of a run and their errors with online times; None if it has none."""
    if not is_online(run):
        return None
    found = run.table("online", draws)[["draw", "mse"]].rename(columns={"mse": "mse_online"})
    found.attrs["labels"] = {"mse_online": "online times"}
    return found


def is_online(run: StoredRun) -> bool:
    """Whether a run has draws with online times that are compared."""
    return {"comparison", "online"} <= {*run.tables}


def online_draws(run: StoredRun) -> OnlineDraws:
    """The draws that have both online times and errors in the comparison.

    Parameters
    ----------
    run : StoredRun
        A run with rows in the tables ``online`` and ``comparison``.
    """
    reference, plan = run.names[0], str(run.job["search"][0]["name"])
    chosen = run.table("online").rename(columns={"mse": "mse_online"})
    compared = run.table("comparison", int(chosen["draw"].max()) + 1)
    columns = [f"{start}_{name}" for name in (reference, plan) for start in ("mse", "degenerate")]
    rows = chosen.merge(compared[["draw", *columns]], on="draw")
    return OnlineDraws(reference, plan, run.sets[plan], rows, problem_of(run).points)


def online_summary(run: StoredRun) -> dict[str, Any] | None:
    """The results of a run's online times; None if it has none."""
    return online_draws(run).summary() if is_online(run) else None
