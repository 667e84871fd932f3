"""One table of sets: a row a set, a column a result."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from pfdist.common.estimate import CLEAR_ERRORS, Estimate
from pfdist.common.measurement_times import EVEN, REGULAR
from pfdist.common.percent import HEAVY
from pfdist.errors import reason_of
from pfdist.filters.aspects import VARIANCE
from pfdist.filters.criterion import CriterionValue
from pfdist.filters.estimate import Evaluation
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.clock import Time
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.set_key import set_key_of
from pfdist.results.budget_curve import FOUND, GIVEN, add_bounds, worse_than
from pfdist.results.columns import COLUMNS, Results, Row, frame_of_sets
from pfdist.results.criteria import columns_of_criteria
from pfdist.results.evenly_spaced import columns_of_even_times
from pfdist.results.moments import (
    ComparisonStatistics,
    Moments,
    controlled_mse,
    relative_gain,
)
from pfdist.results.particle_loss import hardly_measured, lost_text, particle_losses_of
from pfdist.results.stored_run import (
    StoredRun,
    angles_of,
    blocks_of,
    copies_of,
    criterion_of,
    last_bounds,
    measured_of,
    on_common_draws,
    own_estimation,
    problem_of,
    provenance_of,
    statistics_of,
    values_of,
)
from pfdist.results.summary import keep_summary, read_summary, summary_of
from pfdist.store.about import unreadable
from pfdist.store.schema import components_in

if TYPE_CHECKING:
    import pandas as pd

_ROUNDING = 1e-9
_EXACT = "exact"
_CHOSE, _CHANCE = "its draws chose the set", "within chance"
_UNDERESTIMATES = "the search's filter underestimates its error"
_TOO_FEW = (
    "The mean of mse - control is not above 0: there are too few draws to know a gain or the "
    "size of the error."
)
_BEATEN = 3.0  # standard errors by which another set is better than those that searches found
_ERRS_MORE = "the search's filter has a larger error than the job's"


def sets_of(run: StoredRun) -> pd.DataFrame:
    """A row for each compared set, the reference first, with all results of the set.

    The first ten columns are those to look at: ``table.iloc[:, :10]``, which a notebook shows.
    The table has times once the searches have ended, and results of draws once the comparison has
    begun. Fractions are not in per cent. With an exact engine, expected_mse has the standard_error
    0, and gain_of_means has an interval of one point.
    """
    return frame_of_sets(_computed(run) if (known := summary_of(run)) is None else known.sets)


def _computed(run: StoredRun) -> list[Row]:
    rows = {row.name: row for row in _given(run)}
    has_results = run._store.has("comparison")
    if has_results:
        _add_results(run, rows, statistics_of(run))
        add_bounds(rows.values(), last_bounds(run))
    rows = {name: row.plain() for name, row in rows.items()}
    if has_results:
        for name, number in worse_than(rows.values(), blocks_of(run)).items():
            rows[name].worse_than = number
        for name in _beating(run, [*rows.values()]):
            rows[name].beats_search = True
    return [*rows.values()]


def publish_sets(run: StoredRun) -> None:
    """Keep the table of sets in a file, unless it is there; the caller holds the run's lock."""
    with contextlib.suppress(Exception):  # without it, a list takes longer
        if summary_of(run) is None:
            keep_summary(run, _computed(run))


def fault_of_summary(run: StoredRun) -> str:
    """The fault in the listed file of the table of sets; empty if there is none."""
    try:
        known = read_summary(run)
    except Exception as error:  # the same errors as in `summary_of`
        return f"cannot be used: {reason_of(error)}"
    is_same = known is None or _agree([*map(vars, known.sets)], [*map(vars, _computed(run))])
    return "" if is_same else "says something else than the tables"


def _agree(known: Any, computed: Any) -> bool:
    """Whether values differ by rounding alone: versions of a library add in other orders."""
    if isinstance(known, float) and isinstance(computed, float):
        return math.isclose(known, computed, rel_tol=1e-9)
    if isinstance(known, Mapping) and isinstance(computed, Mapping):
        return _agree(sorted(known.items()), sorted(computed.items()))
    if isinstance(known, list | tuple) and isinstance(computed, list | tuple):
        return len(known) == len(computed) and all(map(_agree, known, computed))
    return bool(known == computed)


def rows_of_sets(run: StoredRun) -> list[Row]:
    """The rows of the table of sets, the reference first; empty before the searches have ended."""
    if (known := summary_of(run)) is not None:
        return known.sets
    return _computed(run) if run._store.has("compared") else []


