"""Run a job: compute what its run lacks, then draw the figures."""

from collections.abc import Callable, Iterable
from pathlib import Path
from time import perf_counter
from typing import Any

from pfdist.analysis import Run, open_run
from pfdist.job.job import Job, as_job
from pfdist.plots import draw_figures, figure_files, remove_figures
from pfdist.pools.kinds import POOLS
from pfdist.runner.build import build, check_pool, make_pool
from pfdist.runner.driver import FORKED, drive
from pfdist.runner.identity import opened
from pfdist.runner.named_by_a_run import files_named
from pfdist.runner.processor import note_processor
from pfdist.runner.progress import Report
from pfdist.store import Store


def run(
    job: Job | str | Path,
    results: str | Path | None = None,
    pool: str | None = None,
    workers: int | None = None,
    *,
    address: str | None = None,
    fork: str | Path | None = None,
    changes: Iterable[str] = (),
    report: Report = lambda progress: None,
    say: Callable[[str], Any] = lambda line: None,
) -> Run:
    """Run a job, or go on with its run where it stopped.

    Parameters
    ----------
    job : Job, str or Path
        A job, or the path of its file.
    results : str or Path, optional
        The run's own folder; by default ``results/<the job file's stem>``.
    pool : str, optional
        Name of a pool, such as "ray" or "serial", in the place of the job's execution.pool.
    workers : int, optional
        In the place of the job's execution.workers; 0 takes all cores.
    address : str, optional
        Of a Ray cluster to join.
    fork : str or Path, optional
        The folder of a new run, of a job that differs from that of `results`: evaluations of which
        nothing differs are taken from there.
    changes : iterable of str, optional
        ``key=value`` each, as `pfdist.load_job` takes them.
    report : callable, optional
        Is told of the progress, a `pfdist.runner.progress.Progress` at a time.
    say : callable, optional
        Is told, in a line each, which model files are run, when the pool is ready, which files
        were damaged, and why a search does not believe its estimator.

    Returns
    -------
    Run

    Raises
    ------
    PfdistError
        Whatever went wrong; what was committed is kept, and the same call goes on from there.
    """
    execution = {"pool": pool, "workers": workers, "address": address}
    chosen = [f"execution.{k}={v}" for k, v in execution.items() if v is not None]
    job = as_job(job, [*changes, *chosen])
    check_pool(job.execution)
    path = Path("results") / job.path.stem if results is None else Path(results)
    origin, path = (None, path) if fork is None else (Store(path), Path(fork))
    if origin is not None:
        open_run(origin.path)  # or there is nothing to start from
    for file in files_named(job):
        say(f"runs the model file {file}, which your job names")
    built = build(job)
    with opened(path, built, say) as store:
        if open_run(path).state != "finished":
            remove_figures(path)  # of fewer draws, or drawn on the way
            if origin is not None:
                store.adopt(origin, FORKED)
            note_processor(path, built, say)
            start = perf_counter()
            with make_pool(built, job.execution) as entered:
                say(_ready(job.execution.pool, entered.workers, perf_counter() - start))
                drive(built, store, entered, report, say)
        done = open_run(path)
        if not all(file.exists() for file in figure_files(done)):
            draw_figures(done)
    return done


def _ready(pool: str, workers: int, seconds: float) -> str:
    title = POOLS[pool].title
    return f"{title} is ready: {workers} worker{'s' * (workers != 1)} in {seconds:.1f} s"
