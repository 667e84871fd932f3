"""The tables in the files of a run as DataFrames, and tables that follow from them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from copy import deepcopy
from functools import cached_property, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times
from pfdist.common.plugins import hooked
from pfdist.errors import JobError, StoreError
from pfdist.filters.criterion import MEAN, Criterion, WorstScenario, criterion_named
from pfdist.filters.engines import AUTO
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.job import Job
from pfdist.problem.methods import METHODS
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.scenarios_section import Scenarios
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.problem.set_key import labels_of_sets, phrase_of, references_of
from pfdist.results.moments import BLOCK, ComparisonStatistics, Gain, relative_gain
from pfdist.store import QUESTIONS, Store, check_entries, read_run, unusable
from pfdist.store.schema import KEYS

if TYPE_CHECKING:
    import pandas as pd

_OF_THE_SET = ["position", "name", "measurement_times"]


class StoredRun:
    """The tables of a run, read from its folder."""

    def __init__(self, path: Path, made_from: Job | None = None) -> None:
        check_entries(path)
        self._about, self.job = read_recorded(path, made_from)
        self.path = path
        self._made_from = made_from
        self._store = Store(path)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables that the run has in files."""
        there = self._store.tables
        return tuple(name for name in KEYS if name in there)

    def table(self, name: str, draws: int | None = None) -> pd.DataFrame:
        """A table that the run has in files; only its first draws, if `draws` is given."""
        if not self._store.has(name):
            has = ", ".join(self.tables) or "none yet"
            raise StoreError(f"the run {self.path} has no table {name!r}; it has: {has}")
        table = self._store.compared() if name == "compared" else self._store.read(name, draws)
        if self._store.has("compared"):
            table.attrs["sets"] = self.labels
        return table

    @cached_property
    def sets(self) -> dict[str, Times]:
        """All compared sets by name, the reference first; times on the clock of the job."""
        return self._store.compared_sets()

    @property
    def names(self) -> list[str]:
        """Names of the compared sets, the reference first."""
        return [*self.sets]

    @cached_property
    def labels(self) -> dict[str, str]:
        """The compared sets as tables and figures call them, by name."""
        return labels_of_sets(self.names, self.job)

    @cached_property
    def references(self) -> dict[str, str]:
        """The reference of each compared set that is not itself a reference, by name.

        In a run of several numbers of measurements it has as many measurements as the set.
        """
        return references_of(self.names, self.job)

    @property
    def draws_compared(self) -> int:
        """Number of draws that every set has filtered."""
        return sum(map(len, self._store.draws("comparison")))

    @property
    def state(self) -> str:
        """``searching``, ``comparing`` or ``finished``."""
        if not self._store.has("compared"):
            return "searching"
        if self._store.has_parts(without=QUESTIONS):
            return "comparing"
        enough = self.draws_compared == self.job["comparison"]["draws"]
        wanted = {key: self.job.get(key, {}).get("draws", 0) for key in hooked("sections")}
        has = {key: sum(map(len, self._store.draws(key))) for key in wanted if wanted[key]}
        enough = enough and all(has[key] >= wanted[key] for key in has)
        return "finished" if enough else "comparing"

    @cached_property
    def _measured(self) -> dict[str, Times]:
        points = self._problem.points
        return {name: points.read(times) for name, times in self.sets.items()}

    @cached_property
    def _problem(self) -> ProblemSection:
        return ProblemSection.model_validate(self.job["problem"])


