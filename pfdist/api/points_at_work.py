"""The points of a sweep at work: a few at a time, each in a thread that shares the workers."""

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pfdist.analysis import Run, open_run
from pfdist.analysis.listed_run import FINISHED
from pfdist.api.following import Say
from pfdist.api.run import Ending, run_built
from pfdist.errors import PfdistError, StoreError, one_line
from pfdist.job.sweep import SweepJob
from pfdist.pools.cores import usable_cores
from pfdist.pools.shared import SharedPool
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import Built, build
from pfdist.runner.claims import ClaimsOfRun, SharedClaims
from pfdist.runner.processor import CONTINUED, processor
from pfdist.runner.progress import Progress, Show
from pfdist.runner.session import Session
from pfdist.runner.work_of_runs import of_run
from pfdist.store import Store, holds_run, read_run

_MORE = 2  # points at work than workers: the driver of a point works while it has no task
_MOST = 16  # points at work: each needs memory
_END_SECONDS = 20.0  # that a point has to commit what it has when all are to end


@dataclass
class _Share:
    """How far a point is."""

    phase: str = ""
    done: float = 0.0


class PointsAtWork:
    """Runs the points of a sweep in threads, the first points first.

    Parameters
    ----------
    asked : SweepJob
    path : Path
        The folder of the sweep.
    bound : BoundSettings or None
        Settings of the lower bound of every point; None for no bound.
    show, say : callable
        Receive the progress of the whole sweep, and messages.
    """

    def __init__(
        self, asked: SweepJob, path: Path, bound: BoundSettings | None, show: Show, say: Say
    ) -> None:
        self._failed: dict[str, str] = {}
        self._asked, self._path = asked, path
        self._show, self._say = show, say
        self._todo = iter(enumerate(asked.points))
        self._ending = Ending(figures=False, report=False, bound=bound)
        self._claims = SharedClaims()
        self._shares: dict[str, _Share] = {}
        self._finished = 0
        self._lock, self._building = threading.RLock(), threading.Lock()

    def run(self, shared: SharedPool) -> tuple[dict[str, Run], dict[str, str]]:
        """Compute what the points lack.

        Parameters
        ----------
        shared : SharedPool
            The workers.

        Returns
        -------
        runs : dict of str to Run
            The finished run of each point, by the point's name.
        failed : dict of str to str
            In a line, why each other point failed, by its name.

        Raises
        ------
        PoolError
            No worker answers.
        """
        self._remember_earlier_starts()
        workers = self._asked.execution.workers or usable_cores()
        number = min(len(self._asked.points), workers + _MORE, _MOST)
        threads = [
            threading.Thread(target=self._work, args=[shared], daemon=True) for _ in range(number)
        ]
        for thread in threads:
            thread.start()
        try:
            shared.serve(lambda: not any(thread.is_alive() for thread in threads))
        finally:  # every thread commits what it has: the pool's failure ends them
            for thread in threads:
                thread.join(_END_SECONDS)
        runs = {
            name: open_run(self._path / name)
            for name in self._asked.jobs
            if name not in self._failed
        }
        for name, run in runs.items():
            run.made_from = self._asked.jobs[name]
        return runs, {name: one_line(reason) for name, reason in self._failed.items()}

    def _remember_earlier_starts(self) -> None:
        """Let searches take the evaluations that points have committed before.

        Points that another processor has begun are left out: the last digits may differ.
        """
        if not any(job.search for job in self._asked.jobs.values()):
            return
        here, begun, finished = processor(), list[Path](), 0
        for path in (self._path / name for name in self._asked.jobs):
            # The point itself says what is wrong with its folder.
            with contextlib.suppress(StoreError, OSError):
                if holds_run(path):
                    finished += open_run(path).state == FINISHED
                    provenance = read_run(path)[0]["provenance"]
                    if provenance["processor"] == here and CONTINUED not in provenance:
                        begun.append(path)
        if finished == len(self._asked.jobs):
            return
        for path in begun:
            with contextlib.suppress(StoreError, OSError):
                self._claims.remember(Store(path))

    def _work(self, shared: SharedPool) -> None:
        """Run one point after another."""
        try:
            while shared.failure is None and (chosen := self._next()) is not None:
                rank, name = chosen
                try:
                    self._run(rank, name, shared)
                except PfdistError as error:
                    if shared.failure is None:
                        self._fail(name, error)
        except BaseException as error:
            shared.fail(error)
        finally:
            shared.wake()

    def _next(self) -> tuple[int, str] | None:
        with self._lock:
            rank, point = next(self._todo, (0, None))
            return None if point is None else (rank, point.name)

    def _run(self, rank: int, name: str, shared: SharedPool) -> None:
        with self._building:  # loading a model changes what modules are known
            built = build(self._asked.jobs[name])

        @contextlib.contextmanager
        def at_work(built: Built, store: Store, show: Show, say: Say) -> Iterator[Session]:
            claims = ClaimsOfRun(self._claims, store)
            with shared.join(rank, of_run(built.source)) as pool, claims:
                session = Session.start(built, store, pool, show, say, claims)
                yield session
                session.reporter.finish()

        def show(progress: Progress) -> None:
            self._reach(name, progress)

        def say(line: str) -> None:
            self._say(f"{name}: {line}")

        run_built(built, self._path / name, self._ending, show, say, work=at_work)
        with self._lock:
            self._finished += 1
            self._shares.pop(name, None)
            self._tell()
            self._say(f"{name}: finished ({self._finished} of {len(self._asked.points)})")

    def _fail(self, name: str, error: PfdistError) -> None:
        with self._lock:
            self._failed[name] = str(error)
            self._shares.pop(name, None)
            self._say(f"{name}: failed: {error}; the other points go on")

    def _reach(self, name: str, progress: Progress) -> None:
        with self._lock:
            share = progress.done / progress.total if progress.total else 0.0
            self._shares[name] = _Share(progress.phase, min(share, 1.0))
            self._tell()

    def _tell(self) -> None:
        total = len(self._asked.points)
        ended = self._finished + len(self._failed)
        phases = [f"{name}: {share.phase}" for name, share in self._shares.items()]
        doing = f"; {', '.join(phases)}" if phases else ""
        self._show(
            Progress(
                phase="sweep",
                done=ended + sum(share.done for share in self._shares.values()),
                total=total,
                doing=f"{self._finished} of {total} points finished{doing}",
            )
        )
