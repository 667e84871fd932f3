"""The contract of every pool, and what Ray's alone has.

All quick tests on a cluster of Ray stand here: one process runs a file, so one cluster starts.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist.errors import PoolError, SilenceError
from pfdist.pools import base, ray_pool, workers
from pfdist.pools.base import Function, Pool, Task
from pfdist.pools.kinds import POOLS
from pfdist.pools.ray_cluster import connected, load_ray
from pfdist.pools.ray_pool import RayPool

ROOT = Path(__file__).parents[2]


class Made:
    """The ``function`` of a source, which each worker runs, because it need not know this file."""

    def __init__(self, source: str) -> None:
        self._source = source

    @cached_property
    def _function(self) -> Function:
        return eval(_FUNCTION.format(repr(self._source)))

    def __call__(self, work: Any) -> Any:
        return self._function(work)

    def __reduce__(self) -> tuple[Any, ...]:
        return eval, (_FUNCTION.format(repr(self._source)),)


_FUNCTION = "(lambda scope: (exec({}, scope), scope['function'])[1])({{}})"
SQUARE = Made("def function(work): return work ** 2")
INVERSE = Made("def function(work): return 1 / work")


# Every pool that a job can name, with one worker, and with two where it can have two.
CASES = [
    pytest.param((name, workers), id=f"{name}-{workers}")
    for name, kind in POOLS.items()
    for workers in ((1, 2) if "workers" in kind.takes else (1,))
]


@pytest.fixture(params=CASES)
def make_pool(request: pytest.FixtureRequest) -> Callable[[], Pool]:
    name, workers = request.param
    if name == "ray":
        request.getfixturevalue("ray_cluster")
    return lambda: POOLS[name].make(workers=workers)


@pytest.fixture(scope="module", params=CASES)
def pool(request: pytest.FixtureRequest) -> Iterator[Pool]:
    """A pool that several tests use, one after another."""
    name, workers = request.param
    if name == "ray":
        request.getfixturevalue("ray_cluster")
    with POOLS[name].make(workers=workers) as made:
        yield made


Make = Callable[[int], Pool]
isolated = pytest.mark.parametrize(
    "isolated", [name for name, kind in POOLS.items() if kind.isolated]
)


@pytest.fixture
def make_isolated(isolated: str, request: pytest.FixtureRequest) -> Make:
    """Makes a pool whose workers are other processes, with so many of them."""
    if isolated == "ray":
        request.getfixturevalue("ray_cluster")
    return lambda workers: POOLS[isolated].make(workers=workers)


@pytest.mark.parametrize("name", POOLS)
def test_it_says_where_tasks_are_computed(name: str) -> None:
    kind = POOLS[name]
    assert kind.title[:1].isupper()  # it begins a sentence
    assert kind.description[-1:].isalpha()  # and this is a part of one


def _tasks(count: int, function: Function = SQUARE) -> Iterator[Task]:
    return (Task(f"task {number}", function, number) for number in range(count))


def test_every_task_has_one_outcome_with_its_value(pool: Pool) -> None:
    outcomes = list(pool.run(_tasks(25)))
    assert sorted(outcome.task.work for outcome in outcomes) == list(range(25))
    assert all(outcome.value == outcome.task.work**2 for outcome in outcomes)
    assert all(outcome.error is None and outcome.seconds >= 0 for outcome in outcomes)
    assert all(outcome.worker and outcome.node for outcome in outcomes)
    assert len({outcome.worker for outcome in outcomes}) <= pool.workers


def test_each_task_has_its_own_function(pool: Pool) -> None:
    """As many as a worker keeps, and more."""
    functions = [Made(f"def function(work): return {number}") for number in range(40)]
    tasks = [Task(str(number), each, None) for number, each in enumerate([*functions] * 2)]
    outcomes = list(pool.run(tasks))
    assert sorted(outcome.value for outcome in outcomes) == sorted([*range(40)] * 2)
    assert all(outcome.value == int(outcome.task.key) % 40 for outcome in outcomes)


@isolated
def test_a_function_that_a_worker_cannot_make_is_refused_in_a_line(make_isolated: Make) -> None:
    refused = Made("from pfdist.errors import ModelError; raise ModelError('no')")
    tasks = [Task("refused", refused, 1), Task("good", SQUARE, 3)]
    with make_isolated(1) as pool:
        outcomes = {outcome.task.key: outcome for outcome in pool.run(tasks)}
    assert (outcomes["good"].value, outcomes["good"].refused) == (9, False)
    assert outcomes["refused"].refused
    assert outcomes["refused"].error.startswith("no (found by a worker on ")
    assert "\n" not in outcomes["refused"].error


def test_an_exception_is_an_outcome_with_its_traceback(pool: Pool) -> None:
    outcomes = {outcome.task.work: outcome for outcome in pool.run(_tasks(4, INVERSE))}
    assert "ZeroDivisionError" in outcomes[0].error
    assert "Traceback" in outcomes[0].error
    assert outcomes[0].value is None
    assert [outcomes[k].value for k in (1, 2, 3)] == [1, 1 / 2, 1 / 3]


def test_tasks_are_taken_only_as_they_are_needed(pool: Pool) -> None:
    taken = []

    def counted() -> Iterator[Task]:
        for task in _tasks(100):
            taken.append(task)
            yield task

    outcomes = pool.run(counted())
    next(outcomes)
    assert len(taken) <= 2 * pool.workers + 1
    outcomes.close()


def test_a_pool_runs_nothing_and_again(pool: Pool) -> None:
    assert list(pool.run([])) == []
    assert len(list(pool.run(_tasks(3)))) == 3


@isolated
def test_blas_has_one_thread_in_workers(make_isolated: Make) -> None:
    source = """