def read_recorded(
    path: Path, made_from: Job | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The content of run.json, and the validated job of job.toml, or from which the run was made.

    Raises
    ------
    StoreError
        The folder holds no run, or a file cannot be read or is damaged.
    """
    run, job = read_run(path)
    if made_from is not None and AUTO not in (
        made_from.filter.particles,
        made_from.filter.proposal,
    ):
        return run, made_from.identity()
    lacking, known = [*_lacking_searches(job)], deepcopy(job)
    for section, key, search in lacking:
        known[section][key] = {"method": "random", "name": search.get("name")}
    try:
        identity = Job(**known).identity()  # with every key, even if the file lacks some
    except JobError as error:
        raise unusable(path, "job.toml", str(error)) from error
    for section, key, search in lacking:
        identity[section][key] = search
    return run, identity


def _lacking_searches(job: dict[str, Any]) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """The searches of a job whose methods this process lacks, each with its section and its key."""
    searches, found = job.get("search"), list[tuple[str, Any, Any]]()
    if isinstance(searches, list):
        found += [("search", *each) for each in enumerate(searches)]
    for key in hooked("sections"):
        if isinstance(section := job.get(key), dict) and "search" in section:
            found.append((key, "search", section["search"]))
    for section, key, search in found:
        if isinstance(search, dict) and str(search.get("method", DEFAULT_METHOD)) not in METHODS:
            yield section, key, search


# --- facts about a run ----------------------------------------------------------------------------


def job_of(run: StoredRun) -> Job | None:
    """The job, with its models, from which this process made the run; None for an opened run."""
    return run._made_from


def angles_of(run: StoredRun) -> list[bool]:
    """Whether each component of z is an angle.

    Empty if errors are not in the unit of z, because the model defines its own error, or because
    errors are scaled.
    """
    is_scaled = run.job.get("scenarios", {}).get("scales")
    return [] if is_scaled else [*run._about["provenance"]["angles"]]


def about_of(run: StoredRun) -> dict[str, Any]:
    """The content of run.json as it is now."""
    return read_run(run.path)[0]


def provenance_of(run: StoredRun) -> dict[str, Any]:
    """Where, when and by what the run was computed."""
    provenance: dict[str, Any] = about_of(run)["provenance"]
    return provenance


def version_of(run: StoredRun) -> str:
    """Version of pfdist that started the run."""
    return str(run._about["pfdist"])


def problem_of(run: StoredRun) -> ProblemSection:
    """The section [problem] of the job, with the clock and the constraints."""
    return run._problem


def measured_of(run: StoredRun) -> dict[str, Times]:
    """The points of each compared set, by name."""
    return run._measured


def named_sets(run: StoredRun) -> list[str]:
    """Names of the sets that the job gives by name; the reference may be among them."""
    return [name for name in run.sets if name in run.job["comparison"].get("sets", {})]


def found_sets(run: StoredRun) -> list[str]:
    """Names of the sets that searches have found."""
    named = named_sets(run)
    return [name for name in run.references if name not in named]


def check_one_number(run: StoredRun) -> None:
    """Raise a `StoreError` if the run has times of several numbers of measurements."""
    if has_amounts(run.job):
        raise StoreError(
            f"{run.path} has times of several numbers of measurements: give a run of one number"
        )


def has_scenarios(run: StoredRun) -> bool:
    """Whether each draw has one of several scenarios."""
    return bool(run.job.get("scenarios", {}).get("filter", "learned") != "learned")


def own_estimation(run: StoredRun, search: str) -> dict[str, Any]:
    """Settings in which a search estimates otherwise than the comparison.

    They are particles, resampling and estimator.
    """
    compared = {**run.job["filter"], "estimator": SQUARED_ERROR.name}
    own = run._about["estimations"].get(search, {})
    return {key: value for key, value in own.items() if key in compared and value != compared[key]}


def copies_of(run: StoredRun) -> dict[str, list[int]]:
    """The copies of each evaluation of a search, in all its phases, by the name of the search."""
    if not run._store.has("evaluations"):
        return {}
    rows, copies = run._store.rows("evaluations"), defaultdict[str, list[int]](list)
    for phase, number in zip(rows["phase"].to_pylist(), rows["copies"].to_pylist(), strict=True):
        copies[phase.partition(".")[0]].append(number)
    return copies


def evaluations_of(run: StoredRun) -> int:
    """The number of evaluations of all searches, copies counted."""
    return sum(map(sum, copies_of(run).values()))


def steps_by_part(run: StoredRun) -> dict[str, int]:
    """The particle-steps of all tasks that were computed, by what they are for; most first.

    With an exact engine, the instants of sets.
    """
    store, done = run._store, Counter[str]()
    rows = store.rows("timings").to_pydict() if store.has("timings") else {}
    for part, steps in zip(rows.get("part", ()), rows.get("particle_steps", ()), strict=True):
        done[part] += steps
    return dict(done.most_common())


def unproved(run: StoredRun) -> str:
    """Why found sets have no lower bound, although one was asked for, and which command proves one.

    Empty if there is a lower bound, or if none was asked for.
    """
    proofs = last_bounds(run)
    noted = provenance_of(run).get("unproved")
    found_names = found_sets(run) if run._store.has("compared") else []
    if noted and not any(name in proofs for name in found_names):
        return f"Not proved: {noted}."
    names = defaultdict[str, list[str]](list)
    for name in found_names:
        names[proofs[name]["reason"] if name in proofs else ""].append(run.labels[name])
    return " ".join(
        f"Not proved for {', '.join(map(phrase_of, each))}: {why}."
        for why, each in names.items()
        if why
    )


def killed_of(run: StoredRun) -> dict[str, int]:
    """The number of evaluated sets with an infinite error by degenerate draws, by phase."""
    rows, policy = run.table("evaluations"), run.job["evaluation"]["degenerate_draws"]
    searches = {each["name"]: each["evaluation"] for each in run.job.get("search", ())}
    kills = [n for n, own in searches.items() if own.get("degenerate_draws", policy) == "kill"]
    killed = rows[rows["phase"].isin(kills) & (rows["degenerate_draws"] > 0)]
    return {str(phase): int(n) for phase, n in killed.groupby("phase")["copies"].sum().items() if n}


def blocks_of(run: StoredRun) -> Iterator[pa.Table]:
    """The comparison in tables of `BLOCK` draws each, so that memory does not grow."""
    return run._store.blocks("comparison", BLOCK)


def errors_of(run: StoredRun) -> Iterator[tuple[NDArray[Any], NDArray[Any], pa.Table]]:
    """Per-draw MSE of each set, (D, S), and then its control, (D, 2 S), if there is one.

    The second array marks degenerate draws, (D, S). The third item has the rows of the block.
    """
    starts = ("mse", "control") if run.job["comparison"].get("control") else ("mse",)
    columns = [f"{start}_{name}" for start in starts for name in run.sets]
    for rows in blocks_of(run):
        errors, degenerate = (
            np.stack([rows[name].to_numpy() for name in names], axis=1)
            for names in (columns, [f"degenerate_{name}" for name in run.sets])
        )
        yield errors, degenerate, rows


def on_common_draws(run: StoredRun, *tables: str) -> pa.Table:
    """The columns of some tables and of the comparison, on the draws that all of them have."""
    each = [run._store.rows(table) for table in tables]
    last = min(1 + pc.max(rows["draw"]).as_py() for rows in each)
    each.append(run._store.rows("comparison", last))
    draws = reduce(np.intersect1d, [rows["draw"].to_numpy() for rows in each])
    columns = dict[str, pa.ChunkedArray]()
    for rows in each:
        common = rows.filter(pc.is_in(rows["draw"], pa.array(draws)))
        columns |= dict(zip(common.column_names, common.columns, strict=True))
    return pa.table(columns)


def statistics_of(run: StoredRun) -> ComparisonStatistics:
    """Statistics of all compared draws; memory does not grow with the draws."""
    statistics = ComparisonStatistics(run.names, run.references)
    for mse, degenerate, _ in errors_of(run):
        statistics.add(mse, degenerate)
    return statistics


def last_bounds(run: StoredRun) -> dict[str, dict[str, Any]]:
    """The proof with most compared draws, then most particle-steps, by the name of the set."""
    if not run._store.has("bound"):
        return {}
    rows = run.table("bound").sort_values(["compared_draws", "steps"], kind="stable")
    last = rows.groupby("name").tail(1)
    proofs = last.drop(columns=_OF_THE_SET).to_dict("records")
    for proof in proofs:
        for key in proof.keys() & {"path", "shares"}:
            proof[key] = proof[key].tolist()
    return dict(zip(last["name"], proofs, strict=True))


def exact_errors(run: StoredRun) -> dict[str, float]:
    """The expected MSE of each compared set by name if the engine is exact; otherwise empty."""
    return exact_values(run, "exact_mse")


def exact_values(run: StoredRun, column: str) -> dict[str, float]:
    """The exact values of each compared set in a column, by name; empty if there are none."""
    rows = run.table("compared")
    if column not in rows:
        return {}
    return dict(zip(rows["name"].astype(str), rows[column].astype(float), strict=True))


# --- tables that follow from others ---------------------------------------------------------------


def gains_of(run: StoredRun, draws: int | None = None) -> pd.DataFrame:
    """A row for each draw of the comparison: the relative gain of each set.

    The columns are draw, and gain_NAME for every set over its reference.
    """
    rows = run.table("comparison", draws)
    gains: dict[str, Any] = {"draw": rows["draw"]}
    for name, reference in run.references.items():
        gains[f"gain_{name}"] = relative_gain(
            rows[f"mse_{name}"].to_numpy(), rows[f"mse_{reference}"].to_numpy()
        )
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    return pd.DataFrame(gains)


def scenarios_of(run: StoredRun) -> pd.DataFrame:
    """A row for each scenario of the job and each compared set.

    The columns are scenario (its number, from 0), share and parameters; name (of the set); draws,
    degenerate_draws, expected_mse and standard_error in this scenario; gain_of_means over the
    reference with gain_of_means_low and gain_of_means_high (95 %, Fieller's).
    """
    scenarios = Scenarios.model_validate(run.job["scenarios"]).each
    statistics = [ComparisonStatistics(run.names, references=run.references) for _ in scenarios]
    for mse, degenerate, rows in errors_of(run):
        numbers = rows["scenario"].to_numpy()
        for number, of_scenario in enumerate(statistics):
            of_scenario.add(mse[numbers == number], degenerate[numbers == number])
    table = []
    for number, (scenario, each) in enumerate(zip(scenarios, statistics, strict=True)):
        for name in run.names:
            gain = each.gains.get(name, Gain())  # the reference has none
            (low, high), estimate = gain.of_means_interval, each.estimate(name)
            row = {
                "scenario": number,
                "share": scenario.share,
                "parameters": dict(scenario.parameters),
                "name": name,
                "draws": each.draws,
                "degenerate_draws": each.degenerate_draws[name],
                "expected_mse": estimate.value,
                "standard_error": estimate.standard_error,
                "gain_of_means": gain.of_means,
                "gain_of_means_low": low,
                "gain_of_means_high": high,
            }
            table.append(row)
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    return pd.DataFrame(table)


def criterion_of(run: StoredRun) -> Criterion:
    """The number that the job of a run minimises."""
    if written := run.job["problem"].get("criterion"):
        return criterion_named(written)
    given = run.job.get("scenarios")
    return Scenarios.model_validate(given).form if given else MEAN


def values_of(run: StoredRun) -> dict[str, Estimate]:
    """The error in the worst scenario with each set, if that is what the job minimises."""
    if not isinstance(criterion_of(run), WorstScenario):
        return {}
    rows = scenarios_of(run).sort_values("expected_mse").groupby("name").tail(1)
    columns = rows[["name", "expected_mse", "standard_error", "draws"]]
    return {
        str(name): Estimate(mse, error, draws - 1)
        for name, mse, error, draws in columns.itertuples(index=False)
    }
