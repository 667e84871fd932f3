"""Workers, nodes and servers of Ray that die, stop or vanish in the midst of a run."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from crash.runs import GONE_SECONDS, Running, all_gone, command_of, finish, running, until
from oracles.bytes_of import hashes

DIES = "one worker or a node dies: the run goes on"
HANGS = "nothing hangs"
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
RAY_SECONDS = 90.0  # in which a run whose Ray does not answer has ended

Record = Callable[[str, object], None]


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


def _is_comparing(one: Running) -> bool:
    return one.parts("comparison") > 0 and len(one.workers()) == 2


@pytest.mark.parametrize(
    ("kills", "draws"), [(2, 15_000), pytest.param(20, 500_000, marks=pytest.mark.crash)]
)
def test_a_run_whose_workers_are_killed_ends_with_the_same_bytes(
    kills: int, draws: int, make_job: Callable[[int], Path], tmp_path: Path, record_property: Record
) -> None:
    job, rng, killed = make_job(draws), random.Random(0), set()
    with running(job, tmp_path / "run", *TWO) as one:
        while len(killed) < kills:
            one.wait_for(lambda: set(one.workers()) - killed)
            time.sleep(rng.uniform(0, 0.5))  # it has begun, or waits, or has ended something
            worker = rng.choice([worker for worker in one.workers() if worker not in killed])
            os.kill(worker.id, signal.SIGKILL)
            killed.add(worker)
        assert one.wait() == 0, one.said[-3:]
    assert hashes(tmp_path / "run") == _whole(job)
    record_property("faults", f"{DIES}: {kills}")


@pytest.mark.crash
@pytest.mark.parametrize("stopped", ["one", "all"])
def test_a_run_whose_workers_are_stopped_ends_with_the_same_bytes(
    stopped: str, make_job: Callable[[int], Path], tmp_path: Path, record_property: Record
) -> None:
    job = make_job(100_000)
    with running(job, tmp_path / "run", *TWO) as one:
        one.wait_for(lambda: _is_comparing(one))
        workers = one.workers()[: 1 if stopped == "one" else None]
        for worker in workers:
            os.kill(worker.id, signal.SIGSTOP)
        assert one.wait() == 0, one.said[-3:]
        until(lambda: all_gone(workers), GONE_SECONDS)
    assert hashes(tmp_path / "run") == _whole(job)
    record_property("faults", f"{HANGS}: {len(workers)}")


RAYLET, GCS, WORKER = "raylet/raylet", "gcs_server", "ray::_Worker"


@pytest.mark.crash
@pytest.mark.parametrize(
    "stopped", [[RAYLET], [GCS], [RAYLET, GCS], [RAYLET, WORKER], [RAYLET, GCS, WORKER]]
)
def test_a_run_whose_servers_are_stopped_goes_on_or_says_so_and_leaves_nothing(
    stopped: list[str], make_job: Callable[[int], Path], tmp_path: Path, record_property: Record
) -> None:
    job = make_job(100_000)
    with running(job, tmp_path / "run", *TWO) as one:
        one.wait_for(lambda: _is_comparing(one))
        everything, start = one.family(), time.monotonic()
        for process in everything:
            if any(word in command_of(process) for word in stopped):
                os.kill(process.id, signal.SIGSTOP)
        code = one.wait()
        assert time.monotonic() - start < RAY_SECONDS
        if WORKER in stopped:
            assert code == 1  # there is nobody to start others
        if code:
            assert "no worker has answered for" in one.said[-1]
        until(lambda: all_gone(everything), GONE_SECONDS)
    assert finish(job, tmp_path / "run", "--pool", "serial") == _whole(job)
    record_property("faults", f"{HANGS}: {len(stopped)}")


CLUSTER = """
import sys
from ray.cluster_utils import Cluster
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
print(cluster.address, flush=True)
for line in sys.stdin:
    if line.strip() == "remove":
        cluster.remove_node(nodes.pop(0), allow_graceful=False)
    else:
        nodes.append(cluster.add_node(num_cpus=1))
    print("done", flush=True)
cluster.shutdown()
"""


@pytest.mark.crash
def test_a_run_whose_nodes_vanish_ends_with_the_same_bytes(
    make_job: Callable[[int], Path], tmp_path: Path, record_property: Record
) -> None:
    job = make_job(500_000)
    with subprocess.Popen(
        [sys.executable, "-c", CLUSTER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as cluster:
        assert cluster.stdin is not None
        assert cluster.stdout is not None

        def ask(what: str) -> None:
            print(what, file=cluster.stdin, flush=True)
            assert cluster.stdout.readline() == "done\n"

        address = cluster.stdout.readline().strip()
        with running(job, tmp_path / "run", "--address", address, "--workers", "3") as one:
            one.wait_for(lambda: one.parts("comparison"))
            ask("remove")
            ask("add")
            time.sleep(5.0)
            ask("remove")
            ask("remove")  # from now on there are fewer cores than workers are wanted
            assert one.process.poll() is None
            assert one.wait() == 0, one.said[-3:]
        cluster.stdin.close()
    assert hashes(tmp_path / "run") == _whole(job)
    record_property("faults", f"{DIES}: 3")


@pytest.mark.crash
def test_ray_starts_where_the_path_of_temporary_files_is_too_long_for_its_sockets(
    make_job: Callable[[int], Path], tmp_path: Path
) -> None:
    job, long = make_job(15_000), tmp_path / ("very-" * 20)
    long.mkdir()
    with running(job, tmp_path / "run", *TWO, TMPDIR=str(long)) as one:
        assert one.wait() == 0, one.said[-3:]
    assert hashes(tmp_path / "run") == _whole(job)
