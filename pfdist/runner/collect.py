"""Have tasks done and commit their rows as they come."""

import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass

import pyarrow as pa

from pfdist.errors import TaskError
from pfdist.kernels.noise import stream_key
from pfdist.runner.pool import Outcome, Pool, Task
from pfdist.store import Store, schema

COMMIT_SECONDS = 1.0  # at most so much work is lost by a kill, and a task's


@dataclass(frozen=True)
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

    def run(
        self,
        phase: str,
        table: str,
        tasks: Iterable[Task],
        rows_of: Callable[[Outcome], pa.Table],
    ) -> Generator[Outcome]:
        """Give outcomes as they come; about once a second, and at the end, commit their rows.

        Close the iterator (`contextlib.closing`) and what has come so far is committed, whatever
        happened.

        Raises
        ------
        TaskError
            A task failed. What else was done is committed.
        """
        waiting: list[Outcome] = []
        last = time.monotonic()
        try:
            for outcome in self.pool.run(tasks):
                waiting.append(outcome)
                if outcome.error is not None:
                    reason = outcome.error.strip().splitlines()[-1].removeprefix("pfdist.errors.")
                    raise TaskError(f"a task of {phase} failed: {reason}", outcome.error)
                yield outcome
                if time.monotonic() - last >= COMMIT_SECONDS:
                    self._commit(phase, table, waiting, rows_of)
                    waiting, last = [], time.monotonic()
        finally:
            self._commit(phase, table, waiting, rows_of)

    def _commit(
        self,
        phase: str,
        table: str,
        outcomes: list[Outcome],
        rows_of: Callable[[Outcome], pa.Table],
    ) -> None:
        if not outcomes:
            return
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
