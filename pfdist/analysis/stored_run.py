"""A run as pandas DataFrames and as a summary."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.analysis.belief import own_estimation
from pfdist.analysis.bounds import last_bounds
from pfdist.analysis.budget_curve import budget_table, reaching, with_bounds
from pfdist.analysis.exact import exact_costs
from pfdist.analysis.gains import BLOCK, ComparisonStatistics, relative_gain
from pfdist.analysis.pairs import pairs_table, ranks_table
from pfdist.analysis.particle_loss import ParticleLoss, particle_loss
from pfdist.analysis.recorded import read_recorded
from pfdist.analysis.reference import references_of, without_number
from pfdist.analysis.scenarios import scenarios_table
from pfdist.analysis.summary import SetResult, Summary, summary_of
from pfdist.common.percent import cost, percent_with_interval
from pfdist.common.rounding import with_error
from pfdist.documents.notebook import Shown
from pfdist.documents.parts import Cell, Page, Section, Table
from pfdist.errors import StoreError, shown
from pfdist.job.job import Job
from pfdist.job.problem_section import ProblemSection
from pfdist.job.scenarios_section import Scenarios
from pfdist.store import QUESTIONS, Store, check_entries, schema
from pfdist.times.measurement_times import Times

if TYPE_CHECKING:
    import pandas as pd


class Run(Shown):
    """A run on disk, finished or not; made by `open_run`.

    Attributes
    ----------
    path : Path
        Its folder.
    job : dict
        The resolved job.
    made_from : Job or None
        The job from which this process made the run, with its models. None for a run that was
        opened from its folder, which holds no model.
    """

    made_from: Job | None = None

    def __init__(self, path: Path) -> None:
        self._about, self.job = read_recorded(path)
        self.path = path
        self._store = Store(path)

    # --- the tables -------------------------------------------------------------------------------

    def evaluations(self) -> pd.DataFrame:
        """A row for each evaluation: phase, generation, individual, copies, times, expected MSE."""
        return self._store.read("evaluations")

    def draws(self) -> pd.DataFrame:
        """Per-draw MSE of every evaluation: evaluation, draw, mse."""
        return self._store.read("draws")

    def compared(self) -> pd.DataFrame:
        """A row for each compared set: name, measurement times, cost that its search believed."""
        return self._store.compared()

    def comparison(self, draws: int | None = None) -> pd.DataFrame:
        """A row for each draw: draw, and mse_<name> for every compared set.

        Parameters
        ----------
        draws : int, optional
            Read only so many first draws.
        """
        return self._store.read("comparison", draws)

    def repeated(self) -> pd.DataFrame:
        """A row for each of the first draws: the reference's MSE under other filter noise."""
        return self._store.read("repeated")

    def filter_distance(self) -> pd.DataFrame:
        """For each of the first draws: half the squared distance of two filters with each set."""
        return self._store.read("filter_distance")

    def filter_variance(self) -> pd.DataFrame:
        """For each of the first draws: the variance of particles beside the truth with each set."""
        return self._store.read("filter_variance")

    def online(self) -> pd.DataFrame:
        """A row for each of the first draws: times chosen one after another, and their MSE.

        Without such times the table is empty.
        """
        if not self.has("online"):
            import pandas as pd  # noqa: PLC0415  it loads when tables are made

            return pd.DataFrame(columns=schema("online").names)
        return self._store.read("online")

    def trajectories(self) -> pd.DataFrame:
        """z, y and the estimate of every filter over time, for the comparison's first draws."""
        return self._store.read("trajectories")

    def timings(self) -> pd.DataFrame:
        """A row for each task: seconds, worker, node, failures."""
        return self._store.read("timings")

    def bounds(self) -> pd.DataFrame:
        """A row for each set and each proof of a lower bound: see the columns' descriptions."""
        return self._store.read("bound")

    def profile(self) -> pd.DataFrame:
        """A row for each set and instant: expected error, standard error, effective sample size.

        The table is of the last call of ``pfdist why``.
        """
        return self._store.read("profile")

    def worth(self) -> pd.DataFrame:
        """A row for each measurement of each set: the rise of the expected MSE without it.

        The table is of the last call of ``pfdist why``, as is that of `profile`.
        """
        return self._store.read("worth")

    def sampling_windows(self) -> pd.DataFrame:
        """A row for each measurement and instant to which it alone is moved, by ``pfdist why``."""
        return self._store.read("sampling_windows")

    def jitter(self) -> pd.DataFrame:
        """A row for each set and level: the loss of random times within the sampling windows."""
        return self._store.read("jitter")

    def has(self, table: str) -> bool:
        """Whether the run has rows of a table."""
        return self._store.has(table)

    # --- what follows from them -------------------------------------------------------------------

    def gains(self, draws: int | None = None) -> pd.DataFrame:
        """A row for each draw: draw, and gain_<name> for every set over its reference.

        Parameters
        ----------
        draws : int, optional
            Read only so many first draws.
        """
        rows = self.comparison(draws)
        gains: dict[str, Any] = {"draw": rows["draw"]}
        for name, reference in self.references.items():
            gains[f"gain_{name}"] = relative_gain(
                rows[f"mse_{name}"].to_numpy(), rows[f"mse_{reference}"].to_numpy()
            )
        import pandas as pd  # noqa: PLC0415  it loads when tables are made

        return pd.DataFrame(gains)

    @cached_property
    def names(self) -> list[str]:
        """Names of the compared sets, the reference first."""
        return self._store.compared_names()

    @cached_property
    def references(self) -> dict[str, str]:
        """The reference of each compared set that is no reference, by name.

        In a run of several numbers of measurements it has as many measurements as the set.
        """
        return references_of(self.names, self.job)

    @property
    def named(self) -> list[str]:
        """Names of the sets that the job gives by name; the reference may be among them."""
        return [name for name in self.names if name in self.job["comparison"].get("sets", {})]

    @property
    def found(self) -> list[str]:
        """Names of the sets that searches have found."""
        return [name for name in self.references if name not in self.named]

    @cached_property
    def problem(self) -> ProblemSection:
        """The section [problem] of the job, with the clock and the constraints."""
        return ProblemSection.model_validate(self.job["problem"])

    @property
    def filter_is_wrong(self) -> bool:
        """Whether the filter's model is not the truth."""
        is_told = self.job.get("scenarios", {}).get("filter", "told") == "told"
        return bool(self._about["filter_model"]) or not is_told

    @property
    def state(self) -> str:
        """``searching``, ``comparing`` or ``finished``."""
        if not self._store.has("compared"):
            return "searching"
        if self._store.has_parts(without=QUESTIONS) or self._store.lost():
            return "comparing"
        enough = self.draws_compared == self.job["comparison"]["draws"] or self._narrow
        online = self._store.present("online", "draw").size if self.has("online") else 0
        wanted = self.job.get("online", {}).get("draws", 0)
        return "finished" if enough and online >= wanted else "comparing"

    @property
    def _narrow(self) -> bool:
        """Whether the intervals are as narrow as the job demands."""
        half_width = self.job["comparison"]["until"]["half_width"]
        return bool(half_width > 0 and self.statistics().half_width() <= half_width)

    def statistics(self) -> ComparisonStatistics:
        """Statistics of all compared draws; memory does not grow with the draws."""
        statistics = ComparisonStatistics(self.names, self.draws_compared, self.references)
        for block in self._columns():
            statistics.add(block)
        return statistics

    def particle_losses(
        self, statistics: ComparisonStatistics | None = None
    ) -> dict[str, ParticleLoss]:
        """The loss by the number of particles with each compared set, by name.

        It is empty for exact engines, errors other than the squared norm, and several numbers of
        measurements.

        Parameters
        ----------
        statistics : ComparisonStatistics, optional
            Those of the run, if they are at hand.
        """
        if not (self.has("filter_distance") and self.has("filter_variance")):
            return {}
        rows = self.filter_distance().merge(self.filter_variance(), on="draw")
        rows = rows.merge(self.comparison(int(rows["draw"].max()) + 1), on="draw")
        particles, whole = self.job["filter"]["particles"], (statistics or self.statistics()).mse
        return {
            name: particle_loss(
                particles,
                whole[name],
                *(rows[f"{start}_{name}"].to_numpy() for start in ("mse", "distance", "variance")),
            )
            for name in self.names
        }

    def _columns(self) -> Iterator[NDArray[np.float64]]:
        """Per-draw MSE of all compared sets, block by block: (D, S) each time."""
        for rows in self.blocks():
            yield np.stack([rows[f"mse_{name}"].to_numpy() for name in self.names], axis=1)

    def blocks(self) -> Iterator[pa.Table]:
        """The comparison in tables of as many draws each, so that memory does not grow."""
        return self._store.blocks("comparison", "draw", BLOCK)

    def sets(self) -> dict[str, Times]:
        """All compared sets by name, the reference first; times on the clock of the job."""
        return self._store.compared_sets()

    @property
    def best(self) -> SetResult:
        """The times to measure at, and their results: the found set of least expected MSE.

        The errors are those of the comparison; of the worst scenario, if the job asks for it. If no
        search has run, it is the best of the job's own sets.

        Raises
        ------
        StoreError
            The comparison has not begun, or the run has times of several numbers of measurements.
        """
        self.sets_of_one_number()
        summary = self.summary()
        result = summary.results[summary.by_error[0]]
        if not result.is_compared:
            raise StoreError(f"{self.path} has compared no draws yet: it is {summary.state}")
        return result

    @property
    def has_budget(self) -> bool:
        """Whether the run has times of several numbers of measurements."""
        return "budget" in self.job

    def sets_of_one_number(self) -> dict[str, Times]:
        """Compared sets by name, the reference first.

        Raises
        ------
        StoreError
            The run has times of several numbers of measurements.
        """
        if self.has_budget:
            raise StoreError(
                f"{self.path} has times of several numbers of measurements: give a run of one"
            )
        return self.sets()

    def budget(self, statistics: ComparisonStatistics | None = None) -> pd.DataFrame:
        """A row for each compared set: a number of measurements with a kind of times.

        The kinds are ``found`` (by a search), ``regular`` (or ``reference``, if the job gives its
        times) and ``given`` (the other sets that the job names).

        The columns are kind, measurements, name, measurement_times, expected_mse (on fresh draws),
        standard_error, low and high (ends of the 95 % interval), draws (without the degenerate
        ones), degenerate_draws, top_percent_share (see `summary`), search_cost and
        search_standard_error (what the search believed), and worse_than. The last is the best
        smaller number of measurements of the same kind, if it is better on common draws. The
        intervals of all such differences hold together with 95 %.

        Three columns more say what any feasible times of this number can reach: bound (lower bound
        of the expected MSE), bound_error (standard error), and bound_low (one-sided limit of the
        bound). The limits of all numbers hold together with 95 %. Exact engines have no error. The
        three are NaN where there is no bound, as for the regular times of a budget curve.

        Parameters
        ----------
        statistics : ComparisonStatistics, optional
            Those of the run, if they are at hand.
        """
        reference = without_number(self.names[0], self.job)
        statistics = statistics or self.statistics()
        table = budget_table(self.compared(), statistics, self.blocks(), reference)
        return with_bounds(table, last_bounds(self.bounds()) if self.has("bound") else {})

    def reaching(self, target: float) -> dict[str, dict[str, Any]]:
        """The least number of measurements whose expected MSE is at most a target.

        Parameters
        ----------
        target : float

        Returns
        -------
        dict
            For each kind of times, as ``regular`` and ``found``:

            - measurements: the least number; None if no number reaches the target.
            - interval, 95 %: the least number whose interval reaches the target, and the least
              number whose interval lies below it. The intervals of all numbers hold together.
            - measurement_times.
            - larger_that_do_not: larger numbers whose interval lies above the target. More regular
              times are not always better.
            - impossible, for found times alone: the largest number of measurements with which no
              feasible times and no filter reach the target (bound_low of `budget` lies above the
              target); None if no number is proved. Without a minimum spacing, all smaller numbers
              are impossible too: more measurements never harm the exact filter of the true model.

            The least numbers above leave out each number that is proved impossible.
        """
        return reaching(self.budget(), target)

    def pairs(self) -> pd.DataFrame:
        """A row for each pair of compared sets, on the draws that are degenerate with neither.

        The columns are first and second (names); draws; difference (expected MSE of the first less
        that of the second) with low and high (95 %, Student's t, of the paired differences);
        simultaneous_low and simultaneous_high (with 95 % the intervals of all pairs hold together,
        by Bonferroni); clear (whether the simultaneous interval leaves out 0); gain_of_means (1
        less the first expected MSE over the second) with gain_of_means_low and gain_of_means_high
        (95 %, Fieller's); first_wins (share of the draws in which the first has the lower MSE) with
        first_wins_low and first_wins_high (95 %, Wilson's). Where an engine knows both expected
        MSEs without draws, difference and gain_of_means are exact, and all their limits are equal.
        """
        return pairs_table(self.names, self._columns(), exact_costs(self))

    def scenarios(self) -> pd.DataFrame:
        """A row for each scenario of the job and each compared set.

        The columns are scenario (its number, from 0), share and parameters; name (of the set);
        draws (without the degenerate_draws), expected_mse and standard_error in this scenario; and
        gain_of_means over the reference with gain_of_means_low and gain_of_means_high (95 %,
        Fieller's, for one scenario alone). Without scenarios the table is empty.
        """
        section = self.job.get("scenarios")
        scenarios = Scenarios.model_validate(section).each if section else ()
        return scenarios_table(scenarios, self.names, self.references, self.blocks())

    def ranks(self) -> pd.DataFrame:
        """A row for each compared set, the lowest expected MSE first.

        The columns are name; expected_mse and standard_error; best_rank (1 plus the number of sets
        that are clearly better) and worst_rank (the number of sets less those that are clearly
        worse), as `pairs` defines clear; difference (expected MSE less that of the first row) with
        low and high (95 %, of this pair alone). With 95 % the true ranks of all sets lie from
        best_rank to worst_rank.
        """
        mse, exact = self.statistics().mse, exact_costs(self)
        costs = {name: (each.mean, each.standard_error) for name, each in mse.items()}
        costs |= {name: (cost, 0.0) for name, cost in exact.items()}
        return ranks_table(self.pairs(), costs)

    @property
    def draws_compared(self) -> int:
        """Number of draws that every set has filtered."""
        return int(self._store.present("comparison", "draw").sum())

    def summary(self) -> Summary:
        """How far the run is, and what it has found; see `pfdist.analysis.summary.Summary`."""
        return summary_of(self)

    def _page(self) -> Page:
        return run_card(self)

    def __repr__(self) -> str:
        return f"<{title_of(self)}>"

    @property
    def version(self) -> str:
        """Version of pfdist that started the run."""
        return str(self._about["pfdist"])

    def distrust(self, search: str) -> str | None:
        """Why a search was run again by the squared error; None if it was not."""
        return self._distrusts.get(search)

    def own_estimation(self, search: str) -> dict[str, Any]:
        """How a search estimates otherwise than the comparison: particles, resampling, estimator.

        If a search was run again by the squared error, this is the estimation of the second time.
        """
        redone = self.distrust(search) is not None
        return own_estimation(self._about, self.job, search, redone=redone)

    @cached_property
    def _distrusts(self) -> dict[str, str]:
        """Reason for each search that was run again, by its name."""
        rows = self.compared()
        rows = rows[rows["distrust"].notna()]
        names = [without_number(str(name), self.job) for name in rows["name"]]
        return dict(zip(names, rows["distrust"].astype(str), strict=True))


