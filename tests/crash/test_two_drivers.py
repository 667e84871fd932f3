"""Two drivers on one run: the second is refused; and where nothing can refuse it, does no harm."""

import os
import platform
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.store.repair import verify_run

pytestmark = pytest.mark.usefixtures("no_figures")
PROMISE = "two drivers on one run"
PATIENCE_SECONDS = 120

STOPS = """
import sys, time, pfdist
def report(progress):
    if progress.phase == "comparison" and progress.evaluations:
        print("comparing", flush=True)
        time.sleep(600)
pfdist.run(sys.argv[1], sys.argv[2], progress=report, figures=False)
"""
# A file system without locks, that takes its time; and as many commits as there are tasks.
WITHOUT_LOCKS = """
import errno, fcntl, random, sys, time, pfdist
from pfdist.runner import door, pace
from pfdist.store import files
def no_locks(*_):
    raise OSError(errno.ENOLCK, "No locks available")
fcntl.flock = no_locks
flush, chance = files._flush, random.Random(int(sys.argv[3]))
def slow(path, mode):
    flush(path, mode)
    time.sleep(chance.random() * 0.01)
files._flush = slow
door.COMMIT_SECONDS, pace.Pace.size = 0.0, lambda pace, remaining: 60 * 520
pfdist.run(sys.argv[1], sys.argv[2], figures=False)
"""


def _start(program: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def first(small_job: Job, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A driver in the midst of the comparison, which goes no further."""
    with _start(STOPS, small_job.path, tmp_path / "run") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "comparing\n"
        yield process
        process.kill()


def test_the_second_driver_is_refused_at_once_and_told_who_holds_the_run(
    first: subprocess.Popen[str],
    small_job: Job,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Callable[[str, object], None],
) -> None:
    run = str(tmp_path / "run")
    commands = (
        ["run", str(small_job.path), "--results", run],
        ["repair", run],
        ["verify", run],
    )
    for command in commands:
        assert main(command) == 1
        error = capsys.readouterr().err
        told = re.fullmatch(
            rf"pfdist: {run} is being computed by process {first.pid} on "
            rf"{re.escape(platform.node())} since (\S+): wait for it, .*\n",
            error,
        )
        assert told, error
        assert 0 <= (datetime.now(UTC) - datetime.fromisoformat(told[1])).total_seconds() < 100
    assert main(["status", run]) == 0  # who only reads is not refused
    record_property("faults", f"{PROMISE}: {len(commands)}")


def test_after_kill_9_the_second_driver_starts_without_hand_work(
    first: subprocess.Popen[str],
    small_job: Job,
    tmp_path: Path,
    record_property: Callable[[str, object], None],
) -> None:
    whole = pfdist.run(small_job, tmp_path / "whole", figures=False)
    with pytest.raises(StoreError, match="is being computed by"):
        pfdist.run(small_job, tmp_path / "run", figures=False)
    os.kill(first.pid, signal.SIGKILL)
    assert first.wait(PATIENCE_SECONDS) == -signal.SIGKILL
    pfdist.run(small_job, tmp_path / "run", figures=False)
    assert hashes(tmp_path / "run") == hashes(whole.path)
    record_property("faults", f"{PROMISE}: 2")


@pytest.mark.parametrize("times", [1, pytest.param(10, marks=pytest.mark.crash)])
def test_three_drivers_that_nobody_refuses_end_with_the_same_bytes(
    times: int,
    small_job: Job,
    tmp_path: Path,
    record_property: Callable[[str, object], None],
) -> None:
    whole = hashes(pfdist.run(small_job, tmp_path / "whole", figures=False).path)
    for number in range(times):
        run = tmp_path / f"{number}"
        drivers = [_start(WITHOUT_LOCKS, small_job.path, run, 3 * number + k) for k in range(3)]
        for driver in drivers:
            _, error = driver.communicate(timeout=PATIENCE_SECONDS)
            assert driver.returncode == 0, error[-2000:]
        assert hashes(run) == whole
        assert not list(verify_run(run))
        assert pfdist.open_run(run).state == "finished"
    record_property("faults", f"{PROMISE}: {3 * times}")
