"""One search: ask, evaluate what the store does not hold, commit, tell, until done; then its race.

What a search has found runs in a race on draws of another key, whose winner is compared.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.errors import StoreError
from pfdist.evaluation import (
    SEARCH,
    SHORTLIST,
    Evaluation,
    Purpose,
    SearchEvaluation,
    ShortlistEvaluation,
)
from pfdist.kernels.noise import generator
from pfdist.measurement_times import Times
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.progress import Progress, Report
from pfdist.runner.searches import NamedSearch, Settings
from pfdist.search import Candidate, Exchange, Optimiser, Race
from pfdist.search.base import FINALISTS
from pfdist.store import Store, schema
from pfdist.work import Result, Work, cut

_TABLES = ("evaluations", "draws")
_UNPOLISHED = 2  # that race all the same
_REACH = 2.5  # mean gaps: how far an exchange that polishes moves a time
_EVALUATIONS_AT_ONCE = 200  # read from the store when a phase is published

E = TypeVar("E", bound=Evaluation)


@dataclass(frozen=True)
class _Phase(Generic[E]):
    """An optimiser at work: what its draws are for, and how it evaluates.

    `evaluated` holds per-draw MSE of this session by id, where a set may be wanted again.
    """

    name: str
    optimiser: Optimiser[E]
    purpose: Purpose[E]
    settings: Settings
    built: Built
    evaluated: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    def steps(self) -> float:
        """About how many particle-steps it takes."""
        settings, instants = self.settings, self.built.job.problem.horizon + 1
        a_draw = settings.estimation.steps_an_instant * instants
        return self.optimiser.evaluations * settings.draws * a_draw

    def request(self, candidate: Candidate, generation: int) -> "_Request":
        """What is to be known of a candidate."""
        times, end, draws = candidate
        fresh = [] if self.settings.common_noise else [generation, times]
        stream = self.purpose.stream(self.built.job.seed, self.name, *fresh)
        last = self.built.job.problem.horizon if end is None else end
        estimation, draws = self.settings.estimation, draws or self.settings.draws
        id_ = self.built.source.evaluation_id(times, last, stream, estimation)
        return _Request(
            id_, candidate, last, stream, np.full(draws, np.nan), np.ones(draws, np.bool_)
        )

    def evaluation(self, request: "_Request", exact: float | None = None) -> E:
        """Give what was asked for."""
        times, end, _ = request.candidate
        policy = self.settings.degenerate_policy
        return self.purpose.evaluation(times, request.mse, policy, exact, end)


@dataclass
class _Request:
    """An evaluation that is wanted, and what is known of it."""

    id: str
    candidate: Candidate
    end: int
    stream: int  # of truth and filter: their roles keep them apart
    mse: NDArray[np.float64]
    missing: NDArray[np.bool_]

    @property
    def key(self) -> tuple[Times, int, int]:
        return self.candidate.measurement_times, self.end, self.stream

    def learn(self, draws: Any, mse: Any) -> None:
        """Take the MSE of some draws."""
        self.mse[draws], self.missing[draws] = mse, False


@dataclass(frozen=True)
class Winner:
    """What a search returns: times, and what the search believed of them.

    Parameters
    ----------
    measurement_times : tuple of int
    believed : SearchEvaluation
        On the draws that chose them.
    """

    measurement_times: Times
    believed: SearchEvaluation


def run_search(
    built: Built, search: NamedSearch, collector: Collector, progress: Progress, report: Report
) -> dict[str, Winner]:
    """Run a search to its end and let what it has found race, replaying what the store holds.

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
    dict of str to Winner
        By the name under which it is compared: one, or one for each number of measurements. None
        where every set that it ended with had a degenerate draw.

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """

    def run(phase: _Phase[E]) -> Sequence[E]:
        nonlocal progress
        found = _run(phase, collector, progress, report)
        progress = replace(progress, done=progress.done + phase.steps())
        return [one for one in found if np.isfinite(one.cost)]

    found = run(_searching(built, search))
    if built.numbers:  # nothing is to be decided between
        return {
            built.named(search.name, len(one.measurement_times)): Winner(one.measurement_times, one)
            for one in sorted(found, key=lambda one: len(one.measurement_times))
        }
    if found and search.polishing:
        polished = run(_polishing(built, search, found[0].measurement_times))
        found = [*polished[: FINALISTS - _UNPOLISHED], *found[:_UNPOLISHED]]
    believed = {one.measurement_times: one for one in found}
    best = next(iter(believed), None)
    if len(believed) > 1:
        best = run(_racing(built, search, tuple(believed)))[0].measurement_times
    return {} if best is None else {search.name: Winner(best, believed[best])}


def steps(built: Built, search: NamedSearch) -> float:
    """About how many particle-steps a search takes, with all that follows it."""
    start = built.job.problem.feasible.regular()
    phases = [_searching(built, search)]
    if search.polishing:
        phases.append(_polishing(built, search, start))
    return sum(phase.steps() for phase in phases)


def _searching(built: Built, search: NamedSearch) -> _Phase[SearchEvaluation]:
    return _Phase(search.name, search.optimiser, SEARCH, search.settings, built)


def _polishing(built: Built, search: NamedSearch, start: Times) -> _Phase[SearchEvaluation]:
    """Exchanges, on draws of their own: those of the search flatter what it has found."""
    feasible, settings = built.job.problem.feasible, search.polishing or search.settings
    reach = math.ceil(_REACH * (feasible.horizon + 1) / len(start))
    exchange = Exchange(feasible, settings.draws, start, reach)
    return _Phase(search.polish, exchange, SEARCH, settings, built)


def _racing(
    built: Built, search: NamedSearch, sets: tuple[Times, ...]
) -> _Phase[ShortlistEvaluation]:
    race = Race(sets, search.racing.draws)
    return _Phase(search.shortlist, race, SHORTLIST, search.racing, built)


def _run(phase: _Phase[E], collector: Collector, progress: Progress, report: Report) -> Sequence[E]:
    """Run an optimiser to its end and give its finalists."""
    optimiser, name, store = phase.optimiser, phase.name, collector.store
    committed = _committed_generations(store, name)
    state, generation = optimiser.init(), 0
    share, start = phase.steps() / max(1, optimiser.generations), progress.done
    progress = replace(progress, phase=name, generation=1, generations=optimiser.generations)
    report(progress)
    while not optimiser.done(state):
        rng = generator(phase.built.job.seed, "search", name, generation)
        asked = list(optimiser.ask(state, rng))
        copies = Counter(asked)
        requests = [phase.request(candidate, generation) for candidate in copies]
        evaluations: dict[Candidate, E] = {}
        for candidate, evaluation in _evaluate(phase, requests, collector):
            evaluations[candidate] = evaluation
            if progress.mean is None:  # nothing better to show yet
                costs = _finite_costs(evaluations.values())
                progress = replace(progress, best=min(costs, default=None))
            part = min(generation + len(evaluations) / len(copies), optimiser.generations)
            progress = replace(
                progress,
                done=start + share * part,
                evaluations=progress.evaluations + copies[candidate],
                generation=generation + 1,
                generations=max(generation + 1, optimiser.generations),
            )
            report(progress)
        if generation not in committed:
            rows = partial(_rows, name, generation, asked, requests, evaluations)
            collector.later(partial(_commit, store, name, generation, rows))
        told = [evaluations[candidate] for candidate in asked]
        state, generation = optimiser.tell(state, told), generation + 1
        costs, finalists = _finite_costs(told), optimiser.finalists(state)
        if costs:
            best = finalists[0].cost if finalists else None
            progress = replace(progress, best=best, mean=float(np.mean(costs)))
    collector.later(partial(_publish, store, name))
    return optimiser.finalists(state)


def _finite_costs(evaluations: Iterable[Evaluation]) -> list[float]:
    return [evaluation.cost for evaluation in evaluations if np.isfinite(evaluation.cost)]


def _evaluate(
    phase: _Phase[E], requests: list[_Request], collector: Collector
) -> Iterator[tuple[Candidate, E]]:
    """Evaluate what was asked for, each once, taking from the store what it holds."""
    problem = phase.built.problem
    if problem.exact:  # in no time, so that neither pool nor store is asked
        sets = [request.candidate.measurement_times for request in requests]
        costs = problem.expected_mse(sets, [request.end for request in requests])
        for request, cost in zip(requests, costs, strict=True):
            request.mse = np.empty(0)
            yield request.candidate, phase.evaluation(request, float(cost))
        return
    _recall(phase, requests, collector)
    wanted = {request.key: request for request in requests if request.missing.any()}
    for request in requests:
        if request.key not in wanted:
            yield request.candidate, phase.evaluation(request)

    def rows_of(work: Work, result: Result) -> pa.Table:
        return _draw_rows([wanted[key].id for key in _keys(work)], work.draws, result.mse)

    works = _works(list(wanted.values()), phase.settings)
    run = collector.run(phase.name, "draws", works, rows_of, more_follows=True)
    with closing(run) as pieces:
        for work, result in pieces:
            for key, mse in zip(_keys(work), result.mse.T, strict=True):
                request = wanted[key]
                request.learn(slice(*work.draws), mse)
                if not request.missing.any():
                    yield request.candidate, phase.evaluation(request)


def _recall(phase: _Phase[E], requests: list[_Request], collector: Collector) -> None:
    """Learn what was evaluated before: in this session, or in one whose rows the store holds."""
    of_id = {request.id: request for request in requests}
    for id_ in of_id.keys() & phase.evaluated.keys():
        known = phase.evaluated[id_][: of_id[id_].mse.size]
        of_id[id_].learn(slice(known.size), known)
    lacking = [id_ for id_, request in of_id.items() if request.missing.any()]
    if collector.resumed and lacking:
        for id_, rows in collector.store.per_draw(lacking).to_pandas().groupby("evaluation"):
            request = of_id[str(id_)]
            wanted = rows[rows["draw"] < request.mse.size]
            request.learn(wanted["draw"], wanted["mse"])
    if phase.settings.common_noise:  # or nothing is wanted twice
        for id_, request in of_id.items():
            if id_ not in phase.evaluated or phase.evaluated[id_].size < request.mse.size:
                phase.evaluated[id_] = request.mse


def _works(requests: list[_Request], settings: Settings) -> Iterator[Work]:
    """Put together sets that lack the same draws of one stream: what they share is done once."""
    together: dict[Any, list[_Request]] = defaultdict(list)
    for request in requests:
        together[request.stream, request.missing.tobytes()].append(request)
    for (stream, _), group in together.items():
        lacking = group[0].missing
        for draws in cut(np.flatnonzero(lacking), lacking.size):
            yield Work(
                measurement_times=tuple(request.candidate.measurement_times for request in group),
                ends=tuple(request.end for request in group),
                filter_streams=(stream,) * len(group),
                draws_stream=stream,
                draws=draws,
                estimation=settings.estimation,
            )


def _keys(work: Work) -> list[tuple[Times, int, int]]:
    return list(zip(work.measurement_times, work.ends, work.filter_streams, strict=True))


def _draw_rows(ids: list[str], draws: tuple[int, int], mse: NDArray[np.float64]) -> pa.Table:
    columns = [
        pa.array(np.repeat(ids, len(mse)), pa.string()),
        pa.array(np.tile(np.arange(*draws), len(ids))),
        pa.array(mse.T.ravel(), from_pandas=True),
    ]
    return pa.Table.from_arrays(columns, schema=schema("draws"))


def _rows(
    phase: str,
    generation: int,
    asked: list[Candidate],
    requests: list[_Request],
    evaluations: dict[Candidate, Any],
) -> pa.Table:
    copies = Counter(asked)
    rows = [
        {
            "evaluation": request.id,
            "phase": phase,
            "generation": generation,
            "individual": asked.index(request.candidate),
            "copies": copies[request.candidate],
            "measurement_times": request.candidate.measurement_times,
            "end": request.end,
            "expected_mse": evaluations[request.candidate].expected_mse,
            "standard_error": evaluations[request.candidate].standard_error,
            "draws": evaluations[request.candidate].draws,
            "degenerate_draws": evaluations[request.candidate].degenerate_draws,
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
    most = rows.groupby("evaluation", sort=False)["draws"].max()
    wanted = {str(id_): int(draws) for id_, draws in most.items()}
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
