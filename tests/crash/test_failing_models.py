"""Models that raise, loop or take all memory: it stands in `timings`, and has an end."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pfdist
from crash.runs import finish, running, until
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli.main import main
from pfdist.common.streams import stream_key
from pfdist.filters.evaluator import Evaluator
from pfdist.kernels.variates import TRUTH_MEASUREMENT, variates
from pfdist.runner import comparison_phase

pytestmark = pytest.mark.usefixtures("no_figures")
DRAW, DRAWS = 30, 60  # the one that the fault is in, and how many are compared
SMALL = [
    "evaluation.draws=10",
    "search.genetic.generations=1",
    "search.random.evaluations=1",
    f"comparison.draws={DRAWS}",
]  # NumPy takes its time
MODEL = """
import dataclasses
import os
import resource
import signal
from pathlib import Path

import numpy as np

from pfdist import BatchedModel
from pfdist.models.library import ungm

FLAG = {flag!r}


def limited():
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**28, limits[1]))
    try:
        unlimited()
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def unlimited(most=2**33):
    blocks = []
    while sum(block.nbytes for block in blocks) < most:
        blocks.append(np.ones(2**21))
    raise RuntimeError("nobody has stopped this")


def measurement(x, t, v, p):
    if np.any({condition}):
        {fault}
    return ungm.measurement(x, t, v, p)


given = {{each.name: getattr(ungm.model, each.name) for each in dataclasses.fields(ungm.model)}}
model = BatchedModel(**(given | {{"measurement": measurement}}), version="1")
"""
RAISE = 'raise RuntimeError("no such state")'
RAISE_ONCE = 'if not Path(FLAG).exists(): Path(FLAG).touch(); raise RuntimeError("no such state")'
LOOP = "Path(FLAG).touch()\n        while True: pass"
CRASH = "os.kill(os.getpid(), signal.SIGSEGV)"
CRASH_ONCE = "if not Path(FLAG).exists(): Path(FLAG).touch(); os.kill(os.getpid(), signal.SIGSEGV)"

Make = Callable[..., list[str]]


@pytest.fixture
def command(small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Make the command that runs a job whose model has a fault, in one draw or in all."""

    for few in ("TRAJECTORIES", "LOSS_DRAWS"):
        monkeypatch.setattr(comparison_phase, few, 10)  # the fault is in none of these

    def make(fault: str, run: Path, *options: str, always: bool = False) -> list[str]:
        draws = stream_key(small_job.seed, "comparison", "draws")
        of_draw = variates("normal", 1, draws, np.array([DRAW]), 3, TRUTH_MEASUREMENT, 0).item()
        condition = "t == 3" if always else f"v[0] == {of_draw!r}"
        text = MODEL.format(flag=str(tmp_path / "flag"), condition=condition, fault=fault)
        small_job.path.with_name("mine.py").write_text(text)
        changes = ["--set", 'model.name="mine.py:model"', 'filter.engine="numpy"', *SMALL]
        return ["run", str(small_job.path), "--results", str(run), *changes, *options]

    return make


@pytest.fixture(params=["serial", "threads", "processes", "ray"])
def pool(request: pytest.FixtureRequest) -> str:
    if request.param == "ray":
        request.getfixturevalue("ray_cluster")
    return str(request.param)


def _failures(run: Path) -> list[str]:
    rows = pfdist.open_run(run).table("timings")
    assert rows["failures"].equals(rows["error"].notna().astype(rows["failures"].dtype))
    return rows["error"].dropna().tolist()


def _compared(run: Path) -> set[int]:
    files = run.glob("*/comparison/[!.]*.parquet")
    return set(pd.concat(pd.read_parquet(file, columns=["draw"]) for file in files)["draw"])


