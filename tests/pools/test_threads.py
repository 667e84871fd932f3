"""The pool of threads: what a thread can do to the process, and the process to its threads."""

import subprocess
import sys
import time
from collections.abc import Iterator
from threading import Event
from typing import Any

import pytest

from pfdist import StateSpaceModel
from pfdist.errors import SilenceError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, Work
from pfdist.pools import base
from pfdist.pools.base import Task
from pfdist.pools.threads import ThreadPool


def test_compiled_filters_release_pythons_lock(ungm: StateSpaceModel) -> None:
    """Otherwise this thread stands still, and asks for no task, while another one filters."""
    evaluator = Evaluator(ungm, 60)
    work = Work(((0, 30, 60),), (60,), (1,), 2, (0, 1000), Estimation(4000))
    evaluator.compile(work.estimation)
    with ThreadPool(1) as pool:
        task = Task("a", evaluator.filtered, work)
        asked = 0

        def tasks() -> Iterator[Task | None]:
            nonlocal asked
            yield task
            while True:
                asked += 1
                yield None

        (outcome,) = pool.run(tasks())
    assert outcome.error is None
    assert asked > 5


def test_a_thread_that_is_silent_ends_the_run_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(base, "PATIENCE_SECONDS", 2.0)
    monkeypatch.setattr(base, "LOOK_SECONDS", 0.1)
    go_on = Event()
    tasks = [Task("hangs", lambda work: go_on.wait(), None)]
    tasks += [Task(str(number), abs, -number) for number in range(50)]
    outcomes = list[Any]()
    with (
        pytest.raises(SilenceError, match=r"a thread has not answered for"),
        ThreadPool(2) as pool,
    ):
        outcomes.extend(outcome.value for outcome in pool.run(tasks))
    assert sorted(outcomes) == list(range(50))
    go_on.set()


def test_threads_that_stood_still_with_the_process_are_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As if a batch system had suspended the process for a while."""
    monkeypatch.setattr(base, "PATIENCE_SECONDS", 0.5)
    monkeypatch.setattr(base, "LOOK_SECONDS", 0.1)
    monkeypatch.setattr(base, "STILL_SECONDS", 0.3)
    with ThreadPool(2) as pool:
        run = pool.run(Task(str(n), time.sleep, s) for n, s in enumerate([0.01, 1.2, 0.01, 0.01]))
        next(run)
        time.sleep(1.0)  # nobody looks
        assert len(list(run)) == 3


HANGS = """
import sys
from pfdist.pools.base import Task
from pfdist.pools.threads import ThreadPool

def function(work):
    while True:
        pass

with ThreadPool(2) as pool:
    for outcome in pool.run([Task("a", abs, -1), Task("b", function, None)]):
        sys.exit(3)
"""


def test_a_thread_that_never_ends_does_not_keep_the_process() -> None:
    done = subprocess.run([sys.executable, "-c", HANGS], check=False, timeout=300)
    assert done.returncode == 3
