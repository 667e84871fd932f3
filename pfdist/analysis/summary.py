"""The summary of a run, as `pfdist status --json` prints it."""

import math
from typing import TYPE_CHECKING, Any

import pandas as pd

from pfdist.analysis.belief import belief_of
from pfdist.analysis.bounds import last_bounds
from pfdist.analysis.budget_curve import FOUND
from pfdist.analysis.exact import add_exact_results
from pfdist.analysis.finite import finite
from pfdist.analysis.gains import gain_over_itself
from pfdist.analysis.online import online_draws
from pfdist.analysis.particle_loss import hardly_measured
from pfdist.analysis.reference import described, without_number
from pfdist.evaluation.engines import is_exact

if TYPE_CHECKING:
    from pfdist.analysis.stored_run import Run


def summary_of(run: "Run") -> dict[str, Any]:
    """How far a run is, and what it has found.

    Parameters
    ----------
    run : Run

    Returns
    -------
    dict
        ``state``, ``run``, ``evaluations`` (copies counted), ``draws_compared``, ``has_budget``
        (whether the run has times of several numbers of measurements), ``is_exact``
        (whether the engine knows expected MSEs without draws), ``is_constrained`` (whether the job
        excludes some times, beside their number or cost), ``time_unit`` if the job has a clock,
        ``instant_weights`` (the weight of each instant's error in the MSE, with mean 1) if there
        are weights, ``results`` by name, and ``online`` if there is such a table. Times are those
        of the clock. Fractions are not in per cent; an infinite or unknown value is None. Each
        result has:

        - The columns of `pfdist.analysis.Run.budget`, among them measurement_times, expected_mse,
          standard_error, degenerate_draws, search_cost and search_standard_error.
        - particle_loss and particle_loss_error (by two filters), particle_loss_at_most,
          particle_loss_at_most_error and its 95 % limit particle_loss_limit: the loss by a finite
          number of particles as a fraction of expected_mse, where the engine has particles and the
          error is the squared norm.
          unmeasured_mse: the exact filter's expected MSE without a measurement. warnings: a list
          of sentences.
        - top_percent_share: the share of expected_mse that 1 % of the draws carry; None with fewer
          than 100 draws. Above 0.25 the standard error and the intervals are too small.
        - For the reference: gain_over_itself (see `pfdist.analysis.gains.gain_over_itself`) with
          interval and draws. For the reference and sets that the job names, if they have one
          number of measurements: description, and broken_constraints (see
          `pfdist.job.problem_section.ProblemSection.broken`).
        - For all but references: the fields of `GainSummary`, and gains_disagree
          (`GainSummary.disagree`). The reference has as many measurements.
        - For found sets: search_excess (search_cost over expected_mse, less 1),
          search_estimation (how the search estimated otherwise than the comparison),
          search_cause (why search_cost is not expected_mse), search_distrust (why the search
          was run again by the squared error, or None).
        - For all, if a lower bound was proved: lower_bound, with the columns of `bounds` for
          the proof of most compared draws, then of most particle-steps.

        - With an exact engine: exact_mse, of the reference only if the job names sets, a lower
          bound was proved, or ``pfdist why`` has computed it; then exact_gain of the others, 1
          less the ratio.

        Before the comparison has begun, a result has only measurement_times, search_cost and
        search_standard_error.

        If the job names sets, ``pairs`` and ``ranks`` hold the rows of `pfdist.analysis.Run.pairs`
        and `pfdist.analysis.Run.ranks`.

        If times were chosen one after another, there is a key ``online``: draws (without the
        degenerate_draws, which are degenerate with the online times, the plan or the
        reference), expected_mse and standard_error of the online times, and differs_from_plan
        (share of draws whose times are not those of the plan). The plan is the set of the
        first search. Under ``plan`` and ``reference`` stand name, expected_mse and
        standard_error on these draws, difference (expected MSE of the online times, less that
        of the set) with difference_interval (95 %, Student's t, of the paired differences),
        and the fields of `GainSummary` for the gain of the online times over the set.
    """
    results: dict[str, Any] = {}
    if run.has("compared"):
        compared = run.has("comparison")
        results = _results(run) if compared else _before_the_comparison(run)
        proved = last_bounds(run.bounds()) if run.has("bound") else {}
        for name, columns in proved.items():
            results[name]["lower_bound"] = columns
        add_exact_results(run, results)
    evaluations = int(run.evaluations()["copies"].sum()) if run.has("evaluations") else 0
    has_online = run.has("online") and run.has("comparison")
    online = {"online": finite(online_draws(run).summary())} if has_online else {}
    return {
        "state": run.state,
        "run": str(run.path),
        "evaluations": evaluations,
        "draws_compared": run.draws_compared,
        "has_budget": run.has_budget,
        "is_exact": is_exact(run.job["filter"]["engine"]),
        "is_constrained": run.problem.is_constrained,
        **({"time_unit": run.problem.clock.unit} if run.problem.has_clock else {}),
        **({"instant_weights": [*run.problem.weights]} if run.problem.weights else {}),
        "results": finite(results),
        **online,
        **(_pairs_and_ranks(run) if run.has("comparison") and run.named else {}),
    }


def _results(run: "Run") -> dict[str, dict[str, Any]]:
    """Costs of each set, facts about it, and its gains over its reference."""
    results, statistics = dict[str, dict[str, Any]](), run.statistics()
    for row in run.budget(statistics).to_dict("records"):
        result: dict[str, Any] = {str(key): value for key, value in row.items()}
        name, worse_than = result.pop("name"), result["worse_than"]
        result["worse_than"] = None if pd.isna(worse_than) else worse_than
        if result["kind"] == FOUND:
            result |= belief_of(run, without_number(name, run.job), result)
        elif not run.has_budget:
            result |= described(run.job, name, tuple(result["measurement_times"]))
        if name in statistics.gains:
            result |= statistics.gains[name].summary().columns()
        else:
            result |= _gain_over_itself(run)
        results[name] = result
    losses = run.particle_losses(statistics)
    unmeasured = float(run.filter_variance()["unmeasured"].mean()) if losses else math.nan
    for name, loss in losses.items():
        hardly = hardly_measured(results[name]["expected_mse"], unmeasured)
        warnings = [loss.warning, hardly if name in statistics.gains else ""]
        results[name] |= loss.columns() | {"unmeasured_mse": unmeasured}
        results[name]["warnings"] = [text for text in warnings if text]
    return results


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
        "gain_over_itself_interval": gain.estimate.interval(),
        "gain_over_itself_draws": gain.count,
    }


def _pairs_and_ranks(run: "Run") -> dict[str, Any]:
    """Rows of the tables of pairs and ranks."""
    tables = {"pairs": run.pairs(), "ranks": run.ranks()}
    return {name: finite(table.to_dict("records")) for name, table in tables.items()}


def _before_the_comparison(run: "Run") -> dict[str, Any]:
    """Times of each set, and the cost that its search believed."""
    return {
        str(entry["name"]): {
            "measurement_times": entry["measurement_times"].tolist(),
            "search_cost": float(entry["search_cost"]),
            "search_standard_error": float(entry["search_standard_error"]),
        }
        for entry in run.compared().to_dict("records")
    }
