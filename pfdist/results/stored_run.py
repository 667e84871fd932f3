"""The tables of a run as DataFrames: those that files hold, and those that follow from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from pfdist.common.measurement_times import Times
from pfdist.common.nearest import did_you_mean
from pfdist.common.section import Arguments, Whole
from pfdist.errors import ArgumentError, JobError, StoreError, shown
from pfdist.filters.engines import is_exact
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.problem.job import Job
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.scenarios_section import Scenarios
from pfdist.results.budget_curve import budget_table, with_bounds
from pfdist.results.gains import BLOCK, ComparisonStatistics, Gain, relative_gain
from pfdist.results.pairs import pairs_table, ranks_table
from pfdist.results.particle_loss import ParticleLoss, particle_loss
from pfdist.results.reference import references_of, without_number
from pfdist.store import QUESTIONS, Store, check_entries, read_run, unreadable
from pfdist.store.schema import KEYS

if TYPE_CHECKING:
    import pandas as pd

_OF_THE_SET = ["position", "name", "measurement_times"]


class _Rows(Arguments):
    draws: Annotated[Whole, Field(ge=1, le=2**62)]  # more than any table has


class StoredRun:
    """The tables of a run, read from its folder."""

    def __init__(self, path: Path, made_from: Job | None = None) -> None:
        check_entries(path)
        self._about, self.job = read_recorded(path)
        self.path = path
        self._made_from = made_from
        self._store = Store(path)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables that the run has, those of its files first."""
        stored = [name for name in KEYS if self._store.has(name)]
        computed = [name for name in COMPUTED if name != "scenarios" or name in self.job]
        return (*stored, *(computed if "comparison" in stored else []))

    def table(self, name: str, draws: int | None = None) -> pd.DataFrame:
        """A table of the run, by its name.

        The manual lists all tables and their columns under "Files and tables of a run".

        Parameters
        ----------
        name : str
            One of `tables`.
        draws : int, optional
            Read only so many first draws of a table that has a row for each draw.

        Returns
        -------
        DataFrame
            Its ``attrs["labels"]`` have labels of columns, and ``attrs["sets"]`` the names of the
            compared sets, the reference first.

        Raises
        ------
        ArgumentError
            No table has this name, or the table has no rows of draws.
        StoreError
            The run has no such table yet, or a file cannot be read.
        """
        if name not in TABLES:
            raise ArgumentError(
                f"a table must be one of {', '.join(TABLES)}, got {shown(name)}"
                f"{did_you_mean(name, TABLES)}",
                argument="name",
            )
        if draws is not None:
            draws = _Rows(draws=draws).draws
            if name != "gains" and "draw" not in KEYS.get(name, []):
                raise ArgumentError(f"the table {name} has no rows of draws", argument="draws")
        if not (self._store.has(name) if name in KEYS else name in self.tables):
            has = ", ".join(self.tables) or "none yet"
            raise StoreError(f"the run {self.path} has no table {name!r}; it has: {has}")
        if name == "gains":
            table = gains_of(self, draws)
        elif name in COMPUTED:
            table = COMPUTED[name](self)
        else:
            table = self._store.compared() if name == "compared" else self._store.read(name, draws)
        if self._store.has("compared"):
            table.attrs["sets"] = self.names
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
    def references(self) -> dict[str, str]:
        """The reference of each compared set that is no reference, by name.

        In a run of several numbers of measurements it has as many measurements as the set.
        """
        return references_of(self.names, self.job)

    @property
    def draws_compared(self) -> int:
        """Number of draws that every set has filtered."""
        return sum(map(len, self._store.numbers("comparison", "draw")))

    @property
    def state(self) -> str:
        """``searching``, ``comparing`` or ``finished``."""
        if not self._store.has("compared"):
            return "searching"
        if self._store.has_parts(without=QUESTIONS):
            return "comparing"
        half_width = self.job["comparison"]["until"]["half_width"]
        enough = self.draws_compared == self.job["comparison"]["draws"] or (
            half_width > 0 and statistics_of(self).half_width() <= half_width
        )
        online = sum(map(len, self._store.numbers("online", "draw")))
        wanted = self.job.get("online", {}).get("draws", 0)
        return "finished" if enough and online >= wanted else "comparing"

    @cached_property
    def _problem(self) -> ProblemSection:
        return ProblemSection.model_validate(self.job["problem"])

    @cached_property
    def _distrusts(self) -> dict[str, str]:
        """Reason for each search that was run again, by its name."""
        rows = self.table("compared")
        rows = rows[rows["distrust"].notna()]
        names = [without_number(str(name), self.job) for name in rows["name"]]
        return dict(zip(names, rows["distrust"].astype(str), strict=True))


