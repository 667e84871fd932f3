"""A run as DataFrames and as a summary."""

import math
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pfdist.analysis.gains import BLOCK, Comparison, relative_gain
from pfdist.store import Store, read_run


class Run:
    """A run on disk, finished or not; made by `open_run`.

    Attributes
    ----------
    path : Path
        Its folder.
    job : dict
        The resolved job.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        _, self.job = read_run(path)
        self._store = Store(path)

    def evaluations(self) -> pd.DataFrame:
        """One row an evaluation: phase, generation, individual, copies, times, expected MSE."""
        return self._store.read("evaluations")

    def draws(self) -> pd.DataFrame:
        """Per-draw MSE of every evaluation: evaluation, draw, mse."""
        return self._store.read("draws")

    def compared(self) -> pd.DataFrame:
        """One row a set that is compared: name, measurement times, what its search believed."""
        return self._store.read("compared")

    def comparison(self) -> pd.DataFrame:
        """One row a draw: draw, and mse_<name> for every set compared."""
        return self._store.read("comparison")

    def trajectories(self) -> pd.DataFrame:
        """z, y and every filter's estimate over time, for the first draws of the comparison."""
        return self._store.read("trajectories")

    def timings(self) -> pd.DataFrame:
        """One row a task: seconds, worker, node, failures."""
        return self._store.read("timings")

    def gains(self, draws: int | None = None) -> pd.DataFrame:
        """One row a draw: draw, and gain_<name> for every set but the reference.

        Parameters
        ----------
        draws : int, optional
            The first so many alone.
        """
        rows = self._store.read("comparison", draws)
        gains: dict[str, Any] = {"draw": rows["draw"]}
        for name in self.names[1:]:
            gains[f"gain_{name}"] = relative_gain(
                rows[f"mse_{name}"].to_numpy(), rows[f"mse_{self.names[0]}"].to_numpy()
            )
        return pd.DataFrame(gains)

    @cached_property
    def names(self) -> list[str]:
        """What is compared: the reference first."""
        return [str(name) for name in self.compared()["name"]]

    @property
    def state(self) -> str:
        """``searching``, ``comparing`` or ``finished``."""
        if not self._store.has("compared"):
            return "searching"
        if self._store.has_parts() or self._store.manifest.lost():
            return "comparing"
        enough = self.draws_compared == self.job["comparison"]["draws"] or self._narrow
        return "finished" if enough else "comparing"

    @property
    def _narrow(self) -> bool:
        """Whether the intervals are as narrow as the job wants them."""
        half_width = self.job["comparison"].get("until", {}).get("half_width", 0.0)
        return bool(half_width > 0 and self.statistics().half_width() <= half_width)

    def statistics(self) -> Comparison:
        """Accumulate the comparison block by block: memory does not grow with its draws."""
        found = Comparison(self.names)
        last = self._store.present("comparison", "draw").size
        for rows in self._store.blocks("comparison", "draw", BLOCK, last):
            found.add(np.stack([rows[f"mse_{name}"].to_numpy() for name in self.names], axis=1))
        return found

    @property
    def draws_compared(self) -> int:
        """How many draws every set has filtered."""
        return int(self._store.present("comparison", "draw").sum())

    def summary(self) -> dict[str, Any]:
        """Say how far the run is, and what it has found.

        Returns
        -------
        dict
            ``state``, ``run``, ``evaluations`` (copies counted), ``draws_compared`` and
            ``results``: by name, measurement_times, expected_mse, standard_error,
            degenerate_draws and search_cost, and for all but the reference the fields of
            `GainSummary`. Fractions, not per cent; what is infinite or unknown is None.
        """
        has = self._store.has
        compares = has("compared") and has("comparison")
        evaluations = int(self.evaluations()["copies"].sum()) if has("evaluations") else 0
        return {
            "state": self.state,
            "run": str(self.path),
            "evaluations": evaluations,
            "draws_compared": self.draws_compared,
            "results": finite(self._results(self.statistics())) if compares else {},
        }

    def _results(self, statistics: Comparison) -> dict[str, Any]:
        results: dict[str, Any] = {}
        for entry in self.compared().to_dict("records"):
            mse = statistics.mse[entry["name"]]
            result = {
                "measurement_times": [int(time) for time in entry["measurement_times"]],
                "expected_mse": mse.mean,
                "standard_error": mse.standard_error,
                "degenerate_draws": statistics.draws - mse.count,
                "search_cost": float(entry["search_cost"]),
            }
            if entry["name"] != self.names[0]:
                gain = asdict(statistics.gains[entry["name"]].summary())
                gain["quantiles"] = {str(key): value for key, value in gain["quantiles"].items()}
                result |= {"gain_draws": gain.pop("draws"), **gain}
            results[str(entry["name"])] = result
        return results


def open_run(path: str | Path) -> Run:
    """Open a run's folder for reading.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Run

    Raises
    ------
    StoreError
        The folder holds no run, or one that cannot be read.
    """
    return Run(Path(path))


def finite(value: Any) -> Any:
    """The same with None for every float that is not finite, and lists for tuples."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
