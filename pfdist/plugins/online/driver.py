"""The phase of a run in which measurement times are chosen one after another."""

from collections.abc import Generator, Mapping

import numpy as np
import pyarrow as pa

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork, Result, cut
from pfdist.plugins.online.needs import ON_THE_WAY
from pfdist.plugins.online.planning import planning_of
from pfdist.plugins.online.section import ONLINE, Online, online_of
from pfdist.plugins.online.work import OnlineWork, affordable
from pfdist.problem.job import Job
from pfdist.runner.build import Built
from pfdist.runner.comparison_phase import TRAJECTORIES
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.later import LaterWork
from pfdist.runner.row_formats import RowsByDraw
from pfdist.store import schema

ONLINE_TIMES = "online.times"
"""Name of the phase; no search may have it."""
_BLOCK = 200  # draws, whose rows are published together


def run_online(session: RunSession, sets: Mapping[str, Times]) -> Generator[WorkBatch, None, None]:
    """Choose the times of the draws that the store lacks, and publish the table ``online``.

    The job must have a section [online]. The initial plan is the compared set of the first search.
    """
    built, reporter = session.built, session.reporter
    plan = sets[built.searches[0].name]
    first = next(name for name, times in sets.items() if times == plan)  # whose noise it has
    work, start = online_work(built, plan, first), reporter.progress.done
    draws = work.draws[1]
    reporter.begin("online")

    def learn(piece: FilterWork, result: Result) -> None:
        reporter.advance(piece.steps, len(result.mse))

    works = [work.piece(block) for block in cut(range(draws), _BLOCK)]
    rows = RowsByDraw("online", _rows, _result)
    yield WorkBatch(session, ONLINE_TIMES, works, rows, learn, part="online")
    reporter.reach(start + draws * work.steps_a_draw)
    session.store.settle("online", ONLINE_TIMES)


def _result(rows: pa.Table) -> Result:
    """The result from which these rows were made: the errors."""
    return Result(rows["mse"].to_numpy()[:, None])


def online_steps(built: Built) -> int:
    """Approximate number of particle-steps of the phase."""
    work = online_work(built, built.job.problem.feasible.regular(), "")
    return work.draws[1] * work.steps_a_draw


def online_work(built: Built, plan: Times, name: str) -> OnlineWork:
    """The work for all draws of a job with a section [online]; `name` keys the filters' noise."""
    job, purpose, online = built.job, built.study.purpose, online_of(built.job) or Online()
    return OnlineWork(
        measurement_times=(plan,),
        ends=(job.problem.feasible.horizon,),
        filter_streams=(stream_of(purpose, job.seed, "filter", name),),
        draws_stream=stream_of(purpose, job.seed, "draws"),
        draws=(0, online.draws),
        estimation=built.comparing,
        ids=("online",),
        feasible=built.feasible,
        planning=affordable(
            built, built.feasible, planning_of(job, built.evaluator.variance_is_error)
        ),
        planning_stream=stream_of(purpose, job.seed, "planning"),
        shown=TRAJECTORIES,
        sensors=built.evaluator.points.ways,
    )


def _rows(piece: FilterWork, result: Result) -> pa.Table:
    estimates = [estimate.ravel() for estimate in result.estimates]
    later = len(result.mse) - len(estimates)
    columns = [
        pa.array(np.arange(*piece.draws)),
        pa.array(result.mse[:, 0]),
        pa.array(result.degenerate[:, 0]),
        pa.array(result.measurement_times, pa.list_(pa.int16())),
        pa.array([*estimates, *[None] * later], pa.list_(pa.float64())),
    ]
    return pa.Table.from_arrays(columns, schema=schema("online"))


def _estimations(job: Job, evaluator: Evaluator) -> list[Estimation]:
    ON_THE_WAY.check(ONLINE, job, evaluator)
    return [planning_of(job, evaluator.variance_is_error).estimation]


LATER = LaterWork("online", ONLINE_TIMES, _estimations, online_steps, run_online)
