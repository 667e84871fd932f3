"""An optimiser at work: ask, evaluate what the store lacks, commit, tell, until it is done."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import CHOOSING, stream_of
from pfdist.evaluation.estimate import Evaluation
from pfdist.evaluation.work import BLOCK, Estimation, Result, Work
from pfdist.kernels.noise import generator
from pfdist.runner.block_sums import BlockSums, Counted, evaluated_by_errors
from pfdist.runner.build import Built
from pfdist.runner.door import Batch, Session
from pfdist.runner.kept import PER_DRAW
from pfdist.runner.search_tables import (
    commit_generation,
    committed_generations,
    evaluation_rows,
    publish_search,
)
from pfdist.runner.searches import Settings
from pfdist.search import Candidate, Optimiser
from pfdist.search.probe import new_leaders
from pfdist.times.measurement_times import validated


@dataclass(eq=False)
class Request:
    """An evaluation that is asked for, and the draws that are known of it.

    Parameters
    ----------
    id : str
        Hash of everything on which the per-draw MSE depends.
    candidate : Candidate
    end : int
        Last instant whose error counts.
    stream : int
        Key of draws and filter noise: their roles keep them apart.
    estimation : Estimation
    mse : array of float64, (D,)
        NaN for a draw that is not known yet.
    known : int
        How many draws are known.
    """

    id: str
    candidate: Candidate
    end: int
    stream: int
    estimation: Estimation
    mse: NDArray[np.float64]
    known: int = 0


class Phase:
    """An optimiser with the purpose of its draws and the settings of its evaluations.

    Parameters
    ----------
    name : str
        Name in the tables.
    optimiser : Optimiser
    purpose : str
        Purpose of its draws; they must be draws that choose.
    settings : Settings
    built : Built
    keep_leaders : bool
        Whether the leaders are kept, for probes of the estimator.
    knows_truth : bool
        Whether the filter uses the true model.

    Attributes
    ----------
    evaluated : dict of str to array of float64
        Per-draw MSE by the evaluation's id, of this session, where a set may be asked for again.
    leaders : list of Evaluation
        Evaluations that led the generations; see `pfdist.search.probe.new_leaders`.
    """

    def __init__(
        self,
        name: str,
        optimiser: Optimiser,
        purpose: str,
        settings: Settings,
        built: Built,
        *,
        keep_leaders: bool = False,
        knows_truth: bool = False,
    ) -> None:
        if purpose not in CHOOSING:
            raise ValueError(f"no search may choose by draws with the purpose {purpose!r}")
        self.name, self.optimiser, self.purpose = name, optimiser, purpose
        self.settings, self.built, self.keep_leaders = settings, built, keep_leaders
        self.knows_truth = knows_truth
        self.evaluated: dict[str, NDArray[np.float64]] = {}
        self.leaders: list[Evaluation] = []

    def steps(self) -> float:
        """About how many particle-steps the phase takes."""
        settings, instants = self.settings, self.built.job.problem.feasible.horizon + 1
        a_draw = settings.estimation.steps_an_instant * instants
        return self.optimiser.evaluations * settings.draws * a_draw

    def request(self, candidate: Candidate, generation: int) -> Request:
        """Request of an evaluation for a candidate of a generation.

        Raises
        ------
        MeasurementTimesError
            The optimiser asked for times that do not lie in 0..T.
        """
        times, end, draws, individual, squared, _ = candidate
        last = self.built.job.problem.feasible.horizon if end is None else end
        validated(times, last, f"search {self.name}")
        fresh = [generation, times if individual is None else individual]
        keyed_by = [] if self.settings.common_noise else fresh
        stream = self.stream(*keyed_by)
        estimation = self.built.comparing if squared else self.settings.estimation
        evaluator = self.built.evaluator.truth if self.knows_truth else self.built.evaluator
        id_ = evaluator.evaluation_id(times, last, stream, estimation)
        mse = np.full(draws or self.settings.draws, np.nan)
        return Request(id_, candidate, last, stream, estimation, mse)

    def recall(self, request: Request) -> None:
        """Let a request know the draws that were evaluated before in this session."""
        if self.settings.common_noise:  # with fresh noise no evaluation is asked for twice
            before = self.evaluated.get(request.id, request.mse[:0])[: request.mse.size]
            request.mse[: before.size], request.known = before, before.size
            if before.size < request.mse.size:
                self.evaluated[request.id] = request.mse

    def stream(self, *keyed_by: Any) -> int:
        """Key of the draws and of the filters' noise."""
        return stream_of(self.purpose, self.built.job.seed, self.name, *keyed_by)

    def sums(self, counted: Counted) -> BlockSums:
        """Sums of errors over blocks of draws, for candidates whose errors are wanted."""
        stream, estimation = self.stream(), self.settings.estimation
        streams, truth = (stream, stream), self.knows_truth
        return BlockSums(
            self.built, counted, streams, estimation, knows_truth=truth, phase=self.name
        )

    def evaluation(self, request: Request, exact: float | None = None) -> Evaluation:
        """The evaluation that was requested."""
        times, end, *_ = request.candidate
        policy = self.settings.degenerate_policy
        purpose = self.purpose
        return Evaluation(times, request.mse, policy, exact, end, purpose=purpose)


