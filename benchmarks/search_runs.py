"""A search with its work counted, and the costs of found sets on fresh draws."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist import Job
from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.errors import TaskError
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_mse
from pfdist.filters.variants import task
from pfdist.filters.work import FilterWork
from pfdist.pools.base import Outcome, Pool, Task
from pfdist.runner.build import Built, build
from pfdist.runner.door import RunSession, complete
from pfdist.runner.driver import drive
from pfdist.search import Race
from pfdist.store import Store

STANDARD_ERROR = 0.12  # wanted standard error of an excess, in per cent
ROUND = 5000  # draws of a round
RACE_DRAWS = 1000  # draws of the first round of a race
_TABLES = ":draws:", ":error_sums:"  # in the keys of a search's tasks
STEPS_A_TASK = 200_000_000

Array = NDArray[np.float64]


class Counting:
    """A pool that counts the particle-steps of searches.

    Parameters
    ----------
    pool : Pool
        A pool that was entered.

    Attributes
    ----------
    steps : int
        Particle-steps counted so far.
    workers : int
        Number of workers of the pool.
    """

    def __init__(self, pool: Pool) -> None:
        self._pool, self.workers, self.steps = pool, pool.workers, 0

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Give the outcomes as they come."""
        for outcome in self._pool.run(tasks):
            if any(table in outcome.task.key for table in _TABLES):
                self.steps += sum(work.steps for work in outcome.task.work)
            yield outcome

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        pass


def best_known(problem: str) -> list[Times]:
    """Give the best sets known of a problem, the very best first."""
    rows = pd.read_csv(Path(__file__).with_name("best_known.csv"), comment="#")
    found = rows.loc[rows["problem"] == problem, "times"]
    return [tuple(map(int, times.split())) for times in found]


def search(job: Job, pool: Pool) -> dict[str, Any]:
    """Run the only search of a job, with its shortlist, and give work, time and result.

    Parameters
    ----------
    job : Job
        A job with few draws in the comparison.
    pool : Pool
        A pool for the same problem that was entered.

    Returns
    -------
    dict
        steps: particle-steps, or with the exact engine steps of the Kalman filter; seconds;
        believed: the cost that the search reports; times.
    """
    built, counting = build(job), Counting(pool)
    (name,) = (section.name for section in job.search)
    with tempfile.TemporaryDirectory(prefix="run-") as folder:
        store, start = Store(Path(folder)), perf_counter()
        complete(drive(RunSession(built, store)), counting)
        seconds = perf_counter() - start
        rows, compared = store.read("evaluations"), store.read("compared").set_index("name")
        steps = int((rows["end"] + 1).sum()) if built.evaluator.exact else counting.steps
        believed, times = compared.loc[name, "search_mse"], store.compared_sets()[name]
    return {"steps": steps, "seconds": seconds, "believed": believed, "times": times}


def fresh_costs(built: Built, pool: Pool, sets: Sequence[Times], rounds: int) -> pd.DataFrame:
    """Give the costs of some sets, and the excess of each set over the best set.

    A race determines the best set. Then all sets filter other draws, under common noise, until the
    standard errors of the excess are small.

    Parameters
    ----------
    built : Built
    pool : Pool
        A pool for the same problem that was entered.
    sets : sequence of tuples of int
        Different sets.
    rounds : int
        Largest number of rounds of 5,000 draws.

    Returns
    -------
    DataFrame
        A row for each set: times, cost, standard_error, excess and excess_error (in per cent of the
        best set's cost), draws, best (whether the set won the race).
    """
    costs = exact_mse(built.evaluator, sets)
    if costs is not None:
        excess = 100 * (costs / costs.min() - 1)
        rows = {"cost": costs, "standard_error": 0.0, "excess": excess, "excess_error": 0.0}
        return pd.DataFrame({"times": sets, **rows, "draws": 0, "best": excess == 0})
    best = _winner(built, pool, sets)
    known = {times: np.empty(0) for times in sets}
    for number in range(rounds):
        wanted = [times for times, mse in known.items() if _is_open(mse, known[best])]
        if not wanted:
            break
        draws = (number * ROUND, (number + 1) * ROUND)
        wanted = list(dict.fromkeys([best, *wanted]))
        mse = filtered(built, pool, wanted, stream_of("comparison", built.job.seed), draws)
        for times, column in zip(wanted, mse.T, strict=True):
            known[times] = np.append(known[times], column)
    return pd.DataFrame([_row(times, mse, known[best]) for times, mse in known.items()]).assign(
        best=[times == best for times in known]
    )


def _winner(built: Built, pool: Pool, sets: Sequence[Times]) -> Times:
    race, stream = Race(tuple(sets), RACE_DRAWS), stream_of("shortlist", built.job.seed)
    state, rng = race.init(), np.random.default_rng(0)
    while not race.done(state):
        asked = race.ask(state, rng)
        mse = filtered(
            built,
            pool,
            [candidate.measurement_times for candidate in asked],
            stream,
            (0, state.draws),
        )
        columns = zip(asked, mse.T, strict=True)
        told = [
            Evaluation(candidate.measurement_times, column, purpose="shortlist")
            for candidate, column in columns
        ]
        state = race.tell(state, told)
    return race.finalists(state)[0].measurement_times


def filtered(
    built: Built,
    pool: Pool,
    sets: Sequence[Times],
    stream: int,
    draws: tuple[int, int],
    filter_streams: Sequence[int] = (),
) -> Array:
    """Give the per-draw MSE of each set on common draws, (D, S).

    Parameters
    ----------
    built : Built
    pool : Pool
        A pool for the same problem that was entered.
    sets : sequence of tuples of int
        S sets.
    stream : int
        Key of the draws, and of the noise of all filters.
    draws : (int, int)
        First draw, and the one after the last.
    filter_streams : sequence of int, optional
        Key of each filter's noise, (S,). By default all filters have common noise.
    """
    work = FilterWork(
        measurement_times=tuple(sets),
        ends=(built.job.problem.feasible.horizon,) * len(sets),
        filter_streams=tuple(filter_streams) or (stream,) * len(sets),
        draws_stream=stream,
        draws=draws,
        estimation=built.comparing,
    )
    size, (first, last) = max(1, STEPS_A_TASK // work.steps_a_draw), draws
    pieces = [replace(work, draws=(d, min(last, d + size))) for d in range(first, last, size)]
    mse = np.empty((last - first, len(sets)))
    results = task(built.evaluator)
    for outcome in pool.run([Task(f"fresh:{piece.draws}", results, (piece,)) for piece in pieces]):
        if outcome.error is not None:
            raise TaskError("a task on fresh draws failed", outcome.error)
        (piece,), (result,) = outcome.task.work, outcome.value
        mse[piece.draws[0] - first : piece.draws[1] - first] = result.mse
    return mse


def _is_open(mse: Array, best: Array) -> bool:
    if mse.size < ROUND:
        return True
    of_best = best[: mse.size]
    error = np.nanstd(mse - of_best) / np.sqrt(mse.size) / np.nanmean(of_best)
    return bool(100 * error > STANDARD_ERROR)


def _row(times: Times, mse: Array, best: Array) -> dict[str, Any]:
    of_best, root = best[: mse.size], np.sqrt(mse.size)
    apart, scale = mse - of_best, 100 / np.nanmean(of_best)
    return {
        "times": times,
        "cost": np.nanmean(mse),
        "standard_error": np.nanstd(mse) / root,
        "excess": scale * np.nanmean(apart),
        "excess_error": scale * np.nanstd(apart) / root,
        "draws": mse.size,
    }
