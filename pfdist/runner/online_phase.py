"""The draws whose times are chosen one after another, beside the same draws of the comparison."""

from collections.abc import Generator, Mapping

import numpy as np
import pyarrow as pa

from pfdist.common.streams import stream_of
from pfdist.evaluation.work import Result, Work, cut
from pfdist.job.online_section import Online
from pfdist.runner.build import Built
from pfdist.runner.door import Batch, Session
from pfdist.runner.first_draws import TRAJECTORIES
from pfdist.runner.kept import RowsByDraw
from pfdist.runner.searches import planning_of
from pfdist.sequential.work import OnlineWork
from pfdist.store import schema
from pfdist.times.measurement_times import Times

ONLINE_TIMES = "online.times"
"""Name of the phase; no search is named so."""
_BLOCK = 200  # draws, whose rows are published together


def run_online(session: Session, sets: Mapping[str, Times]) -> Generator[Batch, None, None]:
    """Choose the times of the draws that the store lacks, and publish the table ``online``.

    The job must have a section [online]. The plan before anything is measured is the compared set
    of the first search.
    """
    built, reporter = session.built, session.reporter
    work, start = online_work(built, sets[built.searches[0].name]), reporter.progress.done
    draws = work.draws[1]
    reporter.begin("online")

    def learn(piece: Work, result: Result) -> None:
        reporter.reach(
            reporter.progress.done + piece.steps,
            evaluations=reporter.progress.evaluations + len(result.mse),
        )

    works = [work.part(block) for block in cut(range(draws), _BLOCK)]
    yield Batch(session, ONLINE_TIMES, works, RowsByDraw("online", _rows, _result), learn)
    reporter.reach(start + draws * work.steps_a_draw)
    session.store.settle("online", ONLINE_TIMES)


def _result(rows: pa.Table) -> Result:
    """The result from which these rows were made: the errors."""
    return Result(rows["mse"].to_numpy()[:, None])


def online_steps(built: Built) -> int:
    """Particle-steps of the phase, approximately; 0 without a section [online]."""
    if built.job.online is None:
        return 0
    work = online_work(built, built.job.problem.feasible.regular())
    return work.draws[1] * work.steps_a_draw


def online_work(built: Built, plan: Times) -> OnlineWork:
    """The work for all draws of a job with a section [online]."""
    job, purpose, online = built.job, built.study.purpose, built.job.online or Online()
    # With the noise of this set in the comparison: a draw that keeps the plan has the same error.
    planner = built.searches[0].name
    return OnlineWork(
        measurement_times=(plan,),
        ends=(job.problem.feasible.horizon,),
        filter_streams=(stream_of(purpose, job.seed, "filter", planner),),
        draws_stream=stream_of(purpose, job.seed, "draws"),
        draws=(0, online.draws),
        estimation=built.comparing,
        ids=("online",),
        feasible=built.feasible,
        planning=planning_of(job, built.evaluator.cheapest_estimator),
        planning_stream=stream_of(purpose, job.seed, "planning"),
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
