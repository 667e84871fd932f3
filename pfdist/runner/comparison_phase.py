"""The comparison: every set filters the same fresh draws, which no search has used."""

from collections.abc import Generator, Mapping

import numpy as np
import pyarrow as pa

from pfdist.analysis import BLOCK
from pfdist.analysis.reference import references_of
from pfdist.common.streams import stream_of
from pfdist.errors import StoreError
from pfdist.evaluation.work import Result, Work, cut
from pfdist.runner.build import Built
from pfdist.runner.door import Batch, Session
from pfdist.runner.first_draws import TABLES
from pfdist.runner.interim import InterimGains
from pfdist.runner.kept import OfDraws
from pfdist.store import ROWS_IN_A_FILE, Store, comparison_schema
from pfdist.times.measurement_times import Times, validated

COMPARISON = "comparison"


def run_comparison(session: Session, sets: Mapping[str, Times]) -> Generator[Batch, None, None]:
    """Filter every set on the same draws, and publish the comparison.

    Parameters
    ----------
    session : Session
    sets : mapping of str to tuple of int
        Measurement times by name, the reference first.

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    built, reporter = session.built, session.reporter
    draws, study = built.job.comparison.draws, built.study
    work, start = _work(built, sets), reporter.progress.done
    names, half_width = list(sets), built.job.comparison.until.half_width
    references = references_of(names, built.job.identity())
    interim = InterimGains(names, references, draws, half_width)
    reporter.begin(COMPARISON)
    for table in study.first_draws:
        first_draws = TABLES[table](built, work)
        if first_draws is not None:
            yield from first_draws.fill(COMPARISON, session)
    schema = comparison_schema(list(sets))

    def rows_of(piece: Work, result: Result) -> pa.Table:
        columns = [pa.array(np.arange(*piece.draws))]
        columns += [pa.array(mse, from_pandas=True) for mse in piece.by_id(result).values()]
        return pa.Table.from_arrays(columns, schema=schema)

    def learn(piece: Work, result: Result) -> bool:
        interim.learn(range(*piece.draws), result.mse)
        reporter.reach(
            reporter.progress.done + piece.steps,
            evaluations=reporter.progress.evaluations + len(result.mse),
            found=study.shown(interim.found),
        )
        return interim.enough > 0

    works = [work.part(draws_of_block) for draws_of_block in cut(range(draws), BLOCK)]
    yield Batch(session, COMPARISON, works, OfDraws("comparison", rows_of, _result), learn)
    reporter.reach(start + comparison_steps(built))
    _publish(session.store, interim.enough or draws)


def _result(rows: pa.Table) -> Result:
    """The result that gave these rows."""
    return Result(np.stack([rows[name].to_numpy() for name in rows.column_names[1:]], axis=1))


def comparison_steps(built: Built) -> int:
    """How many particle-steps the whole comparison takes."""
    job = built.job
    instants = len(built.names) * (job.problem.feasible.horizon + 1)
    return job.comparison.draws * job.filter.particles * instants


def _work(built: Built, sets: Mapping[str, Times]) -> Work:
    """All sets on the same draws, each with filter noise of its own; the draws are not chosen."""
    job, purpose, horizon = built.job, built.study.purpose, built.job.problem.feasible.horizon
    return Work(
        measurement_times=tuple(validated(times, horizon, name) for name, times in sets.items()),
        ends=(horizon,) * len(sets),
        filter_streams=tuple(stream_of(purpose, job.seed, "filter", name) for name in sets),
        draws_stream=stream_of(purpose, job.seed, "draws"),
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
