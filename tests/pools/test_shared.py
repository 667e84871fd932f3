"""Several threads have their tasks done by the same workers."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import pytest

from pfdist.errors import PoolError
from pfdist.pools.base import Outcome, Pool, SerialPool, Task
from pfdist.pools.shared import Member, SharedPool

PATIENCE_SECONDS = 30.0


def square(work: tuple[str, int]) -> tuple[str, int]:
    name, number = work
    if number < 0:
        raise ValueError("negative")
    return name, number**2


@contextmanager
def serial() -> Iterator[Pool]:
    with SerialPool(lambda: square) as pool:
        yield pool


def tasks(count: int) -> list[Task]:
    return [Task(f"{number}", number) for number in range(count)]


def served(pool: SharedPool, *bodies: Callable[[int], object]) -> list[threading.Thread]:
    """Serve members in threads, each of which is told its rank."""
    threads = [
        threading.Thread(target=body, args=[rank], daemon=True) for rank, body in enumerate(bodies)
    ]
    for thread in threads:
        thread.start()
    try:
        pool.serve(lambda: not any(thread.is_alive() for thread in threads))
    finally:
        for thread in threads:
            thread.join(PATIENCE_SECONDS)
    return threads


def named(rank: int) -> Callable[[int], tuple[str, int]]:
    return lambda work: (f"member {rank}", work)


def test_each_member_gets_the_outcomes_of_its_own_tasks() -> None:
    shared, found = SharedPool(serial()), dict[int, list[Outcome]]()

    def member(rank: int) -> None:
        with shared.join(rank, named(rank)) as pool:
            assert pool.workers == 1
            found[rank] = list(pool.run(tasks(20 + rank)))

    served(shared, member, member, member)
    for rank, outcomes in found.items():
        assert sorted(outcome.value[1] for outcome in outcomes) == [n**2 for n in range(20 + rank)]
        assert {outcome.value[0] for outcome in outcomes} == {f"member {rank}"}
        assert all(outcome.task in tasks(20 + rank) for outcome in outcomes)  # as it was handed in


def test_the_pool_of_members_without_tasks_is_never_entered() -> None:
    entered, ended = list[str](), list[int]()

    @contextmanager
    def noted() -> Iterator[Pool]:
        entered.append("pool")
        with serial() as pool:
            yield pool

    served(SharedPool(noted()), ended.append, ended.append)
    assert sorted(ended) == [0, 1]
    assert entered == []


def test_tasks_of_the_first_member_go_first() -> None:
    """While the first member has tasks, those of the second wait."""

    @contextmanager
    def slow() -> Iterator[Pool]:
        with SerialPool(lambda: lambda work: time.sleep(0.005) or square(work)) as pool:
            yield pool

    shared, done, both = SharedPool(slow()), list[str](), threading.Barrier(2)

    def member(rank: int) -> None:
        with shared.join(rank, named(rank)) as pool:
            both.wait(PATIENCE_SECONDS)
            done.extend(outcome.value[0] for outcome in pool.run(tasks(100)))
            done.append(f"end {rank}")

    served(shared, member, member)
    assert done.index("end 0") < done.index("end 1")
    before = done[: done.index("end 0")]
    assert before.count("member 1") < 0.2 * before.count("member 0")


def test_an_exception_of_the_function_is_an_outcome() -> None:
    shared, found = SharedPool(serial()), list[Outcome]()

    def member(rank: int) -> None:
        with shared.join(rank, named(rank)) as pool:
            found.extend(pool.run([Task("wrong", -1), Task("right", 2)]))

    served(shared, member)
    errors = {outcome.task.key: outcome.error for outcome in found}
    assert errors["right"] is None
    assert errors["wrong"] is not None
    assert "negative" in errors["wrong"]


def test_a_member_may_break_off_and_go_on_with_other_tasks() -> None:
    shared, found = SharedPool(serial()), list[int]()

    def member(rank: int) -> None:
        with shared.join(rank, named(rank)) as pool:
            first = pool.run(tasks(50))
            next(first)
            first.close()
            found.extend(outcome.value[1] for outcome in pool.run([Task("0", 5), Task("1", 6)]))

    served(shared, member)
    assert sorted(found) == [25, 36]


class Broken:
    """A pool that fails after some tasks."""

    workers = 2

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
        for number, task in enumerate(tasks):
            if task is None:
                return
            if number == 3:
                raise PoolError("no worker has answered")
            yield Outcome(task, None, 0.0, "", "")


def test_a_pool_that_fails_ends_every_member() -> None:
    @contextmanager
    def broken() -> Iterator[Pool]:
        yield Broken()  # type: ignore[misc]

    shared, errors = SharedPool(broken()), dict[int, str]()

    def member(rank: int) -> None:
        try:
            with shared.join(rank, named(rank)) as pool:
                list(pool.run(tasks(100)))
                pytest.fail("it has ended without an error")
        except PoolError as error:
            errors[rank] = str(error)

    with pytest.raises(PoolError, match="no worker has answered"):
        served(shared, member, member)
    assert errors == dict.fromkeys(range(2), "no worker has answered")


def test_members_that_come_later_have_the_same_pool_which_is_left_once() -> None:
    happened, found = list[str](), dict[int, int]()

    @contextmanager
    def noted() -> Iterator[Pool]:
        happened.append("entered")
        with serial() as pool:
            yield pool
        happened.append("left")

    def member(rank: int) -> None:
        with shared.join(rank, named(rank)) as pool:
            found[len(found)] = len(list(pool.run(tasks(20))))

    with SharedPool(noted()) as shared:
        served(shared, member, member)
        served(shared, member)
        assert happened == ["entered"]
    assert happened == ["entered", "left"]
    assert list(found.values()) == [20] * 3


def test_the_error_of_a_thread_that_never_joined_ends_serving() -> None:
    def fails(rank: int) -> None:
        shared.fail(OSError("no such disk"))

    with SharedPool(serial()) as shared, pytest.raises(OSError, match="no such disk"):
        served(shared, fails)


def test_an_interrupt_ends_every_member() -> None:
    @contextmanager
    def interrupted() -> Iterator[Pool]:
        raise KeyboardInterrupt
        yield

    shared, ended = SharedPool(interrupted()), list[int]()

    def member(rank: int) -> None:
        try:
            shared.join(rank, named(rank))
        except KeyboardInterrupt:
            ended.append(rank)

    with pytest.raises(KeyboardInterrupt):
        served(shared, member, member)
    assert sorted(ended) == [0, 1]


@pytest.mark.slow
def test_workers_of_ray_idle_hardly_while_a_member_pauses(ray_cluster: None) -> None:
    """The other member's tasks fill the pause: together they take as long as their tasks."""
    from pfdist.pools.ray_pool import RayPool

    shared, workers = SharedPool(RayPool(lambda: time.sleep, 2)), list[Member]()  # type: ignore[arg-type]
    ends = dict[int, float]()

    def member(rank: int) -> None:
        with shared.join(rank, lambda seconds: seconds) as pool:
            workers.append(pool)
            for _ in range(5):
                outcomes = list(pool.run([Task(f"{k}", 0.1) for k in range(4)]))
                assert [outcome.error for outcome in outcomes] == [None] * 4
                time.sleep(0.2 * (rank == 0))  # the first member thinks
            ends[rank] = time.monotonic()

    served(shared, member, member)
    assert {pool.workers for pool in workers} == {2}
    assert set(ends) == {0, 1}
