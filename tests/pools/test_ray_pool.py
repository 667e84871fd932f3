"""The pool of Ray workers with simulated actors, which answer at once."""

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import cloudpickle
import pytest

from pfdist.errors import EngineWarning, PoolError, SilenceError
from pfdist.pools import base, ray_pool
from pfdist.pools.base import Task
from pfdist.pools.ray_cluster import about
from pfdist.pools.ray_pool import FUNCTIONS, RayPool

Answer = Callable[..., Any]
Started = Callable[..., RayPool]


class _Method:
    """A method of an actor; an exception is the end of the actor."""

    def __init__(self, method: Answer) -> None:
        self._method = method

    def remote(self, *arguments: Any) -> Any:
        answer = Future[Any]()
        try:
            answer.set_result(self._method(*arguments))
        except RuntimeError as error:
            answer.set_exception(error)
        return SimpleNamespace(future=lambda: answer)


class Cluster:
    """A cluster of simulated nodes; ``taken`` counts the cores that have workers."""

    def __init__(self, nodes: dict[str, int]) -> None:
        self.nodes, self.taken = nodes, Counter[str]()

    def all_cores(self) -> int:
        return sum(self.nodes.values())

    def idle_cores(self) -> int:
        return self.all_cores() - self.taken.total()

    def free_cores(self, most: int) -> dict[str, int]:
        found = dict[str, int]()
        for node, cores in self.nodes.items():
            free = min(cores - self.taken[node], most - sum(found.values()))
            found |= {node: free} if free > 0 else {}
        return found


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Started]:
    """Starts a pool of simulated workers; arguments replace methods of the actors."""
    stack = contextlib.ExitStack()

    def start(
        cluster: Cluster,
        workers: int = 0,
        wait_for_cores: int = 0,
        threaded: bool = True,
        **methods: Any,
    ) -> RayPool:
        class Simulated:
            def __init__(self, node: str, cores: int) -> None:
                self.node, self.cores, actor = node, cores, ray_pool._Actor()
                cluster.taken[node] += cores
                for name in ("about", "load", "do"):
                    method = methods.get(name) or getattr(actor, name)
                    setattr(self, name, _Method(method))

        def options(num_cpus: int, max_concurrency: int, scheduling_strategy: Any) -> Any:
            return SimpleNamespace(remote=lambda: Simulated(scheduling_strategy, num_cpus))

        def kill(actor: Simulated) -> None:
            cluster.taken[actor.node] -= actor.cores

        monkeypatch.setattr(ray_pool, "connected", lambda *_: contextlib.nullcontext())
        monkeypatch.setattr(ray_pool, "all_cores", cluster.all_cores)
        monkeypatch.setattr(ray_pool, "free_cores", cluster.free_cores)
        monkeypatch.setattr(ray_pool, "idle_cores", cluster.idle_cores)
        monkeypatch.setattr(ray_pool, "NodeAffinitySchedulingStrategy", lambda node, soft: node)
        monkeypatch.setattr(ray_pool, "_RemoteActor", SimpleNamespace(options=options))
        monkeypatch.setattr(ray_pool, "_send", lambda f: (id(f), cloudpickle.dumps(f)))
        monkeypatch.setattr(ray_pool.ray, "kill", kill)
        monkeypatch.setattr(ray_pool.ray, "is_initialized", lambda: False)
        pool = RayPool(workers, wait_for_cores=wait_for_cores, threaded=threaded)
        return stack.enter_context(pool)

    yield start
    stack.close()


def _workers(pool: RayPool) -> list[tuple[str, int]]:
    return sorted((worker.node, worker.cores) for worker in pool._members)


def test_each_node_has_one_worker_with_a_thread_for_each_core_that_is_free(
    started: Started,
) -> None:
    cluster = Cluster({"a": 4, "b": 2, "c": 8})
    cluster.taken["c"] = 5  # by another driver
    with pytest.warns(EngineWarning, match=r"^5 of the 14 cores .* taken: 9 of 14 workers start"):
        pool = started(cluster)
    assert _workers(pool) == [("a", 4), ("b", 2), ("c", 3)]


def test_tasks_that_keep_pythons_lock_get_a_process_for_each_core(started: Started) -> None:
    pool = started(Cluster({"a": 2, "b": 1}), threaded=False)
    assert _workers(pool) == [("a", 1), ("a", 1), ("b", 1)]


def test_no_more_cores_are_used_than_workers_are_wanted(started: Started) -> None:
    assert _workers(started(Cluster({"a": 2, "b": 2}), 3)) == [("a", 2), ("b", 1)]


