"""Run tasks in a pool, and commit their rows as they come."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field

import pyarrow as pa

from pfdist.common.streams import stream_key
from pfdist.errors import TaskError
from pfdist.evaluation.work import Result, Work
from pfdist.pools.base import Outcome, Pool, Task
from pfdist.runner.claims import ALONE, Claims
from pfdist.runner.pace import Pace, bundles
from pfdist.store import Store, schema

COMMIT_SECONDS = 1.0  # a kill loses at most so much work, and one task
COMMIT_ROWS = 100_000  # at most so many rows wait in memory, however fast a model is


@dataclass
class _Waiting:
    """Outcomes of a phase's tasks, and rows, that are not committed yet; keys name the rows."""

    outcomes: list[Outcome] = field(default_factory=list)
    rows: list[pa.Table] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)


class Collector:
    """Runs tasks in a pool and commits their results.

    Parameters
    ----------
    store : Store
    pool : Pool
    session : str
        Name of this start of the program, for the timings.
    pace : Pace
        The workers' speed; it learns from every task.
    failures : int
        How many tasks may fail; each is computed again.
    resumed : bool
        Whether the store held rows when the session began.
    claims : Claims, optional
        Evaluations that this run shares with others; by default there are no others.
    """

    def __init__(
        self,
        store: Store,
        pool: Pool,
        session: str,
        pace: Pace,
        failures: int = 0,
        resumed: bool = True,
        claims: Claims = ALONE,
    ) -> None:
        self.store, self.resumed, self.claims = store, resumed, claims
        self._pool, self._session, self._pace = pool, session, pace
        self._most_failures, self._failures = failures, 0
        self._commits = 0
        self._waiting: dict[tuple[str, str], _Waiting] = {}
        self._later: list[Callable[[], None]] = []
        self._last_commit = time.monotonic()

    def run(
        self,
        phase: str,
        table: str,
        works: Iterable[Work],
        rows_of: Callable[[Work, Result], pa.Table],
        *,
        more_follows: bool = False,
    ) -> Generator[tuple[Work, Result]]:
        """Yield pieces of the works with their results, in any order.

        Rows are committed about once a second, or sooner if there are many, and at the end. Close
        the iterator (`contextlib.closing`): then all results so far are committed, whatever
        happens.

        Parameters
        ----------
        phase, table : str
            Where the rows belong.
        works : iterable of Work
        rows_of : callable
            Gives the rows of a piece and its result.
        more_follows : bool
            Whether the last rows may wait for the next call. A commit takes a while, and between
            two generations the workers are idle.

        Raises
        ------
        TaskError
            Too many tasks failed. All other results are committed.
        """
        steps = dict[str, int]()  # of each task, by its key
        todo: Iterable[Task] = self._tasks(table, works, steps)
        try:
            while todo:
                failed: list[Task] = []
                for outcome in self._pool.run(todo):
                    waiting = self._waiting.setdefault((phase, table), _Waiting())
                    waiting.outcomes.append(outcome)
                    waiting.keys.append(outcome.task.key)
                    if outcome.error is not None:
                        self._count_failure(phase, outcome.error)
                        failed.append(outcome.task)
                        continue
                    self._pace.learn(steps.pop(outcome.task.key), outcome.seconds)
                    pieces = list(zip(outcome.task.work, outcome.value, strict=True))
                    waiting.rows += [rows_of(work, result) for work, result in pieces]
                    yield from pieces
                    late = time.monotonic() - self._last_commit >= COMMIT_SECONDS
                    if late or sum(rows.num_rows for rows in waiting.rows) >= COMMIT_ROWS:
                        self.flush()
                todo = failed
        except BaseException:
            self.flush()
            raise
        if not more_follows:
            self.flush()

    def _count_failure(self, phase: str, error: str) -> None:
        self._failures += 1
        if self._failures > self._most_failures:
            reason = error.strip().splitlines()[-1].removeprefix("pfdist.errors.")
            times = f"{self._failures} times, the last: " if self._failures > 1 else ""
            raise TaskError(f"a task of {phase} failed: {times}{reason}", error)

    def _tasks(self, table: str, works: Iterable[Work], steps: dict[str, int]) -> Iterator[Task]:
        for bundle in bundles(works, self._pace.size):
            key = f"{table}:{stream_key([(work.ids, work.draws) for work in bundle.works]):016x}"
            steps[key] = bundle.steps
            yield Task(key, bundle.works, self._pace.seconds * bundle.steps)

    def keep(self, phase: str, table: str, key: str, rows: pa.Table) -> None:
        """Commit rows that another run has computed, as if they were computed here."""
        waiting = self._waiting.setdefault((phase, table), _Waiting())
        waiting.rows.append(rows)
        waiting.keys.append(key)

    def later(self, write: Callable[[], None]) -> None:
        """Write something after the next commit, while the workers are busy."""
        self._later.append(write)

    def flush(self) -> None:
        """Commit all waiting rows and timings, then write everything given to `later`."""
        later, self._later = self._later, []
        done, self._waiting = self._waiting, {}
        for (phase, table), waiting in done.items():
            key = f"{stream_key(waiting.keys):016x}"
            if waiting.rows:
                self.store.commit(table, phase, key, pa.concat_tables(waiting.rows))
            if not waiting.outcomes:
                continue
            timings = self._timings(phase, waiting.outcomes)
            self._commits += 1  # a task that fails again has the same key and other timings
            self.store.commit("timings", phase, f"{key}-{self._session}-{self._commits}", timings)
        for write in later:
            write()
        self._last_commit = time.monotonic()

    def _timings(self, phase: str, outcomes: list[Outcome]) -> pa.Table:
        rows = [
            {
                "phase": phase,
                "task": outcome.task.key,
                "session": self._session,
                "seconds": outcome.seconds,
                "worker": outcome.worker,
                "node": outcome.node,
                "failures": int(outcome.error is not None),
                "error": outcome.error,
            }
            for outcome in outcomes
        ]
        return pa.Table.from_pylist(rows, schema=schema("timings"))
