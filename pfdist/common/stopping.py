"""Signals as data: Ctrl-C and signals of batch systems are recorded, and checked where it is safe.

A handler may raise anywhere, even in callbacks of Numba, ctypes and weak references, which swallow
the exception. Ray replaces handlers, too. So the program has none: all its threads block these
signals, and one thread waits for them. The user gets an answer at once, and a second signal ends
the process at once, even while the main thread compiles.

Loops call `check`. In Python and in notebooks it does nothing, and Ctrl-C raises Python's own
KeyboardInterrupt.
"""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator

from pfdist.common.parent import become_child, received, report_code, say

_CODES: dict[int, int] = {
    signal.SIGINT: 130, signal.SIGTERM: 75, signal.SIGHUP: 75, signal.SIGUSR1: 75,
}  # exit codes  # fmt: skip
_STOPPING = "Stopping after the work in flight; {} again to end now"
# A program, such as a batch script or the parent, may hand on what the whole group has received.
_SAME_SECONDS = 0.2
_NOTICE_SECONDS = 25.0  # Slurm kills 30 s after SIGTERM
_CTRL_C_SECONDS = 2.5  # for the commit of finished work; nobody at a terminal waits for longer
_heard = threading.Event()  # `check` raises
_at_work = threading.Event()  # `check` was called
_received = list[int]()
_noting = list[Callable[[], object]]()
SAVED = " Finished work is saved; run the same command to resume."


def check() -> None:
    """Raise KeyboardInterrupt in the main thread if a signal was received.

    It raises at every call, so a command ends even if the exception is swallowed. Before the first
    call there is nothing to save, so a signal ends the process at once.
    """
    _at_work.set()
    if _heard.is_set() and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


@contextlib.contextmanager
def saved(note: Callable[[], object]) -> Iterator[None]:
    """A context of a command that saves its work: a stop says so, and notes that it is a stop.

    `note` is called at the signal, and again before the process ends in whatever way, because this
    thread may still be at work. So a later kill is no crash.
    """
    _noting.append(note)
    try:
        yield
    finally:
        _noting.remove(note)


def sleep(seconds: float) -> None:
    """Sleep; a signal interrupts this at once with a KeyboardInterrupt."""
    _heard.wait(seconds)
    check()


def answered() -> None:
    """Make `check` stop raising, because the command ends and its last steps call it, too."""
    _heard.clear()


def exit_code() -> int | None:
    """The exit code for the first signal; None if none was received."""
    return _CODES[_received[0]] if _received else None


def listen(*, forks: bool = False) -> None:
    """Record signals from now on; only the program's ``main`` calls this, before it starts threads.

    If `forks` is true, it returns in a child whose parent hands on signals.

    A signal that is ignored, such as SIGINT under ``nohup``, stays ignored. Later threads also
    block the signals, and so do processes that they start without a fork in Python.
    """
    numbers = [each for each in _CODES if signal.getsignal(each) is not signal.SIG_IGN]
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    if forks:
        become_child(numbers)
    # Ray forks to start its servers, which must hear the signals; so must a model's own processes.
    os.register_at_fork(after_in_child=lambda: signal.pthread_sigmask(signal.SIG_SETMASK, before))
    threading.Thread(target=_listen, args=(numbers,), daemon=True).start()


def _listen(numbers: Iterable[int]) -> None:
    """Answer signals: the first stops a command at work, a later one ends the process."""
    number, since = received(numbers)[0], time.monotonic()
    is_at_work = _at_work.is_set()
    if is_at_work:
        name = signal.Signals(number).name
        again = "press Ctrl-C" if number == signal.SIGINT else f"send {name}"
        say(_STOPPING.format(again))  # before the command can end
    _received.append(number)
    _note()
    if is_at_work:
        _heard.set()
        most = _CTRL_C_SECONDS if number == signal.SIGINT else _NOTICE_SECONDS
        threading.Thread(target=_end_after, args=(most,), daemon=True).start()
        while received(numbers)[1] and time.monotonic() - since < _SAME_SECONDS:
            pass
    _end_after(0.0)


def _end_after(seconds: float) -> None:
    time.sleep(seconds)
    _note()
    say(f"Stopped.{SAVED if _noting else ''}")
    os._exit(report_code(_CODES[_received[0]]))


def _note() -> None:
    for note in [*_noting]:
        with contextlib.suppress(Exception):  # whatever is wrong, the process ends
            note()
