"""The loop of an optimiser: ask, evaluate what the store lacks, commit, tell, until it is done.

The tables are a search's only checkpoint. After a kill, the phase asks the optimiser again from the
first generation on. Random numbers are keyed by the generation, so the candidates are the same, and
their draws are found by the ids of the evaluations.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.measurement_times import validated
from pfdist.common.streams import CHOOSING, stream_of
from pfdist.errors import StoreError
from pfdist.filters.criterion import Criterion
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_mse
from pfdist.filters.work import BLOCK, Estimation, FilterWork, Result
from pfdist.kernels.variates import generator
from pfdist.runner.block_sums import BlockSums, evaluated_by_errors
from pfdist.runner.build import Built
from pfdist.runner.by_instant import evaluated_in_groups
from pfdist.runner.door import EVALUATIONS, RunSession, WorkBatch
from pfdist.runner.parts import Part
from pfdist.runner.progress import Reporter
from pfdist.runner.row_formats import PER_DRAW
from pfdist.runner.searches import Settings
from pfdist.search import Candidate, Counted, Optimiser
from pfdist.store import Store, schema

_TABLES = ("evaluations", "draws", "error_sums")
_EVALUATIONS_AT_ONCE = 200  # evaluations that are read together when a phase is published


def evaluation_rows(
    phase: str,
    generation: int,
    candidates: list[Candidate],
    requests: Sequence[Any],
    evaluations: dict[Candidate, Any],
) -> pa.Table:
    """Rows of the table ``evaluations``: a row for each request of a generation.

    A column has the value of the first record of the row that has its name.
    """
    table, copies = schema("evaluations"), Counter(candidates)
    sizes = [1 if each.counted is None else len(each.counted.sets) for each in candidates]
    places = (np.cumsum(sizes) - sizes).tolist()
    individuals = dict(zip(reversed(candidates), reversed(places), strict=True))
    records = [
        (
            SimpleNamespace(
                evaluation=request.id,
                phase=phase,
                generation=generation,
                individual=individuals[request.candidate],
                copies=copies[request.candidate],
                end=request.end,
            ),
            evaluations[request.candidate],
            request.estimation,
        )
        for request in requests
    ]
    columns = {name: _column(name, records) for name in table.names}
    return pa.Table.from_pydict(columns, schema=table)


def unpublished(store: Store, phases: Iterable[str]) -> bool:
    """Whether a search has parts that are not yet published as tables."""
    return any(store.has_parts(table, phase) for phase in phases for table in _TABLES)


def publish_search(store: Store, phase: str) -> None:
    """Publish the parts of a search as tables; a repeated call gives the same tables.

    Draws are published before evaluations, because the rows of evaluations identify the draws of
    the search. A kill in between leaves parts of evaluations, and the next call starts again.
    """
    if not unpublished(store, [phase]):
        return
    store.settle("error_sums", phase)
    rows, wanted = store.read("evaluations", phase=phase), dict[str, int]()
    for id_, draws in zip(rows["evaluation"], rows["draws"].tolist(), strict=True):
        wanted[id_] = max(draws, wanted.get(id_, 0))
    store.publish("draws", phase, _draws_of(store, wanted))
    store.publish_frame("evaluations", phase, rows, schema("evaluations"))


def _draws_of(store: Store, wanted: dict[str, int]) -> Iterator[pa.Table]:
    """Yield the rows of the wanted number of draws of each evaluation."""
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


def _column(name: str, records: Sequence[tuple[Any, ...]]) -> list[Any]:
    """The values of a name, from the first record of each row that has the name."""
    owner = next(place for place, record in enumerate(records[0]) if hasattr(record, name))
    return [getattr(row[owner], name) for row in records]  # all rows have the same records


@dataclass(eq=False)
class EvaluationRequest:
    """A requested evaluation, and the draws of it that are known."""

    id: str  # hash of everything on which the MSE of a draw depends
    candidate: Candidate
    end: int  # last instant whose error counts
    stream: int  # key of draws and filter noise: their roles keep them apart
    estimation: Estimation
    mse: NDArray[np.float64]  # (D,); NaN for a draw that is not known yet
    degenerate: NDArray[np.bool_]  # (D,)
    known_draws: int = 0


@dataclass(eq=False)
class Phase:
    """An optimiser, with the purpose of its draws and the settings of its evaluations.

    The tables have its name. The purpose must be one of draws that choose.
    """

    name: str
    optimiser: Optimiser
    purpose: str
    settings: Settings
    built: Built
    criterion: Criterion  # the mean for searches that add errors of instants
    part: Part = "search"
    # Requests by the evaluation's id, of this session, for sets that are requested again
    evaluated: dict[str, EvaluationRequest] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.purpose not in CHOOSING:
            raise ValueError(f"no search may choose by draws with the purpose {self.purpose!r}")

    def steps(self, usual: bool = False) -> float:
        """Approximate number of particle-steps of the phase.

        Forecasts that are shown are the usual number, where a search knows it, and so is the limit
        of a race between all sets. Further answers have shares of the other number.
        """
        settings, instants = self.settings, self.built.job.problem.feasible.horizon + 1
        a_draw = settings.estimation.steps_an_instant * instants
        evaluations = self.optimiser.evaluations
        if usual:
            evaluations = getattr(self.optimiser, "usual_evaluations", evaluations)
        return evaluations * settings.draws * a_draw

    def request(self, candidate: Candidate, generation: int) -> EvaluationRequest:
        """The request of an evaluation for a candidate of a generation.

        Raises `MeasurementTimesError` if the optimiser requests times outside 0..T.
        """
        times, end, draws, individual, _ = candidate
        last = self.built.job.problem.feasible.horizon if end is None else end
        validated(times, self.built.evaluator.points.at(last)[-1], f"search {self.name}")
        fresh = [generation, times if individual is None else individual]
        keyed_by = [] if self.settings.common_noise else fresh
        stream = self.stream(*keyed_by)
        estimation = self.settings.estimation
        id_ = self.built.evaluator.id_of(estimation, times, last, stream)
        mse = np.full(draws or self.settings.draws, np.nan)
        degenerate = np.zeros(mse.size, np.bool_)
        return EvaluationRequest(id_, candidate, last, stream, estimation, mse, degenerate)

    def recall(self, request: EvaluationRequest) -> None:
        """Fill a request with draws that were already evaluated in this session."""
        if self.settings.common_noise:  # with fresh noise no evaluation is requested twice
            before, size = self.evaluated.get(request.id), request.mse.size
            if before is not None:
                known = request.known_draws = min(before.mse.size, size)
                request.mse[:known] = before.mse[:known]
                request.degenerate[:known] = before.degenerate[:known]
            if request.known_draws < size:  # the draws that it still lacks will fill it
                self.evaluated[request.id] = request

    def stream(self, *keyed_by: Any) -> int:
        """Key of the draws and of the filters' noise."""
        return stream_of(self.purpose, self.built.job.seed, self.name, *keyed_by)

    def sums(self, counted: Counted) -> BlockSums:
        """Sums of errors over blocks of draws, for candidates that need expected errors."""
        stream, estimation = self.stream(), self.settings.estimation
        return BlockSums(
            self.built, counted, (stream, stream), estimation, knows_truth=False, phase=self.name,
            part=self.part,
        )  # fmt: skip

    def evaluation(self, request: EvaluationRequest, criterion: Criterion) -> Evaluation:
        """The evaluation that was requested."""
        times, end, *_ = request.candidate
        return Evaluation(
            times,
            request.mse,
            self.settings.degenerate_policy,
            end,
            purpose=self.purpose,
            scenarios=self.built.evaluator.scenarios_of(request.stream, range(request.mse.size)),
            criterion=criterion,
            degenerate=request.degenerate,
        )


