"""What every pool keeps to: one contract, one test."""

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from pfdist.runner.pool import Pool, SerialPool, Task

# A pool's function is made in its workers, which need not know this file.
SQUARE = partial(eval, "lambda work: work ** 2")
INVERSE = partial(eval, "lambda work: 1 / work")
ENVIRONMENT = partial(eval, "lambda work: __import__('os').environ.get(work)")


@pytest.fixture(params=["serial", "ray-1", "ray-2"])
def make_pool(request: pytest.FixtureRequest) -> Callable[[Any], Pool]:
    kind, _, workers = request.param.partition("-")
    if kind == "serial":
        return SerialPool
    request.getfixturevalue("ray_cluster")
    from pfdist.runner.ray_pool import RayPool

    return lambda make_function: RayPool(make_function, int(workers))


def _tasks(count: int) -> Iterator[Task]:
    return (Task(f"task {number}", number) for number in range(count))


def test_every_task_has_one_outcome_with_its_value(make_pool: Callable[[Any], Pool]) -> None:
    with make_pool(SQUARE) as pool:
        outcomes = list(pool.run(_tasks(25)))
    assert sorted(outcome.task.work for outcome in outcomes) == list(range(25))
    assert all(outcome.value == outcome.task.work**2 for outcome in outcomes)
    assert all(outcome.error is None and outcome.seconds >= 0 for outcome in outcomes)
    assert all(outcome.worker and outcome.node for outcome in outcomes)
    assert len({outcome.worker for outcome in outcomes}) <= pool.workers


def test_an_exception_is_an_outcome_with_its_traceback(make_pool: Callable[[Any], Pool]) -> None:
    with make_pool(INVERSE) as pool:
        outcomes = {outcome.task.work: outcome for outcome in pool.run(_tasks(4))}
    assert "ZeroDivisionError" in outcomes[0].error
    assert "Traceback" in outcomes[0].error
    assert outcomes[0].value is None
    assert [outcomes[k].value for k in (1, 2, 3)] == [1, 1 / 2, 1 / 3]


def test_tasks_are_taken_only_as_they_are_needed(make_pool: Callable[[Any], Pool]) -> None:
    taken = []

    def counted() -> Iterator[Task]:
        for task in _tasks(100):
            taken.append(task)
            yield task

    with make_pool(SQUARE) as pool:
        outcomes = pool.run(counted())
        next(outcomes)
        assert len(taken) <= 2 * pool.workers + 1


def test_a_pool_runs_again_and_also_nothing(make_pool: Callable[[Any], Pool]) -> None:
    with make_pool(SQUARE) as pool:
        assert list(pool.run([])) == []
        for count in (1, 3):
            assert len(list(pool.run(_tasks(count)))) == count


def test_ray_workers_have_one_thread_each(ray_cluster: None) -> None:
    from pfdist.runner.ray_pool import RayPool

    names = ["OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"]
    with RayPool(ENVIRONMENT, 1) as pool:
        outcomes = list(pool.run(Task(name, name) for name in names))
    assert {outcome.task.key: outcome.value for outcome in outcomes} == dict.fromkeys(names, "1")


def test_a_ray_worker_that_dies_is_replaced_and_its_tasks_are_done(ray_cluster: None) -> None:
    from pfdist.runner.ray_pool import RayPool

    # Task 3 kills its worker, the first time it is tried.
    kill_once = (
        "lambda work: (__import__('pathlib').Path(work[1]).mkdir(), "
        "__import__('os').kill(__import__('os').getpid(), 9)) "
        "if work[0] == 3 and not __import__('pathlib').Path(work[1]).exists() else work[0]"
    )
    with tempfile.TemporaryDirectory() as folder, RayPool(partial(eval, kill_once), 2) as pool:
        tasks = [Task(f"task {k}", (k, f"{folder}/died")) for k in range(12)]
        outcomes = list(pool.run(tasks))
    assert sorted(outcome.value for outcome in outcomes) == list(range(12))


def test_a_task_that_kills_every_worker_is_given_up_with_an_error(ray_cluster: None) -> None:
    from pfdist.runner.ray_pool import RayPool

    kill = "lambda work: __import__('os').kill(__import__('os').getpid(), 9) if work == 1 else work"
    with RayPool(partial(eval, kill), 2) as pool:
        outcomes = {outcome.task.work: outcome for outcome in pool.run(_tasks(6))}
    assert "died" in outcomes[1].error
    # A neighbour that waited behind it three times may be given up with it; no other is.
    assert sum(outcome.error is None for outcome in outcomes.values()) >= 4
