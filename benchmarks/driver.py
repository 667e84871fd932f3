"""How many cores a driver can feed: the real driver and pool with simulated nodes.

The driver, the pool, the store and the tables are real. The nodes are simulated: a task takes as
long as a worker would take, on a clock that jumps to the next answer when the driver waits. The
answers are computed for real, by a model that takes microseconds, while the clock stands still. Ray
itself takes part of the driver's time, too; `ray_costs` measures it.
"""

import contextlib
import heapq
import itertools
import pickle
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from queue import Empty
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pandas as pd
import psutil
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist import load_job
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREEN, RED
from pfdist.pools import ray_pool
from pfdist.pools.base import SerialPool
from pfdist.pools.ray_pool import RayPool
from pfdist.runner import door
from pfdist.runner.build import build
from pfdist.runner.comparison_phase import comparison_steps
from pfdist.runner.door import RunSession, complete
from pfdist.runner.driver import drive
from pfdist.runner.identity import opened
from pfdist.runner.pace import Pace

TITLE = "Driver"
TABLES: tuple[str, ...] = ("driver", "searches")

JOB = Path(__file__).parents[1] / "jobs" / "paper.toml"
CORES = (10, 100, 1_000, 10_000)
SECONDS = (0.3, 1.0, 10.0)  # of a task
TASKS = 50_000  # at most; and 20 for each core
AS_CHOSEN = "chosen"  # by the driver, for the number of cores
_DRAWS_A_TASK = 20
_FIRST = 2_000  # draws that are compared before: some of them are filtered several times
_SMALL = (
    "problem.horizon=12",
    "problem.measurement_budget=4",
    "filter.particles=4",
    "evaluation.draws=10",
    "search=[{method='random', evaluations=2}]",
)

KERNEL_SECONDS = 1.65e-9  # for a particle-step of the paper's model
SEARCH_CORES = (1, 10, 100, 1_000)
MEASUREMENTS = (11, 21, 31)
_FEW_PARTICLES = 4  # of the genetic algorithm, in place of 500: each is so much slower
SEARCHES = {
    "genetic": ("method='genetic', generations=4", 1_000, 500 / _FEW_PARTICLES),
    "relaxation": ("method='relaxation'", 720, 1),
}
"""Settings of a search, draws of an evaluation by default, and how much slower a particle is."""


