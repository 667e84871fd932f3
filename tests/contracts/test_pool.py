"""The contract of every pool."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from pfdist.errors import EngineWarning, SilenceError
from pfdist.pools.base import Function, Pool, Task
from pfdist.pools.kinds import POOLS


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


@pytest.mark.parametrize("name", POOLS)
def test_it_says_where_tasks_are_computed(name: str) -> None:
    kind = POOLS[name]
    assert kind.title[:1].isupper()  # it begins a sentence
    assert kind.description[-1:].isalpha()  # and this is a part of one


def _tasks(count: int, function: Function = SQUARE) -> Iterator[Task]:
    return (Task(f"task {number}", function, number) for number in range(count))


def test_every_task_has_one_outcome_with_its_value(make_pool: Callable[[], Pool]) -> None:
    with make_pool() as pool:
        outcomes = list(pool.run(_tasks(25)))
    assert sorted(outcome.task.work for outcome in outcomes) == list(range(25))
    assert all(outcome.value == outcome.task.work**2 for outcome in outcomes)
    assert all(outcome.error is None and outcome.seconds >= 0 for outcome in outcomes)
    assert all(outcome.worker and outcome.node for outcome in outcomes)
    assert len({outcome.worker for outcome in outcomes}) <= pool.workers


def test_each_task_has_its_own_function(make_pool: Callable[[], Pool]) -> None:
    """As many as a worker keeps, and more."""
    functions = [Made(f"def function(work): return {number}") for number in range(40)]
    tasks = [Task(str(number), each, None) for number, each in enumerate([*functions] * 2)]
    with make_pool() as pool:
        outcomes = list(pool.run(tasks))
    assert sorted(outcome.value for outcome in outcomes) == sorted([*range(40)] * 2)
    assert all(outcome.value == int(outcome.task.key) % 40 for outcome in outcomes)


def test_a_function_that_a_worker_cannot_make_is_refused_in_a_line(ray_cluster: None) -> None:
    refused = Made("from pfdist.errors import ModelError; raise ModelError('no')")
    tasks = [Task("refused", refused, 1), Task("good", SQUARE, 3)]
    with POOLS["ray"].make(workers=1) as pool:
        outcomes = {outcome.task.key: outcome for outcome in pool.run(tasks)}
    assert (outcomes["good"].value, outcomes["good"].refused) == (9, False)
    assert outcomes["refused"].refused
    assert outcomes["refused"].error.startswith("no (found by a worker on ")
    assert "\n" not in outcomes["refused"].error


def test_an_exception_is_an_outcome_with_its_traceback(make_pool: Callable[[], Pool]) -> None:
    with make_pool() as pool:
        outcomes = {outcome.task.work: outcome for outcome in pool.run(_tasks(4, INVERSE))}
    assert "ZeroDivisionError" in outcomes[0].error
    assert "Traceback" in outcomes[0].error
    assert outcomes[0].value is None
    assert [outcomes[k].value for k in (1, 2, 3)] == [1, 1 / 2, 1 / 3]


def test_tasks_are_taken_only_as_they_are_needed(make_pool: Callable[[], Pool]) -> None:
    taken = []

    def counted() -> Iterator[Task]:
        for task in _tasks(100):
            taken.append(task)
            yield task

    with make_pool() as pool:
        outcomes = pool.run(counted())
        next(outcomes)
        assert len(taken) <= 2 * pool.workers + 1


def test_a_pool_runs_again_and_also_nothing(make_pool: Callable[[], Pool]) -> None:
    with make_pool() as pool:
        assert list(pool.run([])) == []
        for count in (1, 3):
            assert len(list(pool.run(_tasks(count)))) == count


def test_blas_has_one_thread_in_ray_workers(ray_cluster: None) -> None:
    from pfdist.pools.ray_pool import RayPool

    source = """
