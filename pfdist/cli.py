"""The command line: parse, call, and say what went wrong; no logic."""

import contextlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any

from pfdist.errors import EngineWarning, PfdistError, TaskError
from pfdist.runner.streams import flush_output, make_harmless

_GO_ON = "what was done is committed; the same command goes on from there"


_preempted: list[int] = []  # signals by which a batch system has asked for the machine


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        In the place of the process's own.

    Returns
    -------
    int
        The exit code.
    """
    make_harmless()
    # As by nohup, it may be ignored.
    listens = signal.getsignal(signal.SIGINT) in (signal.default_int_handler, _leave)
    if listens:
        signal.signal(signal.SIGINT, _leave)
    # Here and not above: it takes a second, in which one may be asked to end.
    from pfdist.arguments import make_parser  # noqa: PLC0415

    options = make_parser().parse_args(arguments)
    _preempted.clear()
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, _preempt)
    if listens:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        with _warnings_as_lines():
            options.command(options)
            flush_output()
    except PfdistError as error:
        if options.debug:
            raise
        print(f"pfdist: {_one_line(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        ended = "asked to end" if _preempted else "interrupted"
        go_on = f"; {_GO_ON}" if options.goes_on else ""
        print(f"pfdist: {ended}{go_on}", file=sys.stderr)
        return 75 if _preempted else 130
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        sys.stderr.close()
        return 1
    except OSError as error:
        print(f"pfdist: {_unwritten() or error}", file=sys.stderr)
        return 1
    except MemoryError:
        print("pfdist: not enough memory: fewer draws or particles need less", file=sys.stderr)
        return 1
    return 0


def _unwritten() -> OSError | None:
    """Give what is wrong with standard output, if something is."""
    try:
        flush_output()
    except OSError as error:
        return error
    return None


def _leave(number: int, frame: FrameType | None) -> None:
    """Nothing has begun."""
    os.write(sys.stderr.fileno(), b"pfdist: interrupted\n")
    os._exit(130)


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # asked twice: at once
    raise KeyboardInterrupt


def _preempt(number: int, frame: FrameType | None) -> None:
    for again in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(again, signal.SIG_IGN)  # it is said twice where a script forwards it
    _preempted.append(number)
    raise KeyboardInterrupt


@contextlib.contextmanager
def _warnings_as_lines() -> Iterator[None]:
    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"pfdist: warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", EngineWarning)
        warnings.showwarning = show
        yield


def _one_line(error: PfdistError) -> str:
    hint = " (--debug shows the traceback)" if isinstance(error, TaskError) else ""
    return " ".join(str(error).split()) + hint
