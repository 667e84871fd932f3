"""The comparison: every set of times filters the same fresh draws, never those that chose it."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.kernels.noise import stream_key
from pfdist.measurement_times import Times
from pfdist.monte_carlo import Result, Work, cut
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.progress import Progress, Report
from pfdist.store import ROWS_IN_A_FILE, Store, comparison_schema, trajectories_schema

PHASE = "comparison"
TRAJECTORIES = 100  # draws whose z, y and estimates are kept


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
    missing = np.ones(draws, np.bool_)
    missing[store.column("comparison", "draw")] = False
    done = int(draws - missing.sum())
    progress = replace(progress, phase=PHASE, done=progress.done + done * len(sets))
    progress = replace(progress, evaluations=done, generation=0, generations=0)
    report(progress)
    work = _work(built, sets)
    _keep_trajectories(built, work, list(sets), collector)
    schema = comparison_schema(list(sets))

    def rows_of(piece: Work, result: Result) -> pa.Table:
        columns = [pa.array(np.arange(*piece.draws))]
        columns += [pa.array(mse, from_pandas=True) for mse in result.mse.T]
        return pa.Table.from_arrays(columns, schema=schema)

    works = (replace(work, draws=lacking) for lacking in cut(np.flatnonzero(missing), draws))
    with closing(collector.run(PHASE, "comparison", works, rows_of)) as pieces:
        for piece, _ in pieces:
            first, last = piece.draws
            progress = replace(
                progress,
                done=progress.done + (last - first) * len(sets),
                evaluations=progress.evaluations + last - first,
            )
            report(progress)
    _publish(store, draws)


def _work(built: Built, sets: Mapping[str, Times]) -> Work:
    """The same draws for all sets, and for each the noise of its own filter."""
    seed = built.job.seed
    return Work(
        measurement_times=tuple(sets.values()),
        filter_streams=tuple(stream_key(seed, PHASE, "filter", name) for name in sets),
        draws_stream=stream_key(seed, PHASE, "draws"),
        draws=(0, 0),
    )


def _keep_trajectories(built: Built, work: Work, names: list[str], collector: Collector) -> None:
    """Filter the first draws once more, keeping what the figures show."""
    store, draws = collector.store, min(TRAJECTORIES, built.job.comparison.draws)
    missing = np.setdiff1d(np.arange(draws), store.column("trajectories", "draw"))
    _, measurements, quantities = built.problem.model.components
    schema = trajectories_schema(names, quantities, measurements)
    works = [replace(work, draws=lacking, trajectories=True) for lacking in cut(missing, draws)]

    def rows_of(piece: Work, result: Result) -> pa.Table:
        return pa.table(_trajectory_columns(piece, result, names), schema=schema)

    def publish() -> None:
        if store.has_parts("trajectories", PHASE):
            rows = store.read("trajectories")
            table = pa.Table.from_pandas(rows, schema=schema, preserve_index=False)
            store.publish("trajectories", PHASE, [table])

    run = collector.run(PHASE, "trajectories", works, rows_of, more_follows=True)
    with closing(run) as pieces:
        for _ in pieces:
            pass
    collector.later(publish)


def _trajectory_columns(piece: Work, result: Result, names: list[str]) -> dict[str, Any]:
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
        rows = ROWS_IN_A_FILE["comparison"]
        pieces = (
            store.rows_between("comparison", "draw", first, min(first + rows, draws))
            for first in range(0, draws, rows)
        )
        store.publish("comparison", PHASE, pieces)
