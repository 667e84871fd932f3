"""The pool of processes: which processes end, and what they run."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import pfdist
from crash.runs import until
from oracles.bytes_of import hashes
from oracles.in_turn import in_turn
from pfdist.pools.base import Task
from pfdist.pools.processes import ProcessPool

SCRIPT = """
import sys
import pfdist

print("the script runs")
model = pfdist.load_model("random_walk")
problem = pfdist.Problem(model, horizon=12, measurement_budget=4, engine="numpy", particles=20)
few = [{"method": "random", "evaluations": 3, "evaluation": {"draws": 20}}]
job = problem.job(comparison={"draws": 40}, search=few)
run = pfdist.run(job, sys.argv[1], pool="processes", figures=False)
print(len(run.table("comparison")))
"""
HANGING = """
import os, sys, time
from pfdist.pools.base import Task
from pfdist.pools.processes import ProcessPool

with ProcessPool(1) as pool:
    for outcome in pool.run(Task(str(n), lambda n: n and time.sleep(1000) or os.getpid(), n)
                            for n in range(2)):
        print(outcome.value, flush=True)
        {end}
"""


def _process(_: object) -> int:
    return os.getpid()


BLOCKED = """
import os, signal
from pfdist.pools.base import Task
from pfdist.pools.processes import ProcessPool

signals = {signal.SIGINT, signal.SIGTERM, signal.SIGUSR1}
signal.pthread_sigmask(signal.SIG_BLOCK, signals)  # as the program does before its first thread
with ProcessPool(1) as pool:
    (outcome,) = pool.run([Task("a", lambda _: os.getpid(), 0)])
print(signals <= signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


def _started(source: str, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", source, *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _lives(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.fault
def test_a_script_that_guards_nothing_runs_once(tmp_path: Path) -> None:
    """Functions travel by value, so no process needs the script."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, script, tmp_path / "run"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.split("\n") == ["the script runs", "40", ""], done.stderr


@pytest.mark.fault
def test_a_pool_that_is_left_ends_its_processes_though_a_task_hangs_and_no_others() -> None:
    other = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    other.start()
    start = time.monotonic()
    with ProcessPool(1) as pool:
        run = pool.run([Task("a", _process, 0), Task("b", time.sleep, 1000)])
        worker = next(run).value
    assert time.monotonic() - start < 30
    until(lambda: not _lives(worker), 30)
    assert other.is_alive()
    other.kill()


@pytest.mark.fault
def test_processes_end_with_a_program_that_is_killed_or_ends_while_a_task_hangs() -> None:
    for end, code in (("pass", -signal.SIGKILL), ("sys.exit(3)", 3)):
        with _started(HANGING.format(end=end)) as program:
            worker = int(program.stdout.readline())
            if end == "pass":
                assert _lives(worker)
                time.sleep(0.5)
                program.kill()
            assert program.wait(30) == code
            until(lambda worker=worker: not _lives(worker), 30)


def test_signals_stay_blocked_in_a_process_that_starts_others() -> None:
    """Else a signal ends the driver at once, and the rows that wait for a commit are lost."""
    with _started(BLOCKED) as process:
        assert process.communicate(timeout=60)[0] == "True\n"


@in_turn("alone", [False, True])
def test_a_process_that_dies_between_two_answers_costs_no_task(alone: bool) -> None:
    """Whether the pool hears of it by an answer or when it hands out the next task."""
    with ProcessPool(2) as pool:
        values = list[int]()

        def tasks() -> Iterator[Task]:
            for number in range(12):
                if number in ((4, 8) if alone else (5, 9)):
                    own = pool._processes
                    for process in own.ids():
                        os.kill(process, signal.SIGKILL)
                    until(lambda own=own: own._executor._broken)
                yield Task(str(number), lambda work: work**2, number)

        for outcome in pool.run(tasks()):
            assert outcome.error is None
            values.append(outcome.value)
            time.sleep(0.1 * alone)  # meanwhile the others that are in flight end, too
        assert sorted(values) == [number**2 for number in range(12)]


@pytest.mark.fault
def test_a_smoothed_proof_has_the_same_bytes_as_on_one_process(tmp_path: Path) -> None:
    job = pfdist.Problem("random_walk", horizon=8, measurement_budget=3, estimate="smoothed").job(
        search=[{"method": "random", "evaluations": 5, "evaluation": {"draws": 200}}],
        comparison={"draws": 200},
    )
    found = []
    for pool, workers in (("serial", 1), ("processes", 2)):
        run = pfdist.run(job, tmp_path / pool, pool=pool, workers=workers, figures=False)
        pfdist.bound(run, 480, pool=pool, workers=workers, figures=False)
        found.append(hashes(run.path))
    assert found[0] == found[1]
    assert any("error_sums/bound.proof." in file for file in found[0])
