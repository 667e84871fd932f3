"""An optimiser at work: ask, evaluate what the store lacks, commit, tell, until it is done."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pfdist.evaluation.estimate import Evaluation, Purpose
from pfdist.evaluation.work import BLOCK
from pfdist.kernels.noise import generator
from pfdist.runner.block_sums import BlockSums, Counted
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.evaluation_rows import evaluation_rows
from pfdist.runner.progress import Reporter
from pfdist.runner.requests import Request, known
from pfdist.runner.search_tables import commit_generation, committed_generations, publish_search
from pfdist.runner.searches import Settings
from pfdist.runner.window_errors import evaluated_by_errors
from pfdist.search import Candidate, Optimiser
from pfdist.search.probe import new_leaders
from pfdist.times.measurement_times import validated

E = TypeVar("E", bound=Evaluation)


class Phase(Generic[E]):
    """An optimiser with the purpose of its draws and the settings of its evaluations.

    Parameters
    ----------
    name : str
        Name in the tables.
    optimiser : Optimiser
    purpose : Purpose
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
        optimiser: Optimiser[E],
        purpose: Purpose[E],
        settings: Settings,
        built: Built,
        *,
        keep_leaders: bool = False,
        knows_truth: bool = False,
    ) -> None:
        self.name, self.optimiser, self.purpose = name, optimiser, purpose
        self.settings, self.built, self.keep_leaders = settings, built, keep_leaders
        self.knows_truth = knows_truth
        self.evaluated: dict[str, NDArray[np.float64]] = {}
        self.leaders: list[E] = []

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
        source = self.built.source.truth if self.knows_truth else self.built.source
        id_ = source.evaluation_id(times, last, stream, estimation)
        mse = np.full(draws or self.settings.draws, np.nan)
        return Request(
            self.name,
            id_,
            candidate,
            last,
            stream,
            estimation,
            self.knows_truth,
            mse,
            missing=np.isnan(mse),
        )

    def stream(self, *keyed_by: Any) -> int:
        """Key of the draws and of the filters' noise."""
        return self.purpose.stream(self.built.job.seed, self.name, *keyed_by)

    def sums(self, counted: Counted) -> BlockSums:
        """Sums of errors over blocks of draws, for candidates whose errors are wanted."""
        stream, estimation = self.stream(), self.settings.estimation
        streams, truth = (stream, stream), self.knows_truth
        return BlockSums(
            self.built, counted, streams, estimation, knows_truth=truth, phase=self.name
        )

    def evaluation(self, request: Request, exact: float | None = None) -> E:
        """The evaluation that was requested."""
        times, end, *_ = request.candidate
        policy = self.settings.degenerate_policy
        return self.purpose.evaluation(times, request.mse, policy, exact, end)


def run_phase(phase: Phase[E], collector: Collector, reporter: Reporter) -> Sequence[E]:
    """Finalists of an optimiser that runs to its end, with evaluations of the store where possible.

    Parameters
    ----------
    phase : Phase
    collector : Collector
    reporter : Reporter

    Raises
    ------
    MeasurementTimesError
        The optimiser asked for times that do not lie in 0..T.
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    optimiser, name, store = phase.optimiser, phase.name, collector.store
    committed = committed_generations(store, name)
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
        evaluations: dict[Candidate, E] = {}
        least = math.inf
        for candidate, evaluation in _evaluate(phase, requests, windows, collector):
            evaluations[candidate] = evaluation
            if not found and (costs := _whole_costs([evaluation])):  # nothing better to show yet
                least = min(least, *costs)
                reporter.note(best=least)
            part = min(generation + len(evaluations) / len(copies), optimiser.generations)
            reporter.reach(
                start + share * part,
                evaluations=reporter.progress.evaluations + copies[candidate],
                generation=generation + 1,
                generations=max(generation + 1, optimiser.generations),
            )
        if requests and generation not in committed:
            rows = partial(evaluation_rows, name, generation, asked, requests, evaluations)
            collector.later(partial(commit_generation, store, name, generation, rows))
        told = [evaluations[candidate] for candidate in asked]
        if phase.keep_leaders:
            phase.leaders.extend(new_leaders(_whole_or_prefixes(told), phase.leaders))
        state, generation = optimiser.tell(state, told), generation + 1
        costs, finalists = _whole_costs(told), _whole_costs(optimiser.finalists(state))
        mean = float(np.mean(costs)) if costs else None
        reporter.note(best=finalists[0] if finalists else None, mean=mean)
    reporter.note(done=start + phase.steps())
    collector.later(partial(publish_search, store, name))
    return optimiser.finalists(state)


def _whole_or_prefixes(evaluations: Iterable[E]) -> list[E]:
    """Evaluations of sets and their prefixes, whose costs are those of one filter."""
    return [evaluation for evaluation in evaluations if evaluation.errors is None]


def _whole_costs(evaluations: Iterable[Evaluation]) -> list[float]:
    """Costs of whole sets, without those of prefixes, which cover a part of the horizon."""
    return [
        evaluation.cost
        for evaluation in evaluations
        if evaluation.end is None and math.isfinite(evaluation.cost)
    ]


def _evaluate(
    phase: Phase[E], requests: list[Request], windows: list[Candidate], collector: Collector
) -> Iterator[tuple[Candidate, E]]:
    """Yield the evaluation of each request; known draws come from the store and this session.

    Candidates whose errors of each instant are wanted are evaluated first, all together.
    """
    evaluator = phase.built.evaluator
    if windows:
        yield from _errors(phase, windows, collector)
    if evaluator.exact:  # it takes no time, so neither pool nor store is needed
        sets = [request.candidate.measurement_times for request in requests]
        costs = evaluator.expected_mse(sets, [request.end for request in requests])
        for request, cost in zip(requests, costs, strict=True):
            request.mse = np.empty(0)
            yield request.candidate, phase.evaluation(request, float(cost))
        return
    same = defaultdict[str, list[Request]](list)  # a prefix up to T is a whole set, too
    for request in requests:
        same[request.id].append(request)
    longest = [max(alike, key=lambda request: request.mse.size) for alike in same.values()]
    # With fresh noise no evaluation is asked for twice.
    evaluated = phase.evaluated if phase.settings.common_noise else None
    for finished in known(longest, evaluated, collector):
        for request in same[finished.id]:
            request.mse = finished.mse[: request.mse.size]
            yield request.candidate, phase.evaluation(request)


def _errors(
    phase: Phase[E], windows: list[Candidate], collector: Collector
) -> Iterator[tuple[Candidate, E]]:
    """Yield an evaluation with the errors of each instant for each candidate."""
    kind = phase.purpose.evaluation
    blocks = math.ceil((windows[0].draws or phase.settings.draws) / BLOCK)
    evaluations, _ = evaluated_by_errors(windows, kind, phase.built, phase.sums, blocks, collector)
    yield from zip(windows, evaluations, strict=True)
