"""Workers, nodes and servers of Ray that die, stop or vanish in the midst of a run."""

import os
import random
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from psutil import Process

import pfdist
from crash.nodes import kill, nodes, signal_all
from crash.runs import (
    GONE_SECONDS,
    WORKER,
    Running,
    all_gone,
    command_of,
    family,
    finish,
    running,
    until,
)
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.runner.progress import Progress

JOB = """
seed = 6
[problem]
horizon = 30
measurement_budget = 8
[filter]
particles = 500
[evaluation]
draws = 1000
[[search]]
method = "random"
evaluations = 10
[comparison]
draws = {draws}
"""
TWO = ("--pool", "ray", "--workers", "2")
RAY_SECONDS = 200.0  # in which a run whose Ray does not answer has ended
LOST = "pfdist: (no answer from (the Ray cluster|any worker) for|the Ray)"

ENDED = "pfdist: The process that computes ended with exit code 1 and without a message: "

RAYLET, GCS, AGENT = "raylet/raylet", "gcs_server", "ray::DashboardAgent"


@pytest.fixture(scope="module")
def make_job(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    folder = tmp_path_factory.mktemp("jobs")

    def make(draws: int) -> Path:
        """A job with its serial run beside it, in ``whole``."""
        job = folder / f"{draws}" / "job.toml"
        if not job.exists():
            job.parent.mkdir()
            job.write_text(JOB.format(draws=draws))
            finish(job, job.with_name("whole"), "--pool", "serial")
        return job

    return make


def _whole(job: Path) -> dict[str, str]:
    return hashes(job.with_name("whole"))


def _has_come_on(driver: Running, commits: int, killed: set[Process]) -> Callable[[], bool]:
    """Whether something more is committed, and there are workers that live."""
    return lambda: driver.parts("timings") > commits and bool(set(driver.workers()) - killed)


def _is_comparing(driver: Running) -> bool:
    return driver.parts("comparison") > 0 and bool(driver.workers())


@pytest.mark.usefixtures("ray_cluster")
def test_a_worker_that_is_killed_in_each_phase_makes_no_difference(
    small_job: Job, tmp_path: Path
) -> None:
    killed = {}

    def kill(progress: Progress) -> None:
        if progress.evaluations and progress.phase not in killed:
            named = [(command_of(process), process) for process in family(os.getpid())]
            workers = [each for name, each in named if WORKER in name or "ray::IDLE" in name]
            killed[progress.phase] = workers[0]
            os.kill(workers[0].pid, signal.SIGKILL)

    job = small_job.with_changes(["comparison.draws=20000"])
    run = pfdist.run(job, tmp_path / "run", pool="ray", workers=2, progress=kill, figures=False)
    assert set(killed) == {"genetic", "random", "comparison"}
    assert hashes(run.path) == hashes(
        pfdist.run(job, tmp_path / "whole", pool="serial", figures=False).path
    )


@pytest.mark.crash
def test_a_run_whose_workers_are_killed_ends_with_the_same_bytes(
    make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    job, rng, kills, killed = make_job(800_000), random.Random(0), 12, set[Process]()
    with running(job, tmp_path / "run", *TWO) as driver:
        while len(killed) < kills:
            # It must come on, too: a task that dies four times is a failed task, and Ray hands a
            # worker several tasks at a time.
            commits = driver.parts("timings") + 2
            driver.wait_for(_has_come_on(driver, commits, killed))
            time.sleep(rng.uniform(0, 0.5))  # it has begun, or waits, or has ended something
            for worker in set(driver.workers()) - killed:
                os.kill(worker.pid, signal.SIGKILL)
                killed.add(worker)
        assert driver.wait() == 0, driver.said[-3:]
    assert hashes(tmp_path / "run") == _whole(job)


@pytest.mark.crash
@pytest.mark.parametrize(
    "stopped", [[RAYLET], [GCS], [RAYLET, GCS], [GCS, WORKER], [RAYLET, GCS, WORKER]]
)
def test_a_run_whose_servers_are_stopped_goes_on_or_says_so_and_leaves_nothing(
    stopped: list[str], make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    job = make_job(100_000)
    with running(job, tmp_path / "run", *TWO) as driver:
        driver.wait_for(lambda: _is_comparing(driver))
        everything, start = driver.family(), time.monotonic()
        for process in everything:
            if any(word in command_of(process) for word in stopped):
                os.kill(process.pid, signal.SIGSTOP)
        code = driver.wait()
        assert time.monotonic() - start < RAY_SECONDS
        assert code == 75 if GCS in stopped and WORKER in stopped else code in {0, 75}
        if code:
            said = "\n".join(driver.said)
            assert re.search(LOST, said)
        until(lambda: all_gone(everything), GONE_SECONDS)
    assert finish(job, tmp_path / "run", "--pool", "serial") == _whole(job)


@pytest.mark.crash
@pytest.mark.parametrize("killed", [AGENT, RAYLET])
def test_a_run_whose_server_is_killed_says_so_with_exit_code_75_and_leaves_nothing(
    killed: str, make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    """Ray ends the process that computes, with exit code 1 and without a line."""
    job = make_job(100_000)
    with running(job, tmp_path / "run", *TWO) as driver:
        driver.wait_for(lambda: _is_comparing(driver))
        everything, start = driver.family(), time.monotonic()
        os.kill(*(process.pid for process in everything if killed in command_of(process)), 9)
        assert driver.wait() == 75
        assert time.monotonic() - start < RAY_SECONDS
        assert driver.said[-1].startswith(ENDED) or re.match(LOST, driver.said[-1])
        until(lambda: all_gone(everything), GONE_SECONDS)
    assert finish(job, tmp_path / "run", "--pool", "threads") == _whole(job)


@pytest.mark.crash
def test_a_run_whose_nodes_are_killed_added_and_frozen_ends_with_the_same_bytes(
    make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    job = make_job(500_000)
    with nodes(tmp_path, 3) as cluster:
        _, first, second = cluster.all
        address = ("--address", cluster.address)
        with running(job, tmp_path / "run", *address, **cluster.environment) as driver:
            driver.wait_for(lambda: driver.parts("comparison"))
            kill(first)
            third = cluster.add()
            used = lambda: WORKER in " ".join(map(command_of, family(third.pid)))  # noqa: E731
            driver.wait_for(used)
            signal_all(second, signal.SIGSTOP)
            time.sleep(50.0)
            signal_all(second, signal.SIGCONT)
            kill(third)
            assert driver.process.poll() is None
            assert driver.wait() == 0, driver.said[-3:]
        cluster.add()  # the cluster is not the run's, and goes on
    assert hashes(tmp_path / "run") == _whole(job)


@pytest.mark.crash
def test_two_runs_share_a_cluster_and_end_with_the_same_bytes(
    make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    job = make_job(100_000)
    with nodes(tmp_path, 3) as cluster:
        options = ("--address", cluster.address)
        with (
            running(job, tmp_path / "first", *options, **cluster.environment) as first,
            running(job, tmp_path / "second", *options, **cluster.environment) as second,
        ):
            first.wait_for(lambda: first.parts("comparison") and second.parts("comparison"))
            kill(cluster.all[1])
            assert [first.wait(), second.wait()] == [0, 0], (first.said[-3:], second.said[-3:])
    for run in ("first", "second"):
        assert hashes(tmp_path / run) == _whole(job)


@pytest.mark.crash
def test_a_run_whose_head_is_killed_says_so_keeps_what_is_committed_and_resumes(
    make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    job = make_job(100_000)
    with nodes(tmp_path, 3) as cluster:
        options = ("--address", cluster.address)
        with running(job, tmp_path / "run", *options, **cluster.environment) as driver:
            driver.wait_for(lambda: driver.parts("comparison"))
            commits, start = driver.parts("comparison"), time.monotonic()
            kill(cluster.all[0])
            assert driver.wait() == 75
            assert time.monotonic() - start < RAY_SECONDS
            assert re.search(LOST, driver.said[-1])
            assert driver.parts("comparison") >= commits
    assert finish(job, tmp_path / "run", "--pool", "threads") == _whole(job)


@pytest.mark.crash
def test_ray_starts_where_the_path_of_temporary_files_is_too_long_for_its_sockets(
    make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    job, long = make_job(15_000), tmp_path / ("very-" * 20)
    long.mkdir()
    with running(job, tmp_path / "run", *TWO, TMPDIR=str(long)) as driver:
        assert driver.wait() == 0, driver.said[-3:]
    assert hashes(tmp_path / "run") == _whole(job)
