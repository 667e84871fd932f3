"""One table of sets: a row a set, a column a result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pfdist.common.clock import Time
from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import REGULAR
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.set_key import key_of
from pfdist.results.belief import belief_of
from pfdist.results.budget_curve import FOUND, GIVEN, with_bounds, worse_than
from pfdist.results.columns import COLUMNS
from pfdist.results.gains import ComparisonStatistics, gain_over_itself, relative_gain
from pfdist.results.particle_loss import hardly_measured
from pfdist.results.stored_run import (
    StoredRun,
    blocks_of,
    last_bounds,
    particle_losses_of,
    problem_of,
    statistics_of,
    worst_of,
)

if TYPE_CHECKING:
    import pandas as pd

Results = dict[str, Any]


def sets_of(run: StoredRun) -> pd.DataFrame:
    """A row for each compared set, the reference first, with all results of the set.

    The times are known once the searches have ended, and results of draws once the comparison has
    begun. Fractions are not in per cent. An exact engine knows expected_mse, so its standard_error
    is 0, and gain_of_means has an interval of one point.
    """
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    rows = {row["name"]: row for row in _given(run)}
    statistics = statistics_of(run) if "comparison" in run.tables else None
    if statistics is not None:
        _add_results(run, rows, statistics)
    table = pd.DataFrame([*rows.values()], columns=[*COLUMNS])
    if statistics is not None:
        proofs = last_bounds(run)
        table = with_bounds(table, proofs)
        worse = worse_than(table, blocks_of(run))
        table["worse_than"] = [worse.get(name) for name in table["name"]]
    for name, column in COLUMNS.items():
        if column.dtype == "object":
            table[name] = table[name].astype(object).where(table[name].notna(), None)
    return table.astype({name: column.dtype for name, column in COLUMNS.items()})


def _given(run: StoredRun) -> Iterable[Results]:
    """Everything that is known of each set before the comparison."""
    problem = problem_of(run)
    for entry in run.table("compared").to_dict("records"):
        name, times = str(entry["name"]), entry["measurement_times"].tolist()
        reference, is_found = run.references.get(name), not math.isnan(entry["search_mse"])
        own_kind = key_of(name, run.job).origin if reference is None else GIVEN
        row: Results = {
            "name": name,
            "kind": FOUND if is_found else own_kind,
            "reference": reference,
            "measurements": len(times),
            "measurement_times": times,
            "draws": 0,
            "degenerate_draws": 0,
            "broken_constraints": [],
            "warnings": [],
        }
        if problem.total_price is not None:
            row["price"] = float(problem.feasible.price_of(problem.clock.measurements(times)))
        if is_found:
            row["search_mse"] = float(entry["search_mse"])
            row["search_standard_error"] = float(entry["search_standard_error"])
        elif "budget" not in run.job:
            row |= described(run.job, name, tuple(times))
        if not math.isnan(exact := entry.get("exact_mse", math.nan)):
            row |= _exact("expected_mse", exact) | {"standard_error": 0.0}
        yield row


def described(job: Mapping[str, Any], name: str, times: Sequence[Time]) -> dict[str, Any]:
    """A description of a set that the job gives, and the constraints of the job that it breaks.

    Parameters
    ----------
    job : mapping
        The run's resolved job.
    name : str
        Name of the set.
    times : sequence of int or float
        Measurement times of the set, on the clock of the job.

    Returns
    -------
    dict
        ``description``, a phrase, and ``broken_constraints``, a list of sentences.
    """
    problem = ProblemSection.model_validate(job["problem"])
    feasible, instants = problem.feasible, problem.clock.measurements(times)
    number = f"N = {len(times)}"
    if not feasible.counted:
        number += f", spends {feasible.price_of(instants)} of {feasible.total_price}"
    if name in (job.get("comparison", {}).get("sets") or {}) and name != REGULAR:
        phrase = f"the set that comparison.sets.{name} gives ({number})"
    elif name != REGULAR:
        phrase = f"the set that comparison.reference names ({number})"
    elif feasible.is_regular(instants):
        phrase = f"regular times ({number})"
    elif feasible.counted:
        phrase = f"the feasible set nearest to regular times ({number})"
    else:
        phrase = f"nearest to regular times of the sets with the most measurements ({number})"
    return {"description": phrase, "broken_constraints": problem.broken(times)}


def _exact(name: str, value: float) -> Results:
    """A value that is known exactly, with its interval of one point."""
    return {name: value, f"{name}_low": value, f"{name}_high": value}


def _add_results(
    run: StoredRun, rows: dict[str, Results], statistics: ComparisonStatistics
) -> None:
    """Add the results of the compared draws to the rows of the sets."""
    for name, row in rows.items():
        row["draws"] = statistics.mse[name].count
        row["degenerate_draws"] = statistics.degenerate_draws[name]
        if "expected_mse" not in row:
            row.update(_estimated(statistics.mse[name].estimate))
            row["top_percent_share"] = statistics.top_percent_share(name)
        if name in statistics.gains:
            row.update(statistics.gains[name].summary().columns())
    for name, reference in run.references.items():
        of_reference, row = rows[reference], rows[name]
        if row["standard_error"] == of_reference["standard_error"] == 0.0:
            gain = relative_gain(*(np.array(e["expected_mse"]) for e in (row, of_reference)))
            row |= _exact("gain_of_means", float(gain))
    rows[run.names[0]] |= _gain_over_itself(run)
    _add_beliefs(run, rows)
    _add_particle_losses(run, rows, statistics)
    for name, proof in last_bounds(run).items():
        if not proof["reason"]:
            rows[name]["bound_gap"] = proof["gap"]
            rows[name]["bound_gap_at_most"] = proof["gap_at_most"]


def _estimated(mse: Estimate) -> Results:
    low, high = mse.interval()
    return {
        "expected_mse": mse.value,
        "standard_error": mse.standard_error,
        "expected_mse_low": low,
        "expected_mse_high": high,
    }


def _add_beliefs(run: StoredRun, rows: dict[str, Results]) -> None:
    """Add how far the estimate of the search that found a set is off, and why."""
    is_worst = run.job.get("scenarios", {}).get("criterion") == "worst"
    worst = worst_of(run) if is_worst else {}
    for name, row in rows.items():
        if name in worst:
            row["worst_mse"] = worst[name]["expected_mse"]
        if row["kind"] == FOUND:
            search, errors = key_of(name, run.job).origin, row | worst.get(name, {})
            row.update(belief_of(run, search, errors))


def _add_particle_losses(
    run: StoredRun, rows: dict[str, Results], statistics: ComparisonStatistics
) -> None:
    losses = particle_losses_of(run, statistics)
    if not losses:
        return
    unmeasured = float(run.table("filter_variance")["unmeasured"].mean())
    for name, loss in losses.items():
        row = rows[name]
        row |= loss.columns() | {"unmeasured_mse": unmeasured}
        hardly = hardly_measured(row["expected_mse"], unmeasured)
        warnings = [loss.warning, hardly if name in statistics.gains else ""]
        row["warnings"] = [text for text in warnings if text]


def _gain_over_itself(run: StoredRun) -> Results:
    """The effect of filter noise alone on a gain, if the reference was filtered twice."""
    if "repeated" not in run.tables:
        return {}
    again = run.table("repeated")
    last = int(again["draw"].max()) + 1
    both = again.merge(run.table("comparison", last), on="draw")
    gain = gain_over_itself(both[f"mse_{run.names[0]}"].to_numpy(), both["mse"].to_numpy())
    low, high = gain.estimate.interval()
    return {
        "gain_over_itself": gain.mean,
        "gain_over_itself_low": low,
        "gain_over_itself_high": high,
        "gain_over_itself_draws": gain.count,
    }


def best_first(sets: pd.DataFrame) -> list[str]:
    """Names of the found sets, or of all sets of a run without a search, the best first.

    If the worst scenario decides, the errors are those of each set's worst scenario. Sets whose
    error is unknown or infinite come last. The run has one number of measurements.
    """
    found_sets = sets[sets["kind"] == FOUND]
    chosen = found_sets if len(found_sets) else sets
    error = "worst_mse" if chosen["worst_mse"].notna().any() else "expected_mse"
    return [*chosen.sort_values(error, kind="stable")["name"]]
