"""A small parent owns the exit code of the program, whatever ends the process that computes.

A library in C++ may end its process with any exit code and without a line, as Ray does when one of
its servers is lost; a model may crash its process. So the program forks before it has threads and
large libraries. The child computes, and reports its exit code through a pipe before it ends. If it
ends without a report, the parent says so.

A terminal sends Ctrl-C to both, so the parent hands on only signals that another program sent. The
child ends with the parent.
"""

import atexit
import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Iterable
from typing import NoReturn

_AGAIN = 75  # EX_TEMPFAIL: the same command may be started again
_MOST_REPORTS = 64
_pipes = list[int]()  # to the parent; empty in Python and in notebooks
_reported = list[int]()


def report_code(code: int) -> int:
    """Report to the parent the exit code with which this process is about to end; give it back."""
    _reported.append(code)
    for pipe in _pipes:
        with contextlib.suppress(OSError):  # the parent has ended
            os.write(pipe, bytes([code]))
    return code


def received(numbers: Iterable[int]) -> tuple[int, bool]:
    """Wait for one of some signals; give its number, and whether a program sent it."""
    if sys.platform == "darwin":  # it does not say who sent a signal
        number = signal.sigwait(numbers)
        return number, number != signal.SIGINT
    info = signal.sigwaitinfo(numbers)
    # See sigaction(2). The kernel tells only the session's leader that a terminal is closed.
    return info.si_signo, info.si_code <= 0 or info.si_signo == signal.SIGHUP


def say(line: str) -> None:
    """Write a line to standard error, unless it is closed, or nobody reads it."""
    with contextlib.suppress(OSError):
        if select.select([], [2], [], 0)[1]:  # to wait here would leave the next signal unanswered
            begin = "\n" * os.isatty(2)  # the cursor may stand behind a progress bar
            os.write(2, f"{begin}pfdist: {line}\n".encode())


def become_child(numbers: Iterable[int]) -> None:
    """Fork; only the child returns. The parent hands on these signals, which must be blocked."""
    if sys.platform == "darwin":  # the parent could not tell Ctrl-C from other signals
        return
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # if it were ignored, there would be no exit code
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCHLD])
    reports, pipe = os.pipe()
    if child := os.fork():
        os.close(pipe)
        _attend(child, reports, [*numbers, signal.SIGCHLD])
    os.close(reports)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])
    _pipes.append(pipe)
    atexit.register(_end)  # first, so it comes last
    threading.Thread(target=_end_with_parent, args=(pipe,), daemon=True).start()


def _end() -> None:
    """End before the destructors of C++: one that finds a thread, as Arrow has, would abort."""
    if _reported:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):  # it is full, or closed
                stream.flush()
        os._exit(_reported[-1])


def _end_with_parent(pipe: int) -> None:
    parent = select.poll()
    parent.register(pipe, 0)
    parent.poll()  # until nobody can read from it
    os._exit(1)


def _attend(child: int, reports: int, numbers: Iterable[int]) -> NoReturn:
    """Hand on signals until the child has ended, and end as it did."""
    ended = 0
    while not ended:
        number, by_program = received(numbers)
        if number == signal.SIGCHLD:  # it may also have stopped
            ended, status = os.waitpid(child, os.WNOHANG)
        elif by_program:
            os.kill(child, number)
    os.set_blocking(reports, False)  # another process may have the pipe
    with contextlib.suppress(BlockingIOError):
        if reported := os.read(reports, _MOST_REPORTS):
            os._exit(reported[-1])
    code = os.waitstatus_to_exitcode(status)
    how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
    say(
        f"The process that computes ended {how} and without a message: a library or the model "
        "ended it, or memory ran out. Finished work is saved; run the same command to resume."
    )
    os._exit(_AGAIN)
