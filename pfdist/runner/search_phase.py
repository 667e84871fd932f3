"""One search: ask, evaluate what the store does not hold, commit, tell, until done."""

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.kernels.noise import generator, stream_key
from pfdist.measurement_times import Times
from pfdist.monte_carlo import TASK_STEPS, Evaluation, Work, cut
from pfdist.runner.build import Built, NamedSearch
from pfdist.runner.collect import Collector
from pfdist.runner.pool import Outcome, Task
from pfdist.runner.progress import Progress, Report
from pfdist.store import Store, schema

LEAST_STEPS = 5_000_000  # particle-steps of a task: 7 ms, ten times what handing it over costs
LAST_EVALUATIONS = 2  # for each worker: so many at the end of a generation
LAST_PIECES = 4  # are cut into so many tasks each, so that no core waits long for another

_EVALUATIONS_AT_ONCE = 200  # read from the store when a phase is published


@dataclass(frozen=True)
class _Request:
    """An evaluation that is wanted."""

    id: str
    times: Times
    draws_stream: int
    filter_stream: int


def run_search(
    built: Built, search: NamedSearch, collector: Collector, progress: Progress, report: Report
) -> Evaluation:
    """Run a search to its end, replaying what the store holds.

    Parameters
    ----------
    built : Built
    search : NamedSearch
    collector : Collector
    progress : Progress
        How far the run was before this search.
    report : callable

    Returns
    -------
    Evaluation
        What the search returns.

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    optimiser, name, store = search.optimiser, search.name, collector.store
    committed = _committed_generations(store, name)
    draws = built.job.evaluation.draws
    state, generation = optimiser.init(), 0
    progress = replace(progress, phase=name, generation=1, generations=optimiser.generations)
    report(progress)
    while not optimiser.done(state):
        rng = generator(built.job.seed, "search", name, generation)
        population = [tuple(row) for row in optimiser.ask(state, rng).tolist()]
        copies = Counter(population)
        requests = [_request(built, name, generation, times) for times in copies]
        evaluations: dict[Times, Evaluation] = {}
        for evaluation in _evaluate(built, name, requests, collector):
            evaluations[evaluation.measurement_times] = evaluation
            count = copies[evaluation.measurement_times]
            if progress.mean is None:  # nothing better to show yet
                costs = _finite_costs(evaluations.values())
                progress = replace(progress, best=min(costs, default=None))
            progress = replace(
                progress,
                done=progress.done + count * draws,
                evaluations=progress.evaluations + count,
                generation=generation + 1,
            )
            report(progress)
        if generation not in committed:
            rows = _rows(name, generation, population, requests, evaluations)
            collector.commit_later("evaluations", name, f"{generation:06d}", rows)
        told = [evaluations[times] for times in population]
        state, generation = optimiser.tell(state, told), generation + 1
        costs = _finite_costs(told)
        if costs:
            best = optimiser.best(state).cost
            progress = replace(progress, best=best, mean=float(np.mean(costs)))
    collector.flush()
    _publish(store, name)
    return optimiser.best(state)


def _finite_costs(evaluations: Iterable[Evaluation]) -> list[float]:
    return [evaluation.cost for evaluation in evaluations if np.isfinite(evaluation.cost)]


def _request(built: Built, name: str, generation: int, times: Times) -> _Request:
    fresh = [generation, times] if built.job.evaluation.noise == "fresh" else []
    stream = stream_key(built.job.seed, "search", name, *fresh)
    # One stream serves truth and filter: their roles keep them apart.
    return _Request(built.source.evaluation_id(times, stream, stream), times, stream, stream)


def _evaluate(
    built: Built, phase: str, requests: list[_Request], collector: Collector
) -> Iterator[Evaluation]:
    """Evaluate what was asked for, each once, taking from the store what it holds."""
    draws, policy = built.job.evaluation.draws, built.job.evaluation.degenerate_draws
    if built.problem.exact:  # in no time, so that neither pool nor store is asked
        costs = built.problem.expected_mse([request.times for request in requests])
        for request, cost in zip(requests, costs, strict=True):
            yield Evaluation(request.times, np.empty(0), policy, float(cost))
        return
    mse = {request.id: np.full(draws, np.nan) for request in requests}
    missing = {request.id: np.ones(draws, np.bool_) for request in requests}
    if built.job.evaluation.noise == "common":  # what is wanted may be what waits to be committed
        collector.flush()
    known = collector.store.per_draw(list(mse)).to_pandas()
    for id_, rows in known[known["draw"] < draws].groupby("evaluation"):
        mse[str(id_)][rows["draw"]] = rows["mse"]
        missing[str(id_)][rows["draw"]] = False

    def finished(request: _Request) -> Evaluation:
        return Evaluation(request.times, mse[request.id], policy)

    of_id = {request.id: request for request in requests}
    for request in requests:
        if not missing[request.id].any():
            yield finished(of_id.pop(request.id))
    tasks = _tasks(built, list(of_id.values()), missing, collector.pool.workers)
    run = collector.run(phase, "draws", tasks, _draw_rows, more_follows=True)
    with closing(run) as outcomes:
        for outcome in outcomes:
            first, last = outcome.task.work.draws
            id_ = _id_of(outcome.task)
            mse[id_][first:last] = outcome.value.mse[:, 0]
            missing[id_][first:last] = False
            if not missing[id_].any():
                yield finished(of_id[id_])


def _tasks(
    built: Built, requests: list[_Request], missing: dict[str, NDArray[np.bool_]], workers: int
) -> list[Task]:
    """Cut evaluations into tasks, the last ones finer, so that the cores end together."""
    draws = built.job.evaluation.draws
    whole = min(draws, built.problem.draws_of(TASK_STEPS))
    least = built.problem.draws_of(LEAST_STEPS)
    pieces = max(LAST_PIECES, -(-LAST_PIECES * workers // max(1, len(requests))))
    fine = min(whole, max(-(-draws // pieces), least))
    tail = len(requests) - LAST_EVALUATIONS * workers
    return [
        Task(
            f"{request.id}:{first}-{last}",
            Work((request.times,), (request.filter_stream,), request.draws_stream, (first, last)),
        )
        for position, request in enumerate(requests)
        for first, last in cut(
            np.flatnonzero(missing[request.id]).tolist(), whole if position < tail else fine
        )
    ]


def _id_of(task: Task) -> str:
    return task.key.partition(":")[0]


def _draw_rows(outcome: Outcome) -> pa.Table:
    first, last = outcome.task.work.draws
    columns = [
        pa.array([_id_of(outcome.task)] * (last - first), pa.string()),
        pa.array(np.arange(first, last)),
        pa.array(outcome.value.mse[:, 0], from_pandas=True),
    ]
    return pa.Table.from_arrays(columns, schema=schema("draws"))


def _rows(
    phase: str,
    generation: int,
    population: list[Times],
    requests: list[_Request],
    evaluations: dict[Times, Evaluation],
) -> pa.Table:
    copies = Counter(population)
    rows = [
        {
            "evaluation": request.id,
            "phase": phase,
            "generation": generation,
            "individual": population.index(request.times),
            "copies": copies[request.times],
            "measurement_times": request.times,
            "expected_mse": evaluations[request.times].expected_mse,
            "standard_error": evaluations[request.times].standard_error,
            "draws": evaluations[request.times].draws,
            "degenerate_draws": evaluations[request.times].degenerate_draws,
        }
        for request in requests
    ]
    return pa.Table.from_pylist(rows, schema=schema("evaluations"))


def _committed_generations(store: Store, phase: str) -> set[int]:
    if not store.has("evaluations"):
        return set()
    rows = store.read("evaluations")
    return set(rows.loc[rows["phase"] == phase, "generation"])


def _publish(store: Store, phase: str) -> None:
    """Turn the parts of a search into tables; the same again if it was cut short."""
    if not any(store.has_parts(table, phase) for table in ("evaluations", "draws")):
        return
    rows = store.read("evaluations")
    rows = rows[rows["phase"] == phase]
    ids = list(dict.fromkeys(rows["evaluation"]))
    starts = range(0, len(ids), _EVALUATIONS_AT_ONCE)
    pieces = (store.per_draw(ids[first : first + _EVALUATIONS_AT_ONCE]) for first in starts)
    store.publish("draws", phase, pieces)
    table = pa.Table.from_pandas(rows, schema=schema("evaluations"), preserve_index=False)
    store.publish("evaluations", phase, [table])
