"""Results of a run's summary: for the times of one problem, or for a range of budgets.

This module holds everything that differs between the two. Only `results_of` asks which study a run
belongs to.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import pandas as pd

from pfdist.analysis.belief import belief_of
from pfdist.analysis.budget_curve import FOUND, budget_table
from pfdist.analysis.gains import gain_over_itself
from pfdist.analysis.particle_loss import hardly_measured
from pfdist.analysis.reference import described
from pfdist.errors import StoreError
from pfdist.times.measurement_times import Times

if TYPE_CHECKING:
    from pfdist.analysis.stored_run import Run


class Results(Protocol):
    """The questions that a summary asks about a run's tables."""

    has_budget: bool
    """Whether the run has times of several numbers of measurements."""

    def summary(self, run: "Run") -> dict[str, dict[str, Any]]:
        """Results of each compared set, by name; see `pfdist.analysis.Run.summary`."""

    def search_of(self, name: str) -> str:
        """Name of the search that found the set of this name."""

    def budget_table(self, run: "Run") -> pd.DataFrame:
        """Table of the budget curve.

        Raises
        ------
        StoreError
            The run has times of one number of measurements alone.
        """

    def sets_of_one_number(self, run: "Run") -> dict[str, Times]:
        """Compared sets by name.

        Raises
        ------
        StoreError
            The run has times of several numbers of measurements.
        """


class TimesResults:
    """Results of a run that compares the set of each search with one reference."""

    has_budget = False

    def summary(self, run: "Run") -> dict[str, dict[str, Any]]:
        """Costs of each set, facts about the reference, and gains of the others over it."""
        results, statistics = {}, run.statistics()
        for entry in run.compared().to_dict("records"):
            name, mse = str(entry["name"]), statistics.mse[entry["name"]]
            result: dict[str, Any] = {
                "measurement_times": entry["measurement_times"].tolist(),
                "expected_mse": mse.mean,
                "standard_error": mse.standard_error,
                "degenerate_draws": statistics.draws - mse.count,
                "top_percent_share": statistics.top_percent_share(name),
                "search_cost": float(entry["search_cost"]),
                "search_standard_error": float(entry["search_standard_error"]),
            }
            if math.isnan(result["search_cost"]):  # no search found it
                result |= described(run.job, name, tuple(result["measurement_times"]))
            else:
                result |= belief_of(run, name, result)
            if name == run.names[0]:
                result |= _gain_over_itself(run)
            else:
                result |= statistics.gains[name].summary().columns()
            results[name] = result
        losses = run.particle_losses(statistics)
        unmeasured = float(run.filter_variance()["unmeasured"].mean()) if losses else math.nan
        for name, loss in losses.items():
            hardly = hardly_measured(results[name]["expected_mse"], unmeasured)
            warnings = [loss.warning, hardly if name != run.names[0] else ""]
            results[name] |= loss.columns() | {"unmeasured_mse": unmeasured}
            results[name]["warnings"] = [text for text in warnings if text]
        return results

    def search_of(self, name: str) -> str:
        """The set has the name of its search."""
        return name

    def budget_table(self, run: "Run") -> pd.DataFrame:
        """Raise an error: the run has no budget curve."""
        raise StoreError(f"{run.path} has times of one number of measurements alone")

    def sets_of_one_number(self, run: "Run") -> dict[str, Times]:
        """All compared sets by name."""
        return run.sets()


class BudgetResults:
    """Results of a run that compares found with regular times for every measurement budget."""

    has_budget = True

    def summary(self, run: "Run") -> dict[str, dict[str, Any]]:
        """Rows of the budget table by the name of the set, and what the search believed."""
        results = dict[str, dict[str, Any]]()
        for row in run.budget().to_dict("records"):
            result: dict[str, Any] = {str(key): value for key, value in row.items()}
            name, worse_than = result.pop("name"), result["worse_than"]
            result["worse_than"] = None if pd.isna(worse_than) else worse_than
            if result["kind"] == FOUND:
                result |= belief_of(run, self.search_of(name), result)
            results[name] = result
        return results

    def search_of(self, name: str) -> str:
        """The name without the number of measurements."""
        return name.rpartition("_")[0]

    def budget_table(self, run: "Run") -> pd.DataFrame:
        """A row for each kind of times and number of measurements."""
        reference = run.job["comparison"]["reference"]
        return budget_table(run.compared(), run.statistics(), run.blocks(), reference)

    def sets_of_one_number(self, run: "Run") -> dict[str, Times]:
        """Raise an error: the sets have several numbers of measurements."""
        raise StoreError(
            f"{run.path} has times of several numbers of measurements: give a run of one"
        )


def results_of(job: Mapping[str, Any]) -> Results:
    """The results of a run with this resolved job."""
    return BudgetResults() if "budget" in job else TimesResults()


def _gain_over_itself(run: "Run") -> dict[str, Any]:
    """The effect of filter noise alone on a gain, if the reference was filtered twice."""
    if not run.has("repeated"):
        return {}
    again = run.repeated()
    last = int(again["draw"].max()) + 1
    both = again.merge(run.comparison(last), on="draw")
    gain = gain_over_itself(both[f"mse_{run.names[0]}"].to_numpy(), both["mse"].to_numpy())
    return {
        "gain_over_itself": gain.mean,
        "gain_over_itself_interval": gain.interval,
        "gain_over_itself_draws": gain.count,
    }
