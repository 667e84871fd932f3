"""The one door for numbers, and the loop that serves a driver.

A driver is a generator: it yields a `WorkBatch` of works and resumes when all results are there.
Searches, the comparison, block sums, the proof and plugins get every number in this way.

The steps of a batch, in this order, and the cost of a kill at each:

1. Each work is looked up: in the tables of its own run, then in those of other runs.
   Nothing is computed yet, so a kill costs nothing.
2. Missing works are cut into tasks of about 0.3 s, with hundreds of workers up to 2 s; the first
   tasks have one draw. A worker holds one or two tasks, which are lost with it.
3. Results come back in any order. The batch learns each at once, and its rows wait in memory. A
   kill of the driver costs the rows that wait. The driver learns the sums of a block when those of
   its draws are there.
4. Waiting rows are committed after so many particle-steps as `COMMIT_SECONDS` says (five times as
   many in a run of minutes), and at the end of a batch unless more follows. Steps are counted, so a
   busy machine makes no more commits. A commit writes a file under a
   temporary name, flushes it and gives it its name: a kill before the last step leaves a temporary
   file, which the next start removes. The timings of the tasks follow in a separate file: a kill
   between the two costs these timings.
5. When nothing of the batch is missing, the driver resumes. Tables that it publishes with
   `RunSession.later` are written after the next commit, when the workers have their next tasks. A
   kill before costs nothing: the driver finds all rows committed, and publishes them again.

A task that fails runs again after all others, as often as the job allows. Then the driver gets a
`TaskError`, and commits what it has. So every driver may raise `TaskError` (a task failed),
`PoolError` (no worker answers) and `StoreError` (a file cannot be read or written). The docstrings
of drivers do not repeat this.

The door commits rows and timings. The driver publishes them (`Store.settle`), because it knows when
a table is complete. Estimations that the evaluator does not name are compiled with
`Evaluator.compile` before their first batch, because the time of a task is limited.
"""

import contextlib
import time
import uuid
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache, partial
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.stopping import check
from pfdist.common.streams import stream_key
from pfdist.errors import ModelError, PfdistError, PoolError, TaskError
from pfdist.filters.variants import task
from pfdist.filters.work import FilterWork, Result, sum_of_draws, whole_block
from pfdist.pools.base import Outcome, Pool, Task
from pfdist.runner.build import Built
from pfdist.runner.pace import Pace, bundles
from pfdist.runner.parts import Part
from pfdist.runner.progress import Reporter, Say, Show
from pfdist.search.programme import Programme
from pfdist.store import QUESTIONS, Store, schema

# Between two commits: the particle-steps that all workers do in about so many seconds, at a usual
# speed. A kill loses about so much work, and the tasks in flight.
COMMIT_SECONDS = 1.0
COMMIT_ROWS = 100_000  # largest number of rows that wait in memory, however fast a model is
EVALUATIONS = "evaluations"
"""The table whose rows are committed last: an evaluation in it has all its draws in others."""

StoredResults = Iterator[tuple[FilterWork, Result]]
Learn = Callable[[FilterWork, Result], None]


class RowFormat(Protocol):
    """How results become rows of a table, and rows become results again.

    If the format is shared, runs may use each other's rows, because the ids of works identify
    everything on which the rows depend.
    """

    table: str
    is_shared: bool

    def look_up(
        self, store: Store, works: list[FilterWork]
    ) -> tuple[list[FilterWork], StoredResults]:
        """The works that a store lacks, and the results that it has."""

    def rows(self, work: FilterWork, result: Result) -> pa.Table:
        """The rows of a result."""


