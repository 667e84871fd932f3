"""Have tasks done and commit their rows as they come."""

import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field
from functools import partial

import pyarrow as pa

from pfdist.errors import TaskError
from pfdist.kernels.noise import stream_key
from pfdist.runner.pool import Outcome, Pool, Task
from pfdist.store import Store, schema

COMMIT_SECONDS = 1.0  # at most so much work is lost by a kill, and a task's


@dataclass
class Collector:
    """Runs tasks in a pool and commits what they give.

    Parameters
    ----------
    store : Store
    pool : Pool
    session : str
        This start of the program, for the timings.
    """

    store: Store
    pool: Pool
    session: str
    _waiting: list[Outcome] = field(default_factory=list)
    _commit_waiting: Callable[[list[Outcome]], None] = field(default=lambda outcomes: None)
    _later: list[Callable[[], None]] = field(default_factory=list)
    _last: float = field(default_factory=time.monotonic)

    def run(
        self,
        phase: str,
        table: str,
        tasks: Iterable[Task],
        rows_of: Callable[[Outcome], pa.Table],
        *,
        more_follows: bool = False,
    ) -> Generator[Outcome]:
        """Give outcomes as they come; about once a second, and at the end, commit their rows.

        Close the iterator (`contextlib.closing`) and what has come so far is committed, whatever
        happened. If `more_follows`, another run of the same table, the last rows may wait for it:
        the workers have nothing to do between two generations, and a commit takes a while.

        Raises
        ------
        TaskError
            A task failed. What else was done is committed.
        """
        self._commit_waiting = partial(self._commit, phase, table, rows_of)
        try:
            for outcome in self.pool.run(tasks):
                self._waiting.append(outcome)
                if outcome.error is not None:
                    reason = outcome.error.strip().splitlines()[-1].removeprefix("pfdist.errors.")
                    raise TaskError(f"a task of {phase} failed: {reason}", outcome.error)
                yield outcome
                if time.monotonic() - self._last >= COMMIT_SECONDS:
                    self.flush()
        except BaseException:
            self.flush()
            raise
        if not more_follows:
            self.flush()

    def commit_later(self, table: str, phase: str, key: str, rows: pa.Table) -> None:
        """Commit some rows after those that wait."""
        self._later.append(partial(self.store.commit, table, phase, key, rows))

    def flush(self) -> None:
        """Commit what waits."""
        waiting, self._waiting = self._waiting, []
        later, self._later = self._later, []
        if waiting:
            self._commit_waiting(waiting)
        for commit in later:
            commit()
        self._last = time.monotonic()

    def _commit(
        self,
        phase: str,
        table: str,
        rows_of: Callable[[Outcome], pa.Table],
        outcomes: list[Outcome],
    ) -> None:
        key = f"{stream_key([outcome.task.key for outcome in outcomes]):016x}"
        done = [outcome for outcome in outcomes if outcome.error is None]
        if done:
            rows = pa.concat_tables([rows_of(outcome) for outcome in done])
            self.store.commit(table, phase, key, rows)
        self.store.commit("timings", phase, f"{key}-{self.session}", self._timings(phase, outcomes))

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