def run_phase(
    phase: Phase, session: RunSession
) -> Generator[WorkBatch, None, Sequence[Evaluation]]:
    """The finalists of an optimiser, which runs until it is done.

    The next commit publishes the phase, with all parts of its name. Another phase of this name must
    begin after it.

    Raises `MeasurementTimesError` if the optimiser requests times outside 0..T.
    """
    optimiser, name, reporter = phase.optimiser, phase.name, session.reporter
    committed = set[int]()
    if session.store.has(EVALUATIONS, name):
        committed.update(session.store.rows(EVALUATIONS, phase=name)["generation"].to_pylist())
    state, generation = optimiser.init(), 0
    generations = max(1, optimiser.generations)  # expected
    share, start, total = (
        phase.steps(usual=True) / generations,
        reporter.progress.done,
        reporter.progress.total,
    )
    reporter.begin(name, generation=1, generations=generations)
    is_exact, criterion = phase.built.evaluator.exact, phase.criterion
    copies_are_alike = phase.settings.common_noise or is_exact
    while not optimiser.done(state):
        rng = generator(phase.built.job.seed, "search", name, generation)
        candidates = list(optimiser.ask(state, rng))
        if copies_are_alike:
            candidates = [candidate._replace(individual=None) for candidate in candidates]
        by_instant = criterion.by_instant and not is_exact  # of whole sets
        copies = Counter(candidates)
        windows = [each for each in copies if by_instant or each.counted is not None]
        whole = [each for each in copies if each.counted is None]
        requests = [phase.request(each, generation) for each in whole]
        finalists = optimiser.finalists(state)
        record = _Generation(
            reporter,
            generation,
            generations,
            copies,
            (start, share, total),
            reporter.progress.evaluations,
            not finalists,
        )
        if windows:  # the errors of each instant, on the same blocks of draws
            blocks = math.ceil((windows[0].draws or phase.settings.draws) / BLOCK)
            asked, places = zip(*map(_once, windows), strict=True)
            in_groups = partial(evaluated_in_groups, criterion)
            evaluated = in_groups if by_instant else evaluated_by_errors
            by_errors, _ = yield from evaluated(asked, session, phase.sums, blocks, phase.purpose)
            for candidate, own, evaluation in zip(windows, places, by_errors, strict=True):
                errors = None if evaluation.errors is None else evaluation.errors[own]
                record(candidate, replace(evaluation, errors=errors))
            record.show()
        if not (by_instant or _exactly(phase, requests, session, record)):
            yield from _per_draw(phase, requests, session, record)
        evaluations = record.evaluations
        if requests and generation not in committed:
            rows = evaluation_rows(name, generation, candidates, requests, evaluations)
            session.keep_rows(name, EVALUATIONS, rows)
        in_order = [evaluations[candidate] for candidate in candidates]
        state, generation = optimiser.tell(state, in_order), generation + 1
        errors, best = _whole_errors(in_order), _whole_errors(optimiser.finalists(state))
        mean = float(np.mean(errors)) if errors else None
        reporter.note(best=best[0] if best else None, mean=mean)
    late = share * max(0, generation - generations)
    reporter.note(done=start + phase.steps(usual=True) + late, total=total + late)
    # After the last generation, which also waits: `later` keeps the order.
    session.later(partial(publish_search, session.store, name))
    return optimiser.finalists(state)