class WorkBatch:
    """Works whose results a driver needs before it resumes.

    The rows belong to a phase of the session's run, and the particle-steps count for a part.
    Without a row format, results are not stored, so they are never looked up; timings are stored in
    phases that have a table.

    `learn` receives each piece of a work with its result, in any order.

    If `more_follows`, the last rows wait for the next batch. A commit takes a while, and the
    workers would be idle between two generations.
    """

    def __init__(
        self,
        session: "RunSession",
        phase: str,
        works: Iterable[FilterWork],
        row_format: RowFormat | None,
        learn: Learn = lambda work, result: None,
        *,
        more_follows: bool = False,
        part: Part = "search",
    ) -> None:
        self.session, self.phase, self.works = session, phase, list(works)
        self.row_format, self._part = row_format, part
        self._learn, self._more_follows = learn, more_follows
        self._open = dict[Any, _Block]()  # unfinished blocks of sums, by the ids and the block

    def receive(self, work: FilterWork, result: Result) -> None:
        """Hand a result to the driver; draws of a block of sums wait until the block is whole."""
        if work.is_part_of_block:
            draw, _ = work.draws
            block = whole_block(draw)
            sums = self._open.setdefault((work.ids, block), _Block(block[0]))
            sums.add(draw, result.sums)
            if sums.end < block[1]:
                return
            del self._open[work.ids, block]
            work, result = work.piece(block), replace(result, sums=sums.total)
            self.keep_result(work, result)
        self._learn(work, result)

    def compute(self, works: list[FilterWork], pool: Pool) -> None:
        """Compute works in tasks; those that fail run again after all others.

        Raises `ModelError` if a worker cannot load the models, and `TaskError` if too many tasks
        failed.
        """
        # Tasks are cut one at a time, so each is as long as the speed learnt so far allows.
        tasks = self._tasks(works, self.session.pace(pool.workers))
        while failed := [each.task for each in pool.run(tasks) if not self._take(each)]:
            tasks = iter(failed)

    def _tasks(self, works: list[FilterWork], pace: Pace) -> Iterator[Task]:
        table = self.row_format.table if self.row_format is not None else self.phase
        results = task(self.session.built.evaluator)
        for bundle in bundles(works, pace.size, pace.expected, pace.least_draws):
            key = f"{table}:{stream_key([(work.ids, work.draws) for work in bundle.works]):016x}"
            yield Task(key, results, bundle.works, pace.expected(bundle.steps))

    def _take(self, outcome: Outcome) -> bool:
        """Take the outcome of a task, and say whether it has results.

        The rows wait for a commit, and the driver learns the results.
        """
        session, works = self.session, outcome.task.work
        steps = 0 if outcome.error is not None else session.steps_of(works, outcome.value)
        if self.row_format is not None or self.phase in QUESTIONS:  # failed tasks, too
            session.keep_timing(self.phase, self._part, steps, outcome)
        session.done[self._part] += steps
        if outcome.error is not None:
            if outcome.refused:
                raise ModelError(outcome.error)
            session.count_failure(self.phase, outcome.error)
            return False
        session.update_pace(sum(work.steps for work in works), outcome.seconds)
        # The commit comes last, so it has the rows of the whole task.
        for work, result in zip(works, outcome.value, strict=True):
            self.keep_result(work, result)
            self.receive(work, result)
        session.commit_if_late()
        return True

    def keep_result(self, work: FilterWork, result: Result) -> None:
        """Keep the rows of a result for the next commit."""
        if self.row_format is not None:
            rows = self.row_format.rows(work, result)
            self.session.keep_rows(self.phase, self.row_format.table, rows)

    def end(self) -> None:
        """Commit the waiting rows, unless more follow."""
        if not self._more_follows:
            self.session.commit()


class _Block:
    """The sums over the first draws of a block; those of later draws wait, and may be large."""

    def __init__(self, first: int) -> None:
        self.end, self._waiting = first, dict[int, NDArray[np.float64]]()
        self.total: NDArray[np.float64] = np.empty(0)

    def add(self, draw: int, sums: NDArray[np.float64]) -> None:
        """Add the sums of a draw, in the order of the draws."""
        self._waiting[draw] = sums
        while self.end in self._waiting:
            following = self._waiting.pop(self.end)
            self.total = sum_of_draws([self.total, following] if self.total.size else [following])
            self.end += 1


Driver = Generator[WorkBatch, None, Any]
"""Yields one batch after another, and returns a value."""


