"""The points of a sweep at work: a few at a time, which share the workers."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from pfdist.errors import BusyError, PfdistError, StoreError, one_line
from pfdist.plugins.sweep.sweep_file import SweepJob
from pfdist.pools.cores import usable_cores
from pfdist.questions.list_runs import FINISHED
from pfdist.questions.run import compute
from pfdist.results import Run, open_run
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import build
from pfdist.runner.door import Driver, RunSession
from pfdist.runner.identity import opened
from pfdist.runner.progress import Progress, Say, Show, heard, silent
from pfdist.runner.provenance import lender
from pfdist.store import Store, holds_run, is_held

_MORE = 2  # points at work than workers: some wait for others, and some are at their last tasks
_MOST = 16  # points at work: each needs memory


class SweepPoints(NamedTuple):
    """The points of a sweep when a process has done what it can.

    Parameters
    ----------
    runs : dict of str to Run
        The finished run of each point, by the point's name.
    failed : dict of str to str
        In a line, why each other point failed, by its name.
    busy : list of str
        Points that other processes compute.
    """

    runs: dict[str, Run]
    failed: dict[str, str]
    busy: list[str]


class PointsAtWork:
    """The points of a sweep at work, the first points first.

    Parameters
    ----------
    sweep : SweepJob
    path : Path
        The folder of the sweep.
    bound : BoundSettings or None
        Settings of the lower bound of every point; None for no bound.
    show, say : callable
        Receive the progress of the whole sweep, and messages.
    """

    def __init__(
        self, sweep: SweepJob, path: Path, bound: BoundSettings | None, show: Show, say: Say
    ) -> None:
        self._failed: dict[str, str] = {}
        self._busy: dict[str, str] = {}  # who computes points that this process leaves out
        self._sweep, self._path, self._bound = sweep, path, bound
        self._show, self._say = show, say
        self._progress: dict[str, Progress] = {}
        self._at_work = self._finished = 0

    def drivers(self) -> Iterator[Driver | None]:
        """Yield the driver of each point; None while others must end first.

        Points that another process computes are left out, and tried again when all others have
        ended. So several processes may share a sweep.
        """
        todo = [*self._sweep.jobs]
        while todo:
            for name in todo:
                self._busy.pop(name, None)  # the others are still left out
                self._at_work += 1
                yield self._point(name)
            while self._at_work:
                yield None
            todo = [name for name in self._busy if not is_held(self._path / name)]
        for name, why in self._busy.items():
            heard(self._say, f"{name}: left out: {why}")

    def points(self) -> SweepPoints:
        """The points when all drivers have ended."""
        left = self._failed | self._busy
        jobs = {name: job for name, job in self._sweep.jobs.items() if name not in left}
        runs = {name: Run(self._path / name, job) for name, job in jobs.items()}
        failed = {name: one_line(why) for name, why in self._failed.items()}
        return SweepPoints(runs, failed, [*self._busy])

    @property
    def at_once(self) -> int:
        """How many points are at work at the same time."""
        workers = self._sweep.execution.workers or usable_cores()
        return min(len(self._sweep.points), workers + _MORE, _MOST)

    def begun(self) -> list[Store]:
        """The stores of points that were begun before, whose evaluations all points take.

        Points on another processor are left out, and points with damaged files: their own drivers
        raise the error.
        """
        begun, finished = list[Path](), 0
        for path in (self._path / name for name in self._sweep.jobs):
            with contextlib.suppress(StoreError, OSError):
                if holds_run(path):
                    finished += open_run(path).state == FINISHED
                    begun.append(path)
        stores = list[Store]()
        if finished < len(self._sweep.jobs):
            for path in begun:
                with contextlib.suppress(StoreError, OSError):
                    stores.append(lender(path))
        return stores

    def _point(self, name: str) -> Driver:
        """Compute a point. An error of it does not end the others."""

        def show(progress: Progress) -> None:
            self._progress[name] = progress
            self._tell()

        def of_point(line: str) -> None:
            self._say(f"{name}: {line}")

        say = silent if self._say is silent else of_point  # lines about results become warnings
        try:
            built = build(self._sweep.jobs[name], self._path / name)
            with opened(self._path / name, built) as store:
                run = Run(store.path, built.job)
                yield from compute(RunSession(built, store, show, say), run, self._bound)
        except BusyError as error:
            self._busy[name] = str(error)
            return
        except PfdistError as error:
            self._failed[name] = str(error)
            self._say(f"{name}: failed: {error}; the other points continue")
            return
        finally:
            self._at_work -= 1
            self._progress.pop(name, None)
        self._finished += 1
        self._tell()
        self._say(f"{name}: finished ({self._finished} of {len(self._sweep.points)})")

    def _tell(self) -> None:
        number = len(self._sweep.points)
        ended = self._finished + len(self._failed)
        points = ((each.done, each.total - each.optional) for each in self._progress.values())
        phases = [f"{name}: {each.phase}" for name, each in self._progress.items()]
        doing = f"; {', '.join(phases)}" if phases else ""
        self._show(
            Progress(
                phase="sweep",
                done=ended + sum(min(done / total, 1.0) for done, total in points if total > 0),
                total=number,
                doing=f"{self._finished} of {number} points finished{doing}",
            )
        )
