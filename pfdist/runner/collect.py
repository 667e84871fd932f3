"""Have tasks done and commit their rows as they come."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field

import pyarrow as pa

from pfdist.common.streams import stream_key
from pfdist.errors import TaskError
from pfdist.evaluation.work import Result, Work
from pfdist.pools.base import Outcome, Pool, Task
from pfdist.runner.pace import Pace, bundles
from pfdist.store import Store, schema

COMMIT_SECONDS = 1.0  # at most so much work is lost by a kill, and a task's
COMMIT_ROWS = 100_000  # and so many wait in memory, however fast a model is


@dataclass
class _Waiting:
    """What was done and is not committed yet."""

    outcomes: list[Outcome] = field(default_factory=list)
    rows: list[pa.Table] = field(default_factory=list)


@dataclass
class Collector:
    """Runs tasks in a pool and commits what they give.

    Parameters
    ----------
    store : Store
    pool : Pool
    session : str
        This start of the program, for the timings.
    pace : Pace
        What is known of the workers' speed; it learns from what they do.
    failures : int
        How many tasks may fail, and are done once more.
    resumed : bool
        Whether the store held rows when the session began.
    """

    store: Store
    pool: Pool
    session: str
    pace: Pace
    failures: int = 0
    resumed: bool = True
    _failures: int = 0
    _commits: int = 0
    _waiting: dict[tuple[str, str], "_Waiting"] = field(default_factory=dict)
    _later: list[Callable[[], None]] = field(default_factory=list)
    _last: float = field(default_factory=time.monotonic)

    def run(
        self,
        phase: str,
        table: str,
        works: Iterable[Work],
        rows_of: Callable[[Work, Result], pa.Table],
        *,
        more_follows: bool = False,
    ) -> Generator[tuple[Work, Result]]:
        """Have works done in tasks, and give pieces of them as they come.

        About once a second, or where they are many, and at the end their rows are committed.

        Close the iterator (`contextlib.closing`) and what has come so far is committed, whatever
        happened. If `more_follows`, another run, the last rows may wait for it: the workers have
        nothing to do between two generations, and a commit takes a while.

        Raises
        ------
        TaskError
            One task too many failed. What else was done is committed.
        """
        todo: Iterable[Task] = self._tasks(table, works)
        try:
            while todo:
                failed: list[Task] = []
                for outcome in self.pool.run(todo):
                    waiting = self._waiting.setdefault((phase, table), _Waiting())
                    waiting.outcomes.append(outcome)
                    if outcome.error is not None:
                        self._count_failure(phase, outcome.error)
                        failed.append(outcome.task)
                        continue
                    self.pace.learn(outcome.task.work, outcome.seconds)
                    pieces = list(zip(outcome.task.work, outcome.value, strict=True))
                    waiting.rows += [rows_of(work, result) for work, result in pieces]
                    yield from pieces
                    late = time.monotonic() - self._last >= COMMIT_SECONDS
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
        if self._failures > self.failures:
            reason = error.strip().splitlines()[-1].removeprefix("pfdist.errors.")
            times = f"{self._failures} times, the last: " if self._failures > 1 else ""
            raise TaskError(f"a task of {phase} failed: {times}{reason}", error)

    def _tasks(self, table: str, works: Iterable[Work]) -> Iterator[Task]:
        for bundle in bundles(works, self.pace.size):
            key = f"{table}:{stream_key([repr(work) for work in bundle]):016x}"
            yield Task(key, bundle, self.pace.expected(bundle))

    def later(self, write: Callable[[], None]) -> None:
        """Have something written after what waits: while the workers have tasks in their hands."""
        self._later.append(write)

    def flush(self) -> None:
        """Commit what waits."""
        later, self._later = self._later, []
        done, self._waiting = self._waiting, {}
        for (phase, table), waiting in done.items():
            key = f"{stream_key([outcome.task.key for outcome in waiting.outcomes]):016x}"
            if waiting.rows:
                self.store.commit(table, phase, key, pa.concat_tables(waiting.rows))
            timings = self._timings(phase, waiting.outcomes)
            self._commits += 1  # what failed fails again: the same tasks, and other timings
            self.store.commit("timings", phase, f"{key}-{self.session}-{self._commits}", timings)
        for write in later:
            write()
        self._last = time.monotonic()

    def _timings(self, phase: str, outcomes: list[Outcome]) -> pa.Table:
        rows = [
            {
                "phase": phase,
                "task": outcome.task.key,
                "session": self.session,
                "seconds": outcome.seconds,
                "worker": outcome.worker,
                "node": outcome.node,
                "failures": int(outcome.error is not None),
                "error": outcome.error,
            }
            for outcome in outcomes
        ]
        return pa.Table.from_pylist(rows, schema=schema("timings"))