class RunSession:
    """One start of the program on a run: its objects, its progress, and the rows to commit.

    `show` receives the progress, and `say` receives lines for the user.
    """

    def __init__(
        self,
        built: Built,
        store: Store,
        show: Show = lambda progress: None,
        say: Say = lambda line: None,
    ) -> None:
        self.built, self.store, self.say, self.reporter = built, store, say, Reporter(show)
        self.failures = 0
        # Particle-steps that this session has computed, by part; with an exact engine, instants.
        # The table ``timings`` has those of all sessions.
        self.done = Counter[Part]()
        self._pace: Pace | None = None
        self._had_rows = dict[str, bool]()  # by table; see `had_rows`
        # Names of sessions sort in the order in which they started.
        self._name = f"{int(time.time()):08x}{uuid.uuid4().hex[:4]}"
        # Rows that wait for the next commit, by phase and table
        self.rows: dict[tuple[str, str], list[pa.Table]] = {}
        self._timings: dict[str, list[dict[str, Any]]] = {}  # rows of the table, by phase
        self._exact = Counter[tuple[str, Part]]()  # instants that wait for the next commit
        self._later: list[Callable[[], None]] = []
        self._waiting = 0
        # The first programmes of phases, for later drivers: rows of this session are not looked up.
        self.programmes = dict[str, Programme]()
        self._steps = self._committed = 0  # particle-steps of all tasks, and at the last commit

    def keep_rows(self, phase: str, table: str, rows: pa.Table) -> None:
        """Keep rows for the next commit."""
        self.rows.setdefault((phase, table), []).append(rows)
        self._waiting += rows.num_rows

    def keep_timing(self, phase: str, part: Part, steps: int, outcome: Outcome) -> None:
        """Keep the timing of a task, and what it has computed, for the next commit."""
        timed = outcome.seconds, outcome.worker, outcome.node, outcome.error
        self._keep_timing(phase, part, steps, outcome.task.key, *timed)

    def _keep_timing(
        self,
        phase: str,
        part: Part,
        steps: int,
        task: str,
        seconds: float = 0.0,
        worker: str = "",
        node: str = "",
        error: str | None = None,
    ) -> None:
        row = {
            "phase": phase,
            "task": task,
            "session": self._name,
            "seconds": seconds,
            "worker": worker,
            "node": node,
            "failures": int(error is not None),
            "error": error,
            "part": part,
            "particle_steps": steps,
        }
        self._timings.setdefault(phase, []).append(row)

    def steps_of(self, works: Iterable[FilterWork], results: Iterable[Result]) -> int:
        """The particle-steps that works have taken; an exact filter has one particle."""
        has_particles = self.built.evaluator.has_particles
        return sum(
            work.steps_of(result) // (1 if has_particles else work.estimation.steps_an_instant)
            for work, result in zip(works, results, strict=True)
        )

    def count_exact(self, phase: str, part: Part, instants: int) -> None:
        """Count instants of sets whose errors this process has computed without draws."""
        self.done[part] += instants
        self._exact[phase, part] += instants

    def had_rows(self, table: str) -> bool:
        """Whether the store had rows of a table when this session first needed them.

        Rows that this session commits itself are never looked up: no driver needs a result twice.
        """
        if table not in self._had_rows:
            self._had_rows[table] = self.store.has(table)
        return self._had_rows[table]

    def pace(self, workers: int) -> Pace:
        """The speed of the workers, estimated from all tasks of this session."""
        if self._pace is None:
            engine, guess = self.built.evaluator.computed_by, self.built.evaluator.seconds_a_step
            least = engine.least_draws
            self._pace = Pace(guess, workers, least_draws=least)
        return self._pace

    def update_pace(self, steps: int, seconds: float) -> None:
        """Update the speed with a task of so many particle-steps that took so many seconds."""
        self._steps += steps
        if self._pace is not None:
            self._pace.update(steps, seconds)

    def count_failure(self, phase: str, error: str) -> None:
        """Count a task that failed, and raise a `TaskError` if too many have failed."""
        self.failures += 1
        if self.failures > self.built.job.execution.failures:
            reason = error.strip().splitlines()[-1].removeprefix("pfdist.errors.")
            times = f"{self.failures} times, the last: " if self.failures > 1 else ""
            raise TaskError(f"a task of {phase} failed: {times}{reason}", error)

    def later(self, write: Callable[[], None]) -> None:
        """Call a function after the next commit, while the workers are busy."""
        self._later.append(write)

    def commit_if_late(self) -> None:
        """Commit after so many particle-steps, later after five times as many, or after many rows.

        So a run of hours has fewer files in ``parts``, which helps network file systems.
        """
        least = 0.0 if self._pace is None else self._pace.in_seconds(COMMIT_SECONDS)
        most = min(5 * least, max(least, self._steps / 100))
        if self._steps - self._committed >= most or self._waiting >= COMMIT_ROWS:
            self.commit()

    def commit(self) -> None:
        """Commit all waiting rows and timings, then write everything given to `later`.

        Every row is committed before any table is published. So a published table never lacks rows
        that were computed before it.
        """
        # Taken out first: if a write fails, closing the driver commits again, and must not repeat
        # it.
        later, self._later = self._later, []
        rows, self.rows, self._waiting = self.rows, {}, 0
        for (phase, part), instants in self._exact.items():
            self._keep_timing(phase, part, instants, f"exact:{part}:{self.done[part]}")
        self._exact.clear()
        timings, self._timings = self._timings, {}
        for phase, table in sorted(rows, key=lambda each: each[1] == EVALUATIONS):
            self.store.commit(table, phase, pa.concat_tables(rows[phase, table]))
        for phase, done in timings.items():
            self.store.commit("timings", phase, pa.Table.from_pylist(done, schema("timings")))
        with self.store.together():
            for write in later:
                write()
        self._committed = self._steps