def _given(run: StoredRun) -> Iterable[Row]:
    problem, measured = problem_of(run), measured_of(run)
    for entry in run.table("compared").to_dict("records"):
        name, times = str(entry["name"]), entry["measurement_times"].tolist()
        reference, is_found = run.references.get(name), not math.isnan(entry["search_mse"])
        key = set_key_of(name, run.job)
        own_kind = key.origin if reference is None else GIVEN
        row = Row(**dict.fromkeys(COLUMNS))
        row.add({
            "name": name,
            "label": run.labels[name],
            "kind": FOUND if is_found else own_kind,
            "reference": reference,
            "measurements": len(times),
            "budget": int(key.number or len(times)),
            "measurement_times": times,
            "draws": 0,
            "degenerate_draws": 0,
            "broken_constraints": [],
            "warnings": [],
        })  # fmt: skip
        if problem.total_price is not None:
            row.price = float(problem.feasible.price_of(measured[name]))
        if is_found:
            row.add({each: entry[each] for each in ("search_mse", "search_standard_error")})
        elif not has_amounts(run.job):
            row.add(described(run.job, name, tuple(times), problem))
        if not math.isnan(exact := entry.get("exact_mse", math.nan)):
            row.add(_exact("expected_mse", exact) | {"standard_error": 0.0})
        for each in problem.errors_beside:
            if not math.isnan(exact := entry.get(each.exact_column, math.nan)):
                row.add(each.columns(Estimate(exact)))
        yield row


def described(
    job: Mapping[str, Any],
    name: str,
    times: Sequence[Time],
    problem: ProblemSection | None = None,
) -> dict[str, Any]:
    """A description of a set that the job gives, and the constraints of the job that it breaks.

    Parameters
    ----------
    job : mapping
        The run's resolved job.
    name : str
        Name of the set.
    times : sequence of int or float
        Measurement times of the set, on the clock of the job.
    problem : ProblemSection, optional
        The job's section [problem], if it is known.

    Returns
    -------
    dict
        ``description``, a phrase, and ``broken_constraints``, a list of sentences.
    """
    problem = problem or ProblemSection.model_validate(job["problem"])
    feasible, instants = problem.feasible, problem.points.read(times)
    number = f"N = {len(times)}"
    if feasible.total_price is not None:
        number += f", spends {feasible.price_of(instants)} of {feasible.total_price}"
    if name in (job.get("comparison", {}).get("sets") or {}) and name != REGULAR:
        phrase = f"the set that comparison.sets.{name} gives ({number})"
    elif name == EVEN:
        phrase = f"the best evenly spaced times ({number})"
    elif name != REGULAR:
        phrase = f"the set that comparison.reference names ({number})"
    elif feasible.is_regular(instants):
        phrase = f"regular times ({number})"
    elif feasible.spaced:
        phrase = f"evenly spaced {feasible.spaced}, as many as possible ({number})"
    elif feasible.counted:
        phrase = f"the feasible set nearest to regular times ({number})"
    else:
        phrase = f"nearest to regular times of the sets with the most measurements ({number})"
    return {"description": phrase, "broken_constraints": problem.broken(times)}


def _add_errors_beside(run: StoredRun, rows: dict[str, Row]) -> None:
    """Add the values that the job's criterion gives the errors beside that of the job."""
    form = criterion_of(run).mse_criterion
    for error in problem_of(run).errors_beside:
        draws = on_common_draws(run, error.table) if run._store.has(error.table) else pa.table({})
        columns = {name: draws[name].to_numpy() for name in draws.column_names}
        for name, row in rows.items() if columns else ():
            mse, numbers = columns[f"{error.named}_{name}"], columns.get("scenario")
            row.add(error.columns(Evaluation((), mse, scenarios=numbers, criterion=form).estimate))


def _beating(run: StoredRun, rows: Sequence[Row]) -> list[str]:
    """Names of the given sets and opponents that clearly beat every found set, by common draws."""
    judged = [row for row in rows if row.expected_mse is not None and not row.broken_constraints]
    found = [row for row in judged if row.kind == FOUND]
    if not found or has_amounts(run.job) or not criterion_of(run).is_mean:
        return []
    best = min(found, key=lambda row: row.expected_mse)
    others = [row for row in judged if row.kind != FOUND and row.expected_mse < best.expected_mse]
    differences = {row.name: Moments() for row in others}
    for block in blocks_of(run) if others else ():
        for name, moments in differences.items():
            difference = controlled_mse(block, best.name) - controlled_mse(block, name)
            moments.add(difference[~np.isnan(difference)])
    return [
        row.name for row in others
        if (row.standard_error == best.standard_error == 0.0
            and best.expected_mse - row.expected_mse > _ROUNDING * best.expected_mse)
        or differences[row.name].estimate.is_positive(_BEATEN)
    ]  # fmt: skip


