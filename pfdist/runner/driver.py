"""The driver of a run: searches, then the comparison, then online draws. It knows no pool."""

from collections.abc import Generator
from functools import partial
from typing import Any

import pyarrow as pa

from pfdist.errors import SearchError
from pfdist.runner.build import Built
from pfdist.runner.comparison_phase import COMPARISON, comparison_steps, run_comparison
from pfdist.runner.door import Batch, Session
from pfdist.runner.online_phase import ONLINE_TIMES, online_steps, run_online
from pfdist.runner.search_phase import run_search, search_steps
from pfdist.runner.search_tables import unpublished
from pfdist.store import Store, compared_schema
from pfdist.times.measurement_times import Times

COMPARED = "search"


def drive(session: Session) -> Generator[Batch, None, None]:
    """Compute everything that a run still lacks, be it new or half finished.

    Parameters
    ----------
    session : Session

    Raises
    ------
    SearchError
        A search found no set of times without degenerate draws.
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    built, store, reporter = session.built, session.store, session.reporter
    reporter.foresee(foreseen_steps(built))
    try:
        lost = store.lost()  # they are computed again
        has = store.has("compared") and not store.has_parts("compared")
        if lost or not has or unpublished(store, built.phases):
            sets = yield from _search(session)
        else:
            sets = built.instants(store.compared_sets())
            reporter.note(done=_searching_steps(built))
        yield from run_comparison(session, sets)
        if built.job.online is not None:
            yield from run_online(session, sets)
        session.commit()
        store.manifest.forget(store.lost())  # answers to questions are not made again
    finally:  # also where the driver is closed: it loses nothing that it has
        session.commit()
        for phase in (*built.phases, COMPARISON, ONLINE_TIMES):
            store.settle("timings", phase)


def foreseen_steps(built: Built) -> float:
    """About how many particle-steps a whole run takes."""
    return _searching_steps(built) + comparison_steps(built) + online_steps(built)


def _searching_steps(built: Built) -> float:
    return sum(search_steps(built, search) for search in built.searches)


def _search(session: Session) -> Generator[Batch, None, dict[str, Times]]:
    """Run every search, and return the sets that are compared, by name."""
    built = session.built
    rows = _given_rows(built)
    for search in built.searches:
        end = yield from run_search(session, search)
        rows += [
            {
                "name": name,
                "measurement_times": winner.measurement_times,
                "search_cost": winner.cost,
                "search_standard_error": winner.standard_error,
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
    with_exact = any("exact_mse" in row for row in rows)
    table = pa.Table.from_pylist(rows, schema=compared_schema(with_exact=with_exact))
    # Written after the tables of the searches: it marks the searches as done.
    session.later(partial(_publish_compared, session.store, table))
    return {row["name"]: row["measurement_times"] for row in rows}


def _given_rows(built: Built) -> list[dict[str, Any]]:
    """Rows of the sets that no search finds; with an exact engine, the costs of named sets."""
    sets = built.study.unsearched
    rows: list[dict[str, Any]] = [
        {"name": name, "measurement_times": times} for name, times in sets.items()
    ]
    if built.evaluator.exact and built.job.comparison.named:
        for row, cost in zip(rows, built.evaluator.expected_mse([*sets.values()]), strict=True):
            row["exact_mse"] = float(cost)
    return rows


def _publish_compared(store: Store, table: pa.Table) -> None:
    store.commit("compared", COMPARED, "sets", table)  # a part shows that publishing was cut short
    store.publish("compared", COMPARED, [table])