class Clock:
    """The driver's time: real time, but it stands still while simulated nodes compute."""

    def __init__(self) -> None:
        self._offset = -time.perf_counter()
        self.waited = 0.0  # seconds for which the driver had nothing to do

    def now(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() + self._offset

    def wait_until(self, moment: float) -> None:
        """Jump to a later moment."""
        jump = max(0.0, moment - self.now())
        self._offset += jump
        self.waited += jump

    @contextlib.contextmanager
    def standing_still(self) -> Iterator[None]:
        """Let real time pass that is not the driver's."""
        moment = self.now()
        try:
            yield
        finally:
            self._offset -= self.now() - moment


class Nodes:
    """Simulated nodes, and the queue of their answers as `RayPool` reads it."""

    def __init__(self, cores: int, seconds_a_step: float) -> None:
        self.clock, self.seconds_a_step = Clock(), seconds_a_step
        self.cores = cores
        self.busy, self.tasks, self.last = 0.0, 0, 0.0
        self._count = itertools.count()
        self._finishing: list[tuple[float, int, Future[Any], Any]] = []
        self._answers: deque[Future[Any]] = deque()

    def finish(self, moment: float, answer: Any) -> Any:
        """A call whose answer comes at a moment."""
        call = Future[Any]()
        heapq.heappush(self._finishing, (moment, next(self._count), call, answer))
        return SimpleNamespace(future=lambda: call)

    def put(self, call: Future[Any]) -> None:
        """Note an answer that has come."""
        self._answers.append(call)

    def get(self, timeout: float) -> Future[Any]:
        """The next answer; the clock jumps to it if it is still to come."""
        if not self._answers:
            if not self._finishing:
                raise Empty
            moment, _, call, answer = heapq.heappop(self._finishing)
            self.clock.wait_until(moment)
            call.set_result(answer)
        return self._answers.popleft()


class _Remote:
    """Does tasks on simulated cores, in the place of Ray's remote function."""

    def __init__(self, nodes: Nodes) -> None:
        self._nodes, self._free = nodes, [0.0] * nodes.cores  # when each core is free

    def remote(self, _: str, content: list[Any], work: bytes, __: float) -> Any:
        """The call of a task."""
        nodes, (function,) = self._nodes, content
        with nodes.clock.standing_still():
            works = pickle.loads(work)  # noqa: S301
            value = function(works)
            seconds = sum(part.steps for part in works) * nodes.seconds_a_step
            end = max(heapq.heappop(self._free), nodes.clock.now()) + seconds
            heapq.heappush(self._free, end)
            nodes.busy, nodes.tasks = nodes.busy + seconds, nodes.tasks + 1
            nodes.last = max(nodes.last, end)
        return nodes.finish(end, (value, seconds, "worker", "node", None, False))


@contextlib.contextmanager
def simulated(nodes: Nodes) -> Iterator[RayPool]:
    """A `RayPool` whose nodes are simulated."""
    cores = SimpleNamespace(number=nodes.cores, look=lambda: nodes.cores)
    clock = SimpleNamespace(monotonic=nodes.clock.now, time=time.time)
    replaced = {
        "connected": lambda *_: contextlib.nullcontext(),
        "_Cores": lambda: cores,
        "_stored": lambda function: ("", [function]),
        "_remote": lambda: _Remote(nodes),
        "SimpleQueue": lambda: nodes,
        "time": clock,
    }
    with contextlib.ExitStack() as stack:
        for name, value in replaced.items():
            stack.enter_context(patch.object(ray_pool, name, value))
        stack.enter_context(patch.object(door, "time", clock))
        yield stack.enter_context(RayPool())


def measure(quick: bool, say: Say) -> Tables:
    """Compare two sets on simulated nodes, and time the driver.

    Parameters
    ----------
    quick : bool
        Few cores.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        driver: a row for each number of cores and length of a task, with cores, wanted (seconds of
        a task, or chosen), task_seconds (mean), tasks, microseconds (of the driver a task), busy
        (share of the cores) and mebibytes (that the process has grown by).
    """
    rows = []
    for cores in CORES[:1] if quick else CORES:
        lengths: list[float | str] = [*SECONDS[: 1 if quick else None], AS_CHOSEN]
        for wanted in lengths:
            row = {"cores": cores, "wanted": wanted, **run(cores, wanted)}
            rows.append(row)
            say(
                f"{cores:,} cores, tasks of {row['task_seconds']:.2f} s: "
                f"{row['microseconds']:.0f} us of the driver a task, {row['busy']:.1%} busy"
            )
    return {"driver": pd.DataFrame(rows), "searches": pd.DataFrame(_searches(quick, say))}


def run(cores: int, wanted: float | str) -> dict[str, float]:
    """One comparison: its tasks, the time of the driver, and how busy the cores were."""
    tasks_a_core = min(20, TASKS // cores)
    draws = tasks_a_core * cores * _DRAWS_A_TASK
    few, built = (
        build(load_job(JOB, [*_SMALL, f"comparison.draws={count}"]))
        for count in (_FIRST, draws + _FIRST)
    )
    steps = comparison_steps(built)
    length = 1.0 if wanted == AS_CHOSEN else float(wanted)
    nodes = Nodes(cores, length * cores * tasks_a_core / (steps * draws / (draws + _FIRST)))
    process = psutil.Process()
    with contextlib.ExitStack() as stack:
        if wanted != AS_CHOSEN:
            fixed = lambda pace, remaining: max(1, round(length / pace.seconds))  # noqa: E731
            stack.enter_context(patch.object(Pace, "size", fixed))
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="driver-"))
        path = Path(folder, "run")
        with opened(path, few) as store:  # the search
            complete(drive(RunSession(few, store)), contextlib.nullcontext(SerialPool()))
        store = stack.enter_context(opened(path, built))
        guess = Pace(nodes.seconds_a_step, cores, learnt=True)
        stack.enter_context(patch.object(RunSession, "pace", lambda *_, **__: guess))
        pool = stack.enter_context(simulated(nodes))
        memory = process.memory_info().rss
        begin, waited = nodes.clock.now(), nodes.clock.waited
        complete(drive(RunSession(built, store)), contextlib.nullcontext(pool))
        end = nodes.clock.now()
        worked = end - begin - (nodes.clock.waited - waited)
        grown = process.memory_info().rss - memory
    return {
        "task_seconds": nodes.busy / nodes.tasks,
        "tasks": nodes.tasks,
        "microseconds": worked / nodes.tasks * 1e6,
        "busy": nodes.busy / (cores * (nodes.last - begin)),
        "mebibytes": grown / 2**20,
    }