import numpy, threadpoolctl
def function(work): return [each["num_threads"] for each in threadpoolctl.threadpool_info()]
"""
    with RayPool(1) as pool:
        (outcome,) = pool.run([Task("threads", Made(source), None)])
    assert outcome.value
    assert set(outcome.value) == {1}


@pytest.mark.parametrize("threaded", [True, False])
def test_ray_workers_are_processes_with_threads_or_one_for_each_core(
    threaded: bool, ray_cluster: None
) -> None:
    from pfdist.pools.ray_pool import RayPool

    who = Made("import os, time\ndef function(work): time.sleep(0.05); return os.getpid()")
    with RayPool(2, threaded=threaded) as pool:
        outcomes = list(pool.run(_tasks(20, who)))
    assert len({outcome.value for outcome in outcomes}) == (1 if threaded else 2)
    assert len({outcome.worker for outcome in outcomes}) == 2


def test_a_run_that_is_broken_off_leaves_the_pool_to_the_next(
    make_pool: Callable[[], Pool],
) -> None:
    with make_pool() as pool:
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


@pytest.mark.slow
def test_cores_that_are_taken_are_said_and_their_workers_join_when_they_are_free(
    ray_cluster: None,
) -> None:
    from pfdist.pools.ray_pool import RayPool

    slow = Made("import time\ndef function(work): time.sleep(0.05)")
    with contextlib.ExitStack() as other:
        other.enter_context(RayPool(1))
        with contextlib.ExitStack() as stack:
            said = r"^1 of the 2 cores of the Ray cluster are taken: 1 of 2 workers start now"
            with pytest.warns(EngineWarning, match=said):
                pool = stack.enter_context(RayPool(2))
            run = pool.run(_tasks(300, slow))
            first = {next(run).worker for _ in range(10)}
            other.close()
            rest = [outcome.worker for outcome in run]
    assert len(first) == 1
    assert len(rest) == 290
    assert len(set(rest)) == 2


# --- what befalls workers -------------------------------------------------------------------------

# A core is free some seconds after its worker was stopped and killed, and the next test is quicker.
ending = pytest.mark.filterwarnings("ignore:.*cores of the Ray cluster are taken")


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
ALWAYS = 1000

DIES = "one worker or a node dies: the run goes on"
HANGS = "nothing hangs"
Record = Callable[[str, object], None]


@pytest.fixture
def impatient(ray_cluster: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here takes longer than a moment."""
    from pfdist.pools import base

    monkeypatch.setattr(base, "PATIENCE_SECONDS", 3.0)  # the machine may be busy
    monkeypatch.setattr(base, "LOOK_SECONDS", 0.1)


@ending
@pytest.mark.fault
@pytest.mark.parametrize(
    "fault", [KILL, *(pytest.param(each, marks=pytest.mark.crash) for each in (STOP, LOOP))]
)
def test_a_ray_worker_that_is_lost_is_replaced_and_its_tasks_are_done(
    fault: str, impatient: None, tmp_path: Path, record_property: Record
) -> None:
    from pfdist.pools.ray_pool import RayPool

    with RayPool(2) as pool:
        outcomes = list(pool.run(_tasks_in(tmp_path, 12, _faulty(fault, times=1))))
        assert sorted(outcome.value for outcome in outcomes) == list(range(12))
        (lost,) = (int(file.name) for file in tmp_path.iterdir())
        _until(lambda: _gone(lost))  # it cannot wake up and answer twice
    record_property("faults", f"{DIES if fault == KILL else HANGS}: 1")


@ending
@pytest.mark.fault
def test_tasks_of_a_lost_worker_are_done_next_while_the_others_go_on(
    impatient: None, tmp_path: Path, record_property: Record
) -> None:
    from pfdist.pools.ray_pool import RayPool

    fault = _faulty(KILL, times=1).replace("return", "time.sleep(0.02); return")
    with RayPool(2) as pool:
        outcomes = [outcome.value for outcome in pool.run(_tasks_in(tmp_path, 300, fault))]
    assert sorted(outcomes) == list(range(300))
    assert outcomes.index(3) < 30
    record_property("faults", f"{DIES}: 1")


@ending
@pytest.mark.crash
@pytest.mark.parametrize("fault", [KILL, STOP])
def test_a_task_that_costs_every_worker_is_given_up_with_an_error(
    fault: str, impatient: None, tmp_path: Path, record_property: Record
) -> None:
    from pfdist.pools import ray_pool

    tasks = _tasks_in(tmp_path, 8, _faulty(fault, times=ALWAYS))
    with ray_pool.RayPool(2) as pool:
        outcomes = {outcome.task.work[0]: outcome for outcome in pool.run(tasks)}
    words = "died" if fault == KILL else "no answer in"
    assert words in outcomes.pop(3).error
    assert {number: outcome.value for number, outcome in outcomes.items()} == {
        number: number for number in (0, 1, 2, 4, 5, 6, 7)
    }
    most = ray_pool.DEATHS if fault == KILL else ray_pool.SILENCES
    lost = len(list(tmp_path.iterdir()))
    assert lost in (most, most + 1)  # the first may have had another task too
    record_property("faults", f"{DIES if fault == KILL else HANGS}: {lost}")


