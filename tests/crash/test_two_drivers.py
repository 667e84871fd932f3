"""Two drivers on one run: the second ends with an error, or a warning where there are no locks."""

import contextlib
import errno
import itertools
import os
import platform
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from conftest import Called

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import PfdistWarning, StoreError
from pfdist.store import files, held
from pfdist.store.verify import verify_run

pytestmark = pytest.mark.usefixtures("no_figures")
PATIENCE_SECONDS = 120

STOPS = """
import sys, time, pfdist
def report(progress):
    if progress.phase == "comparison" and progress.evaluations:
        print("comparing", flush=True)
        time.sleep(600)
pfdist.run(sys.argv[1], sys.argv[2], progress=report, figures=False)
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
    first: subprocess.Popen[str], small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = str(tmp_path / "run")
    commands = (["run", str(small_job.path), "--results", run], ["verify", run])
    for command in commands:
        assert main(command) == 1
        error = capsys.readouterr().err
        told = re.fullmatch(
            rf"pfdist: {run} is being computed by process {first.pid} on "
            rf"{re.escape(platform.node())} since (\S+); wait for it, .*\n",
            error,
        )
        assert told, error
        assert 0 <= (datetime.now(UTC) - datetime.fromisoformat(told[1])).total_seconds() < 100
    assert main(["status", run]) == 0  # who only reads is not refused


@pytest.mark.plugins("rule", "runs", "why")
def test_beside_a_command_that_writes_others_read_and_none_writes(
    small_run: pfdist.Run, call: Callable[..., Called]
) -> None:
    """Whatever writes to a run says who holds it; whatever reads it answers."""
    run, before = small_run.path, hashes(small_run.path).items()
    with held(run):
        for line in ("run", "rule", "bound", "verify"):
            called = call(line, run)
            assert (called.code, called.out) == (1, "")
            assert f"is being computed by process {os.getpid()} on" in called.err
        for line in ("why", "status", "table", "list"):
            called = call(line, run)
            assert called.code == 0, called.err
    assert before <= hashes(run).items()  # `why` draws figures
    assert call("verify", run).code == 0


@pytest.mark.plugins("runs")
def test_a_clock_that_jumps_changes_nothing(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forward by decades, and back before 1970, while a run is computed and when it grows."""
    whole = pfdist.run(small_job, tmp_path / "whole", figures=False)
    clock = itertools.cycle([4e9, -5.0, 1e9])
    monkeypatch.setattr("time.time", lambda: next(clock))
    few = small_job.with_changes(["comparison.draws=100"])
    for job in (few, small_job):
        run = pfdist.run(job, tmp_path / "run", figures=False)
    assert hashes(run.path) == hashes(whole.path)
    assert pfdist.list_runs(run.path)["state"].tolist() == ["finished"]
    assert not [*verify_run(run.path)]


def test_after_kill_9_the_second_driver_starts_without_hand_work(
    first: subprocess.Popen[str], small_job: Job, tmp_path: Path
) -> None:
    whole = pfdist.run(small_job, tmp_path / "whole", figures=False)
    with pytest.raises(StoreError, match="is being computed by"):
        pfdist.run(small_job, tmp_path / "run", figures=False)
    os.kill(first.pid, signal.SIGKILL)
    assert first.wait(PATIENCE_SECONDS) == -signal.SIGKILL
    pfdist.run(small_job, tmp_path / "run", figures=False)
    assert hashes(tmp_path / "run") == hashes(whole.path)


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("fcntl.flock", errno.ENOLCK, "has no locks .*: only one command at a time may write to"),
        ("os.fsync", errno.EINVAL, "cannot flush files to disk .*: a power cut may lose finished"),
    ],
)
def test_a_file_system_that_lacks_locks_or_flushes_costs_a_warning_and_not_the_run(
    name: str,
    error: int,
    words: str,
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = pfdist.run(small_job, tmp_path / "whole", figures=False)

    def refuses(*_: object) -> None:
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(name, refuses)
    files._warn_of_no_flush.cache_clear()
    with pytest.warns(PfdistWarning, match=words):
        pfdist.run(small_job, tmp_path / "run", figures=False)
    assert hashes(tmp_path / "run") == hashes(whole.path)


def test_a_driver_waits_for_a_command_that_lists_its_pages(
    small_run: pfdist.Run, small_job: Job
) -> None:
    """Such a command holds the lock for a moment."""
    holding = contextlib.ExitStack()
    holding.enter_context(held(small_run.path))
    threading.Timer(0.3, holding.close).start()
    assert pfdist.run(small_job, small_run.path, figures=False).state == "finished"