@pytest.mark.parametrize("fault", ["a node joins", "a node is lost"])
def test_cores_that_become_free_get_workers_at_the_next_look(
    fault: str, started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base, "LOOK_SECONDS", 0.0)
    cluster = Cluster({"a": 2})
    pool = started(cluster)
    run = pool.run(Task(str(number), abs, -number) for number in range(2000))
    outcomes = [next(run).value for _ in range(10)]
    if fault == "a node is lost":
        cluster.nodes = {}
        outcomes += [each.value for each in pool._lose(next(iter(pool._members)), "gone", 3)]
    cluster.nodes["b"] = 2
    outcomes += [outcome.value for outcome in run]
    assert ("b", 2) in _workers(pool)
    assert sorted(outcomes) == list(range(2000))


def test_workers_start_when_the_cluster_has_as_many_cores_as_are_waited_for(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster = Cluster({"a": 2})
    monkeypatch.setattr(base, "PAUSE_SECONDS", 0.0)
    looks = iter(range(5))
    count = cluster.all_cores

    def all_cores() -> int:
        if next(looks, None) == 3:
            cluster.nodes["b"] = 4
        return count()

    monkeypatch.setattr(cluster, "all_cores", all_cores)
    with pytest.warns(EngineWarning, match=r"^the Ray cluster has 2 of 6 cores: waiting .* 300 s"):
        pool = started(cluster, wait_for_cores=6)
    assert _workers(pool) == [("a", 2), ("b", 4)]


def test_cores_that_never_come_end_the_wait(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray_pool, "WAIT_SECONDS", 0.1)
    with (
        pytest.warns(EngineWarning, match="2 of 6 cores"),
        pytest.raises(SilenceError, match=r"^after 0 s the Ray cluster has 2 of the 6 cores"),
    ):
        started(Cluster({"a": 2}), wait_for_cores=6)


def test_a_node_of_another_version_is_named_and_left_out(started: Started) -> None:
    versions = iter([{"pfdist": "0.1"}, {}, {}])
    with pytest.warns(EngineWarning, match=r"every node must have .*got 0\.1 on .*; the other nod"):
        pool = started(Cluster(dict.fromkeys("abc", 1)), about=lambda: about() | next(versions))
    assert pool.workers == 2
    outcomes = pool.run(Task(str(number), abs, -number) for number in range(20))
    assert sorted(outcome.value for outcome in outcomes) == list(range(20))


def test_where_every_node_has_another_version_there_is_no_pool(started: Started) -> None:
    with (
        pytest.warns(EngineWarning, match="left out|go on without"),
        pytest.raises(PoolError, match=r"^every node must have pfdist .*install the same"),
    ):
        started(Cluster({"a": 1, "b": 1}), about=lambda: about() | {"pfdist": "0.1"})


def test_tasks_of_a_lost_worker_are_done_next_and_alone(started: Started) -> None:
    lives, done = [2], list[int]()

    def do(key: int, work: int) -> tuple[Any, ...]:
        if work == 500 and lives:
            lives.pop()
            raise RuntimeError("the actor died")
        done.append(work)
        return work, 0.1, "worker", "node", None

    pool = started(Cluster(dict.fromkeys("abcde", 2)), do=do)
    outcomes = [outcome.value for outcome in pool.run(Task(str(n), abs, n) for n in range(10_000))]
    assert sorted(outcomes) == list(range(10_000))
    assert outcomes.index(500) < 500 + 6 * 10
    assert pool._aside is None  # the worker that did it has ended


def test_a_worker_makes_each_function_once_as_long_as_it_keeps_it(
    started: Started, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, make = list[int](), ray_pool._Actor._make

    def counted(actor: Any, key: int, content: bytes) -> Any:
        made.append(key)
        return make(actor, key, content)

    monkeypatch.setattr(ray_pool._Actor, "_make", counted)
    pool = started(Cluster({"a": 1}))
    functions = [eval(f"lambda work: {number}") for number in range(FUNCTIONS + 1)]
    few = [functions[number % 3] for number in range(30)]
    assert all(o.error is None for o in pool.run(Task(str(n), f, n) for n, f in enumerate(few)))
    assert len(made) == 3
    everything = [Task(str(n), f, n) for n, f in enumerate(functions)]
    assert all(o.error is None for o in pool.run(everything))
    assert len(made) == FUNCTIONS + 1
    assert all(o.error is None for o in pool.run([Task("again", functions[0], 0)]))
    assert len(made) == FUNCTIONS + 2  # it was the oldest
