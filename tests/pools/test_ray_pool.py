"""The pool of Ray tasks: cores, versions, and a cluster that does not answer."""

import time
from types import SimpleNamespace

import pytest

from pfdist.errors import EngineWarning, PoolError, SilenceError
from pfdist.pools import ray_pool
from pfdist.pools.base import Task
from pfdist.pools.ray_pool import RayPool

pytestmark = pytest.mark.usefixtures("ray_cluster")


def few(count):
    return (Task(str(number), abs, -number) for number in range(count))


@pytest.fixture
def cores(monkeypatch):
    """Lets the cluster seem to have these numbers of cores, one after another."""

    def let(*numbers):
        rest = list(numbers)

        def look(cluster):
            cluster.number = rest.pop(0) if len(rest) > 1 else rest[0]
            return cluster.number

        monkeypatch.setattr(ray_pool._Cores, "look", look)

    return let


def test_workers_are_the_cores_of_the_cluster_and_of_nodes_that_join(cores):
    cores(2, 2, 5)
    with RayPool() as pool:
        assert pool.workers == 2
        assert len(list(pool.run(few(20)))) == 20
        assert pool.workers == 5


@pytest.mark.parametrize(
    ("demanded", "number", "most"),
    [(0, 0, 16), (0, 4, 16), (0, 500, 1000), (3, 500, 3), (3, 3, 6), (3, 1, 6)],
)
def test_so_many_tasks_are_in_flight(demanded, number, most, cores):
    """At least 16, also on a cluster without cores, which then gets some."""
    cores(number)
    with RayPool(demanded) as pool:
        assert pool._most_in_flight == most


def test_a_pool_waits_for_cores(cores):
    cores(-1, 2, 2, 6)
    said = r"^the Ray cluster has 2 of 6 cores \(execution\.wait_for_cores\); waiting at most 300 s"
    with pytest.warns(EngineWarning, match=said), RayPool(wait_for_cores=6) as pool:
        assert pool.workers == 6


def test_cores_that_never_come_end_the_wait(cores, monkeypatch):
    cores(2)
    monkeypatch.setattr(ray_pool, "CORES_SECONDS", 0.1)
    said = r"^the Ray cluster has 2 of 6 cores \(execution\.wait_for_cores\) after 0 s"
    with (
        pytest.warns(EngineWarning, match="waiting"),
        pytest.raises(SilenceError, match=said),
        RayPool(wait_for_cores=6),
    ):
        pass


def test_a_node_of_another_version_ends_the_run_in_a_line(monkeypatch):
    ray_pool._remote.cache_clear()
    monkeypatch.setattr(ray_pool.metadata, "version", lambda name: "9.9")
    said = r"^every node must have pfdist 9\.9, got .+ on .+: install the same version there$"
    with RayPool(1) as pool, pytest.raises(PoolError, match=said):
        list(pool.run(few(3)))
    ray_pool._remote.cache_clear()


@pytest.mark.parametrize("fault", ["hangs", "raises"])
def test_a_cluster_that_does_not_answer_ends_the_run_before_ray_ends_the_process(
    fault, monkeypatch
):
    def cluster_resources():
        if fault == "hangs":
            time.sleep(20.0)
        raise RuntimeError("the head is lost")

    with RayPool(1) as pool:
        cores = ray_pool._Cores()
        monkeypatch.setattr(pool, "_cores", cores)
        ray = SimpleNamespace(cluster_resources=cluster_resources)
        monkeypatch.setattr(ray_pool, "load_ray", lambda: ray)
        monkeypatch.setattr(ray_pool, "LOST_SECONDS", 0.2)
        said = (
            "no answer from the Ray cluster for" if fault == "hangs" else "lost: the head is lost"
        )
        with pytest.raises(SilenceError, match=said):
            _look_often(cores)


def _look_often(cores):
    while True:
        cores.look()
        time.sleep(0.02)