def _exact(name: str, value: float) -> Results:
    return {name: value, f"{name}_low": value, f"{name}_high": value}


def _add_results(run: StoredRun, rows: dict[str, Row], statistics: ComparisonStatistics) -> None:
    for name, row in rows.items():
        count, failed = statistics.mse[name].count, statistics.degenerate_draws[name]
        row.add({"draws": count, "degenerate_draws": failed})
        if row.expected_mse is None:
            mse = statistics.estimate(name)
            low, high = mse.interval()
            row.add({"expected_mse": mse.value, "standard_error": mse.standard_error})
            row.add({"expected_mse_low": low, "expected_mse_high": high})
            row.add({"largest_share": statistics.largest_share(name)})
            if statistics.has_control and not mse.value > 0.0:
                row.warnings.append(_TOO_FEW)
        if name in statistics.gains:
            row.add(statistics.gains[name].columns())
    for name, reference in run.references.items():
        of_reference, row = rows[reference], rows[name]
        if row.standard_error == of_reference.standard_error == 0.0:
            gain = relative_gain(*(np.array(each.expected_mse) for each in (row, of_reference)))
            row.add(_exact("gain_of_means", float(gain)))
    _add_errors_beside(run, rows)
    for name, columns in columns_of_criteria(run):
        rows[name].add(columns)
    found = {name: row.expected_mse for name, row in rows.items() if row.kind == FOUND}
    for name, columns in columns_of_even_times(run, found).items():
        rows[name].add(columns)
    _add_typical_errors(run, rows)
    _add_search_errors(run, rows)
    _add_particle_losses(run, rows, statistics)
    _add_lost_constants(run, rows)


def _add_typical_errors(run: StoredRun, rows: dict[str, Row]) -> None:
    """Add the root of each set's expected MSE, by component of z."""
    angles = angles_of(run)
    if not angles:
        return
    shares = _shares(run, angles) if len(angles) > 1 else {name: [1.0] for name in rows}
    for name, row in rows.items():
        errors = [share * row.expected_mse for share in shares.get(name, ())]
        row.typical_error = [*map(typical_error, errors, angles)] if errors else None


def typical_error(error: float, is_angle: bool) -> float:
    """The root of a mean squared error, or the circular deviation for a mean of 1 - cos."""
    if is_angle:
        return math.sqrt(-2.0 * math.log1p(-error)) if error < 1.0 else math.inf
    return math.sqrt(max(0.0, error))


def _shares(run: StoredRun, angles: Sequence[bool]) -> dict[str, list[float]]:
    """The shares of the components of z in the error of each set, by the trajectories."""
    if not run._store.has("trajectories"):
        return {}
    rows, problem = run.table("trajectories"), problem_of(run)
    suffixes = [each.suffix for each in components_in(rows, "z_")]
    if len(angles) != len(suffixes):
        reason = f"provenance.angles must have {len(suffixes)} values, got {len(angles)}"
        raise unreadable(run.path, "run.json", reason)
    weights = dict(zip(problem.clock.times, problem.weights or (), strict=False))
    weight, shares = rows["t"].map(weights) if weights else 1.0, dict[str, list[float]]()
    for name in run.names:
        differences = [rows[f"z_{each}"] - rows[f"estimate_{name}_{each}"] for each in suffixes]
        errors = [
            float((weight * (1 - np.cos(each) if is_angle else each**2)).mean())
            for each, is_angle in zip(differences, angles, strict=True)
        ]
        shares[name] = [error / sum(errors) for error in errors] if sum(errors) else []
    return shares


def _add_search_errors(run: StoredRun, rows: dict[str, Row]) -> None:
    """Add the error of the estimate of the search that found a set, and its cause."""
    values, copies, judged_by = values_of(run), copies_of(run), criterion_of(run).name
    for name, row in rows.items():
        own: Results = {}
        if value := values.get(name):
            row.criterion_value = value.value
            own = {"expected_mse": value.value, "standard_error": value.standard_error}
        elif row.criterion_value is not None:
            judged = CriterionValue(
                *(getattr(row, f"{judged_by}{end}") for end in ("", "_low", "_high"))
            )
            own = {"expected_mse": row.criterion_value, "standard_error": judged.standard_error}
        if row.kind == FOUND:
            search = set_key_of(name, run.job).origin
            row.add(_search_errors(run, search, vars(row) | own, len(copies.get(search, [1]))))