def open_run(path: str | Path) -> Run:
    """A run in a folder, opened for reading.

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
    if not isinstance(path, str | Path):
        raise StoreError(f"a run must be the path of its folder, got {shown(path)}", argument="run")
    check_entries(Path(path))
    return Run(Path(path))


def title_of(run: Run) -> str:
    """A run in a line: its folder, its state and how many draws are compared.

    Parameters
    ----------
    run : Run
    """
    try:
        return f"run {run.path}: {run.state}, {run.draws_compared:,} draws compared"
    except StoreError:
        return f"run {run.path}: cannot be read"


def run_card(run: Run) -> Page:
    """The sets of a run with their expected MSE and gain."""
    try:
        results = run.summary().results
    except StoreError:
        return Page("", title_of(run), [])
    head = ("times", "measurements", "expected MSE", "below the reference")
    rows = [[Cell(text) for text in _row(name, each)] for name, each in results.items()]
    return Page("", title_of(run), [Section("", [Table("", head, rows)])])


def _row(name: str, result: SetResult) -> tuple[str, ...]:
    mse = gain = ""
    if result.is_compared:
        mse = with_error(cost(result.expected_mse), result.standard_error)
    if result.gain_draws is not None:
        gain = percent_with_interval(result.gain_of_means, result.gain_of_means_interval)
    return name, str(result.measurements), mse, gain