def read_recorded(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Content of run.json, and the job of job.toml, which is validated as every job is.

    Raises
    ------
    StoreError
        The folder holds no run, or a file cannot be read or is damaged.
    """
    run, job = read_run(path)
    try:
        identity = Job(**job).identity()  # with every key, even if the file lacks some
    except JobError as error:
        raise unreadable(path, "job.toml", str(error)) from error
    return run, identity


# --- facts about a run ----------------------------------------------------------------------------


def job_of(run: StoredRun) -> Job | None:
    """The job, with its models, from which this process made the run; None of an opened run."""
    return run._made_from


def version_of(run: StoredRun) -> str:
    """Version of pfdist that started the run."""
    return str(run._about["pfdist"])


def problem_of(run: StoredRun) -> ProblemSection:
    """The section [problem] of the job, with the clock and the constraints."""
    return run._problem


def named_sets(run: StoredRun) -> list[str]:
    """Names of the sets that the job gives by name; the reference may be among them."""
    return [name for name in run.sets if name in run.job["comparison"].get("sets", {})]


def found_sets(run: StoredRun) -> list[str]:
    """Names of the sets that searches have found."""
    named = named_sets(run)
    return [name for name in run.references if name not in named]


def check_one_number(run: StoredRun) -> None:
    """Raise a `StoreError` if the run has times of several numbers of measurements."""
    if "budget" in run.job:
        raise StoreError(
            f"{run.path} has times of several numbers of measurements: give a run of one"
        )


def filter_is_wrong(run: StoredRun) -> bool:
    """Whether the filter's model is not the truth."""
    is_told = run.job.get("scenarios", {}).get("filter", "told") == "told"
    return bool(run._about["filter_model"]) or not is_told


def distrust_of(run: StoredRun, search: str) -> str | None:
    """Why a search was run again by the squared error; None if it was not."""
    return run._distrusts.get(search)


def own_estimation(run: StoredRun, search: str) -> dict[str, Any]:
    """How a search estimates otherwise than the comparison: particles, resampling, estimator.

    If a search was run again by the squared error, this is the estimation of the second time.
    """
    compared = {**run.job["filter"], "estimator": SQUARED_ERROR.name}
    own = run._about["estimations"].get(search, {})
    if search in run._distrusts:
        own = {"resampling": own.get("resampling", compared["resampling"])}
    return {key: value for key, value in own.items() if key in compared and value != compared[key]}


def copies_of(run: StoredRun) -> dict[str, list[int]]:
    """The copies of each evaluation of a search, in all its phases, by the name of the search."""
    if not run._store.has("evaluations"):
        return {}
    rows = run.table("evaluations")
    names = rows["phase"].astype(str).str.partition(".")[0]
    return {str(name): copies.tolist() for name, copies in rows["copies"].groupby(names)}


def killed_of(run: StoredRun) -> dict[str, int]:
    """How many evaluated sets of each phase degenerate draws have killed, if they killed any."""
    rows, policy = run.table("evaluations"), run.job["evaluation"]["degenerate_draws"]
    searches = {each["name"]: each["evaluation"] for each in run.job.get("search", ())}
    kills = [n for n, own in searches.items() if own.get("degenerate_draws", policy) == "kill"]
    killed = rows[rows["phase"].isin(kills) & (rows["degenerate_draws"] > 0)]
    return {str(phase): int(n) for phase, n in killed.groupby("phase")["copies"].sum().items() if n}


def blocks_of(run: StoredRun) -> Iterator[pa.Table]:
    """The comparison in tables of as many draws each, so that memory does not grow."""
    return run._store.blocks("comparison", "draw", BLOCK)


def _errors_of(run: StoredRun) -> Iterator[tuple[NDArray[Any], NDArray[Any], pa.Table]]:
    """Per-draw MSE, and whether each draw is degenerate, (D, S); and the rows of the block."""
    for rows in blocks_of(run):
        mse, degenerate = (
            np.stack([rows[f"{start}_{name}"].to_numpy() for name in run.sets], axis=1)
            for start in ("mse", "degenerate")
        )
        yield mse, degenerate, rows


def statistics_of(run: StoredRun) -> ComparisonStatistics:
    """Statistics of all compared draws; memory does not grow with the draws."""
    statistics = ComparisonStatistics(run.names, run.draws_compared, run.references)
    for mse, degenerate, _ in _errors_of(run):
        statistics.add(mse, degenerate)
    return statistics


def last_bounds(run: StoredRun) -> dict[str, dict[str, Any]]:
    """The proof of most compared draws, then most particle-steps, by the set's name."""
    if not run._store.has("bound"):
        return {}
    rows = run.table("bound").sort_values(["compared_draws", "steps"], kind="stable")
    last = rows.groupby("name").tail(1)
    proofs = last.drop(columns=_OF_THE_SET).to_dict("records")
    for proof in proofs:
        for key in proof.keys() & {"path", "shares"}:
            proof[key] = proof[key].tolist()
    return dict(zip(last["name"], proofs, strict=True))


def exact_costs(run: StoredRun) -> dict[str, float]:
    """The exact expected MSE of each compared set whose tables hold it, by name.

    The searches know it of the sets that they have found. That of the reference is known once
    ``pfdist bound`` or ``pfdist why`` has computed it. If the engine needs draws, nothing is known
    exactly.
    """
    if not is_exact(run.job["filter"]["engine"]):
        return {}
    rows = run.table("compared")
    costs = dict(zip(rows["name"], rows["search_cost"], strict=True))
    if "exact_mse" in rows:  # a run with sets that its job names
        given = rows[rows["exact_mse"].notna()]
        costs |= dict(zip(given["name"], given["exact_mse"], strict=True))
    if run._store.has("profile"):
        profile = run.table("profile")
        counts = profile["weight"] != 0.0  # an error that does not count may be infinite
        profile["error"] = (profile["error"] * profile["weight"]).where(counts, 0.0)
        costs |= profile.groupby("name")["error"].mean().to_dict()
    if run._store.has("bound"):
        proved = run.table("bound").drop_duplicates("name", keep="last")
        costs |= dict(zip(proved["name"], proved["expected_mse"], strict=True))
    return {str(name): float(cost) for name, cost in costs.items() if not math.isnan(cost)}


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


def budget_of(run: StoredRun, statistics: ComparisonStatistics | None = None) -> pd.DataFrame:
    """A row for each compared set: a number of measurements with a kind of times.

    The kinds are ``found`` (by a search), ``regular`` (or ``reference``, if the job gives its
    times) and ``given`` (the other sets that the job names).

    The columns are kind, measurements, name, measurement_times, expected_mse (on fresh draws),
    standard_error, low and high (ends of the 95 % interval), draws, degenerate_draws,
    top_percent_share (the share of expected_mse that 1 % of the draws carry), search_cost and
    search_standard_error (what the search believed), and worse_than. The last is the best smaller
    number of measurements of the same kind, if it is better on common draws. The intervals of all
    such differences hold together with 95 %.

    Three columns more say what any feasible times of this number can reach: bound (lower bound of
    the expected MSE), bound_error (standard error), and bound_low (one-sided limit of the bound).
    The limits of all numbers hold together with 95 %. Exact engines have no error. The three are
    NaN where there is no bound, as for the regular times of a budget curve.
    """
    reference = without_number(run.names[0], run.job)
    statistics = statistics or statistics_of(run)
    table = budget_table(run.table("compared"), statistics, blocks_of(run), reference)
    return with_bounds(table, last_bounds(run))


def pairs_of(run: StoredRun) -> pd.DataFrame:
    """A row for each pair of compared sets, on the same draws.

    The columns are first and second (names); draws; difference (expected MSE of the first less
    that of the second) with low and high (95 %, Student's t, of the paired differences);
    simultaneous_low and simultaneous_high (with 95 % the intervals of all pairs hold together, by
    Bonferroni); clear (whether the simultaneous interval leaves out 0); gain_of_means (by which
    share of the second expected MSE the first is lower; negative if it is higher, so its sign is
    opposite to that of difference) with gain_of_means_low and gain_of_means_high (95 %, Fieller's);
    first_wins (share of the draws in which the first has the lower MSE) with
    first_wins_low and first_wins_high (95 %, Wilson's). Where an engine knows both expected MSEs
    without draws, difference and gain_of_means are exact, and all their limits are equal.
    """
    return pairs_table(run.names, (block for block, *_ in _errors_of(run)), exact_costs(run))


def ranks_of(run: StoredRun) -> pd.DataFrame:
    """A row for each compared set, the lowest expected MSE first.

    The columns are name; expected_mse and standard_error; best_rank (1 plus the number of sets that
    are clearly better) and worst_rank (the number of sets less those that are clearly worse), as
    the table ``pairs`` defines clear; difference (expected MSE less that of the first row) with low
    and high (95 %, of this pair alone). With 95 % the true ranks of all sets lie from best_rank to
    worst_rank.
    """
    costs = {
        name: (each.mean, each.standard_error) for name, each in statistics_of(run).mse.items()
    }
    costs |= {name: (cost, 0.0) for name, cost in exact_costs(run).items()}
    return ranks_table(pairs_of(run), costs)


def scenarios_of(run: StoredRun) -> pd.DataFrame:
    """A row for each scenario of the job and each compared set.

    The columns are scenario (its number, from 0), share and parameters; name (of the set); draws
    and degenerate_draws, expected_mse and standard_error in this scenario; and
    gain_of_means over the reference with gain_of_means_low and gain_of_means_high (95 %, Fieller's,
    for one scenario alone).
    """
    scenarios = Scenarios.model_validate(run.job["scenarios"]).each
    statistics = [ComparisonStatistics(run.names, references=run.references) for _ in scenarios]
    for mse, degenerate, rows in _errors_of(run):
        numbers = rows["scenario"].to_numpy()
        for number, of_scenario in enumerate(statistics):
            of_scenario.add(mse[numbers == number], degenerate[numbers == number])
    table = []
    for number, (scenario, each) in enumerate(zip(scenarios, statistics, strict=True)):
        for name, moments in each.mse.items():
            gain = each.gains.get(name, Gain())  # the reference has none
            low, high = gain.of_means_interval
            row = {
                "scenario": number,
                "share": scenario.share,
                "parameters": dict(scenario.parameters),
                "name": name,
                "draws": moments.count,
                "degenerate_draws": each.degenerate_draws[name],
                "expected_mse": moments.mean,
                "standard_error": moments.standard_error,
                "gain_of_means": gain.of_means,
                "gain_of_means_low": low,
                "gain_of_means_high": high,
            }
            table.append(row)
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    return pd.DataFrame(table)


def worst_of(run: StoredRun) -> dict[str, dict[str, Any]]:
    """The expected_mse, standard_error and draws of each set in its worst scenario, by name."""
    rows = scenarios_of(run).sort_values("expected_mse").groupby("name").tail(1)
    columns = rows.set_index("name")[["expected_mse", "standard_error", "draws"]]
    return {str(name): dict(row) for name, row in columns.iterrows()}


def particle_losses_of(
    run: StoredRun, statistics: ComparisonStatistics | None = None
) -> dict[str, ParticleLoss]:
    """The loss by the number of particles with each compared set, by name.

    It is empty for exact engines, errors other than the squared norm, and several numbers of
    measurements.
    """
    if not (run._store.has("filter_distance") and run._store.has("filter_variance")):
        return {}
    rows = run.table("filter_distance").merge(run.table("filter_variance"), on="draw")
    rows = rows.merge(run.table("comparison", int(rows["draw"].max()) + 1), on="draw")
    particles, whole = run.job["filter"]["particles"], (statistics or statistics_of(run)).mse
    return {
        name: particle_loss(
            particles,
            whole[name],
            *(rows[f"{start}_{name}"].to_numpy() for start in ("mse", "distance", "variance")),
        )
        for name in run.sets
    }


COMPUTED: dict[str, Callable[[StoredRun], pd.DataFrame]] = {
    "gains": gains_of,
    "budget": budget_of,
    "pairs": pairs_of,
    "ranks": ranks_of,
    "scenarios": scenarios_of,
}
"""Tables that follow from others, by name; the docstring of each function names the columns."""

TABLES = (*KEYS, *COMPUTED)
"""Names of all tables that a run may have."""