import numpy, threadpoolctl
def function(work): return [each["num_threads"] for each in threadpoolctl.threadpool_info()]
"""
    with make_isolated(1) as pool:
        (outcome,) = pool.run([Task("threads", Made(source), None)])
    assert outcome.value
    assert set(outcome.value) == {1}


@isolated
def test_workers_are_processes(make_isolated: Make) -> None:
    who = Made("import os, time\ndef function(work): time.sleep(0.2); return os.getpid()")
    with make_isolated(2) as pool:
        outcomes = list(pool.run(_tasks(20, who)))
    assert len({outcome.value for outcome in outcomes}) == 2
    assert all(outcome.worker == str(outcome.value) for outcome in outcomes)


def test_a_run_that_is_broken_off_leaves_the_pool_to_the_next(pool: Pool) -> None:
    broken_off = pool.run(_tasks(50))
    next(broken_off)
    broken_off.close()
    again = list(pool.run(Task(f"again {number}", SQUARE, number) for number in range(5)))
    assert sorted(outcome.value for outcome in again) == [0, 1, 4, 9, 16]
    assert all(outcome.task.key.startswith("again") for outcome in again)


def test_a_signal_ends_a_run_before_the_next_outcome(
    make_pool: Callable[[], Pool], stop: Callable[..., None]
) -> None:
    with make_pool() as pool:
        outcomes = pool.run(_tasks(1000))
        next(outcomes)
        stop(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            next(outcomes)


@pytest.mark.parametrize("name", [name for name, kind in POOLS.items() if kind.takes])
def test_a_signal_ends_a_run_while_it_waits_for_a_task(
    name: str, stop: Callable[..., None], request: pytest.FixtureRequest
) -> None:
    if name == "ray":
        request.getfixturevalue("ray_cluster")
    slow = Made("import time\ndef function(work): time.sleep(3.0)")
    with POOLS[name].make(workers=1) as pool:
        threading.Timer(0.5, stop, [signal.SIGTERM]).start()
        with pytest.raises(KeyboardInterrupt):
            assert next(pool.run(_tasks(1, slow))) is None  # not reached


# --- what befalls workers -------------------------------------------------------------------------


def _faulty(fault: str, *, times: int) -> str:
    """Source of a function of (number, folder): number 3 meets a fault, so many times."""
    return f"""
import os, pathlib, signal, time

def function(work):
    number, folder = work
    if number == 3 and len(os.listdir(folder)) < {times}:
        (pathlib.Path(folder) / str(os.getpid())).touch()
        {fault}
    return number
"""


def _tasks_in(folder: Path, count: int, source: str) -> list[Task]:
    function = Made(source)
    return [Task(f"task {number}", function, (number, str(folder))) for number in range(count)]


def _gone(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"


KILL = "os.kill(os.getpid(), signal.SIGKILL)"
STOP = "os.kill(os.getpid(), signal.SIGSTOP)"
LOOP = "while True: pass"
SLEEP = "time.sleep(1000)"
ALWAYS = 1000


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here takes longer than a moment."""
    monkeypatch.setattr(base, "PATIENCE_SECONDS", 3.0)  # the machine may be busy


@isolated
@pytest.mark.fault
@pytest.mark.parametrize("fault", [KILL, LOOP, pytest.param(SLEEP, marks=pytest.mark.crash)])
def test_a_worker_that_is_lost_is_replaced_and_its_tasks_are_done(
    fault: str, make_isolated: Make, impatient: None, tmp_path: Path
) -> None:
    """A task that was alone when its process ended fails once; the loop then does it again."""
    with make_isolated(2) as pool:
        outcomes = list(pool.run(_tasks_in(tmp_path, 12, _faulty(fault, times=1))))
        values = {outcome.task.work[0]: outcome.value for outcome in outcomes}
        assert values.pop(3) in (3, None)
        assert values == {number: number for number in range(12) if number != 3}
        (lost,) = (int(file.name) for file in tmp_path.iterdir())
        _until(lambda: _gone(lost))  # it cannot answer twice