@ending
@pytest.mark.fault
def test_when_no_worker_answers_the_pool_says_so_and_nothing_hangs(
    impatient: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record_property: Record
) -> None:
    from pfdist.pools import ray_pool

    monkeypatch.setattr(ray_pool, "ANSWER_SECONDS", 4.0)
    stop_all = _faulty(STOP, times=ALWAYS).replace("number == 3", "number > 9")
    # Those that are to replace the stopped ones stop too, as they make their function.
    folder = str(tmp_path)
    stop_all += f"if os.listdir({folder!r}): function((10, {folder!r}))"
    said = r"no worker has answered for \d+ s .*no answer in"
    with ray_pool.RayPool(2) as pool, pytest.raises(SilenceError, match=said):
        list(pool.run(_tasks_in(tmp_path, 20, stop_all)))
    stopped = [int(file.name) for file in tmp_path.iterdir()]
    _until(lambda: all(map(_gone, stopped)))
    record_property("faults", f"{HANGS}: {len(stopped)}")


@ending
@pytest.mark.crash
def test_workers_that_were_all_killed_are_replaced_however_long_it_takes_to_load(
    impatient: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record_property: Record
) -> None:
    """A model may take longer to compile than silent workers are waited for."""
    from pfdist.pools import ray_pool

    monkeypatch.setattr(ray_pool, "ANSWER_SECONDS", 4.0)
    slow = tmp_path / "slow"
    source = f"""
import os, pathlib, time

def function(work):
    time.sleep(0.05)
    return os.getpid()

if pathlib.Path({str(slow)!r}).exists():
    time.sleep(15)
"""
    with ray_pool.RayPool(2) as pool:
        run = pool.run(_tasks(60, Made(source)))
        first = [next(run).value for _ in range(10)]
        slow.touch()
        for worker in set(first):
            os.kill(worker, signal.SIGKILL)
        rest = [outcome.value for outcome in run]
    assert len(rest) == 50
    assert len(set(first)) == 1  # one process with two threads
    assert not set(rest) & set(first)
    record_property("faults", f"{DIES}: 2")


@ending
@pytest.mark.crash
def test_nobody_listens_to_an_answer_that_comes_too_late(
    impatient: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, record_property: Record
) -> None:
    from pfdist.pools.ray_pool import RayPool, _Worker

    end, kept = _Worker.end, []

    def keep(worker: _Worker) -> threading.Thread:
        kept.append(worker)
        return threading.Timer(0.0, int)

    late = tmp_path / "late"
    fault = _faulty(f"time.sleep(6); pathlib.Path({str(late)!r}).touch()", times=1)
    monkeypatch.setattr(_Worker, "end", keep)
    outcomes, seen_late = [], 0
    (tmp_path / "folder").mkdir()
    fault = fault.replace("return", "time.sleep(0.5); return")
    with RayPool(1) as pool:
        for outcome in pool.run(_tasks_in(tmp_path / "folder", 20, fault)):
            outcomes.append(outcome.value)
            seen_late += late.exists()
        (lost, *_) = kept
        monkeypatch.setattr(_Worker, "end", end)
        end(lost).join()
    assert sorted(outcomes) == list(range(20))
    assert seen_late > 3  # it had answered long before the end
    record_property("faults", f"{HANGS}: 1")


@ending
@pytest.mark.crash
def test_workers_that_stood_still_with_everything_else_are_kept(
    impatient: None, monkeypatch: pytest.MonkeyPatch, record_property: Record
) -> None:
    """A batch system suspends a job: all its processes, for a while."""
    from pfdist.pools import base, ray_pool

    monkeypatch.setattr(base, "STILL_SECONDS", 1.0)
    who = Made("import os, time\ndef function(work): time.sleep(0.05); return os.getpid()")
    with ray_pool.RayPool(2) as pool:
        run = pool.run(_tasks(60, who))
        workers = {next(run).value for _ in range(10)}
        for worker in workers:
            os.kill(worker, signal.SIGSTOP)
        time.sleep(3 * base.PATIENCE_SECONDS)
        for worker in workers:  # they wake up a moment after this process
            threading.Timer(0.3, os.kill, [worker, signal.SIGCONT]).start()
        rest = [outcome.value for outcome in run]
    assert len(rest) == 50
    assert set(rest) <= workers
    record_property("faults", f"{HANGS}: {len(workers)}")


def _until(reached: Callable[[], bool], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < deadline, f"not reached in {seconds:.0f} s"
        time.sleep(0.05)
