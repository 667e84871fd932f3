"""One search: ask, evaluate what the store does not hold, commit, tell, until done."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.errors import StoreError
from pfdist.kernels.noise import generator, stream_key
from pfdist.measurement_times import Times
from pfdist.monte_carlo import Evaluation, Result, Work, cut
from pfdist.runner.build import Built, NamedSearch
from pfdist.runner.collect import Collector
from pfdist.runner.progress import Progress, Report
from pfdist.store import Store, schema

_TABLES = ("evaluations", "draws")
_EVALUATIONS_AT_ONCE = 200  # read from the store when a phase is published


@dataclass
class _Request:
    """An evaluation that is wanted, and what is known of it."""

    id: str
    times: Times
    stream: int  # of truth and filter: their roles keep them apart
    mse: NDArray[np.float64]
    missing: NDArray[np.bool_]

    @property
    def key(self) -> tuple[Times, int]:
        return self.times, self.stream

    def learn(self, draws: Any, mse: Any) -> None:
        """Take the MSE of some draws."""
        self.mse[draws], self.missing[draws] = mse, False


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
            rows = partial(_rows, name, generation, population, requests, evaluations)
            collector.later(partial(_commit, store, name, generation, rows))
        told = [evaluations[times] for times in population]
        state, generation = optimiser.tell(state, told), generation + 1
        costs = _finite_costs(told)
        if costs:
            best = optimiser.best(state).cost
            progress = replace(progress, best=best, mean=float(np.mean(costs)))
    collector.later(partial(_publish, store, name))
    return optimiser.best(state)


def _finite_costs(evaluations: Iterable[Evaluation]) -> list[float]:
    return [evaluation.cost for evaluation in evaluations if np.isfinite(evaluation.cost)]


def _request(built: Built, name: str, generation: int, times: Times) -> _Request:
    fresh = [generation, times] if built.job.evaluation.noise == "fresh" else []
    stream, draws = stream_key(built.job.seed, "search", name, *fresh), built.job.evaluation.draws
    id_ = built.source.evaluation_id(times, stream, stream)
    return _Request(id_, times, stream, np.full(draws, np.nan), np.ones(draws, np.bool_))


def _evaluate(
    built: Built, phase: str, requests: list[_Request], collector: Collector
) -> Iterator[Evaluation]:
    """Evaluate what was asked for, each once, taking from the store what it holds."""
    policy = built.job.evaluation.degenerate_draws
    if built.problem.exact:  # in no time, so that neither pool nor store is asked
        costs = built.problem.expected_mse([request.times for request in requests])
        for request, cost in zip(requests, costs, strict=True):
            yield Evaluation(request.times, np.empty(0), policy, float(cost))
        return
    _recall(built, requests, collector)
    wanted = {request.key: request for request in requests if request.missing.any()}
    for request in requests:
        if request.key not in wanted:
            yield Evaluation(request.times, request.mse, policy)

    def rows_of(work: Work, result: Result) -> pa.Table:
        ids = [wanted[key].id for key in _keys(work)]
        return pa.concat_tables(map(partial(_draw_rows, work.draws), ids, result.mse.T))

    works = _works(list(wanted.values()))
    run = collector.run(phase, "draws", works, rows_of, more_follows=True)
    with closing(run) as pieces:
        for work, result in pieces:
            for key, mse in zip(_keys(work), result.mse.T, strict=True):
                request = wanted[key]
                request.learn(slice(*work.draws), mse)
                if not request.missing.any():
                    yield Evaluation(request.times, request.mse, policy)


def _recall(built: Built, requests: list[_Request], collector: Collector) -> None:
    """Learn what the store holds."""
    if built.job.evaluation.noise == "common":  # what is wanted may be what waits to be committed
        collector.flush()
    of_id, draws = {request.id: request for request in requests}, built.job.evaluation.draws
    known = collector.store.per_draw(list(of_id)).to_pandas()
    for id_, rows in known[known["draw"] < draws].groupby("evaluation"):
        of_id[str(id_)].learn(rows["draw"], rows["mse"])


def _works(requests: list[_Request]) -> Iterator[Work]:
    """Put together sets that lack the same draws of one stream: what they share is done once."""
    together: dict[Any, list[_Request]] = defaultdict(list)
    for request in requests:
        together[request.stream, request.missing.tobytes()].append(request)
    for (stream, _), group in together.items():
        times, streams = tuple(request.times for request in group), (stream,) * len(group)
        lacking = group[0].missing
        for draws in cut(np.flatnonzero(lacking), lacking.size):
            yield Work(times, streams, stream, draws)


def _keys(work: Work) -> list[tuple[Times, int]]:
    return list(zip(work.measurement_times, work.filter_streams, strict=True))


def _draw_rows(draws: tuple[int, int], id_: str, mse: NDArray[np.float64]) -> pa.Table:
    columns = [
        pa.array([id_] * mse.size, pa.string()),
        pa.array(np.arange(*draws)),
        pa.array(mse, from_pandas=True),
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


def _commit(store: Store, phase: str, generation: int, rows: Callable[[], pa.Table]) -> None:
    store.commit("evaluations", phase, f"{generation:06d}", rows())


def _committed_generations(store: Store, phase: str) -> set[int]:
    if not store.has("evaluations"):
        return set()
    rows = store.read("evaluations")
    return set(rows.loc[rows["phase"] == phase, "generation"])


def unpublished(store: Store, phases: Iterable[str]) -> bool:
    """Whether a search has parts that are not tables yet."""
    return any(store.has_parts(table, phase) for phase in phases for table in _TABLES)


def _publish(store: Store, phase: str) -> None:
    """Turn the parts of a search into tables; the same again if it was cut short."""
    if not unpublished(store, [phase]):
        return
    rows = store.read("evaluations")
    rows = rows[rows["phase"] == phase]
    wanted = dict(zip(rows["evaluation"], rows["draws"], strict=True))
    store.publish("draws", phase, _draws_of(store, wanted))
    table = pa.Table.from_pandas(rows, schema=schema("evaluations"), preserve_index=False)
    store.publish("evaluations", phase, [table])


def _draws_of(store: Store, wanted: dict[str, int]) -> Iterator[pa.Table]:
    """Give the rows of so many draws of each evaluation, or none: their parts are to be removed."""
    ids = list(wanted)
    for first in range(0, len(ids), _EVALUATIONS_AT_ONCE):
        some = ids[first : first + _EVALUATIONS_AT_ONCE]
        rows = store.per_draw(some)
        if rows.num_rows != sum(wanted[id_] for id_ in some):
            raise StoreError(
                f"{store.path} lacks draws that were committed: is another driver at work there? "
                "Run the same command again"
            )
        yield rows
