"""The results of a run as one record, which `pfdist status --json` prints."""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from textwrap import shorten
from typing import Any, TypeVar

from pfdist.common.clock import Time
from pfdist.common.formatted_times import formatted_times
from pfdist.common.rounding import with_error
from pfdist.errors import relative
from pfdist.filters.engines import is_exact
from pfdist.results.belief import belief_of
from pfdist.results.budget_curve import FOUND
from pfdist.results.gains import gain_over_itself
from pfdist.results.online import online_draws
from pfdist.results.particle_loss import hardly_measured
from pfdist.results.reference import described, without_number
from pfdist.results.stored_run import (
    StoredRun,
    budget_of,
    copies_of,
    exact_costs,
    last_bounds,
    named_sets,
    particle_losses_of,
    problem_of,
    read_recorded,
    statistics_of,
    worst_of,
)

Ends = list[float | None]
Row = dict[str, Any]
T = TypeVar("T")
_MOST_LETTERS = 60  # of the times in the `repr` of a set


def _unknown() -> Ends:
    return [None, None]


@dataclass(frozen=True, kw_only=True, repr=False)
class SetResult:
    """The results of one set of times.

    None stands for a value that is infinite or unknown, or that such a set does not have. Fractions
    are not in per cent, and intervals hold with 95 %.

    Parameters
    ----------
    kind, measurement_times, expected_mse, standard_error, low, high, draws, degenerate_draws
        As of the table ``budget``, like worse_than, bound, bound_error and bound_low. Only
        the times are known before the comparison has begun, and the next two fields.
    cost : float or None
        Total cost of the measurements, where the job has a total cost.
    search_cost, search_standard_error : float or None
        The search that found the set believed this cost of it.
    search_excess, search_estimation, search_cause, search_distrust
        search_cost over expected_mse (over that of the worst scenario, where it decides), less 1;
        how the search estimated otherwise than the comparison; why the two are not equal; and why
        the search was run again by the squared error, or None.
    top_percent_share : float or None
        The share of expected_mse that 1 % of the draws carry; None with fewer than 100 draws. Above
        0.25 the standard error and the intervals are too small.
    gain_draws, mean_relative_gain, positive_fraction, gain_of_means, mean_log10_ratio, quantiles
        The gain over the reference with as many measurements; see `GainSummary`.
    gains_disagree : bool
        `GainSummary.disagree`.
    gain_over_itself, gain_over_itself_interval, gain_over_itself_draws
        Known of a reference alone; see `pfdist.results.gains.gain_over_itself`.
    particle_loss, particle_loss_error : float or None
        The loss by a finite number of particles, by two filters, as a fraction of expected_mse. It
        is known where the engine has particles and the error is the squared norm.
    particle_loss_at_most, particle_loss_at_most_error, particle_loss_limit : float or None
        A value that is at least this loss, its standard error, and its 95 % limit.
    unmeasured_mse : float or None
        The exact filter's expected MSE without a measurement.
    lower_bound : dict or None
        Columns of the table ``bound``, of the proof of most compared draws, then of most
        particle-steps.
    exact_mse, exact_gain : float or None
        An exact engine knows the expected MSE, and 1 less its ratio to that of the reference. Those
        of the reference are known if the job names sets, if a lower bound was proved, or if
        ``pfdist why`` has computed them.
    description, broken_constraints : str and list of str
        A phrase about the reference, or a set that the job names, and the constraints of the job
        that it breaks (see `pfdist.problem.problem_section.ProblemSection.broken`).
    warnings : list of str
        Sentences.
    """

    measurement_times: list[Time]
    measurements: int
    search_cost: float | None
    search_standard_error: float | None
    cost: float | None = None
    kind: str = ""
    expected_mse: float | None = None
    standard_error: float | None = None
    low: float | None = None
    high: float | None = None
    draws: int = 0
    degenerate_draws: int = 0
    top_percent_share: float | None = None
    worse_than: int | None = None
    bound: float | None = None
    bound_error: float | None = None
    bound_low: float | None = None
    search_excess: float | None = None
    search_estimation: Row = field(default_factory=dict)
    search_cause: str | None = None
    search_distrust: str | None = None
    gain_draws: int | None = None
    mean_relative_gain: float | None = None
    mean_relative_gain_interval: Ends = field(default_factory=_unknown)
    positive_fraction: float | None = None
    positive_fraction_interval: Ends = field(default_factory=_unknown)
    gain_of_means: float | None = None
    gain_of_means_interval: Ends = field(default_factory=_unknown)
    mean_log10_ratio: float | None = None
    mean_log10_ratio_interval: Ends = field(default_factory=_unknown)
    quantiles: dict[str, float | None] = field(default_factory=dict)
    gains_disagree: bool = False
    gain_over_itself: float | None = None
    gain_over_itself_interval: Ends = field(default_factory=_unknown)
    gain_over_itself_draws: int | None = None
    particle_loss: float | None = None
    particle_loss_error: float | None = None
    particle_loss_at_most: float | None = None
    particle_loss_at_most_error: float | None = None
    particle_loss_limit: float | None = None
    unmeasured_mse: float | None = None
    lower_bound: Row | None = None
    exact_mse: float | None = None
    exact_gain: float | None = None
    description: str = ""
    broken_constraints: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        mse = with_error(self.expected_mse, self.standard_error)
        listed = shorten(formatted_times(self.measurement_times), _MOST_LETTERS, placeholder=" ...")
        return f"<{self.measurements} measurements, expected MSE {mse}: t = {listed}>"

    @property
    def is_compared(self) -> bool:
        """Whether the comparison has begun: all sets filter the same fresh draws."""
        return self.kind != ""

    @property
    def is_found(self) -> bool:
        """Whether a search has found the set."""
        return self.search_cost is not None


