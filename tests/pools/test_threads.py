"""The pool of threads: what a thread can do to the process, and the process to its threads."""

import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from pfdist import StateSpaceModel
from pfdist.errors import EngineWarning
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork
from pfdist.pools import threads
from pfdist.pools.base import Task
from pfdist.pools.threads import ThreadPool


def test_compiled_filters_release_pythons_lock(ungm: StateSpaceModel) -> None:
    """Otherwise this thread stands still, and asks for no task, while another one filters."""
    evaluator = Evaluator(ungm, 60)
    work = FilterWork(((0, 30, 60),), (60,), (1,), 2, (0, 1000), Estimation(4000))
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


def test_nothing_ends_a_task_of_a_thread_but_a_warning_says_what_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nobody can tell a thread that hangs from one that is slow because the machine is busy."""
    monkeypatch.setattr(threads, "LONG_SECONDS", 0.3)
    tasks = [Task("long", time.sleep, 1.5)]
    tasks += [Task(str(number), abs, -number) for number in range(50)]
    says = pytest.warns(EngineWarning, match=r"task long has run for \d+ s")
    with says as said, ThreadPool(2) as pool:
        assert len(list(pool.run(tasks))) == 51
    assert 1 <= len(said) <= 3  # after .3, .6 and 1.2 s


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
