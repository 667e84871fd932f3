"""The pool of threads: what a thread can do to the process, and the process to its threads."""

import subprocess
import sys
import time

import pytest

from pfdist import StateSpaceModel
from pfdist.errors import EngineWarning
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork
from pfdist.pools import base, threads
from pfdist.pools.base import Task
from pfdist.pools.threads import ThreadPool


def test_compiled_filters_release_pythons_lock(
    ungm: StateSpaceModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise this thread stands still, and sees no signal, while another one filters."""
    evaluator, looks = Evaluator(ungm, 60), list[object]()
    work = FilterWork(((0, 30, 60),), (60,), (1,), 2, (0, 1000), Estimation(4000))
    evaluator.compile(work.estimation)
    monkeypatch.setattr(base, "WAIT_SECONDS", 0.01)
    with ThreadPool(1) as pool:
        monkeypatch.setattr(pool, "_warn_of_long_tasks", lambda: looks.append(None))
        (outcome,) = pool.run([Task("a", evaluator.filtered, work)])
    assert outcome.error is None
    assert len(looks) > 5


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