def _searches(quick: bool, say: Say) -> list[dict[str, Any]]:
    """Searches of the paper's problem on simulated nodes."""
    rows: list[dict[str, Any]] = []
    for search, (_, draws, _) in SEARCHES.items():
        for measurements in (21,) if quick else MEASUREMENTS:
            for times in (1,) if quick else (1, 10):
                for cores in SEARCH_CORES[: 1 if quick else None]:
                    case = (search, measurements, times * draws, cores)
                    names = ("search", "measurements", "draws", "cores")
                    row = dict(zip(names, case, strict=True)) | run_search(*case)
                    rows.append(row)
                    say(", ".join(f"{name} {value}" for name, value in row.items()))
    return rows


def run_search(search: str, measurements: int, draws: int, cores: int) -> dict[str, float]:
    """A search: the work, the time that it takes, and how busy the cores are meanwhile."""
    settings, _, slower = SEARCHES[search]
    particles = [f"filter.particles={_FEW_PARTICLES}"] if slower > 1 else []
    changes = [
        f"problem.measurement_budget={measurements}",
        f"search=[{{{settings}, evaluation.draws={draws}}}]",
        "comparison.draws=2",
        *particles,
    ]
    built = build(load_job(JOB, changes))
    nodes = Nodes(cores, slower * KERNEL_SECONDS)
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="driver-"))
        guess = Pace(nodes.seconds_a_step, cores, learnt=True)
        stack.enter_context(patch.object(RunSession, "pace", lambda *_, **__: guess))
        pool = stack.enter_context(simulated(nodes))
        store = stack.enter_context(opened(Path(folder, "run"), built))
        begin = nodes.clock.now()
        complete(drive(RunSession(built, store)), contextlib.nullcontext(pool))
        seconds = nodes.last - begin
    busy = nodes.busy / (cores * seconds)
    return {"core_seconds": nodes.busy, "seconds": seconds, "busy": busy}


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    lines = [
        [
            f"{row['cores']:,}",
            f"{row['task_seconds']:.2f}",
            f"{row['tasks']:,}",
            f"{row['microseconds']:.0f}",
            f"{100 * row['busy']:.1f}",
            f"{row['mebibytes']:.0f}",
        ]
        for _, row in tables["driver"].iterrows()
    ]
    head = ["cores", "seconds a task", "tasks", "driver, microseconds a task", "cores busy, %"]
    driver = markdown([*head, "grown by, MiB"], lines)
    return "\n\n".join([(__doc__ or "").strip(), driver, _searches_in_markdown(tables)])


def _searches_in_markdown(tables: Tables) -> str:
    lines = []
    cases = tables["searches"].groupby(["search", "measurements", "draws"], sort=False)
    for (search, measurements, draws), rows in cases:
        work = f"{rows['core_seconds'].iloc[0]:.1f}"
        seconds = [f"{value:.1f}" for value in rows["seconds"]]
        lines.append([str(search), str(measurements), f"{draws:,}", work, *seconds])
    cores = [f"s, {count:,} cores" for count in tables["searches"]["cores"].unique()]
    return markdown(["search", "N", "draws", "work of one core, s", *cores], lines)


def plot(tables: Tables) -> Figure:
    """Draw the share of busy cores against their number."""
    figure = Figure(figsize=(COLUMN_INCHES, 0.8 * COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    for (wanted, rows), color in zip(
        tables["driver"].groupby("wanted", sort=False), (GREEN, BLUE, RED, "black"), strict=False
    ):
        label = "as chosen" if wanted == AS_CHOSEN else f"{wanted} s"
        axes.plot(rows["cores"], 100 * rows["busy"], color=color, marker="o", label=label)
    axes.set_xscale("log")
    axes.set_ylim(0, 102)
    axes.set_xlabel("cores")
    axes.set_ylabel("cores busy, %")
    axes.legend(title="seconds a task")
    return figure
