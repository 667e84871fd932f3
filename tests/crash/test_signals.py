"""Asked to end, by a person or by a batch system: what is done is kept, and nobody waits long."""

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import SMALL_JOB
from psutil import Process

import pfdist
from crash.runs import (
    GONE_SECONDS,
    PATIENCE_SECONDS,
    WORKER,
    all_gone,
    command_of,
    end,
    finish,
    marked,
    running,
    until,
)
from oracles.bytes_of import hashes
from oracles.stopped import SAVED, STOPPED, STOPPING
from pfdist import Job

CODES = [(signal.SIGINT, 130), (signal.SIGTERM, 75), (signal.SIGUSR1, 75)]
NOTICE_SECONDS = 20.0  # what a batch system gives

WORKERS = ("default_worker.py", "ray::IDLE", WORKER)  # in the commands of Ray's workers


@pytest.fixture(scope="module")
def long_job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A job of some seconds with its run on threads beside it, in ``whole``."""
    job = tmp_path_factory.mktemp("long") / "job.toml"
    job.write_text(SMALL_JOB.replace("draws = 250", "draws = 500_000"))
    finish(job, job.with_name("whole"), "--pool", "threads")
    return job


# As a terminal or a batch script starts it: SIGINT is not ignored, and there is one thread.
BEGINS = """
import os, signal, sys, threading, time
from pfdist.cli.main import main
from pfdist.common import stopping
signal.signal(signal.SIGINT, signal.default_int_handler)
def listen(original=stopping.listen, **options):
    original(**options)  # before NumPy starts threads
    exec({!r}, globals())
stopping.listen = listen
print("beginning", flush=True)
sys.exit(main())
"""


@contextmanager
def program(lines: str, *words: object) -> Iterator[subprocess.Popen[str]]:
    """The program in a process, which runs some lines of Python when it has begun."""
    command = [sys.executable, "-c", BEGINS.format(lines), *map(str, words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "beginning\n"
        try:
            yield process
        finally:
            process.kill()


ENDLESS = """
from pfdist.filters.evaluator import Evaluator
def forever(*_):
    print("computing", flush=True)
    time.sleep(600)
Evaluator.filtered = forever
"""


def test_the_second_ctrl_c_ends_at_once_what_the_first_cannot(
    small_job: Job, tmp_path: Path
) -> None:
    with program(ENDLESS, "run", small_job.path, "--results", tmp_path / "run") as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "computing\n"
        process.send_signal(signal.SIGINT)
        assert STOPPING[signal.SIGINT] in iter(lambda: process.stderr.readline().strip(), "")
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_SECONDS) == 130
    runs = [pfdist.run(small_job, tmp_path / name, figures=False) for name in ("run", "whole")]
    assert hashes(runs[0].path) == hashes(runs[1].path)


@pytest.mark.plugins("check")
@pytest.mark.parametrize(
    ("number", "code", "after"), [(*CODES[0], 0.05), (*CODES[1], 0.3), (*CODES[2], 0.3)]
)
def test_a_signal_ends_the_program_at_once_while_it_is_loaded(
    number: signal.Signals, code: int, after: float
) -> None:
    with program("", "check-model", "ungm") as process:  # loads Numba: a second
        time.sleep(after)
        process.send_signal(number)
        _, error = process.communicate(timeout=PATIENCE_SECONDS)
        assert process.returncode == code
        assert error == f"{STOPPED}\n"


LAST_CHECK = "no formula fails at any instant"


@pytest.mark.crash
@pytest.mark.parametrize(
    "line",
    [
        "evaluate {job} --times 0:12:3",
        "why {run}/job.toml",
        "sweep {job} --over seed=1:2 --dry-run",
        "run {job} --results {new} --pool threads",
    ],
)
def test_a_signal_while_kernels_compile_stops_before_the_next_compilation(
    line: str,
    small_run: pfdist.Run,
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cache, new = tmp_path / "cache", tmp_path / "new"
    monkeypatch.setenv("PFDIST_CACHE_DIR", str(cache))
    words = line.format(job=small_job.path, run=small_run.path, new=new).split()
    with program("", *words) as process:
        until(lambda: any(cache.rglob("*simulate_draws*.nbc")))  # the filter is compiled next
        process.send_signal(signal.SIGTERM)
        output, error = process.communicate(timeout=PATIENCE_SECONDS)
        assert process.returncode == 75
    resumes = str(new) in words
    assert error.splitlines()[-2:] == [STOPPING[signal.SIGTERM], SAVED if resumes else STOPPED]
    assert LAST_CHECK not in output
    assert "MSE" not in output
    assert not (new / "tables").exists()


# In such a callback, an exception of a handler would be swallowed.
CALLBACKS = {"weakref": "weakref.finalize(set(), end)", "ctypes": "ctypes.CFUNCTYPE(None)(end)()"}
MODEL = """
import ctypes, dataclasses, os, signal, time, weakref
from pfdist import BatchedModel
from pfdist.models.library import ungm
FLAG, BEGUN = {flag!r}, {begun!r}
def end():
    os.kill(os.getpid(), signal.SIGTERM)
    for _ in range(1000): pass
    time.sleep(0.2)  # the thread that waits for signals may be waiting for a core