BUSY = """
import os, time
os.nice(5)  # so that it gets little of the processor

def function(seconds):
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass
    return os.getpid()
"""


@pytest.mark.slow
@isolated
def test_a_task_that_computes_is_never_ended_because_the_machine_is_busy(
    make_isolated: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The task computes for .2 s, and may for .5 s; it waits far longer for a processor."""
    monkeypatch.setattr(base, "PATIENCE_SECONDS", 0.5)
    spin = [sys.executable, "-c", "while True: pass"]
    with contextlib.ExitStack() as stack, make_isolated(1) as pool:
        (first,) = pool.run([Task("first", Made(BUSY), 0.01)])
        for _ in range(2 * (os.cpu_count() or 1)):
            process = stack.enter_context(subprocess.Popen(spin))
            stack.callback(process.kill)
        (outcome,) = pool.run([Task("second", Made(BUSY), 0.2)])
    assert outcome.value == first.value
    assert outcome.seconds > 0.5  # it was busy: otherwise nothing was tested


@pytest.mark.parametrize("isolated", ["processes", pytest.param("ray", marks=pytest.mark.slow)])
def test_limits_are_those_of_a_task_and_not_of_a_worker(
    make_isolated: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker lives through 600 tasks, which compute for longer than one task may."""
    monkeypatch.setattr(base, "PATIENCE_SECONDS", 1.0)
    with make_isolated(1) as pool:
        outcomes = list(pool.run(_tasks(600, Made(BUSY.replace("(seconds)", "(_, seconds=.002)")))))
    assert len({outcome.value for outcome in outcomes}) == 1


@isolated
@pytest.mark.fault
@pytest.mark.parametrize("fault", [KILL, pytest.param(LOOP, marks=pytest.mark.crash)])
def test_a_task_that_costs_every_worker_is_given_up_with_an_error(
    fault: str, make_isolated: Make, impatient: None, tmp_path: Path
) -> None:
    tasks = _tasks_in(tmp_path, 8, _faulty(fault, times=ALWAYS))
    with make_isolated(2) as pool:
        outcomes = {outcome.task.work[0]: outcome for outcome in pool.run(tasks)}
    error = outcomes.pop(3).error
    assert error.startswith(
        "its worker ended: it crashed, ran out of memory, or computed or slept for longer than 3"
    )
    assert {number: outcome.value for number, outcome in outcomes.items()} == {
        number: number for number in (0, 1, 2, 4, 5, 6, 7)
    }
    lost = len(list(tmp_path.iterdir()))
    assert lost in (1, 2, 4)  # alone, or beside others first; Ray tries it four times


@isolated
@pytest.mark.fault
def test_when_no_worker_answers_the_pool_says_so_and_nothing_hangs(
    make_isolated: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base, "PATIENCE_SECONDS", 4.0)
    monkeypatch.setattr(workers, "SILENCE_SECONDS", 8.0)
    stop_all = _faulty(STOP, times=2).replace("number == 3", "number > 9")
    with (
        make_isolated(2) as pool,
        pytest.raises(SilenceError, match=r"no answer from .* for \d+ s"),
    ):
        list(pool.run(_tasks_in(tmp_path, 20, stop_all)))
    stopped = [int(file.name) for file in tmp_path.iterdir()]
    for worker in stopped:
        _wake(worker)


@isolated
@pytest.mark.crash
def test_workers_that_stood_still_with_everything_else_are_waited_for(
    make_isolated: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A batch system suspends a job: all its processes, for a while.

    A worker that held a task may end itself when it wakes up; then its task is done again.
    """
    monkeypatch.setattr(base, "STILL_SECONDS", 1.0)
    monkeypatch.setattr(workers, "SILENCE_SECONDS", 30.0)
    who = Made("import os, time\ndef function(work): time.sleep(0.05); return os.getpid()")
    with make_isolated(2) as pool:
        run = pool.run(_tasks(60, who))
        stopped = {next(run).value for _ in range(10)}
        for worker in stopped:
            os.kill(worker, signal.SIGSTOP)
        time.sleep(35.0)
        for worker in stopped:  # they wake up a moment after this process
            threading.Timer(0.3, _wake, [worker]).start()
        rest = [outcome.value for outcome in run]
    assert len(rest) == 50


def _wake(process: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, signal.SIGCONT)


def _until(reached: Callable[[], bool], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < deadline, f"not reached in {seconds:.0f} s"
        time.sleep(0.05)


# --- runs, and the pool of Ray --------------------------------------------------------------------


@pytest.mark.fault  # `.ci/run` runs it beside the faults
@pytest.mark.parametrize(
    "file", ["tests/small.toml", pytest.param("jobs/quick.toml", marks=pytest.mark.slow)]
)
def test_two_workers_of_ray_give_the_bytes_of_the_serial_pool(
    file: str, finished: Callable[..., Path], tmp_path: Path, ray_cluster: None
) -> None:
    job = pfdist.load_job(ROOT / file)
    serial = hashes(finished('execution.pool="serial"', job=job.path.read_text()))
    pfdist.run(job, tmp_path / "run", pool="ray", workers=2, figures=False)
    assert hashes(tmp_path / "run") == serial
    assert len(serial) > 6


@pytest.mark.parametrize("address", ["", "local"])
def test_without_an_existing_cluster_one_is_started(
    address: str, ray_cluster: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, Any] = {}
    ray = load_ray()
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", lambda **options: seen.update(options))
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    with connected(address, 3):
        pass
    assert (seen["address"], seen["num_cpus"], seen["include_dashboard"]) == ("local", 3, False)
    assert not seen["log_to_driver"]


def few(count: int) -> Iterator[Task]:
    return (Task(str(number), abs, -number) for number in range(count))


@pytest.fixture
def cores(ray_cluster: None, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Lets the cluster seem to have these numbers of cores, one after another."""

    def let(*numbers: int) -> None:
        rest = list(numbers)

        def look(cluster: Any) -> int:
            cluster.number = rest.pop(0) if len(rest) > 1 else rest[0]
            return cluster.number

        monkeypatch.setattr(ray_pool._Cores, "look", look)

    return let


def test_workers_are_the_cores_of_the_cluster_and_of_nodes_that_join(
    cores: Callable[..., None],
) -> None:
    cores(2, 2, 5)
    with RayPool() as pool:
        assert pool.workers == 2
        assert len(list(pool.run(few(20)))) == 20
        assert pool.workers == 5


@pytest.mark.parametrize(
    ("demanded", "number", "most"),
    [(0, 0, 16), (0, 4, 16), (0, 500, 1000), (3, 500, 3), (3, 3, 6), (3, 1, 6)],
)
def test_so_many_tasks_are_in_flight(
    demanded: int, number: int, most: int, cores: Callable[..., None]
) -> None:
    """At least 16, also on a cluster without cores, which then gets some."""
    cores(number)
    with RayPool(demanded) as pool:
        assert pool._most_in_flight == most


@pytest.mark.parametrize("demanded", [0, 2])
def test_an_own_cluster_whose_node_is_lost_says_so(
    demanded: int, cores: Callable[..., None]
) -> None:
    cores(2, 2, 0)
    with RayPool(demanded) as pool, pytest.raises(SilenceError, match="its node does not answer"):
        list(pool.run(few(20)))


def test_a_pool_begins_when_the_cluster_has_told_its_cores(cores: Callable[..., None]) -> None:
    cores(-1, -1, 2)
    with RayPool() as pool:
        assert pool.workers == 2


def test_a_node_of_another_version_ends_the_run_in_a_line(
    ray_cluster: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray_pool._remote.cache_clear()
    monkeypatch.setattr(ray_pool.metadata, "version", lambda name: "9.9")
    said = r"^every node must have pfdist 9\.9, got .+ on .+: install the same version there$"
    with RayPool(1) as pool, pytest.raises(PoolError, match=said):
        list(pool.run(few(3)))
    ray_pool._remote.cache_clear()


@pytest.mark.parametrize("fault", ["hangs", "raises"])
def test_a_cluster_that_does_not_answer_ends_the_run_before_ray_ends_the_process(
    fault: str, ray_cluster: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cluster_resources() -> None:
        if fault == "hangs":
            time.sleep(20.0)
        raise RuntimeError("the head is lost")

    with RayPool(1) as pool:
        cores = ray_pool._Cores()
        monkeypatch.setattr(pool, "_cores", cores)
        ray = SimpleNamespace(cluster_resources=cluster_resources)
        monkeypatch.setattr(ray_pool, "load_ray", lambda: ray)
        monkeypatch.setattr(ray_pool, "LOST_SECONDS", 0.2)
        said = (
            "no answer from the Ray cluster for" if fault == "hangs" else "lost: the head is lost"
        )
        with pytest.raises(SilenceError, match=said):
            _look_often(cores)


def _look_often(cores: Any) -> None:
    while True:
        cores.look()
        time.sleep(0.02)