@dataclass(frozen=True)
class Summary:
    """How far a run is, and what it has found.

    Parameters
    ----------
    state, run : str
        ``searching``, ``comparing`` or ``finished``; the run's folder.
    evaluations : int
        Copies counted.
    draws_compared : int
    has_budget : bool
        Whether the run has times of several numbers of measurements.
    is_exact : bool
        Whether the engine knows expected MSEs without draws.
    is_constrained : bool
        Whether the job excludes some times, beside their number or cost.
    time_unit : str or None
        That of the job's clock; None without a clock.
    instant_weights : list of float or None
        The weight of each instant's error in the MSE, with mean 1, if there are weights.
    results : dict of str to SetResult
        The results of each set by name, the reference first.
    online : dict or None
        Results of times that were chosen one after another: draws, degenerate_draws (with the
        online times, the plan or the reference), expected_mse and
        standard_error of the online times, and differs_from_plan (share of draws whose times are
        not those of the plan). The plan is the set of the first search. Under ``plan`` and
        ``reference`` stand name, expected_mse and standard_error on these draws, difference
        (expected MSE of the online times, less that of the set) with difference_interval (95 %,
        Student's t, of the paired differences), and the fields of `GainSummary` for the gain of
        the online times over the set.
    pairs, ranks : list of dict or None
        Rows of the tables ``pairs`` and ``ranks``, if the job names sets.
    scenarios : list of dict or None
        Rows of the table ``scenarios``, if the job has scenarios.
    is_worst : bool
        Whether the job asks for the least expected MSE in the worst scenario.
    unproved : str
        Why found sets have no lower bound, although one was asked for, and which command proves
        one; empty if nothing is to be said.
    """

    state: str
    run: str
    evaluations: int
    draws_compared: int
    has_budget: bool
    is_exact: bool
    is_constrained: bool
    time_unit: str | None
    instant_weights: list[float] | None
    results: dict[str, SetResult]
    online: Row | None
    pairs: list[Row] | None
    ranks: list[Row] | None
    scenarios: list[Row] | None = None
    is_worst: bool = False
    unproved: str = ""

    @property
    def by_error(self) -> list[str]:
        """Names of the found sets, or of all sets of a run without a search, the best first.

        Exact errors decide if the engine knows them, and else the errors on the compared draws.
        If the worst scenario decides, the errors are those of each set's worst scenario. Sets whose
        error is unknown or infinite come last. The run has one number of measurements.
        """
        found_results = {name: result for name, result in self.results.items() if result.is_found}
        errors = {
            name: result.exact_mse if self.is_exact else result.expected_mse
            for name, result in (found_results or self.results).items()
        }
        if self.is_worst and self.scenarios:
            worst = {name: self.worst_scenario(name) for name in errors}
            errors = {name: row["expected_mse"] if row else None for name, row in worst.items()}
        return sorted(errors, key=lambda name: (errors[name] is None, errors[name] or 0.0))

    def worst_scenario(self, name: str) -> Row | None:
        """The scenario with the largest expected MSE of a set, as a row; None if one is unknown."""
        rows = [row for row in self.scenarios or [] if row["name"] == name]
        if any(row["expected_mse"] is None for row in rows):
            return None
        return max(rows, key=lambda row: float(row["expected_mse"]))

    def as_json(self) -> Row:
        """All fields; those of each set as a dict."""
        return asdict(self)


def summary_of(run: StoredRun) -> Summary:
    """How far a run is, and what it has found.

    Parameters
    ----------
    run : StoredRun
    """
    tables, problem = run.tables, problem_of(run)
    compared = "comparison" in tables
    named = compared and bool(named_sets(run))
    scenarios = run.job.get("scenarios", {})
    results = _results(run) if "compared" in tables else {}
    return Summary(
        state=run.state,
        run=str(run.path),
        evaluations=sum(map(sum, copies_of(run).values())),
        draws_compared=run.draws_compared,
        has_budget="budget" in run.job,
        is_exact=is_exact(run.job["filter"]["engine"]),
        is_constrained=problem.is_constrained,
        time_unit=problem.clock.unit if problem.has_clock else None,
        instant_weights=[*problem.weights] if problem.weights else None,
        results=results,
        online=finite(online_draws(run).summary()) if compared and "online" in tables else None,
        pairs=_rows(run, "pairs") if named else None,
        ranks=_rows(run, "ranks") if named else None,
        scenarios=_rows(run, "scenarios") if compared and scenarios else None,
        is_worst=bool(scenarios) and scenarios["criterion"] == "worst",
        unproved=_unproved(run, results),
    )