def measurement(x, t, v, p):
    if t == 3 and not os.path.exists(FLAG) and os.path.exists(BEGUN):
        os.mkdir(FLAG)
        {callback}
    return ungm.measurement(x, t, v, p)
given = {{each.name: getattr(ungm.model, each.name) for each in dataclasses.fields(ungm.model)}}
model = BatchedModel(**(given | {{"measurement": measurement}}), version="1")
"""


@pytest.mark.parametrize(
    "callback",
    [CALLBACKS["weakref"], pytest.param(CALLBACKS["ctypes"], marks=pytest.mark.crash)],
    ids=CALLBACKS,
)
def test_a_signal_in_a_callback_ends_the_run_which_then_resumes(
    callback: str, small_job: Job, tmp_path: Path
) -> None:
    flag, run = tmp_path / "flag", tmp_path / "run"
    begun, model = str(run / "job.toml"), tmp_path / "mine.py"
    model.write_text(MODEL.format(flag=str(flag), begun=begun, callback=callback))
    options = ["--set", f"model.name='{model}:model'", "filter.engine=numpy", "--no-report"]
    options += [
        "--set",
        "comparison.draws=5",
        "problem.horizon=4",
        "filter.particles=5",
        "--pool",
        "serial",
    ]
    with running(small_job.path, run, *options) as driver:
        assert driver.wait() == 75
        assert driver.said[-2:] == [STOPPING[signal.SIGTERM], SAVED]
    assert flag.exists()
    resumed, whole = (finish(small_job.path, each, *options) for each in (run, tmp_path / "whole"))
    assert resumed == whole


SENDS = """
from pfdist.pools.ray_cluster import load_ray
ray = load_ray(own=True)
original = ray.{what}
def patched(*arguments, **options):
    threading.Timer({after}, os.kill, [os.getpid(), signal.{number}]).start()
    return original(*arguments, **options)
ray.{what} = patched
"""


@pytest.mark.crash
@pytest.mark.parametrize(
    ("what", "after"),
    [("init", after) for after in (0.0, 1.0, 4.0)]
    + [("shutdown", after) for after in (0.0, 0.1, 0.5, 1.0)],
)
@pytest.mark.parametrize(("number", "code"), CODES)
def test_a_signal_while_ray_starts_or_ends_has_its_exit_code_and_leaves_nothing(
    number: signal.Signals,
    code: int,
    what: str,
    after: float,
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lines, run = SENDS.format(what=what, after=after, number=number.name), tmp_path / "run"
    mark = secrets.token_hex(8)
    monkeypatch.setenv("PFDIST_TEST", mark)
    words = ["run", small_job.path, "--results", run, "--pool", "ray", "--no-report"]
    with program(lines, *words) as process:
        _, error = process.communicate(timeout=PATIENCE_SECONDS)
        assert process.returncode == code
        assert error.splitlines()[-1] == SAVED
        assert error.splitlines().count(STOPPING[number]) == 1
        until(lambda: not marked("PFDIST_TEST", mark), GONE_SECONDS)
    assert finish(small_job.path, run) == finish(small_job.path, tmp_path / "whole")


@pytest.mark.crash
@pytest.mark.parametrize(("number", "code"), [*CODES, (signal.SIGHUP, 75)])
def test_a_run_on_ray_that_is_asked_to_end_does_so_soon_and_leaves_nothing(
    number: signal.Signals, code: int, small_job: Job, tmp_path: Path
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
        assert driver.said[-1] == SAVED
        until(lambda: all_gone(everything), GONE_SECONDS)


@pytest.mark.crash
@pytest.mark.parametrize("after", [1.0, 3.0, 5.0, "search", "comparison"])
def test_workers_end_with_a_run_on_ray_that_is_killed_and_it_resumes(
    after: float | str, long_job: Path, tmp_path: Path
) -> None:
    """Whenever it is: while Ray starts, and in each phase. Ray's own agents are left to Ray."""
    run, mark = tmp_path / "run", secrets.token_hex(8)

    def workers() -> list[Process]:
        found = marked("PFDIST_TEST", mark)
        return [each for each in found if any(word in command_of(each) for word in WORKERS)]

    options = ("--pool", "ray", "--workers", "2")
    try:
        with running(long_job, run, *options, PFDIST_TEST=mark) as driver:
            if isinstance(after, str):
                driver.wait_for(lambda: driver.parts({"search": "draws"}.get(after, after)))
            else:
                driver.wait_for((run / "run.json").exists)
                time.sleep(after)
            driver.process.kill()
            assert driver.wait() == -signal.SIGKILL
            until(lambda: not workers(), GONE_SECONDS)
    finally:
        end(marked("PFDIST_TEST", mark))
    assert finish(long_job, run, "--pool", "threads") == hashes(long_job.with_name("whole"))
