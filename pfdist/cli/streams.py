"""Standard streams that may be closed, full, or read by nobody."""

import io
import os
import sys
from typing import Any

_NAMES = ("stdin", "stdout", "stderr")


class _Deaf(io.FileIO):
    """A file that takes what is written, though it may keep nothing."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


def make_harmless() -> None:
    """Have closed standard streams go nowhere, and no write to standard error fail.

    What is opened takes the lowest number that is free: where standard error is closed, this could
    be a file of a run, in which libraries would then write their messages.
    """
    for number, name in enumerate(_NAMES):
        try:
            os.fstat(number)
        except OSError:  # closed; the numbers below are taken, so that this one is the next
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w" if number else "r", encoding="utf-8"))  # noqa: SIM115
    if sys.stderr is sys.__stderr__ and isinstance(sys.stderr, io.TextIOWrapper):
        encoding, errors = sys.stderr.encoding, sys.stderr.errors
        quiet: Any = _Deaf(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = io.TextIOWrapper(quiet, encoding, errors, write_through=True)


def flush_output() -> None:
    """Write what has been printed; the interpreter would do so too late to say what went wrong.

    Raises
    ------
    OSError
        It cannot be written. What is left of it is given up.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        if sys.stdout is sys.__stdout__:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            os.close(nowhere)
        if isinstance(error, BrokenPipeError):
            raise
        raise OSError(f"standard output cannot be written: {error.strerror}") from error