def _unproved(run: StoredRun, results: Mapping[str, SetResult]) -> str:
    """Why found sets have no lower bound; see `Summary.unproved`."""
    proofs = {name: each.lower_bound for name, each in results.items() if each.is_found}
    noted = read_recorded(run.path)[0]["provenance"].get("unproved")
    if noted and not any(proofs.values()):
        return f"Not proved: {noted}."
    names = defaultdict[str, list[str]](list)
    for name, proof in proofs.items():
        names[proof["reason"] if proof else ""].append(name)
    return " ".join(
        f"Not proved for {', '.join(each)}: {why}." for why, each in names.items() if why
    )


def _rows(run: StoredRun, table: str) -> list[Any]:
    """Rows of a table, as JSON can hold them."""
    return finite(run.table(table).to_dict("records"))


def _results(run: StoredRun) -> dict[str, SetResult]:
    """The result of each set by name, the reference first."""
    results = _compared(run) if "comparison" in run.tables else _before_the_comparison(run)
    proofs = last_bounds(run)
    for name, columns in proofs.items():
        results[name]["lower_bound"] = columns
    problem = problem_of(run)
    if problem.total_cost is not None:
        for result in results.values():
            instants = problem.clock.measurements(result["measurement_times"])
            cost = problem.feasible.cost_of(instants)
            result["cost"] = cost if isinstance(cost, int) else float(cost)
    exact = exact_costs(run)
    for name, mse in exact.items():
        results[name]["exact_mse"] = mse
    for name, reference in run.references.items():
        if exact.get(reference):
            results[name]["exact_gain"] = 1 - exact[name] / exact[reference]
    return {name: SetResult(**finite(columns)) for name, columns in results.items()}


def _compared(run: StoredRun) -> dict[str, Row]:
    """Costs of each set, facts about it, and its gains over its reference."""
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    results, statistics = dict[str, Row](), statistics_of(run)
    is_worst = run.job.get("scenarios", {}).get("criterion") == "worst"
    worst = worst_of(run) if is_worst else {}
    for row in budget_of(run, statistics).to_dict("records"):
        result: Row = {str(key): value for key, value in row.items()}
        name, worse_than = result.pop("name"), result["worse_than"]
        result["worse_than"] = None if pd.isna(worse_than) else worse_than
        if result["kind"] == FOUND:
            result |= belief_of(run, without_number(name, run.job), result | worst.get(name, {}))
        elif "budget" not in run.job:
            result |= described(run.job, name, tuple(result["measurement_times"]))
        if name in statistics.gains:
            result |= statistics.gains[name].summary().columns()
        else:
            result |= _gain_over_itself(run)
        results[name] = result
    losses = particle_losses_of(run, statistics)
    unmeasured = float(run.table("filter_variance")["unmeasured"].mean()) if losses else math.nan
    for name, loss in losses.items():
        hardly = hardly_measured(results[name]["expected_mse"], unmeasured)
        warnings = [loss.warning, hardly if name in statistics.gains else ""]
        results[name] |= loss.columns() | {"unmeasured_mse": unmeasured}
        results[name]["warnings"] = [text for text in warnings if text]
    return results


def _gain_over_itself(run: StoredRun) -> Row:
    """The effect of filter noise alone on a gain, if the reference was filtered twice."""
    if "repeated" not in run.tables:
        return {}
    again = run.table("repeated")
    last = int(again["draw"].max()) + 1
    both = again.merge(run.table("comparison", last), on="draw")
    gain = gain_over_itself(both[f"mse_{run.names[0]}"].to_numpy(), both["mse"].to_numpy())
    return {
        "gain_over_itself": gain.mean,
        "gain_over_itself_interval": gain.estimate.interval(),
        "gain_over_itself_draws": gain.count,
    }


def _before_the_comparison(run: StoredRun) -> dict[str, Row]:
    """Times of each set, and the cost that its search believed."""
    return {
        str(entry["name"]): {
            "measurement_times": entry["measurement_times"].tolist(),
            "measurements": len(entry["measurement_times"]),
            "search_cost": float(entry["search_cost"]),
            "search_standard_error": float(entry["search_standard_error"]),
        }
        for entry in run.table("compared").to_dict("records")
    }


def finite(value: T) -> T:
    """The same value for JSON: None for floats that are not finite, lists, and relative paths."""
    plain: Any = relative(value) if isinstance(value, str) else value
    if isinstance(value, dict):
        plain = {key: finite(inner) for key, inner in value.items()}
    elif isinstance(value, list | tuple):
        plain = [finite(inner) for inner in value]
    elif isinstance(value, float) and not math.isfinite(value):
        plain = None
    return plain  # type: ignore[no-any-return]
