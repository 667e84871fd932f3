"""A run as DataFrames and as a summary."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from pfdist.analysis.belief import cause_of_excess
from pfdist.analysis.budget import FOUND, budget_table, reaching
from pfdist.analysis.gains import BLOCK, Comparison, gain_over_itself, relative_gain
from pfdist.analysis.recorded import read_recorded
from pfdist.analysis.reference import described
from pfdist.errors import StoreError
from pfdist.store import Store, check_entries


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
        self._about, self.job = read_recorded(path)
        self._store = Store(path)

    def evaluations(self) -> pd.DataFrame:
        """One row an evaluation: phase, generation, individual, copies, times, expected MSE."""
        return self._store.read("evaluations")

    def draws(self) -> pd.DataFrame:
        """Per-draw MSE of every evaluation: evaluation, draw, mse."""
        return self._store.read("draws")

    def compared(self) -> pd.DataFrame:
        """One row a set that is compared: name, measurement times, what its search believed."""
        return self._store.compared()

    def comparison(self) -> pd.DataFrame:
        """One row a draw: draw, and mse_<name> for every set compared."""
        return self._store.read("comparison")

    def repeated(self) -> pd.DataFrame:
        """One row a draw, of the first ones: the reference's MSE under other noise."""
        return self._store.read("repeated")

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
        for rows in self._blocks():
            found.add(np.stack([rows[f"mse_{name}"].to_numpy() for name in self.names], axis=1))
        return found

    def _blocks(self) -> Iterator[pa.Table]:
        last = self._store.present("comparison", "draw").size
        return self._store.blocks("comparison", "draw", BLOCK, last)

    @property
    def has_budget(self) -> bool:
        """Whether it has times of several numbers of measurements."""
        return "budget" in self.job

    def budget(self) -> pd.DataFrame:
        """One row a kind of times, ``regular`` or ``found``, and number of measurements.

        Columns kind, measurements, name, measurement_times, expected_mse (on fresh draws),
        standard_error, low and high (of its 95 % interval), draws (that count), degenerate_draws,
        search_cost and search_standard_error (what the search believed), and worse_than: of the
        same kind, the best number of fewer measurements, where it is better on common draws (the
        intervals of all such differences hold together with 95 %).
        """
        if not self.has_budget:
            raise StoreError(f"{self.path} has times of one number of measurements alone")
        reference = self.job["comparison"]["reference"]
        return budget_table(self.compared(), self.statistics(), self._blocks(), reference)

    def reaching(self, target: float) -> dict[str, dict[str, Any]]:
        """Give the least number of measurements whose expected MSE is at most a target.

        Parameters
        ----------
        target : float

        Returns
        -------
        dict
            Of ``regular`` and of ``found`` times: measurements (None if none of those tried
            reaches it) and its interval, 95 % (the least number whose interval reaches it, and the
            least whose interval lies below it, where the intervals of all numbers hold together),
            measurement_times, and larger_that_do_not (larger numbers whose interval lies above it:
            of regular times more are not always better).
        """
        return reaching(self.budget(), target)

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
            degenerate_draws, search_cost and search_standard_error; for the reference
            description (what it is), broken_constraints (see
            `pfdist.job.problem_section.ProblemSection.broken`) and gain_over_itself (see
            `pfdist.analysis.gains.gain_over_itself`) with its interval and draws; for the others
            search_excess (search_cost over expected_mse, less 1), search_estimation (how the search
            that found the set estimates otherwise than the comparison, draws aside), search_cause
            (why search_cost is not expected_mse), search_distrust (why the search was done again by
            the squared error, or None), the fields of `GainSummary` and gains_disagree
            (`GainSummary.disagree`).
            Fractions, not per cent; what is infinite or unknown is None. Of a run for several
            numbers of measurements the results are the rows of `budget`, and for those found
            search_excess, search_estimation, search_cause and search_distrust. Before the
            comparison has begun, each result has measurement_times, search_cost and
            search_standard_error alone.
        """
        has, results = self._store.has, {}
        if has("compared") and has("comparison"):
            results = self._budget_results() if self.has_budget else self._results()
        elif has("compared"):
            results = self._found()
        evaluations = int(self.evaluations()["copies"].sum()) if has("evaluations") else 0
        return {
            "state": self.state,
            "run": str(self.path),
            "evaluations": evaluations,
            "draws_compared": self.draws_compared,
            "results": finite(results),
        }

    def _budget_results(self) -> dict[str, Any]:
        results = dict[str, Any]()
        for row in self.budget().to_dict("records"):
            result: dict[str, Any] = {str(key): value for key, value in row.items()}
            name, worse_than = result.pop("name"), result["worse_than"]
            result["worse_than"] = None if pd.isna(worse_than) else worse_than
            if result["kind"] == FOUND:
                result |= self._belief(name.rpartition("_")[0], result)
            results[name] = result
        return results

    def _found(self) -> dict[str, Any]:
        """What is known before the comparison has begun: the times, and what searches believed."""
        return {
            str(entry["name"]): {
                "measurement_times": [int(time) for time in entry["measurement_times"]],
                "search_cost": float(entry["search_cost"]),
                "search_standard_error": float(entry["search_standard_error"]),
            }
            for entry in self.compared().to_dict("records")
        }

    def _results(self) -> dict[str, Any]:
        results, statistics = dict[str, Any](), self.statistics()
        for entry in self.compared().to_dict("records"):
            mse = statistics.mse[entry["name"]]
            result: dict[str, Any] = {
                "measurement_times": [int(time) for time in entry["measurement_times"]],
                "expected_mse": mse.mean,
                "standard_error": mse.standard_error,
                "degenerate_draws": statistics.draws - mse.count,
                "search_cost": float(entry["search_cost"]),
                "search_standard_error": float(entry["search_standard_error"]),
            }
            if entry["name"] == self.names[0]:
                times = tuple(result["measurement_times"])
                result |= described(self.job, self.names[0], times) | self._over_itself()
            else:
                result |= self._belief(str(entry["name"]), result)
                summary = statistics.gains[entry["name"]].summary()
                gain = asdict(summary) | {"gains_disagree": summary.disagree}
                gain["quantiles"] = {str(key): value for key, value in gain["quantiles"].items()}
                result |= {"gain_draws": gain.pop("draws"), **gain}
            results[str(entry["name"])] = result
        return results

    def _over_itself(self) -> dict[str, Any]:
        """What the filters' noise does to a gain, where the reference was filtered twice."""
        if not self._store.has("repeated"):  # an older run
            return {}
        again = self.repeated()
        last = int(again["draw"].max()) + 1
        both = again.merge(self._store.read("comparison", last), on="draw")
        found = gain_over_itself(both[f"mse_{self.names[0]}"].to_numpy(), both["mse"].to_numpy())
        return {
            "gain_over_itself": found.mean,
            "gain_over_itself_interval": found.interval,
            "gain_over_itself_draws": found.count,
        }

    def _belief(self, search: str, result: dict[str, Any]) -> dict[str, Any]:
        """How far what a search believed is from the truth, and how it estimates otherwise."""
        mse = result["expected_mse"]
        comparable = mse != 0.0 and math.isfinite(mse)
        own, count = self.own_estimation(search), self._evaluations_of(search)
        return {
            "search_excess": result["search_cost"] / mse - 1.0 if comparable else math.nan,
            "search_estimation": own,
            "search_cause": cause_of_excess(result, own, str(self.path), count),
            "search_distrust": self.distrust(search),
        }

    def _evaluations_of(self, search: str) -> int:
        """How many sets a search evaluated, polishing and shortlist among them."""
        if not self._store.has("evaluations"):
            return 1
        phases = self.evaluations()["phase"].astype(str).str.partition(".")[0]
        return max(1, int((phases == search).sum()))

    @property
    def knows_estimations(self) -> bool:
        """Whether the run says how each search estimated, which older runs do not of "auto"."""
        return "estimations" in self._about

    @cached_property
    def _distrusts(self) -> dict[str, str]:
        """By the name of a search that was done again, the reason."""
        rows = self.compared()
        if "distrust" not in rows:  # an older run
            return {}
        rows = rows[rows["distrust"].notna()]
        names = [str(name) for name in rows["name"]]
        if self.has_budget:  # a search has a set for each number of measurements
            names = [name.rpartition("_")[0] for name in names]
        return dict(zip(names, rows["distrust"].astype(str), strict=True))

    def distrust(self, search: str) -> str | None:
        """Why a search was done again by the squared error; None if it was not."""
        return self._distrusts.get(search)

    def own_estimation(self, search: str) -> dict[str, Any]:
        """How a search estimates otherwise than the comparison: particles, resampling, estimator.

        For a search that was done again by the squared error it is how it estimated then. In an
        older run what "auto" stood for is not known, and left out.
        """
        compared = {**self.job["filter"], "estimator": "squared_error"}
        if "estimations" in self._about:
            own = self._about["estimations"].get(search, {})
        else:
            given = {one["name"]: one.get("evaluation", {}) for one in self.job["search"]}
            own = {key: its for key, its in given[search].items() if its != "auto"}
        if self.distrust(search):
            own = {"resampling": own.get("resampling", compared["resampling"])}
        return {key: its for key, its in own.items() if key in compared and its != compared[key]}


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
    check_entries(Path(path))
    return Run(Path(path))


def finite(value: Any) -> Any:
    """The same with None for every float that is not finite, and lists for tuples."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