def _once(candidate: Candidate) -> tuple[Candidate, Any]:
    """The candidate with each different filter once, and where the errors of all are."""
    if candidate.counted is None:
        return candidate, slice(None)
    counted, places = candidate.counted.once()
    return candidate._replace(counted=counted), places


def _whole_errors(evaluations: Iterable[Evaluation]) -> list[float]:
    """Finite errors of whole sets; those of prefixes cover only a part of the horizon."""
    return [
        evaluation.expected_mse
        for evaluation in evaluations
        if evaluation.end is None and math.isfinite(evaluation.expected_mse)
    ]


@dataclass(eq=False)
class _Generation:
    """The evaluations of a generation so far, and the progress that they make."""

    reporter: Reporter
    number: int
    generations: int  # expected
    copies: Counter[Candidate]
    # Done before the search, those of a generation, and the forecast of the run, which grows with
    # each generation that was not expected:
    steps: tuple[float, float, float]
    before: int  # number of evaluations of former generations
    shows_best: bool
    evaluations: dict[Candidate, Evaluation] = field(default_factory=dict)
    recorded: int = 0
    least: float = math.inf

    def __call__(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Record the evaluation of a candidate."""
        self.evaluations[candidate] = evaluation
        self.recorded += self.copies[candidate]
        if self.shows_best:
            self.least = min(self.least, *_whole_errors([evaluation]), math.inf)

    def show(self) -> None:
        """Report the evaluations that were recorded so far."""
        reporter, (start, share, total) = self.reporter, self.steps
        if math.isfinite(self.least):
            reporter.note(best=self.least)
        part = self.number + len(self.evaluations) / len(self.copies)
        reporter.reach(
            start + share * part,
            total=total + share * max(0.0, part - self.generations),
            evaluations=self.before + self.recorded,
            generation=self.number + 1,
            generations=self.generations,
        )


def _exactly(
    phase: Phase, requests: list[EvaluationRequest], session: RunSession, record: _Generation
) -> bool:
    """Record the exact evaluation of each request, and say whether the engine gives it.

    It takes no time, so neither pool nor store.
    """
    sets = [request.candidate.measurement_times for request in requests]
    ends = [request.end for request in requests]
    errors = exact_mse(phase.built.evaluator, sets, ends, phase.criterion)
    if errors is None:
        return False
    session.count_exact(phase.name, phase.part, sum(ends) + len(ends))
    for request, error in zip(requests, errors.tolist(), strict=True):
        request.mse, request.degenerate = np.empty(0), np.empty(0, np.bool_)
        record(request.candidate, phase.evaluation(request, phase.criterion.exactly(error)))
    record.show()
    return True


def _per_draw(
    phase: Phase,
    requests: list[EvaluationRequest],
    session: RunSession,
    record: _Generation,
) -> Generator[WorkBatch, None, None]:
    """Record the evaluation of each request as soon as all its draws are known."""
    # Requests may have one id and different numbers of draws; also, a prefix up to T is a whole
    # set. The longest request is evaluated, and the others take its first draws.
    same = defaultdict[str, list[EvaluationRequest]](list)
    for request in requests:
        same[request.id].append(request)
    longest = {id_: max(alike, key=lambda each: each.mse.size) for id_, alike in same.items()}

    def record_all(request: EvaluationRequest) -> None:
        for alike in same[request.id]:
            draws = slice(alike.mse.size)
            alike.mse, alike.degenerate = request.mse[draws], request.degenerate[draws]
            record(alike.candidate, phase.evaluation(alike, phase.criterion))

    def learn(work: FilterWork, result: Result) -> None:
        degenerate = work.by_id(result, "degenerate")
        for id_, mse in work.by_id(result).items():
            request, draws = longest[id_], slice(*work.draws)
            request.mse[draws], request.degenerate[draws] = mse, degenerate[id_]
            request.known_draws += mse.size
            if request.known_draws == request.mse.size:
                record_all(request)
        record.show()

    for request in longest.values():
        phase.recall(request)
        if request.known_draws == request.mse.size:
            record_all(request)
    record.show()
    works = list(_works(phase, longest.values()))
    if works:
        yield WorkBatch(
            session, phase.name, works, PER_DRAW, learn, more_follows=True, part=phase.part
        )


def _works(phase: Phase, requests: Iterable[EvaluationRequest]) -> Iterator[FilterWork]:
    """Works for the missing draws; sets that lack the same draws of a stream go together."""
    together = defaultdict[Any, list[EvaluationRequest]](list)
    for request in requests:
        first, size = request.known_draws, request.mse.size
        if first < size:
            together[request.stream, request.estimation, (first, size)].append(request)
    for (stream, estimation, draws), group in together.items():
        sets = [request.candidate.measurement_times for request in group]
        ends, ids = zip(*((request.end, request.id) for request in group), strict=True)
        yield phase.built.evaluator.work(
            sets, stream, stream, draws, estimation, ends=ends, ids=ids
        )
