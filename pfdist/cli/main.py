"""The program `pfdist`: parse the arguments, call the command, and say what went wrong.

A signal of the user or of a batch system ends a command as an error would, so that it cleans up;
see `pfdist.common.stopping`.
"""

import contextlib
import os
import sys
import warnings
from argparse import Namespace
from collections.abc import Iterator, Sequence
from traceback import format_exception
from typing import Any

from pfdist.cli.parser import make_parser, welcome
from pfdist.cli.streams import encode_all_text, flush_output, make_harmless, stdout_for_json
from pfdist.common import stopping
from pfdist.errors import (
    PfdistError,
    PfdistWarning,
    PoolError,
    SilenceError,
    TaskError,
    one_line,
    printable,
    started_in,
)

# Exit codes. 75 is EX_TEMPFAIL: a batch script may start the same command again.
_DONE, _ERROR, _INTERRUPTED, _AGAIN = 0, 1, 130, 75
_SAVED = " Finished work is saved; run the same command to resume."
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
    encode_all_text()
    words = sys.argv[1:] if arguments is None else arguments
    if not words:
        print(welcome(), end="")
        return _DONE
    if arguments is None:
        stopping.listen()
    try:
        started_in(os.getcwd())  # a model may move the process
        # Not above: the package itself makes this check, before anything imports Numba.
        from pfdist.kernels import check_settings  # noqa: PLC0415

        check_settings()
        options = make_parser().parse_args(arguments)
    except Exception as error:
        return _error(error, debug="--debug" in words)
    return _run(options, ends=arguments is None)


def _run(options: Namespace, *, ends: bool) -> int:
    """Call the command; turn errors into a line and an exit code.

    `ends` says whether the process ends afterwards.
    """
    try:
        with _warnings_as_lines():
            try:
                with stdout_for_json(options, ends=ends):
                    options.called.call(options)
            except PoolError:  # the workers have received the signal, too
                stopping.check()
                raise
            flush_output()
        stopping.check()  # the exit code says that a signal was received, even at the very end
    except KeyboardInterrupt:
        resumes = options.called.goes_on and not getattr(options, "dry_run", False)
        print(f"pfdist: Stopped.{_SAVED if resumes else ''}", file=sys.stderr)
        return stopping.exit_code() or _INTERRUPTED
    except BrokenPipeError:  # the reader of the output has ended, as `head` does
        sys.stderr.close()
        return stopping.exit_code() or _ERROR
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
    return stopping.exit_code() or (_AGAIN if isinstance(error, SilenceError) else _ERROR)


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
