"""The driver: search phases, then the comparison. It uses a pool and a store, and knows no Ray."""

import uuid
from collections.abc import Callable
from functools import partial
from typing import Any

import pandas as pd
import pyarrow as pa

from pfdist.errors import SearchError
from pfdist.pools.base import Pool
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.comparison_phase import COMPARISON, comparison_steps, run_comparison
from pfdist.runner.pace import Pace
from pfdist.runner.progress import Report, Reporter
from pfdist.runner.search_phase import run_search, search_steps
from pfdist.runner.search_tables import unpublished
from pfdist.store import Store, schema
from pfdist.times.measurement_times import Times

FORKED = "forked-from"
"""Phase of rows that a fork takes from another run; the fork publishes those that it needs."""
COMPARED = "search"


def drive(
    built: Built,
    store: Store,
    pool: Pool,
    report: Report,
    say: Callable[[str], Any] = lambda line: None,
) -> None:
    """Compute everything that a run still lacks, be it new or half finished.

    Parameters
    ----------
    built : Built
    store : Store
    pool : Pool
        A pool that the caller has entered.
    report : callable
        Receives the progress after each outcome.
    say : callable, optional
        Receives a line if a search does not trust its estimator.

    Raises
    ------
    SearchError
        A search found no set of times without degenerate draws.
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    failures = built.job.execution.failures
    pace = Pace(built.problem.seconds_a_step, pool.workers)
    collector = Collector(store, pool, uuid.uuid4().hex[:8], pace, failures, store.has("draws"))
    searched = sum(search_steps(built, search) for search in built.searches)
    reporter = Reporter(report, searched + comparison_steps(built))
    try:
        lost = store.manifest.lost()  # they are computed again
        has = store.has("compared") and not store.has_parts("compared")
        if lost or not has or unpublished(store, built.phases):
            sets = _search(built, collector, reporter, say)
        else:
            sets = compared_sets(store)
            reporter.note(done=searched)
        run_comparison(built, sets, collector, reporter)
        collector.flush()
        store.publish("draws", FORKED, [])
        store.manifest.forget_lost()
    finally:
        collector.flush()
        for phase in (*built.phases, COMPARISON):
            _publish_timings(store, phase)


def compared_sets(store: Store) -> dict[str, Times]:
    """The compared sets of times by name, in the order of their table."""
    rows = store.compared()
    return {
        str(name): tuple(int(time) for time in times)
        for name, times in zip(rows["name"], rows["measurement_times"], strict=True)
    }


def _search(
    built: Built, collector: Collector, reporter: Reporter, say: Callable[[str], Any]
) -> dict[str, Times]:
    """Run every search, and return the sets that are compared, by name."""
    rows: list[dict[str, Any]] = [
        {"name": name, "measurement_times": times} for name, times in built.study.references.items()
    ]
    for search in built.searches:
        end = run_search(built, search, collector, reporter, say)
        rows += [
            {
                "name": name,
                "measurement_times": winner.measurement_times,
                "search_cost": winner.believed.cost,
                "search_standard_error": winner.believed.standard_error,
                "distrust": end.distrust,
            }
            for name, winner in end.winners.items()
        ]
    found = {row["name"] for row in rows}
    for name in built.names:
        if name not in found:
            raise SearchError(
                f"search {name}: every set of times that it ended with had a degenerate "
                f"draw (a measurement no particle can explain); more particles than "
                f"{built.job.filter.particles} help, or evaluation.degenerate_draws = 'leave_out'"
            )
    for position, row in enumerate(rows):
        row["position"] = position
    table = pa.Table.from_pylist(rows, schema=schema("compared"))
    # Written after the tables of the searches: it marks the searches as done.
    collector.later(partial(_publish_compared, collector.store, table))
    return {row["name"]: row["measurement_times"] for row in rows}


def _publish_compared(store: Store, table: pa.Table) -> None:
    store.commit("compared", COMPARED, "sets", table)  # a part shows that publishing was cut short
    store.publish("compared", COMPARED, [table])


def _publish_timings(store: Store, phase: str) -> None:
    if not store.has_parts("timings", phase):
        return
    rows: pd.DataFrame = store.read("timings")
    rows = rows[rows["phase"] == phase]
    table = pa.Table.from_pandas(rows, schema=schema("timings"), preserve_index=False)
    store.publish("timings", phase, [table])
