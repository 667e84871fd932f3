"""A lower bound of the expected MSE of every feasible set, and the gap of a run's sets."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pfdist.analysis import Run, finite
from pfdist.api.at_work import at_work
from pfdist.api.finished_run import built_again, finished_run
from pfdist.bounds.gap import Gap
from pfdist.errors import JobError, RunMismatchError
from pfdist.evaluation.engines import KALMAN
from pfdist.plots import draw_figures
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import Built, check_pool
from pfdist.runner.identity import opened
from pfdist.runner.processor import note_processor
from pfdist.runner.progress import Report
from pfdist.runner.prover import Prover
from pfdist.store import Store

_DEFAULT = BoundSettings()


@dataclass(frozen=True)
class Bound:
    """Result of `bound`.

    Parameters
    ----------
    run : Path
    window, longest_gap, windows : int
        Windows of the relaxation at first, and how many it knows in the end.
    particles, draws : int
        Settings of the bound's filter; 0 where the engine is exact.
    confidence : float
        Confidence of the limit of each gap.
    within_reached : bool or None
        Whether the limits of all found sets are as small as demanded; None if nothing was demanded.
    gaps : list of Gap
        One for each compared set of the run.
    """

    run: Path
    window: int
    longest_gap: int
    windows: int
    particles: int
    draws: int
    confidence: float
    within_reached: bool | None
    gaps: list[Gap]

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; an unknown value is None."""
        own = {key: value for key, value in vars(self).items() if key not in ("run", "gaps")}
        sets = {gap.name: gap.columns() for gap in self.gaps}
        for row in sets.values():
            del row["name"]
        answer: dict[str, Any] = finite({"run": str(self.run), **own, "sets": sets})
        return answer


def bound(
    run: str | Path,
    settings: BoundSettings = _DEFAULT,
    *,
    pool: str | None = None,
    workers: int | None = None,
    address: str | None = None,
    model: str = "",
    filter_model: str = "",
    figures: bool = True,
    report: Report = lambda progress: None,
    say: Callable[[str], Any] = lambda line: None,
) -> Bound:
    """Prove how much lower the expected MSE of any other feasible times can be.

    The function runs the model, on draws that neither chose the times nor compared them, and
    writes the tables ``bound`` and ``error_sums`` of the run. The same call goes on where it was
    stopped. It runs a model file that the run's folder names only if the file is unchanged since
    the run, and if the user has run the file on this machine before.

    Parameters
    ----------
    run : str or Path
        Folder of a finished run.
    settings : BoundSettings
        Draws, particles, windows and limits of the proof, and the gap that is demanded.
    pool, workers, address : optional
        Where to compute, as for `pfdist.run`. The default is Ray with all cores of this machine,
        wherever the run was computed; exact engines need no pool.
    model, filter_model : str, optional
        ``path/file.py:object``: replaces the file that the run names for the model or for the
        filter's model. It is run without question, and must mean the same as the run's model.
    figures : bool
        Whether to draw the figure of the bound against work.
    report : callable, optional
        Receives the progress.
    say : callable, optional
        Receives lines: each model file before it is run, and when the pool is ready.

    Returns
    -------
    Bound

    Raises
    ------
    StoreError
        The folder holds no finished run, or the model has changed since, or the run names a model
        file that is not run without the user's word.
    JobError, ModelError
        The model defines an error of its own; the relaxation is too large; or the model cannot be
        loaded.
    TaskError, PoolError
        A task failed, or no worker answers. All committed sums are kept.
    """
    execution = {"pool": pool, "workers": workers, "address": address}
    given = {key: value for key, value in execution.items() if value is not None}
    proved = finished_run(run)
    if proved.job["filter"]["engine"] == KALMAN.name:
        given = {"pool": "serial"}  # there is nothing to compute in a pool
    built = built_again(proved, {"model": model, "filter_model": filter_model}, say, given)
    check_pool(built.job.execution)
    prover, within = _prover(built, settings), settings.within
    with _store(proved, built, say) as store, at_work(built, store, report, say) as session:
        session.reporter.foresee(prover.steps)
        look = prover.prove(session, finished_run(run))  # it may have been found damaged
        if figures and store.path == proved.path:
            draw_figures(proved, "bound")
    return Bound(
        proved.path,
        settings.window,
        prover.relaxation.longest_gap,
        len(prover.relaxation.windows),
        prover.particles,
        look.draws,
        prover.confidence,
        None if within is None else look.is_within(within, built.study.references),
        look.gaps,
    )


def _prover(built: Built, settings: BoundSettings) -> Prover:
    try:
        return Prover(built, settings)
    except JobError as error:
        if error.argument != "window":
            raise
        message = f"{error}; take a smaller window, or more memory"
        raise JobError(message, argument="window") from error


@contextlib.contextmanager
def _store(run: Run, built: Built, say: Callable[[str], Any]) -> Iterator[Store]:
    """Give the run's own store, or a store for a while if another version computed the run."""
    with contextlib.ExitStack() as stack:
        try:
            store = stack.enter_context(opened(run.path, built, say))
            note_processor(run.path, built, say)
        except RunMismatchError as error:
            difference, *_ = error.differences
            say(f"{run.path} is of another program ({difference}): the bound is not stored there")
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="pfdist-bound-"))
            store = Store(Path(folder))
        yield store
