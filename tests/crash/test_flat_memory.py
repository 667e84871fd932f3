"""Ten times as many draws take no more memory, and are the same whether at once or in two goes."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from crash.runs import running

FEW, MANY = 100_000, 1_000_000
JOB = """
seed = 1
[problem]
horizon = 2
measurement_budget = 2
[filter]
particles = 4
[evaluation]
draws = 10
[[search]]
method = "random"
evaluations = 2
[execution]
pool = "serial"
"""
# The peak is of this process alone: getrusage would count its parent's, before it became another.
PROGRAM = """
import sys
from pathlib import Path
from pfdist.cli.main import main
assert main(sys.argv[1:]) == 0
print(Path("/proc/self/status").read_text())
"""
PEAK = re.compile(r"^VmHWM:\s+(\d+) kB$", re.MULTILINE)

Peaks = dict[str, float]


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("job") / "tiny.toml"
    path.write_text(JOB)
    return path


def _peak_megabytes(*arguments: object) -> float:
    command = [sys.executable, "-c", PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    found = PEAK.search(done.stdout)
    assert found, done.stderr[-2000:]
    return int(found[1]) / 1024


@pytest.fixture(scope="module")
def serial_peaks(job: Path) -> dict[int, Peaks]:
    """Megabytes of each command, by the number of draws; the runs lie beside the job."""
    peaks: dict[int, Peaks] = {}
    for draws in (FEW, MANY):
        run = job.with_name(f"{draws}")
        options = ["--results", run, "--set", f"comparison.draws={draws}"]
        peaks[draws] = {"run": _peak_megabytes("run", job, *options)}  # summary and figures too
        for command in ("status", "plot", "verify"):
            peaks[draws][command] = _peak_megabytes(command, run)
    return peaks


def _assert_flat(peaks: dict[int, Peaks]) -> None:
    for whose, peak in peaks[FEW].items():
        assert peaks[MANY][whose] < 1.1 * peak, (whose, peaks)


@pytest.mark.crash
def test_a_million_draws_take_as_much_memory_as_a_hundred_thousand(
    serial_peaks: dict[int, Peaks],
) -> None:
    _assert_flat(serial_peaks)


@pytest.mark.crash
def test_on_ray_too_for_the_driver_and_its_workers(job: Path, tmp_path: Path) -> None:
    peaks: dict[int, Peaks] = {}
    for draws in (FEW, MANY):
        options = ["--pool", "ray", "--workers", "1", "--set", f"comparison.draws={draws}"]
        peaks[draws] = {}
        with running(job, tmp_path / f"{draws}", *options) as driver:
            while driver.process.poll() is None:
                processes = {each.pid: "driver" for each in driver.computing}
                processes |= {worker.pid: "worker" for worker in driver.workers()}
                for process, whose in processes.items():
                    found = PEAK.search(_status(process))
                    if found:
                        peaks[draws][whose] = int(found[1]) / 1024
                time.sleep(0.02)
            assert driver.wait() == 0, driver.said[-3:]
    assert set(peaks[MANY]) == {"driver", "worker"}
    _assert_flat(peaks)


def _status(process: int) -> str:
    try:
        return Path(f"/proc/{process}/status").read_text()
    except OSError:  # it has ended meanwhile
        return ""
