"""Ended by a signal in either phase and run again: the same bytes."""

import hashlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

JOB = """
seed = 5
[problem]
horizon = 30
measurement_budget = 8
[filter]
particles = 100
[evaluation]
draws = 400
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
    return _hashes(run)


def _end_when(
    process: subprocess.Popen[bytes], reached: Callable[[], bool], number: signal.Signals
) -> int:
    """Send a signal once a run has got so far; give its exit code."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while not reached():
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline, "the run never got so far"
        time.sleep(0.005)
    process.send_signal(number)
    return process.wait(PATIENCE_SECONDS)


def _hashes(run: Path) -> dict[str, str]:
    files = [run / "job.toml", *sorted((run / "tables").rglob("*.parquet"))]
    return {
        str(path.relative_to(run)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
        if "timings" not in path.parts
    }


def _parts(run: Path, table: str) -> int:
    return len(list((run / "parts" / table).glob("[!.]*.parquet")))


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("job") / "kill.toml"
    path.write_text(JOB)
    return path


@pytest.fixture(scope="module")
def never_killed(job: Path) -> dict[str, str]:
    hashes = _finish(job, job.with_name("never killed"), "serial")
    assert "tables/comparison/comparison-00001.parquet" in hashes
    return hashes


@pytest.mark.parametrize(
    ("pool", "searching", "comparing"),
    [
        ("serial", (signal.SIGKILL, -9), (signal.SIGKILL, -9)),
        ("ray", (signal.SIGKILL, -9), (signal.SIGKILL, -9)),
        ("serial", (signal.SIGTERM, 75), (signal.SIGINT, 130)),
    ],
    ids=["serial killed", "ray killed", "asked to end"],
)
def test_a_run_ended_in_every_phase_goes_on_to_the_same_bytes(
    pool: str,
    searching: tuple[signal.Signals, int],
    comparing: tuple[signal.Signals, int],
    job: Path,
    never_killed: dict[str, str],
    tmp_path: Path,
) -> None:
    run = tmp_path / "run"
    number, code = searching
    assert _end_when(_start(job, run, pool), lambda: _parts(run, "draws") >= 2, number) == code
    assert not (run / "tables" / "compared").exists()  # it was still searching
    number, code = comparing
    assert _end_when(_start(job, run, pool), lambda: _parts(run, "comparison") >= 1, number) == code
    assert not (run / "tables" / "comparison").exists()  # it was still comparing
    assert _finish(job, run, pool) == never_killed
    assert not list(run.rglob(".*"))
