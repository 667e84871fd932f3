"""The comparison: every set filters the same fresh draws, which no search has used."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.analysis import BLOCK
from pfdist.errors import StoreError
from pfdist.evaluation.work import Result, Work, cut
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.first_draws import TABLES
from pfdist.runner.interim import InterimGains
from pfdist.runner.progress import Reporter
from pfdist.store import ROWS_IN_A_FILE, Store, comparison_schema
from pfdist.times.measurement_times import Times, validated

COMPARISON = "comparison"


def run_comparison(
    built: Built, sets: Mapping[str, Times], collector: Collector, reporter: Reporter
) -> None:
    """Filter every set on the draws that the store lacks, and publish the comparison.

    Parameters
    ----------
    built : Built
    sets : mapping of str to tuple of int
        Measurement times by name, the reference first.
    collector : Collector
    reporter : Reporter

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    store, draws, study = collector.store, built.job.comparison.draws, built.study
    work, present = _work(built, sets), _present(store, draws)
    interim = InterimGains(list(sets), draws, built.job.comparison.until.half_width)
    for rows in store.blocks("comparison", "draw", BLOCK, draws):
        interim.learn(rows)
    compared, start = int(present.sum()), reporter.progress.done
    reporter.note(done=start + compared * work.steps_a_draw)
    reporter.begin(COMPARISON, evaluations=compared, found=study.shown(interim.found))
    for table in study.first_draws:
        first_draws = TABLES[table](built, work)
        if first_draws is not None:
            first_draws.fill(COMPARISON, collector)
    schema = comparison_schema(list(sets))

    def rows_of(piece: Work, result: Result) -> pa.Table:
        columns = [pa.array(np.arange(*piece.draws))]
        columns += [pa.array(mse, from_pandas=True) for mse in piece.by_id(result).values()]
        return pa.Table.from_arrays(columns, schema=schema)

    works = (
        replace(work, draws=lacking)
        for first in range(0, draws, BLOCK)
        for lacking in cut(first + np.flatnonzero(~present[first : first + BLOCK]), BLOCK)
    )
    if not interim.enough:
        with closing(collector.run(COMPARISON, "comparison", works, rows_of)) as pieces:
            for piece, result in pieces:
                interim.learn(rows_of(piece, result))
                compared += len(result.mse)
                reporter.reach(
                    reporter.progress.done + piece.steps,
                    evaluations=compared,
                    found=study.shown(interim.found),
                )
                if interim.enough:
                    break
    reporter.reach(start + comparison_steps(built))
    _publish(store, interim.enough or draws)


def comparison_steps(built: Built) -> int:
    """How many particle-steps the whole comparison takes."""
    job = built.job
    instants = len(built.names) * (job.problem.feasible.horizon + 1)
    return job.comparison.draws * job.filter.particles * instants


def _present(store: Store, draws: int) -> NDArray[np.bool_]:
    """Whether each draw is committed."""
    present, committed = np.zeros(draws, np.bool_), store.present("comparison", "draw")[:draws]
    present[: committed.size] = committed
    return present


def _work(built: Built, sets: Mapping[str, Times]) -> Work:
    """All sets on the same draws, each with filter noise of its own; the draws are not chosen."""
    job, purpose, horizon = built.job, built.study.purpose, built.job.problem.feasible.horizon
    return Work(
        measurement_times=tuple(validated(times, horizon, name) for name, times in sets.items()),
        ends=(horizon,) * len(sets),
        filter_streams=tuple(purpose.stream(job.seed, "filter", name) for name in sets),
        draws_stream=purpose.stream(job.seed, "draws"),
        draws=(0, 0),
        estimation=built.comparing,
        ids=tuple(sets),
    )


def _publish(store: Store, draws: int) -> None:
    """Turn parts into tables, as many draws at a time as make a file."""
    if store.has_parts("comparison", COMPARISON):
        if not store.present("comparison", "draw")[:draws].all():
            raise StoreError(
                f"{store.path} lacks draws that were committed: is another driver at work there? "
                "Run the same command again"
            )
        rows = ROWS_IN_A_FILE["comparison"]
        store.publish("comparison", COMPARISON, store.blocks("comparison", "draw", rows, draws))