def test_one_draw_that_fails_ends_the_run_after_all_others_with_its_traceback(
    pool: str, command: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert main(command(RAISE, run, "--pool", pool)) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("pfdist: a task of comparison failed: 4 times, the last: ")
    assert "no such state" in last
    errors = _failures(run)
    assert len(errors) == 4  # execution.failures, and the one that was too many
    for error in errors:
        assert "Traceback" in error
        assert "mine.py" in error
        assert "RuntimeError: no such state" in error
    lacking = sorted(set(range(DRAWS)) - _compared(run))
    assert DRAW in lacking
    assert lacking == list(range(lacking[0], lacking[-1] + 1))  # one task


@pytest.mark.parametrize("pool", ["threads", pytest.param("ray", marks=pytest.mark.crash)])
@pytest.mark.usefixtures("ray_cluster")
def test_a_draw_that_fails_once_is_done_again_and_the_run_ends_with_the_same_bytes(
    pool: str, command: Make, tmp_path: Path
) -> None:
    assert main(command(RAISE_ONCE, tmp_path / "run", "--pool", pool)) == 0
    assert len(_failures(tmp_path / "run")) == 1
    assert main(command(RAISE_ONCE, tmp_path / "whole", "--pool", "serial")) == 0
    assert not _failures(tmp_path / "whole")
    assert hashes(tmp_path / "run") == hashes(tmp_path / "whole")


def test_models_that_a_worker_cannot_make_end_the_run_in_a_line(
    ray_cluster: None,
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    made = "exec(\"from pfdist.errors import ModelError; raise ModelError('no such package')\")"
    monkeypatch.setattr(Evaluator, "__reduce__", lambda evaluator: (eval, (made,)))
    options = ["--results", str(tmp_path / "run"), "--pool", "ray"]
    assert main(["run", str(small_job.path), *options]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("pfdist: no such package (found by a worker on ")


@pytest.mark.parametrize(
    ("pool", "failures"), [("serial", 5), pytest.param("processes", 0, marks=pytest.mark.crash)]
)
def test_a_model_that_always_fails_is_tried_so_often_and_no_more(
    failures: int, pool: str, command: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As if only workers could see it: the driver would refuse such a model before any task.
    monkeypatch.setattr("pfdist.runner.build._check_draws", lambda job, evaluator: None)
    options = ["--set", f"execution.failures={failures}", "--pool", pool]
    assert main(command(RAISE, tmp_path / "run", *options, always=True)) == 1
    assert len(_failures(tmp_path / "run")) == failures + 1


@pytest.mark.crash
@pytest.mark.parametrize("fault", [LOOP, CRASH])
@pytest.mark.parametrize("pool", ["processes", "ray"])
def test_a_draw_that_never_ends_or_crashes_fails(
    fault: str,
    pool: str,
    ray_cluster: None,
    command: Make,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("pfdist.pools.base.PATIENCE_SECONDS", 3.0)
    options = ["--set", "execution.failures=1", "--pool", pool]
    assert main(command(fault, tmp_path / "run", *options)) == 1
    errors = _failures(tmp_path / "run")
    assert len(errors) == 2
    says = "its worker ended: it crashed, ran out of memory, or computed or slept for longer than"
    assert all(error.startswith(says) for error in errors)
    assert says in capsys.readouterr().err.splitlines()[-1]
    assert DRAW not in _compared(tmp_path / "run")


@pytest.mark.parametrize("pool", ["threads", "serial"])
def test_one_ctrl_c_ends_a_run_whose_formula_never_ends(
    pool: str, command: Make, tmp_path: Path
) -> None:
    """Threads commit first; this process itself, while it computes, ends after 3 s."""
    run = tmp_path / "run"
    words = command(LOOP, run, "--pool", pool, *(["--workers", "2"] if pool == "threads" else []))
    with running(Path(words[1]), run, *words[4:], "--no-report") as driver:
        driver.wait_for((tmp_path / "flag").exists)
        time.sleep(3.0)  # so long the other thread computes
        driver.process.send_signal(signal.SIGINT)
        until(lambda: driver.said[-1].startswith("pfdist: Stopped."))
        assert driver.wait() == 130
    if pool == "serial":
        return
    assert "comparison" in set(pfdist.open_run(run).table("timings")["phase"])
    assert not (run / ".begun").exists()


@pytest.mark.parametrize("pool", ["threads", pytest.param("serial", marks=pytest.mark.crash)])
def test_after_a_model_has_crashed_the_process_the_next_start_says_so(
    pool: str, command: Make, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    words = command(CRASH_ONCE, run)
    job, options = Path(words[1]), [*words[4:], "--pool", pool, "--no-report"]
    with running(job, run, *options) as driver:
        assert driver.wait() == 75
        assert driver.said[-1].startswith("pfdist: The process that computes ended by SIGSEGV and")
    with running(job, run, *options) as driver:
        assert driver.wait() == 0, driver.said[-3:]
        (said,) = (line for line in driver.said if "ended without a message" in line)
        assert "--pool processes isolates the model" in said
    assert hashes(run) == finish(job, tmp_path / "whole", *options)


@pytest.mark.parametrize("pool", ["threads", pytest.param("processes", marks=pytest.mark.crash)])
def test_a_draw_that_takes_all_memory_it_may_have_fails_with_its_traceback(
    pool: str, command: Make, tmp_path: Path
) -> None:
    options = ["--set", "execution.failures=1", "--pool", pool]
    assert main(command("limited()", tmp_path / "run", *options)) == 1
    errors = _failures(tmp_path / "run")
    assert len(errors) == 2
    assert all("MemoryError" in error for error in errors)
    assert all("mine.py" in error for error in errors)


@pytest.mark.crash
def test_a_draw_that_takes_all_memory_there_is_fails_when_ray_ends_its_worker(
    command: Make, tmp_path: Path, small_job: Job
) -> None:
    lines = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
    total, free = (int(lines[key].split()[0]) for key in ("MemTotal", "MemAvailable"))
    if free < 6 * 1024**2:
        pytest.skip("too little memory to take of")
    threshold = 1 - (free - 3 * 1024**2) / total  # Ray's memory monitor ends workers from there on
    options = ["--set", "execution.failures=0", "--pool", "ray", "--workers", "2"]
    words = command("unlimited()", tmp_path / "run", *options)[4:]
    monitor = {
        "RAY_memory_usage_threshold": f"{threshold:.3f}",
        "RAY_memory_monitor_refresh_ms": "50",
    }
    with running(small_job.path, tmp_path / "run", *words, **monitor) as driver:
        assert driver.wait() == 1
    assert driver.said[-1].startswith("pfdist: a task of comparison failed: ")
    (error,) = _failures(tmp_path / "run")
    assert "memory" in error
    assert "nobody has stopped this" not in error