def complete(
    driver: Driver,
    pool: contextlib.AbstractContextManager[Pool],
    lent: Mapping[str, Store] = MappingProxyType({}),
) -> Any:
    """The value of a driver, with a pool that is left when the driver has ended; see `serve`."""
    with entered_late(pool) as workers:
        return serve(driver, workers, lent)


@contextlib.contextmanager
def entered_late(pool: contextlib.AbstractContextManager[Pool]) -> Iterator[Callable[[], Pool]]:
    """A function that gives the pool, which is entered by the first call and left at the end."""
    with contextlib.ExitStack() as stack:
        yield cache(lambda: stack.enter_context(pool))


def lent_by(stores: Iterable[Store]) -> dict[str, Store]:
    """The store that has an evaluation, by its id; the first store goes first."""
    return {id_: store for store in reversed([*stores]) for id_ in store.evaluations()}


def serve(driver: Driver, workers: Callable[[], Pool], lent: Mapping[str, Store]) -> Any:
    """The value of a driver, which gets the results of each batch that it yields.

    `workers` gives the pool, if there are tasks. `lent` has the stores of other runs, by the ids of
    evaluations that are taken from them. Whatever error the driver or the pool raises, the driver
    is closed: it commits its rows while its folder is still locked.
    """
    error: PfdistError | None = None
    with contextlib.closing(driver):
        while True:
            check()
            try:
                batch = next(driver) if error is None else driver.throw(error)
            except StopIteration as end:
                return end.value
            error = _error_of(partial(_complete, batch, workers, lent))


def _complete(batch: WorkBatch, workers: Callable[[], Pool], lent: Mapping[str, Store]) -> None:
    """Give a batch the results of all its works: stored ones, those of other runs, and new ones."""
    works, row_format, session = batch.works, batch.row_format, batch.session
    if row_format is not None:
        if session.had_rows(row_format.table):
            works = _learnt(batch, session.store, works)
        if row_format.is_shared and lent:
            works = _borrowed(batch, works, lent)
    if works:
        batch.compute(works, workers())
    batch.end()


def _borrowed(
    batch: WorkBatch, works: list[FilterWork], lent: Mapping[str, Store]
) -> list[FilterWork]:
    """The works that no other run has.

    Rows of another run are committed in this run, too: so its files do not depend on others.
    """
    by_store = defaultdict[Store | None, list[FilterWork]](list)
    for work in works:
        stores = [lent.get(id_) for id_ in work.ids[: 1 if work.summed else None]]
        for store in dict.fromkeys(stores):
            sets = [place for place, each in enumerate(stores) if each is store]
            by_store[store].append(work if work.summed else work.piece(work.draws, sets))
    lacking = by_store.pop(None, [])
    for store, parts in by_store.items():
        lacking += parts if store is None else _learnt(batch, store, parts, keep=True)
    return lacking


def _error_of(function: Callable[[], object]) -> PfdistError | None:
    """The error with which a call ends, if the driver may handle it.

    A `PoolError` goes through: without workers, no driver can continue.
    """
    try:
        function()
    except PfdistError as error:
        if is_of_pool(error):
            raise
        return error
    return None


def is_of_pool(error: PfdistError) -> bool:
    """Whether no driver can continue, because no worker answers."""
    return isinstance(error, PoolError) and not isinstance(error, TaskError)


def _learnt(
    batch: WorkBatch, store: Store, works: list[FilterWork], *, keep: bool = False
) -> list[FilterWork]:
    """The works that a store lacks, after a batch has learnt the stored results of the others."""
    if batch.row_format is None:
        return works
    lacking, stored = batch.row_format.look_up(store, works)
    for work, result in stored:
        if keep:
            batch.keep_result(work, result)
        batch.receive(work, result)
    return lacking