def run_phase(phase: Phase, session: Session) -> Generator[Batch, None, Sequence[Evaluation]]:
    """Finalists of an optimiser that runs to its end.

    Parameters
    ----------
    phase : Phase
    session : Session

    Raises
    ------
    MeasurementTimesError
        The optimiser asked for times that do not lie in 0..T.
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    optimiser, name, reporter = phase.optimiser, phase.name, session.reporter
    committed = committed_generations(session.store, name)
    state, generation = optimiser.init(), 0
    share, start = phase.steps() / max(1, optimiser.generations), reporter.progress.done
    reporter.begin(name, generation=1, generations=optimiser.generations)
    copies_are_alike = phase.settings.common_noise or phase.built.evaluator.exact
    while not optimiser.done(state):
        rng = generator(phase.built.job.seed, "search", name, generation)
        asked = list(optimiser.ask(state, rng))
        if copies_are_alike:
            asked = [candidate._replace(individual=None) for candidate in asked]
        copies = Counter(asked)
        requests = [phase.request(each, generation) for each in copies if each.since is None]
        windows = [each for each in copies if each.since is not None]
        found = optimiser.finalists(state)
        known = _Known(phase, session, copies, generation, (start, share), shows_best=not found)
        if windows:
            for candidate, evaluation in (yield from _errors(phase, windows, session)):
                known(candidate, evaluation)
        if phase.built.evaluator.exact:
            _exactly(phase, requests, known)
        else:
            yield from _per_draw(phase, requests, session, known)
        evaluations = known.evaluations
        if requests and generation not in committed:
            rows = partial(evaluation_rows, name, generation, asked, requests, evaluations)
            session.later(partial(commit_generation, session.store, name, generation, rows))
        told = [evaluations[candidate] for candidate in asked]
        if phase.keep_leaders:
            phase.leaders.extend(new_leaders(_whole_or_prefixes(told), phase.leaders))
        state, generation = optimiser.tell(state, told), generation + 1
        costs, finalists = _whole_costs(told), _whole_costs(optimiser.finalists(state))
        mean = float(np.mean(costs)) if costs else None
        reporter.note(best=finalists[0] if finalists else None, mean=mean)
    reporter.note(done=start + phase.steps())
    session.later(partial(publish_search, session.store, name))
    return optimiser.finalists(state)


def _whole_or_prefixes(evaluations: Iterable[Evaluation]) -> list[Evaluation]:
    """Evaluations of sets and their prefixes, whose costs are those of one filter."""
    return [evaluation for evaluation in evaluations if evaluation.errors is None]


def _whole_costs(evaluations: Iterable[Evaluation]) -> list[float]:
    """Costs of whole sets, without those of prefixes, which cover a part of the horizon."""
    return [
        evaluation.cost
        for evaluation in evaluations
        if evaluation.end is None and math.isfinite(evaluation.cost)
    ]


class _Known:
    """The evaluations of a generation that are known, and the progress that they make."""

    def __init__(
        self,
        phase: Phase,
        session: Session,
        copies: Counter[Candidate],
        generation: int,
        steps: tuple[float, float],
        *,
        shows_best: bool,
    ) -> None:
        self.evaluations: dict[Candidate, Evaluation] = {}
        self._reporter, self._copies = session.reporter, copies
        self._generations, self._generation = phase.optimiser.generations, generation
        self._steps, self._shows_best, self._least = steps, shows_best, math.inf

    def __call__(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Know the evaluation of a candidate."""
        self.evaluations[candidate] = evaluation
        reporter, (start, share) = self._reporter, self._steps
        if self._shows_best and (costs := _whole_costs([evaluation])):
            self._least = min(self._least, *costs)
            reporter.note(best=self._least)
        part = self._generation + len(self.evaluations) / len(self._copies)
        reporter.reach(
            start + share * min(part, self._generations),
            evaluations=reporter.progress.evaluations + self._copies[candidate],
            generation=self._generation + 1,
            generations=max(self._generation + 1, self._generations),
        )


