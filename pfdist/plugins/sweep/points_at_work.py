"""The points of a sweep at work: one after another, with the same workers."""

from collections.abc import Iterable
from contextlib import AbstractContextManager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

from pfdist.errors import BusyError, PfdistError, StoreError, one_line
from pfdist.plugins.runs.listing import FINISHED
from pfdist.plugins.sweep.sweep_file import SweepJob
from pfdist.pools.base import Pool
from pfdist.questions.run import compute
from pfdist.results import Run, open_run
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import build
from pfdist.runner.door import RunSession, entered_late, is_of_pool, lent_by, serve
from pfdist.runner.identity import opened
from pfdist.runner.progress import Progress, Say, Show, heard, silent
from pfdist.runner.provenance import lender
from pfdist.store import Store, holds_run, is_held


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


def compute_points(
    sweep: SweepJob,
    path: Path,
    bound: BoundSettings | None,
    pool: AbstractContextManager[Pool],
    show: Show,
    say: Say,
) -> SweepPoints:
    """Compute the points of a sweep, one after another, with the same workers.

    Points that another process computes are left out, and tried again when all others have ended.
    So several processes may share a sweep. An error of a point does not end the others.

    Parameters
    ----------
    sweep : SweepJob
    path : Path
        The folder of the sweep.
    bound : BoundSettings or None
        Settings of the lower bound of every point; None for no bound.
    pool : context manager
        The workers, which start with the first task.
    show, say : callable
        Receive the progress of the whole sweep, and messages.

    Raises
    ------
    PoolError
        No worker answers.
    """
    number, runs = len(sweep.points), dict[str, Run]()
    failed, busy = dict[str, str](), dict[str, str]()  # why, by the name of the point

    def tell(name: str = "", progress: Progress | None = None) -> None:
        share, doing = 0.0, f"{len(runs)} of {number} points finished"
        if progress is not None:
            total, doing = progress.total - progress.optional, f"{doing}; {name}: {progress.phase}"
            share = min(progress.done / total, 1.0) if total > 0 else 0.0
        show(Progress("sweep", len(runs) + len(failed) + share, number, doing=doing))

    lent, todo = lent_by(_begun(sweep, path)), [*sweep.jobs]
    with entered_late(pool) as workers:
        while todo:
            for name in todo:
                busy.pop(name, None)
                # Lines about results become warnings if nobody listens.
                of_point = silent if say is silent else partial(_say_of_point, say, name)
                try:
                    built = build(sweep.jobs[name], path / name)
                    with opened(path / name, built) as store:
                        run = Run(store.path, built.job)
                        session = RunSession(built, store, partial(tell, name), of_point)
                        serve(compute(session, run, bound), workers, lent)
                except BusyError as error:
                    busy[name] = str(error)
                    continue
                except PfdistError as error:
                    if is_of_pool(error):
                        raise
                    failed[name] = str(error)
                    say(f"{name}: failed: {error}; the other points continue")
                else:
                    runs[name] = Run(path / name, sweep.jobs[name])
                    tell()
                    say(f"{name}: finished ({len(runs)} of {number})")
                lent |= lent_by(_lenders([path / name]))
            todo = [name for name in busy if not is_held(path / name)]
    for name, why in busy.items():
        heard(say, f"{name}: left out: {why}")
    in_order = {name: runs[name] for name in sweep.jobs if name in runs}
    return SweepPoints(in_order, {name: one_line(why) for name, why in failed.items()}, [*busy])


def _say_of_point(say: Say, name: str, line: str) -> None:
    say(f"{name}: {line}")


def _begun(sweep: SweepJob, path: Path) -> list[Store]:
    """The stores of points that were begun before, unless all are finished."""
    begun, finished = list[Path](), 0
    for each in (path / name for name in sweep.jobs):
        with suppress(StoreError, OSError):
            if holds_run(each):
                finished += open_run(each).state == FINISHED
                begun.append(each)
    return _lenders(begun) if finished < len(sweep.jobs) else []


def _lenders(paths: Iterable[Path]) -> list[Store]:
    """The stores of points whose evaluations the others take.

    Points on another processor are left out, and points with damaged files: their own drivers raise
    the error.
    """
    stores = list[Store]()
    for path in paths:
        with suppress(StoreError, OSError):
            stores.append(lender(path))
    return stores
