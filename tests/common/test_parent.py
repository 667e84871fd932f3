"""A small parent owns the exit code: whatever ends its child, and each signal is received once."""

import fcntl
import os
import pty
import signal
import subprocess
import sys
import termios
import time

import psutil
import pytest

from oracles import stopped

CODES = [(signal.SIGINT, 130), (signal.SIGTERM, 75), (signal.SIGHUP, 75)]
STOPPING = {number: f"{line}\n" for number, line in stopped.STOPPING.items()}
STOPPED = f"{stopped.STOPPED}\n"
ENDED = (
    "pfdist: The process that computes ended {} and without a message: a library or the model "
    "ended it, or memory ran out. Finished work is saved; run the same command to resume.\n"
)
# As a terminal starts a program: a shell's background jobs ignore SIGINT, and `nohup` SIGHUP.
PROGRAM = """
import ctypes, os, signal, sys, threading, time
from pfdist.common import stopping
from pfdist.common.parent import report_code
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGCHLD, signal.{chld})
stopping.listen(forks=True)
try:
    {lines}
except KeyboardInterrupt:
    code = stopping.exit_code()
    time.sleep(0.5)  # a second signal would end it here
    sys.exit(report_code(code))
"""
WAITS = "stopping.check(); print(os.getpid(), flush=True); stopping.sleep(60.0)"


def started(lines: str, chld: str = "SIG_DFL", **options: object) -> "subprocess.Popen[str]":
    command = [sys.executable, "-c", PROGRAM.format(lines=lines, chld=chld)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, **(pipes | options))  # type: ignore[call-overload, no-any-return]


def done(lines: str, chld: str = "SIG_DFL") -> tuple[int, str]:
    with started(lines, chld) as process:
        _, error = process.communicate(timeout=60)
    return process.returncode, error


@pytest.mark.parametrize(
    ("lines", "how", "chld"),
    [
        ("os._exit(1)", "with exit code 1", "SIG_DFL"),  # as Ray's C++ does
        ("os._exit(0)", "with exit code 0", "SIG_IGN"),
        ("ctypes.string_at(0)", "by SIGSEGV", "SIG_IGN"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "by SIGKILL", "SIG_DFL"),
    ],
)
def test_an_end_without_a_report_is_one_line_and_75(lines: str, how: str, chld: str) -> None:
    assert done(lines, chld) == (75, ENDED.format(how))


def test_a_reported_exit_code_stays_whatever_ends_the_process_afterwards() -> None:
    assert done("report_code(0); os.abort()") == (0, "")
    assert done("report_code(2); os._exit(1)") == (2, "")
    assert done("report_code(0); report_code(3); sys.exit(report_code(3))") == (3, "")


def test_no_destructor_of_c_runs_after_a_report() -> None:
    """Threads of C++ that their destructor finds would end the process with SIGABRT."""
    destroys = "import atexit; atexit.register(print, 'last'); c = ctypes.CDLL(None); "
    destroys += "c.on_exit(c.psignal, b'a destructor'); "  # it would write this
    with started(destroys + "sys.exit(report_code(0))") as process:
        assert process.communicate(timeout=60) == ("last\n", "")
    assert process.returncode == 0


def test_processes_that_the_child_leaves_delay_no_end() -> None:
    """A fork has the pipe, too, and this one lives for longer than the test waits."""
    left = "import warnings; warnings.simplefilter('ignore'); "  # of threads, since Python 3.12
    left += "os.fork() or (os.close(1), os.close(2), time.sleep(100)); os._exit(1)"
    start = time.monotonic()
    assert done(left) == (75, ENDED.format("with exit code 1"))
    assert time.monotonic() - start < 60


@pytest.mark.parametrize(
    ("receiver", "number", "code"),
    [(each, *CODES[0]) for each in ("parent", "child", "group")] + [("group", *CODES[2])],
)
def test_a_signal_to_the_parent_the_child_or_their_group_is_received_once(
    number: signal.Signals, code: int, receiver: str
) -> None:
    with started(WAITS, start_new_session=True) as process:
        assert process.stdout is not None
        child = int(process.stdout.readline())
        os.kill({"parent": process.pid, "child": child, "group": -process.pid}[receiver], number)
        _, error = process.communicate(timeout=60)
        assert (process.returncode, error) == (code, STOPPING[number])


def test_a_second_signal_to_the_parent_ends_at_once() -> None:
    lines = "stopping.check(); print(os.getpid(), flush=True); time.sleep(60)"
    with started(lines) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        assert process.stderr is not None
        assert process.stderr.readline() == STOPPING[signal.SIGTERM]
        time.sleep(0.3)  # what programs repeat sooner counts once
        process.send_signal(signal.SIGINT)
        assert (process.wait(60), process.stderr.read()) == (75, STOPPED)


@pytest.mark.parametrize(
    ("keys", "said"),
    [(b"\x03", [STOPPING[signal.SIGINT]]), (b"\x03\x03", [STOPPING[signal.SIGINT], STOPPED])],
)
def test_ctrl_c_of_a_terminal_is_received_once(keys: bytes, said: list[str]) -> None:
    """Twice ends at once, however soon the second comes: a terminal repeats nothing."""
    terminal, inside = pty.openpty()
    own = {"preexec_fn": lambda: fcntl.ioctl(inside, termios.TIOCSCTTY, 0)}  # its terminal
    with started(WAITS, stdin=inside, start_new_session=True, **own) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        for number, key in enumerate(keys):
            os.write(terminal, bytes([key]))
            assert process.stderr.readline() == said[number]
        assert (process.wait(60), process.stderr.read()) == (130, "")
    os.close(terminal)
    os.close(inside)


def test_a_terminal_that_is_closed_is_a_stop() -> None:
    """The kernel sends SIGHUP to all processes of the terminal."""
    terminal, inside = pty.openpty()
    own = {"preexec_fn": lambda: fcntl.ioctl(inside, termios.TIOCSCTTY, 0)}
    with started(WAITS, stdin=inside, start_new_session=True, **own) as process:
        assert process.stdout is not None
        process.stdout.readline()
        os.close(terminal)
        assert process.communicate(timeout=60) == ("", STOPPING[signal.SIGHUP])
    assert process.returncode == 75
    os.close(inside)


def test_the_child_ends_with_its_parent() -> None:
    with started(WAITS) as process:
        assert process.stdout is not None
        child = psutil.Process(int(process.stdout.readline()))
        process.kill()
        assert process.wait(60) == -signal.SIGKILL
        child.wait(60)  # an error if it lives any longer
