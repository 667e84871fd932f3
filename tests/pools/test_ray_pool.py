"""The pool of Ray workers with simulated actors, which answer at once."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from pfdist.errors import EngineWarning, PoolError
from pfdist.pools import ray_pool
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


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[Started]:
    """Starts a pool of simulated workers; arguments replace methods of the actors."""
    stack = contextlib.ExitStack()

    def start(workers: int, **methods: Answer) -> RayPool:
        class Simulated:
            def __init__(self) -> None:
                actor = ray_pool._Actor()
                for name in ("about", "make", "do"):
                    method = methods.get(name)
                    own = getattr(actor, name)
                    setattr(self, name, _Method(own if method is None else method))

        with monkeypatch.context() as patch:
            patch.setattr(ray_pool, "connected", lambda *_: contextlib.nullcontext())
            patch.setattr(ray_pool.ray, "cluster_resources", lambda: {"CPU": workers})
            patch.setattr(ray_pool.ray, "is_initialized", lambda: False)
            monkeypatch.setattr(ray_pool, "_RemoteActor", SimpleNamespace(remote=Simulated))
            monkeypatch.setattr(ray_pool.ray, "kill", lambda actor: None)
            return stack.enter_context(RayPool(workers))

    yield start
    stack.close()


def test_a_node_of_another_version_is_named_and_left_out(started: Started) -> None:
    versions = iter(["0.1", about()["pfdist"], about()["pfdist"]])
    with pytest.warns(EngineWarning, match=r"every node must have .*got 0\.1 on .*; the other nod"):
        pool = started(3, about=lambda: about() | {"pfdist": next(versions)})
    assert pool.workers == 2
    outcomes = pool.run(Task(str(number), abs, -number) for number in range(20))
    assert sorted(outcome.value for outcome in outcomes) == list(range(20))


def test_where_every_node_has_another_version_there_is_no_pool(started: Started) -> None:
    with (
        pytest.warns(EngineWarning, match="left out|go on without"),
        pytest.raises(PoolError, match=r"^every node must have pfdist .*install the same"),
    ):
        started(2, about=lambda: about() | {"pfdist": "0.1"})


def test_tasks_of_a_lost_worker_are_done_next_and_alone(started: Started) -> None:
    lives, busy = [2], list[int]()

    def do(key: int, work: int) -> tuple[Any, ...]:
        if work == 500 and lives:
            lives.pop()
            raise RuntimeError("the actor died")
        busy.append(work)
        return work, 0.1, "worker", "node", None

    pool = started(10, do=do)
    outcomes = [outcome.value for outcome in pool.run(Task(str(n), abs, n) for n in range(10_000))]
    assert sorted(outcomes) == list(range(10_000))
    assert outcomes.index(500) < 500 + 4 * 10


def test_a_worker_makes_each_function_once_as_long_as_it_keeps_it(started: Started) -> None:
    actor, made = ray_pool._Actor(), list[int]()

    def make(key: int, content: bytes) -> int | str:
        made.append(key)
        return actor.make(key, content)

    pool = started(1, make=make, do=actor.do)
    functions = [eval(f"lambda work: {number}") for number in range(FUNCTIONS + 1)]
    few = [functions[number % 3] for number in range(30)]
    assert all(o.error is None for o in pool.run(Task(str(n), f, n) for n, f in enumerate(few)))
    assert len(made) == 3
    assert all(
        o.error is None for o in pool.run(Task(str(n), f, n) for n, f in enumerate(functions))
    )
    assert len(made) == FUNCTIONS + 1
    assert all(o.error is None for o in pool.run([Task("again", functions[0], 0)]))
    assert len(made) == FUNCTIONS + 2  # it was the oldest
