"""An optimiser at work: ask, evaluate what the store does not hold, commit, tell, until done."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.evaluation.estimate import Evaluation, Purpose
from pfdist.evaluation.work import Estimation, Result, Work, cut
from pfdist.kernels.noise import generator
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.progress import Progress, Report
from pfdist.runner.search_tables import commit_generation, committed_generations, publish_search
from pfdist.runner.searches import Settings
from pfdist.search import Candidate, Optimiser
from pfdist.search.probe import new_leaders
from pfdist.store import schema
from pfdist.times.measurement_times import Times

E = TypeVar("E", bound=Evaluation)
_Key = tuple[Times, int, int, Estimation]  # with an end, and a stream


@dataclass(frozen=True)
class Phase(Generic[E]):
    """An optimiser at work: what its draws are for, and how it evaluates.

    Parameters
    ----------
    name : str
        In the tables.
    optimiser : Optimiser
    purpose : Purpose
    settings : Settings
    built : Built
    evaluated : dict of str to array of float64
        Per-draw MSE of this session by id, where a set may be wanted again.
    leaders : list of Evaluation
        Those that led its generations; see `pfdist.search.probe.new_leaders`.
    """

    name: str
    optimiser: Optimiser[E]
    purpose: Purpose[E]
    settings: Settings
    built: Built
    evaluated: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    leaders: list[E] = field(default_factory=list)

    def steps(self) -> float:
        """About how many particle-steps it takes."""
        settings, instants = self.settings, self.built.job.problem.horizon + 1
        a_draw = settings.estimation.steps_an_instant * instants
        return self.optimiser.evaluations * settings.draws * a_draw

    def request(self, candidate: Candidate, generation: int) -> "_Request":
        """What is to be known of a candidate."""
        times, end, draws, individual, squared = candidate
        fresh = [generation, times if individual is None else individual]
        keyed_by = [] if self.settings.common_noise else fresh
        stream = self.purpose.stream(self.built.job.seed, self.name, *keyed_by)
        last = self.built.job.problem.horizon if end is None else end
        estimation = self.built.comparing if squared else self.settings.estimation
        id_ = self.built.source.evaluation_id(times, last, stream, estimation)
        mse = np.full(draws or self.settings.draws, np.nan)
        return _Request(id_, candidate, last, stream, estimation, mse, np.isnan(mse))

    def alike(self, candidate: Candidate) -> Candidate:
        """Candidate, without its place in the population where copies cannot differ."""
        same = self.settings.common_noise or self.built.problem.exact
        return candidate._replace(individual=None) if same else candidate

    def evaluation(self, request: "_Request", exact: float | None = None) -> E:
        """Give what was asked for."""
        times, end, *_ = request.candidate
        policy = self.settings.degenerate_policy
        return self.purpose.evaluation(times, request.mse, policy, exact, end)


@dataclass
class _Request:
    """An evaluation that is wanted, and what is known of it."""

    id: str
    candidate: Candidate
    end: int
    stream: int  # of truth and filter: their roles keep them apart
    estimation: Estimation
    mse: NDArray[np.float64]
    missing: NDArray[np.bool_]

    @property
    def key(self) -> "_Key":
        return self.candidate.measurement_times, self.end, self.stream, self.estimation

    def learn(self, draws: Any, mse: Any) -> None:
        """Take the MSE of some draws."""
        self.mse[draws], self.missing[draws] = mse, False


def run_phase(
    phase: Phase[E], collector: Collector, progress: Progress, report: Report
) -> Sequence[E]:
    """Run an optimiser to its end, replaying what the store holds, and give its finalists.

    Parameters
    ----------
    phase : Phase
    collector : Collector
    progress : Progress
        How far the run was before.
    report : callable

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    optimiser, name, store = phase.optimiser, phase.name, collector.store
    committed = committed_generations(store, name)
    state, generation = optimiser.init(), 0
    share, start = phase.steps() / max(1, optimiser.generations), progress.done
    generations = optimiser.generations
    progress = replace(
        progress, phase=name, best=None, mean=None, generation=1, generations=generations
    )
    report(progress)
    while not optimiser.done(state):
        rng = generator(phase.built.job.seed, "search", name, generation)
        asked = [phase.alike(candidate) for candidate in optimiser.ask(state, rng)]
        copies = Counter(asked)
        requests = [phase.request(candidate, generation) for candidate in copies]
        found = optimiser.finalists(state)
        evaluations: dict[Candidate, E] = {}
        for candidate, evaluation in _evaluate(phase, requests, collector):
            evaluations[candidate] = evaluation
            if not found:  # nothing better to show yet
                costs = _whole_costs(evaluations.values())
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
            collector.later(partial(commit_generation, store, name, generation, rows))
        told = [evaluations[candidate] for candidate in asked]
        phase.leaders.extend(new_leaders(told, phase.leaders))
        state, generation = optimiser.tell(state, told), generation + 1
        costs, finalists = _whole_costs(told), _whole_costs(optimiser.finalists(state))
        mean = float(np.mean(costs)) if costs else None
        progress = replace(progress, best=finalists[0] if finalists else None, mean=mean)
    collector.later(partial(publish_search, store, name))
    return optimiser.finalists(state)


def _whole_costs(evaluations: Iterable[Evaluation]) -> list[float]:
    """Costs of whole sets: that of a prefix is of a part of the horizon."""
    return [
        evaluation.cost
        for evaluation in evaluations
        if evaluation.end is None and np.isfinite(evaluation.cost)
    ]


def _evaluate(
    phase: Phase[E], requests: list[_Request], collector: Collector
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

    works = _works(list(wanted.values()))
    run = collector.run(phase.name, "draws", works, rows_of, more_follows=True)
    with closing(run) as pieces:
        for work, result in pieces:
            for key, mse in zip(_keys(work), result.mse.T, strict=True):
                request = wanted[key]
                request.learn(slice(*work.draws), mse)
                if not request.missing.any():
                    yield request.candidate, phase.evaluation(request)


def _recall(phase: Phase[E], requests: list[_Request], collector: Collector) -> None:
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


def _works(requests: list[_Request]) -> Iterator[Work]:
    """Put together sets that lack the same draws of one stream: what they share is done once."""
    together: dict[Any, list[_Request]] = defaultdict(list)
    for request in requests:
        together[request.stream, request.estimation, request.missing.tobytes()].append(request)
    for (stream, estimation, _), group in together.items():
        lacking = group[0].missing
        for draws in cut(np.flatnonzero(lacking), lacking.size):
            yield Work(
                measurement_times=tuple(request.candidate.measurement_times for request in group),
                ends=tuple(request.end for request in group),
                filter_streams=(stream,) * len(group),
                draws_stream=stream,
                draws=draws,
                estimation=estimation,
            )


def _keys(work: Work) -> list[_Key]:
    sets = zip(work.measurement_times, work.ends, work.filter_streams, strict=True)
    return [(*each, work.estimation) for each in sets]


def _draw_rows(ids: list[str], draws: tuple[int, int], mse: NDArray[np.float64]) -> pa.Table:
    of_draw = np.repeat(np.arange(len(ids)), len(mse))
    columns = [
        pa.array(ids, pa.string()).take(of_draw),
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
            "particles": request.estimation.particles,
            "estimator": request.estimation.estimator,
            "expected_mse": evaluations[request.candidate].expected_mse,
            "standard_error": evaluations[request.candidate].standard_error,
            "draws": evaluations[request.candidate].draws,
            "degenerate_draws": evaluations[request.candidate].degenerate_draws,
        }
        for request in requests
    ]
    return pa.Table.from_pylist(rows, schema=schema("evaluations"))
