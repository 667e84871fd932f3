"""Ten times as many draws take no more memory."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PROMISE = "memory is flat"
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
import re, sys
from pathlib import Path
from pfdist.cli import main
assert main(sys.argv[1:]) == 0
print(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[0])
"""


def _peak_megabytes(*arguments: object) -> float:
    command = [sys.executable, "-c", PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = re.search(r"VmHWM:\s+(\d+) kB$", done.stdout)
    assert found
    return int(found[1]) / 1024


@pytest.mark.crash
def test_a_million_draws_take_as_much_memory_as_a_hundred_thousand(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    job = tmp_path / "tiny.toml"
    job.write_text(JOB)
    peaks: dict[int, dict[str, float]] = {}
    for draws in (100_000, 1_000_000):
        run = tmp_path / f"{draws}"
        options = ["--results", run, "--set", f"comparison.draws={draws}"]
        peaks[draws] = {"run": _peak_megabytes("run", job, *options)}  # summary and figures too
        for command in ("status", "plot", "verify"):
            peaks[draws][command] = _peak_megabytes(command, run)
    few, many = peaks.values()
    for command, peak in few.items():
        assert many[command] < 1.1 * peak, (command, peaks)
    record_property("faults", f"{PROMISE}: {len(few)}")
