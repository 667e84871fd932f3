"""Signals as data: where they are answered, and that nothing else hears them."""

import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from oracles import stopped
from pfdist.cli.main import main
from pfdist.common import stopping
from pfdist.problem.sections import Execution
from pfdist.questions.at_work import noted

CODES = [(signal.SIGINT, 130), (signal.SIGTERM, 75), (signal.SIGHUP, 75), (signal.SIGUSR1, 75)]
STOPPING = {number: f"{line}\n" for number, line in stopped.STOPPING.items()}
STOPPED = f"{stopped.STOPPED}\n"
# As a terminal starts a program: a shell's background jobs ignore SIGINT, and `nohup` SIGHUP.
PROGRAM = """
import os, signal, sys, threading, time
from pfdist.common import stopping
from pfdist.common.stopping import check, exit_code
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
{before}
def send(number):
    os.kill(os.getpid(), number)
    time.sleep(0.05)
def heard(number):
    check()
    send(number)
    while exit_code() is None:
        time.sleep(0.001)
stopping.listen()
{lines}
"""


def done(lines: str, before: str = "") -> tuple[int, str, str]:
    """Exit code and output of a program that listens, then runs some lines."""
    # From Python 3.12 on, a fork beside a thread, as that which listens, is warned about.
    options = ["-W", "ignore::DeprecationWarning"]
    command = [sys.executable, *options, "-c", PROGRAM.format(before=before, lines=lines)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return ended.returncode, ended.stdout, ended.stderr


@pytest.mark.parametrize(("number", "code"), CODES)
def test_a_signal_is_raised_where_it_is_looked_at_and_nowhere_else(
    number: signal.Signals, code: int
) -> None:
    lines = f"""
heard({number:d})
for look in (check, check, lambda: stopping.sleep(600.0)):  # also after the first was swallowed
    try:
        look()
    except KeyboardInterrupt:
        print("raised")
stopping.answered()
check()
sys.exit(exit_code())
"""
    assert done(lines) == (code, "raised\n" * 3, STOPPING[number])


@pytest.mark.parametrize(("number", "code"), CODES)
def test_a_signal_before_the_first_look_ends_the_process_at_once(
    number: signal.Signals, code: int
) -> None:
    assert done(f"send({number:d}); time.sleep(600)") == (code, "", STOPPED)


def test_a_second_signal_ends_the_process_at_once_with_the_code_of_the_first() -> None:
    again = "heard(signal.{}); send(signal.{}); time.sleep(600)"
    late = "stopping._SAME_SECONDS = 0.0"
    assert done(again.format("SIGINT", "SIGINT"), late) == (
        130,
        "",
        STOPPING[signal.SIGINT] + STOPPED,
    )
    assert done(again.format("SIGTERM", "SIGINT"), late) == (
        75,
        "",
        STOPPING[signal.SIGTERM] + STOPPED,
    )


@pytest.mark.parametrize(("number", "code"), CODES)
def test_a_signal_that_a_program_hands_on_at_once_counts_once(
    number: signal.Signals, code: int
) -> None:
    lines = f"""
stopping._SAME_SECONDS = 60.0
heard({number:d})
send({number:d})
send({number:d})
print("alive", flush=True)
stopping._SAME_SECONDS = 0.0  # as if it were later
send({number:d})
time.sleep(600)
"""
    assert done(lines) == (code, "alive\n", STOPPING[number] + STOPPED)


def test_after_the_notice_of_a_batch_system_the_process_ends_whatever_it_does() -> None:
    lines = "heard(signal.SIGUSR1); time.sleep(600)"
    assert done(lines, "stopping._NOTICE_SECONDS = 0.1") == (
        75,
        "",
        STOPPING[signal.SIGUSR1] + STOPPED,
    )


def test_a_stop_in_the_middle_of_long_work_is_noted_and_says_that_work_is_saved() -> None:
    """At once, so that even a kill after it is no crash; and before the process ends."""
    lines = """
with stopping.saved(lambda: print("noted", flush=True)), stopping.saved(lambda: 1 / 0):
    heard(signal.SIGINT)
    time.sleep(600)
"""
    saved = STOPPED.rstrip() + stopping.SAVED + "\n"
    once = "stopping._CTRL_C_SECONDS = 0.1"
    assert done(lines, once) == (130, "noted\n" * 2, STOPPING[signal.SIGINT] + saved)
    by_kill = "with stopping.saved(lambda: os.kill(os.getpid(), 9)): heard(signal.SIGTERM)"
    assert done(by_kill)[0] == -signal.SIGKILL  # it was noted before anything else


def test_the_mark_of_a_process_at_work_is_gone_once_it_was_stopped(tmp_path: Path) -> None:
    job, said = SimpleNamespace(execution=Execution(pool="serial")), list[str]()
    built = SimpleNamespace(evaluator=SimpleNamespace(engine="compiled"), job=job)
    store = SimpleNamespace(path=tmp_path)
    session: Any = SimpleNamespace(store=store, built=built, say=said.append)
    with noted(session):
        assert (tmp_path / ".begun").exists()
        stopping._note()
        assert not (tmp_path / ".begun").exists()
    with noted(session):
        pass
    assert said == []
    (tmp_path / ".begun").touch()
    with noted(session):
        pass
    assert "ended without a message" in said[0]


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    ignore = "signal.signal(signal.SIGINT, signal.SIG_IGN)"  # as `nohup` does
    lines = "check(); send(signal.SIGINT); check(); heard(signal.SIGTERM); sys.exit(exit_code())"
    assert done(lines, ignore) == (75, "", STOPPING[signal.SIGTERM])


@pytest.mark.parametrize("handler", ["signal.SIG_DFL", "lambda *_: sys.exit(1)"])
def test_handlers_that_a_library_sets_change_nothing(handler: str) -> None:
    lines = (
        f"signal.signal(signal.SIGTERM, {handler}); heard(signal.SIGTERM); sys.exit(exit_code())"
    )
    assert done(lines) == (75, "", STOPPING[signal.SIGTERM])


def test_a_forked_child_ends_by_a_signal_that_its_parent_does_not_hear() -> None:
    lines = """
check()
for number in (signal.SIGTERM, signal.SIGUSR1):
    child = os.fork()
    if not child:
        time.sleep(600)
    os.kill(child, number)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
check()
"""
    assert done(lines) == (0, f"{-signal.SIGTERM}\n{-signal.SIGUSR1}\n", "")


def test_no_thread_but_the_main_one_is_interrupted() -> None:
    lines = """
heard(signal.SIGTERM)
thread = threading.Thread(target=lambda: print("passed", check()))
thread.start()
thread.join()
"""
    assert done(lines) == (0, "passed None\n", STOPPING[signal.SIGTERM])


def test_a_command_that_python_calls_listens_to_nothing() -> None:
    numbers = [number for number, _ in CODES]
    before = [signal.getsignal(number) for number in numbers], signal.pthread_sigmask(0, [])
    threads = threading.active_count()
    assert main([]) == 0
    assert threading.active_count() == threads
    assert ([*map(signal.getsignal, numbers)], signal.pthread_sigmask(0, [])) == before
    stopping.check()
    assert stopping.exit_code() is None


def test_the_program_has_no_other_thread_when_it_begins_to_listen() -> None:
    lines = 'import pfdist.cli.main; print(os.listdir("/proc/self/task") == [str(os.getpid())])'
    command = [sys.executable, "-c", f"import os; {lines}"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "True\n"
