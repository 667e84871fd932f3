"""The program `pfdist`: parse the arguments, call the command, and say what went wrong.

A signal of the user or of a batch system ends a command as an error would, so that it cleans up.
"""

import contextlib
import os
import signal
import sys
import warnings
from argparse import Namespace
from collections.abc import Iterator, Sequence
from traceback import format_exception
from types import FrameType
from typing import Any

from pfdist.cli.parser import make_parser, welcome
from pfdist.cli.streams import encode_all_text, flush_output, make_harmless, stdout_for_json
from pfdist.errors import (
    PfdistError,
    PfdistWarning,
    SilenceError,
    TaskError,
    one_line,
    printable,
    started_in,
)

_BATCH_SYSTEMS = (signal.SIGTERM, signal.SIGUSR1)  # batch systems send these when time is up
_received: list[int] = []  # signals of a batch system since the command began


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


# --- the program ----------------------------------------------------------------------------------

# Exit codes. 75 is EX_TEMPFAIL: a batch script may start the same command again.
_DONE, _ERROR, _INTERRUPTED, _AGAIN = 0, 1, 130, 75
_GOES_ON = "finished work is committed; the same command goes on from there"
_LONGEST = 1200  # characters of an error's line; longer lines lose their middle


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after ``pfdist``; by default those of this process.

    Returns
    -------
    int
        The exit code: 0; 1 after an error; 130 after Ctrl-C; or 75 if the same command may be
        started again, because a batch system ended it or its workers no longer answered.

    Raises
    ------
    SystemExit
        The arguments are wrong (2), or only help or the version was wanted (0).
    """
    make_harmless()
    os.umask(os.umask(0o077) & 0o077)  # the user must be able to use what a command writes
    end_at_once()
    encode_all_text()
    words = sys.argv[1:] if arguments is None else arguments
    if not words:
        print(welcome(), end="")
        return _DONE
    try:
        started_in(os.getcwd())  # a model may move the process
        # Not above: the package itself makes this check, before anything imports Numba.
        from pfdist.kernels import check_settings  # noqa: PLC0415

        check_settings()
        options = make_parser().parse_args(arguments)
    except Exception as error:
        return _error(error, debug="--debug" in words)
    interrupt_command()
    return _run(options, ends=arguments is None)


def _run(options: Namespace, *, ends: bool) -> int:
    """Call the command; turn errors into a line and an exit code.

    `ends` says whether the process ends afterwards.
    """
    try:
        with _warnings_as_lines():
            with stdout_for_json(options, ends=ends):
                options.called.call(options)
            flush_output()
    except KeyboardInterrupt:
        cause = "asked to end" if _received else "interrupted"
        keeps = options.called.goes_on and not getattr(options, "dry_run", False)
        goes_on = f"; {_GOES_ON}" if keeps else ""
        print(f"pfdist: {cause}{goes_on}", file=sys.stderr)
        return _AGAIN if _received else _INTERRUPTED
    except BrokenPipeError:  # the reader of the output has ended, as `head` does
        sys.stderr.close()
        return _ERROR
    except Exception as error:
        return _error(error, debug=options.debug)
    return _DONE


def _error(error: Exception, *, debug: bool) -> int:
    """Print an error as one line, after its traceback if that is wanted; return the exit code."""
    reason, hint = str(error), ""
    if isinstance(error, PfdistError) and error.argument:
        hint = f" (--{error.argument.replace('_', '-')})"
    elif isinstance(error, MemoryError):
        reason = "not enough memory; fewer draws or particles need less"
    elif isinstance(error, OSError | ImportError):
        reason = str(_output_error() or error)
    elif isinstance(error, TaskError) or not isinstance(error, PfdistError):
        hint = " (--debug shows the traceback)"
    if not isinstance(error, PfdistError | MemoryError | OSError | ImportError):
        reason = f"unexpected {type(error).__name__}: {error}"
    if debug:
        print(printable("".join(format_exception(error))), end="", file=sys.stderr)
    line = one_line(" ".join(reason.split()))
    if len(line) > _LONGEST:
        line = f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
    print(f"pfdist: {line}{hint}", file=sys.stderr)
    return _AGAIN if isinstance(error, SilenceError) else _ERROR


def _output_error() -> OSError | None:
    """The error that a flush of standard output raises; None if there is none."""
    try:
        flush_output()
    except OSError as error:
        return error
    return None


@contextlib.contextmanager
def _warnings_as_lines() -> Iterator[None]:
    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"pfdist: warning: {one_line(str(message))}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", PfdistWarning)
        warnings.showwarning = show
        yield
