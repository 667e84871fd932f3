"""Signals by which a user or a batch system asks the program to end."""

import os
import signal
import sys
from types import FrameType

_BATCH_SYSTEMS = (signal.SIGTERM, signal.SIGUSR1)  # send these when the time of a job is up
_received: list[int] = []


def end_at_once() -> None:
    """Let Ctrl-C end the program at once, because no command has begun.

    If Ctrl-C is ignored, as ``nohup`` does, it stays ignored.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def interrupt_command() -> None:
    """Let Ctrl-C and the signals of batch systems raise KeyboardInterrupt in the command."""
    _received.clear()
    for number in _BATCH_SYSTEMS:
        signal.signal(number, _preempt)
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, _interrupt)


def preempted() -> bool:
    """Whether a batch system has asked the program to end."""
    return bool(_received)


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(sys.stderr.fileno(), b"pfdist: interrupted\n")
    os._exit(130)


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # a second Ctrl-C ends it at once
    raise KeyboardInterrupt


def _preempt(number: int, frame: FrameType | None) -> None:
    for repeated in _BATCH_SYSTEMS:  # a script may forward the signal that its group received
        signal.signal(repeated, signal.SIG_IGN)
    _received.append(number)
    raise KeyboardInterrupt
