"""Signals as data: Ctrl-C and signals of batch systems are noted, and looked at where it is safe.

A handler that raises does so wherever Python happens to be, also in callbacks of Numba, ctypes and
weak references, which swallow it. So the program's handlers do nothing. Python writes the number of
each signal to a pipe (`signal.set_wakeup_fd`), and a thread reads it. So the user gets an answer at
once, and a second signal ends the process at once, also while the main thread compiles.

Loops call `check`. In Python and in notebooks nobody listens: `check` does nothing, and Ctrl-C is
Python's own KeyboardInterrupt.
"""

import atexit
import contextlib
import os
import select
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

_CODES: dict[int, int] = {signal.SIGINT: 130, signal.SIGTERM: 75, signal.SIGUSR1: 75}  # exit codes
_STOPPING = "Stopping after the work in flight; press Ctrl-C again to end now"
# A batch script may hand on the signal that its whole group has received.
_SAME_SECONDS = 1.0
_NOTICE_SECONDS = 25.0  # Slurm kills 30 s after SIGTERM


@dataclass
class _Signals:
    """What is known of the signals of this process."""

    first: int | None = None  # the signal that was received first
    since: float = 0.0
    at_work: bool = False  # whether `check` was called since the command began
    heard: threading.Event = field(default_factory=threading.Event)  # whether `check` raises
    notice: float | None = None  # seconds until the process ends, whatever it does
    before: dict[int, Any] = field(default_factory=dict)  # the handlers that ours replace


_signals = _Signals()


def check() -> None:
    """Raise KeyboardInterrupt in the main thread if a signal was received.

    It raises at every call, so a command ends even if something swallows the exception. Before the
    first call nothing is at stake, and a signal ends the process at once.
    """
    _signals.at_work = True
    if _signals.heard.is_set() and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


def sleep(seconds: float) -> None:
    """Sleep; a signal ends this at once, by a KeyboardInterrupt."""
    _signals.heard.wait(seconds)
    check()


def answered() -> None:
    """Let `check` raise no longer, because the command ends, and its last work needs loops."""
    _signals.heard.clear()


def exit_code() -> int | None:
    """The exit code that the first signal demands; None if none was received."""
    return None if _signals.first is None else _CODES[_signals.first]


def renew() -> None:
    """Set the handlers again, because Ray has set others."""
    for number in _signals.before:
        signal.signal(number, _noted)


@contextlib.contextmanager
def listening(*, ends: bool) -> Iterator[None]:
    """Note signals inside a with statement; only the program's ``main`` does so.

    A signal that is ignored, as SIGINT by ``nohup``, stays ignored. `ends` says whether the process
    ends afterwards. If not, the former handlers are set again.
    """
    if threading.current_thread() is not threading.main_thread():  # Python sets no handlers there
        yield
        return
    reader, writer = os.pipe()  # children do not inherit it
    os.set_blocking(writer, False)
    listener = threading.Thread(target=_listen, args=(reader,), daemon=True)
    listener.start()
    wakeup = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in _CODES:
        if (handler := signal.getsignal(number)) is not signal.SIG_IGN:
            _signals.before[number] = handler or signal.SIG_DFL
    _signals.at_work = False
    renew()
    if ends:
        atexit.register(_ignore)  # before Ray is imported: so it is called last
    try:
        yield
    finally:
        _signals.at_work = False
        if not ends:
            signal.set_wakeup_fd(wakeup)
            os.close(writer)  # this ends the thread
            listener.join()
            _restore(wakeup)


def _noted(number: int, frame: FrameType | None) -> None:
    """Do nothing: Python has written the number to the pipe."""


def _listen(reader: int) -> None:
    with open(reader, "rb", buffering=0) as pipe:
        while True:
            if not select.select([pipe], [], [], _signals.notice)[0]:
                _end()
            if not (numbers := pipe.read(64)):
                return
            for number in numbers:
                if number in _signals.before:
                    _receive(number)


def _receive(number: int) -> None:
    """Answer a signal: the first stops a command at work, a later one ends the process."""
    now = time.monotonic()
    if _signals.first is None:
        _signals.first, _signals.since = number, now
        if _signals.at_work:
            _signals.notice = None if number == signal.SIGINT else _NOTICE_SECONDS
            _signals.heard.set()
            _say(_STOPPING)
            return
        _say("Stopped.")
    elif number != signal.SIGINT and now - _signals.since < _SAME_SECONDS:
        return
    _end()


def _end() -> None:
    os._exit(exit_code() or 0)


def _say(line: str) -> None:
    """Write a line to standard error, unless it is closed, or nobody reads it."""
    with contextlib.suppress(OSError):
        if select.select([], [2], [], 0)[1]:  # to wait here would leave the next signal unanswered
            begin = "\n" * os.isatty(2)  # the cursor may stand behind a progress bar
            os.write(2, f"{begin}pfdist: {line}\n".encode())


def _restore(wakeup: int) -> None:
    """Set the former handlers again, and forget what was received."""
    signal.set_wakeup_fd(wakeup)
    for number, handler in _signals.before.items():
        signal.signal(number, handler)
    vars(_signals).update(vars(_Signals()))


def _ignore() -> None:
    """Ignore signals while the interpreter ends, because its last work comes after handlers."""
    for number in _signals.before:
        signal.signal(number, signal.SIG_IGN)


def _forked() -> None:
    """Forget the signals in a child process, which writes into its parent's pipe otherwise."""
    if _signals.before:
        _restore(-1)


os.register_at_fork(after_in_child=_forked)
