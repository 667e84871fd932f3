"""Asked to end, by a person or by a batch system: what is done is kept, and nobody waits long."""

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import pfdist
from crash.runs import GONE_SECONDS, PATIENCE_SECONDS, all_gone, finish, running, until
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.pools.guard import marked

ASKED = "Ctrl-C"
NOTICE_SECONDS = 20.0  # what a batch system gives

Record = Callable[[str, object], None]

# As a terminal or a batch script starts it: SIGINT is not ignored.
SLOW_TO_LEAVE = """
import signal, sys, time
from pfdist.cli.main import main
from pfdist.filters.evaluator import Evaluator
from pfdist.pools.base import SerialPool

def leave(*_):
    print("leaving", flush=True)
    time.sleep(600)

def forever(*_):
    print("computing", flush=True)
    time.sleep(600)

signal.signal(signal.SIGINT, signal.default_int_handler)
SerialPool.__exit__, Evaluator.filtered = leave, forever
sys.exit(main(sys.argv[1:]))
"""


def test_the_second_ctrl_c_ends_at_once_what_the_first_cannot(
    small_job: Job, tmp_path: Path, record_property: Record
) -> None:
    command = [
        sys.executable,
        "-c",
        SLOW_TO_LEAVE,
        "run",
        small_job.path,
        "--results",
        tmp_path / "run",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "computing\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "leaving\n"
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(2.0) == 130
    runs = [pfdist.run(small_job, tmp_path / name, figures=False) for name in ("run", "whole")]
    assert hashes(runs[0].path) == hashes(runs[1].path)
    record_property("faults", f"{ASKED}: 2")


BEGINS = """
import signal, sys
from pfdist.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)
print("beginning", flush=True)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("after", [0.05, 0.3])
def test_ctrl_c_is_heard_while_the_program_is_loaded(after: float, record_property: Record) -> None:
    command = [sys.executable, "-c", BEGINS, "check-model", "ungm"]  # loads Numba: a second
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "beginning\n"
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=30.0)
        assert process.returncode == 130
        assert error == "pfdist: interrupted\n"
    record_property("faults", f"{ASKED}: 1")


@pytest.mark.crash
@pytest.mark.parametrize(
    ("number", "code"),
    [
        (signal.SIGTERM, 75),
        (signal.SIGUSR1, 75),
        (signal.SIGINT, 130),
    ],
)
def test_a_run_on_ray_that_is_asked_to_end_does_so_soon_and_leaves_nothing(
    number: signal.Signals, code: int, small_job: Job, tmp_path: Path, record_property: Record
) -> None:
    job = small_job.path
    job.write_text(job.read_text().replace("draws = 250", "draws = 1_000_000"))
    run = tmp_path / "run"
    with running(job, run, "--pool", "ray") as driver:
        driver.wait_for(lambda: driver.parts("comparison"))
        everything, start = driver.family(), time.monotonic()
        os.killpg(driver.process.pid, number)  # the whole group, as a terminal or a batch system
        assert driver.wait() == code
        assert time.monotonic() - start < NOTICE_SECONDS
        assert "the same command goes on from there" in driver.said[-1]
        until(lambda: all_gone(everything), GONE_SECONDS)
    record_property("faults", f"{ASKED}: 1")


@pytest.mark.crash
@pytest.mark.parametrize("after", [0.5, 2.0, 4.0])
def test_a_run_that_is_asked_to_end_while_ray_starts_does_so(
    after: float, small_job: Job, tmp_path: Path, record_property: Record
) -> None:
    with running(small_job.path, tmp_path / "run", "--pool", "ray") as driver:
        driver.wait_for((tmp_path / "run" / "run.json").exists)
        time.sleep(after)
        everything = driver.family()
        driver.process.send_signal(signal.SIGTERM)
        assert driver.process.wait(PATIENCE_SECONDS) in {0, 75}
        until(lambda: all_gone(everything), GONE_SECONDS)
    assert finish(small_job.path, tmp_path / "run") == finish(small_job.path, tmp_path / "whole")
    record_property("faults", f"{ASKED}: 1")


@pytest.mark.crash
@pytest.mark.usefixtures("hangup_ends_children")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
@pytest.mark.parametrize("after", [1.0, 3.0, 5.0, "search", "comparison"])
def test_nothing_outlives_a_run_on_ray_that_is_killed(
    number: signal.Signals,
    after: float | str,
    small_job: Job,
    tmp_path: Path,
    record_property: Record,
) -> None:
    """Whenever it is: while Ray starts, and in each phase."""
    job, run, mark = small_job.path, tmp_path / "run", secrets.token_hex(8)
    job.write_text(job.read_text().replace("draws = 250", "draws = 1_000_000"))
    with running(job, run, "--pool", "ray", "--workers", "2", PFDIST_TEST=mark) as driver:
        if isinstance(after, str):
            driver.wait_for(lambda: driver.parts({"search": "draws"}.get(after, after)))
        else:
            driver.wait_for((run / "run.json").exists)
            time.sleep(after)
        driver.process.send_signal(number)
        assert driver.wait() == -number
        until(lambda: not marked("PFDIST_TEST", mark), GONE_SECONDS)
    record_property("faults", "nothing hangs: 1")