def _exactly(
    phase: Phase, requests: list[Request], know: Callable[[Candidate, Evaluation], None]
) -> None:
    """Know the evaluation of each request: it takes no time, so neither pool nor store."""
    sets = [request.candidate.measurement_times for request in requests]
    costs = phase.built.evaluator.expected_mse(sets, [request.end for request in requests])
    for request, cost in zip(requests, costs, strict=True):
        request.mse = np.empty(0)
        know(request.candidate, phase.evaluation(request, float(cost)))


def _per_draw(
    phase: Phase,
    requests: list[Request],
    session: Session,
    know: Callable[[Candidate, Evaluation], None],
) -> Generator[Batch, None, None]:
    """Know the evaluation of each request as soon as all its draws are known."""
    same = defaultdict[str, list[Request]](list)  # a prefix up to T is a whole set, too
    for request in requests:
        same[request.id].append(request)
    longest = {id_: max(alike, key=lambda each: each.mse.size) for id_, alike in same.items()}

    def know_all(request: Request) -> None:
        for alike in same[request.id]:
            alike.mse = request.mse[: alike.mse.size]
            know(alike.candidate, phase.evaluation(alike))

    def learn(work: Work, result: Result) -> None:
        for id_, mse in work.by_id(result).items():
            request = longest[id_]
            request.mse[slice(*work.draws)] = mse
            request.known += mse.size
            if request.known == request.mse.size:
                know_all(request)

    for request in longest.values():
        phase.recall(request)
        if request.known == request.mse.size:
            know_all(request)
    works = list(_works(phase, longest.values()))
    if works:
        yield Batch(session, phase.name, works, PER_DRAW, learn, more_follows=True)


def _works(phase: Phase, requests: Iterable[Request]) -> Iterator[Work]:
    """Works for the missing draws; sets that lack the same draws of a stream go together."""
    together = defaultdict[Any, list[Request]](list)
    for request in requests:
        first, size = request.known, request.mse.size
        if first < size:
            together[request.stream, request.estimation, (first, size)].append(request)
    for (stream, estimation, draws), group in together.items():
        yield Work(
            measurement_times=tuple(request.candidate.measurement_times for request in group),
            ends=tuple(request.end for request in group),
            filter_streams=(stream,) * len(group),
            draws_stream=stream,
            draws=draws,
            estimation=estimation,
            ids=tuple(request.id for request in group),
            knows_truth=phase.knows_truth,
        )


def _errors(
    phase: Phase, windows: list[Candidate], session: Session
) -> Generator[Batch, None, list[tuple[Candidate, Evaluation]]]:
    """Evaluations with the errors of each instant, for each candidate, all together."""
    blocks = math.ceil((windows[0].draws or phase.settings.draws) / BLOCK)
    evaluations, _ = yield from evaluated_by_errors(
        windows, session, phase.sums, blocks, phase.purpose
    )
    return list(zip(windows, evaluations, strict=True))
