"""The draws whose times are chosen one after another, beside the same draws of the comparison."""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace

import numpy as np
import pyarrow as pa

from pfdist.evaluation.work import Result, Work, cut
from pfdist.job.online_section import Online
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.runner.first_draws import TRAJECTORIES
from pfdist.runner.online_planning import planning_of
from pfdist.runner.progress import Reporter
from pfdist.sequential.work import OnlineWork
from pfdist.store import schema
from pfdist.times.measurement_times import Times

CHOOSING = "online.times"
"""Name of the phase; no search is named so."""
_BLOCK = 200  # draws, whose rows are published together


def run_online(
    built: Built, sets: Mapping[str, Times], collector: Collector, reporter: Reporter
) -> None:
    """Choose the times of the draws that the store lacks, and publish the table ``online``.

    Parameters
    ----------
    built : Built
        Its job has a section [online].
    sets : mapping of str to tuple of int
        Compared sets by name. The plan before anything is measured is that of the first search.
    collector : Collector
    reporter : Reporter

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    store, work = collector.store, online_work(built, sets[built.searches[0].name])
    draws, present = work.draws[1], store.present("online", "draw")
    missing = np.setdiff1d(np.arange(draws), np.flatnonzero(present))
    done = draws - missing.size
    start = reporter.progress.done
    reporter.begin("online", evaluations=done)
    reporter.note(done=start + done * work.steps_a_draw)
    works = (replace(work, draws=lacking) for lacking in cut(missing, _BLOCK))
    with closing(collector.run(CHOOSING, "online", works, _rows)) as pieces:
        for piece, result in pieces:
            done += len(result.mse)
            reporter.reach(reporter.progress.done + piece.steps, evaluations=done)
    reporter.reach(start + draws * work.steps_a_draw)
    store.settle("online", CHOOSING)


def online_steps(built: Built) -> int:
    """About how many particle-steps the phase takes; 0 without a section [online]."""
    if built.job.online is None:
        return 0
    work = online_work(built, built.job.problem.feasible.regular())
    return work.draws[1] * work.steps_a_draw


def online_work(built: Built, plan: Times) -> OnlineWork:
    """The work for all draws of a job with a section [online]."""
    job, purpose, online = built.job, built.study.purpose, built.job.online or Online()
    planner = built.searches[0].name  # with its noise, draws that keep the plan keep its error
    return OnlineWork(
        measurement_times=(plan,),
        ends=(job.problem.feasible.horizon,),
        filter_streams=(purpose.stream(job.seed, "filter", planner),),
        draws_stream=purpose.stream(job.seed, "draws"),
        draws=(0, online.draws),
        estimation=built.comparing,
        ids=("online",),
        feasible=built.feasible,
        planning=planning_of(job, built.evaluator.cheapest_estimator),
        planning_stream=purpose.stream(job.seed, "planning"),
        shown=TRAJECTORIES,
    )


def _rows(piece: Work, result: Result) -> pa.Table:
    estimates = [estimate.ravel() for estimate in result.estimates]
    later = len(result.mse) - len(estimates)
    columns = [
        pa.array(np.arange(*piece.draws)),
        pa.array(result.mse[:, 0], from_pandas=True),
        pa.array(result.measurement_times, pa.list_(pa.int16())),
        pa.array([*estimates, *[None] * later], pa.list_(pa.float64())),
    ]
    return pa.Table.from_arrays(columns, schema=schema("online"))
