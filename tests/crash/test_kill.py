"""Ended by a signal in either phase and run again: the same bytes."""

import itertools
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli import main
from pfdist.monte_carlo import Problem, Work

JOB = """
seed = 5
[problem]
horizon = 30
measurement_budget = 8
[filter]
particles = 100
[evaluation]
draws = 4000
[[search]]
method = "genetic"
population = 10
generations = 12
[[search]]
method = "random"
evaluations = 40
[comparison]
draws = 60_000
"""
PATIENCE_SECONDS = 120.0


def _start(job: Path, run: Path, pool: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "pfdist", "run", job, "--results", run, "--pool", pool]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _finish(job: Path, run: Path, pool: str) -> dict[str, str]:
    process = _start(job, run, pool)
    assert process.wait(PATIENCE_SECONDS) == 0
    return hashes(run)


def _kill_when(process: subprocess.Popen[bytes], reached: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_SECONDS
    while not reached():
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline, "the run never got so far"
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait(PATIENCE_SECONDS) == -signal.SIGKILL


def _parts(run: Path, table: str) -> int:
    return len(list((run / "parts" / table).glob("[!.]*.parquet")))


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("job") / "kill.toml"
    path.write_text(JOB)
    return path


@pytest.fixture(scope="module")
def never_killed(job: Path) -> dict[str, str]:
    whole = _finish(job, job.with_name("never killed"), "serial")
    assert "tables/comparison/comparison-00001.parquet" in whole
    return whole


SEARCHING, COMPARING = ("draws", "compared"), ("comparison", "comparison")


@pytest.mark.parametrize(
    ("pool", "phases"), [("serial", [SEARCHING, COMPARING]), ("ray", [COMPARING])]
)
def test_a_run_killed_in_a_phase_ends_with_the_same_bytes(
    pool: str,
    phases: list[tuple[str, str]],
    job: Path,
    never_killed: dict[str, str],
    tmp_path: Path,
) -> None:
    run = tmp_path / "run"
    for parts, table in phases:
        _kill_when(_start(job, run, pool), lambda: _parts(run, parts) >= 1)  # noqa: B023
        assert not (run / "tables" / table).exists()  # it was in the midst of the phase
    assert _finish(job, run, pool) == never_killed
    assert not list(run.rglob(".*"))


@pytest.mark.parametrize(("state", "sets", "task"), [("searching", 1, 7), ("comparing", 3, 2)])
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 75), (signal.SIGUSR1, 75)]
)
def test_a_run_asked_to_end_keeps_what_is_done_and_goes_on(
    number: signal.Signals,
    code: int,
    state: str,
    sets: int,
    task: int,
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole, run = tmp_path / "whole", tmp_path / "run"
    command = ["run", str(small_job.path), "--results"]
    assert main([*command, str(whole)]) == 0
    calls, do = itertools.count(1), Problem.__call__

    def signalled(self: Problem, work: Work) -> Any:
        if len(work.measurement_times) == sets and next(calls) == task:
            signal.raise_signal(number)
        return do(self, work)

    # A shell's background jobs, as CI may be, are started with SIGINT ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with monkeypatch.context() as patch:
        patch.setattr(Problem, "__call__", signalled)
        assert main([*command, str(run)]) == code
    signal.signal(signal.SIGINT, before)
    assert "the same command goes on" in capsys.readouterr().err
    kept = pfdist.open_run(run)
    assert kept.state == state
    assert len(kept.draws()) > 0
    assert main([*command, str(run)]) == 0
    assert hashes(run) == hashes(whole)
