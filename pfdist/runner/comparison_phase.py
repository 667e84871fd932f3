"""The comparison: every set of times filters the same fresh draws, never those that chose it."""

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.analysis import BLOCK, Comparison
from pfdist.errors import StoreError
from pfdist.evaluation import BUDGET, REPORT
from pfdist.measurement_times import Times
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.progress import Found, Progress, Report
from pfdist.store import (
    ROWS_IN_A_FILE,
    Store,
    comparison_schema,
    schema,
    trajectories_schema,
)
from pfdist.work import Result, Work, cut

PHASE = "comparison"
TRAJECTORIES = 100  # draws whose z, y and estimates are kept
REPEATED = 2000  # draws that the reference filters twice


def run_comparison(
    built: Built,
    sets: Mapping[str, Times],
    collector: Collector,
    progress: Progress,
    report: Report,
) -> None:
    """Filter the draws that the store does not hold yet with every set, and publish.

    Parameters
    ----------
    built : Built
    sets : mapping of str to tuple of int
        Measurement times by name, the reference first.
    collector : Collector
    progress : Progress
        How far the run was before the comparison.
    report : callable

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    store, draws = collector.store, built.job.comparison.draws
    work, present = _work(built, sets), _present(store, draws)
    done = int(present.sum())
    known = _Known(list(sets), draws, built.job.comparison.until.half_width)
    for rows in store.blocks("comparison", "draw", BLOCK, draws):
        known.learn(rows)
    progress = replace(
        progress,
        phase=PHASE,
        done=progress.done + done * work.steps_a_draw,
        evaluations=done,
        generation=0,
        generations=0,
        found=() if built.numbers else known.found,
    )
    report(progress)
    if not built.numbers:  # one reference, and sets to show beside it
        _keep_trajectories(built, work, list(sets), collector)
        _repeat_reference(built, work, collector)
    kept = comparison_schema(list(sets))

    def rows_of(piece: Work, result: Result) -> pa.Table:
        columns = [pa.array(np.arange(*piece.draws))]
        columns += [pa.array(mse, from_pandas=True) for mse in result.mse.T]
        return pa.Table.from_arrays(columns, schema=kept)

    works = (
        replace(work, draws=lacking)
        for first in range(0, draws, BLOCK)
        for lacking in cut(first + np.flatnonzero(~present[first : first + BLOCK]), BLOCK)
    )
    if not known.enough:
        with closing(collector.run(PHASE, "comparison", works, rows_of)) as pieces:
            for piece, result in pieces:
                known.learn(rows_of(piece, result))
                progress = replace(
                    progress,
                    done=progress.done + piece.steps,
                    evaluations=progress.evaluations + len(result.mse),
                    found=() if built.numbers else known.found,
                )
                report(progress)
                if known.enough:
                    break
    report(replace(progress, total=progress.done))  # fewer, if they were enough
    _publish(store, known.enough or draws)


def _present(store: Store, draws: int) -> NDArray[np.bool_]:
    """Which draws are committed."""
    present, committed = np.zeros(draws, np.bool_), store.present("comparison", "draw")[:draws]
    present[: committed.size] = committed
    return present


class _Known:
    """What is known from the blocks of draws up to the first gap, whatever order they came in.

    Parameters
    ----------
    names : list of str
        The reference first.
    draws : int
        All that are wanted: the last block is a shorter one.
    half_width : float
        Of the widest interval, at which there are draws enough; 0 for never.
    """

    def __init__(self, names: list[str], draws: int, half_width: float) -> None:
        self._statistics, self._draws, self._half_width = Comparison(names), draws, half_width
        self._waiting: dict[int, _Block] = {}
        self.enough = 0  # draws, once there are so many

    @property
    def found(self) -> tuple[Found, ...]:
        """The gains so far."""
        return tuple(
            Found(
                name,
                gain.relative.mean,
                gain.interval,
                gain.positive / gain.relative.count,
                gain.of_means,
                gain.of_means_interval,
            )
            for name, gain in self._statistics.gains.items()
            if gain.relative.count
        )

    def learn(self, rows: pa.Table) -> None:
        """Take rows of draws; of a block whole, and all before it, the statistics are made."""
        draws = rows["draw"].to_numpy()
        values = np.stack([rows[name].to_numpy() for name in rows.column_names[1:]], axis=1)
        for number in np.unique(draws // BLOCK).tolist():
            in_block = draws // BLOCK == number
            if number not in self._waiting:
                size = min(BLOCK, self._draws - number * BLOCK)
                self._waiting[number] = _Block(size, values.shape[1])
            self._waiting[number].take(draws[in_block] - number * BLOCK, values[in_block])
        while not self.enough and (following := self._next()) is not None:
            self._statistics.add(following)
            if self._half_width and self._statistics.half_width() <= self._half_width:
                self.enough = self._statistics.draws

    def _next(self) -> NDArray[np.float64] | None:
        number = self._statistics.draws // BLOCK
        if number in self._waiting and not self._waiting[number].lacks:
            return self._waiting.pop(number).values
        return None


class _Block:
    """Draws of a block, as they come."""

    def __init__(self, draws: int, sets: int) -> None:
        self.values, self.missing = np.empty((draws, sets)), np.ones(draws, np.bool_)

    @property
    def lacks(self) -> bool:
        return bool(self.missing.any())

    def take(self, places: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        self.values[places], self.missing[places] = values, False


def _work(built: Built, sets: Mapping[str, Times]) -> Work:
    """The same draws for all sets, and for each the noise of its own filter."""
    job, purpose = built.job, BUDGET if built.numbers else REPORT
    return Work(
        measurement_times=tuple(sets.values()),
        ends=(job.problem.horizon,) * len(sets),
        filter_streams=tuple(purpose.stream(job.seed, "filter", name) for name in sets),
        draws_stream=purpose.stream(job.seed, "draws"),
        draws=(0, 0),
        estimation=built.comparing,
    )


def steps(built: Built) -> int:
    """How many particle-steps the whole comparison takes."""
    job = built.job
    instants = len(built.names) * (job.problem.horizon + 1)
    return job.comparison.draws * job.filter.particles * instants


def _keep_trajectories(built: Built, work: Work, names: list[str], collector: Collector) -> None:
    """Filter the first draws once more, keeping what the figures show."""
    _, measurements, quantities = built.problem.model.components
    kept = trajectories_schema(names, quantities, measurements)
    draws, work = min(TRAJECTORIES, built.job.comparison.draws), replace(work, trajectories=True)
    columns = partial(_trajectory_columns, names)
    _keep_first("trajectories", kept, draws, work, columns, collector)


def _repeat_reference(built: Built, work: Work, collector: Collector) -> None:
    """Filter the first draws with the reference once more, under other noise.

    So is measured what the filters' noise alone does to a relative gain.
    """
    job = built.job
    again = REPORT.stream(job.seed, "filter", job.comparison.reference_name, "again")
    sets, ends = work.measurement_times[:1], work.ends[:1]
    work = replace(work, measurement_times=sets, ends=ends, filter_streams=(again,))

    def columns(piece: Work, result: Result) -> dict[str, Any]:
        mse = pa.array(result.mse[:, 0], from_pandas=True)
        return {"draw": np.arange(*piece.draws), "mse": mse}

    draws = min(REPEATED, job.comparison.draws)
    _keep_first("repeated", schema("repeated"), draws, work, columns, collector)


def _keep_first(
    table: str,
    kept: pa.Schema,
    draws: int,
    work: Work,
    columns: Callable[[Work, Result], dict[str, Any]],
    collector: Collector,
) -> None:
    """Fill a table with what is made of the first draws, where it lacks some."""
    store = collector.store
    missing = np.setdiff1d(np.arange(draws), np.flatnonzero(store.present(table, "draw")))
    works = [replace(work, draws=lacking) for lacking in cut(missing, draws)]

    def rows_of(piece: Work, result: Result) -> pa.Table:
        return pa.table(columns(piece, result), schema=kept)

    def publish() -> None:
        if store.has_parts(table, PHASE):
            rows = pa.Table.from_pandas(store.read(table), schema=kept, preserve_index=False)
            store.publish(table, PHASE, [rows])

    run = collector.run(PHASE, table, works, rows_of, more_follows=True)
    with closing(run) as pieces:
        for _ in pieces:
            pass
    collector.later(publish)


def _trajectory_columns(names: list[str], piece: Work, result: Result) -> dict[str, Any]:
    first, last = piece.draws
    instants = result.z.shape[1]
    columns: dict[str, Any] = {
        "draw": np.repeat(np.arange(first, last), instants),
        "t": np.tile(np.arange(instants, dtype=np.int32), last - first),
    }
    columns |= _by_component("z", result.z) | _by_component("y", result.y)
    for name, estimate in zip(names, result.estimates, strict=True):
        columns |= _by_component(f"estimate_{name}", estimate)
    return columns


def _by_component(name: str, values: NDArray[np.float64]) -> dict[str, pa.Array]:
    """(D, T+1, components) as a column a component, draw after draw; NaN becomes null."""
    return {
        f"{name}_{k}": pa.array(values[:, :, k].ravel(), from_pandas=True)
        for k in range(values.shape[2])
    }


def _publish(store: Store, draws: int) -> None:
    """Turn parts into tables, as many draws at a time as make a file."""
    if store.has_parts("comparison", PHASE):
        if not store.present("comparison", "draw")[:draws].all():
            raise StoreError(
                f"{store.path} lacks draws that were committed: is another driver at work there? "
                "Run the same command again"
            )
        rows = ROWS_IN_A_FILE["comparison"]
        store.publish("comparison", PHASE, store.blocks("comparison", "draw", rows, draws))