def _search_errors(run: StoredRun, search: str, result: Results, evaluations: int) -> Results:
    """The columns that begin with search_, from a set's errors in the search and on fresh draws."""
    mse = result["expected_mse"]
    comparable = mse != 0.0 and math.isfinite(mse)
    own = own_estimation(run, search)
    return {
        "search_excess": math.copysign(1.0, mse) * (result["search_mse"] / mse - 1.0)
        if comparable
        else math.nan,
        "search_settings": ", ".join(f"{key} = {value}" for key, value in own.items()),
        "search_cause": cause_of_excess(result, own, evaluations),
    }


def cause_of_excess(result: Mapping[str, Any], own: Mapping[str, Any], evaluations: int = 1) -> str:
    """Why a search's estimate differs from the error on fresh draws.

    A search chooses the set with the smallest of many estimates, so the estimate is too low. The
    draws explain a difference up to the likely minimum of as many normal variates.

    Parameters
    ----------
    result : mapping
        With search_mse, search_standard_error, expected_mse and standard_error.
    own : mapping
        Settings in which the search estimates otherwise than the comparison.
    evaluations : int
        Number of evaluations from which the search chose.
    """
    difference = result["search_mse"] - result["expected_mse"]
    error = math.hypot(result["search_standard_error"], result["standard_error"])
    limit = largest_of(evaluations) if difference < 0 and not _is_biased(own) else CLEAR_ERRORS
    rounding = _ROUNDING * abs(result["expected_mse"])  # matters where both errors are exact
    if not abs(difference) > limit * error + rounding:
        return (_CHOSE if difference <= 0 else _CHANCE) if error else _EXACT
    if difference > 0 and own:
        return _ERRS_MORE
    if _is_biased(own):
        return _UNDERESTIMATES
    size = f"{abs(difference) / error:.1f} standard errors" if error else "both are exact"
    return f"unexplained: {size}; `pfdist verify` checks the files"


def largest_of(count: int) -> float:
    """A bound that the largest of so many standard normal variates rarely exceeds.

    It exceeds the bound at most as often as a single variate exceeds `CLEAR_ERRORS` (Boole's
    inequality).

    Examples
    --------
    >>> [round(largest_of(count), 2) for count in (1, 1000, 1_000_000)]
    [4.0, 5.41, 6.54]
    """
    normal = NormalDist()
    return -normal.inv_cdf(normal.cdf(-CLEAR_ERRORS) / max(1, count))


def _is_biased(own: Mapping[str, Any]) -> bool:
    return bool(own.get("estimator", SQUARED_ERROR.name) != SQUARED_ERROR.name)


def _add_particle_losses(
    run: StoredRun, rows: dict[str, Row], statistics: ComparisonStatistics
) -> None:
    losses = particle_losses_of(run, statistics)
    if not losses:
        return
    unmeasured = float(run._store.rows(VARIANCE.table)["unmeasured"].to_pandas().mean())
    # A budget curve has many sets: the largest loss speaks for all.
    worst = max(losses, key=lambda name: losses[name].limit) if has_amounts(run.job) else ""
    for name, loss in losses.items():
        row = rows[name]
        row.add(loss.columns() | {"unmeasured_mse": unmeasured})
        hardly = hardly_measured(row.expected_mse, unmeasured)
        is_heavy = row.largest_share is not None and row.largest_share > HEAVY  # said already
        said = [loss.large, loss.rare * (not is_heavy)]
        warnings = [*said, hardly if name in statistics.gains else ""]
        row.warnings += [text for text in warnings if text and worst in ("", name)]


def _add_lost_constants(run: StoredRun, rows: dict[str, Row]) -> None:
    for name, share in provenance_of(run).get("lost_constants", {}).items():
        rows[name].add({"lost_constants": share})
        rows[name].warnings += [text for text in [lost_text(share)] if text]


def recommended(run: StoredRun) -> Row:
    """The row of the set that answers name first, see `best_first`."""
    rows = rows_of_sets(run)
    name = best_first(rows)[0]
    return next(row for row in rows if row.name == name)


def best_first(sets: Sequence[Row]) -> list[str]:
    """Names of the found sets, or of all sets of a run without a search, the best first.

    A given set or opponent that beats all found ones is one of them. They are ordered by the number
    that the job minimises. Sets of which it is unknown or infinite come last. The run has one
    number of measurements.
    """
    chosen = [row for row in sets if row.kind == FOUND or row.beats_search] or sets

    def error(row: Row) -> float:
        found = row.expected_mse if row.criterion_value is None else row.criterion_value
        return math.inf if found is None else found

    return [row.name for row in sorted(chosen, key=error)]
