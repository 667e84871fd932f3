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
from typing import Any

from pfdist.cli.parser import make_parser, welcome
from pfdist.cli.streams import encode_all_text, flush_output, make_harmless, stdout_for_json
from pfdist.common import stopping
from pfdist.errors import PfdistError, PfdistWarning, PoolError, SilenceError, TaskError, one_line

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
    if arguments is None:
        stopping.listen()
    encode_all_text()
    if not (sys.argv[1:] if arguments is None else arguments):
        print(welcome(), end="")
        return _DONE
    try:
        options = make_parser().parse_args(arguments)
    except PfdistError as error:
        return _failed(str(error))
    return _run(options, ends=arguments is None)


def _run(options: Namespace, *, ends: bool) -> int:
    """Call the command; turn the errors that a user can cause into a line and an exit code.

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
    except PfdistError as error:
        if options.debug:
            raise
        hint = " (--debug shows the traceback)" if isinstance(error, TaskError) else ""
        option = error.argument.replace("_", "-")
        code = _AGAIN if isinstance(error, SilenceError) else _ERROR
        return _failed(str(error), f" (--{option})" if option else hint, code)
    except KeyboardInterrupt:
        resumes = options.called.goes_on and not getattr(options, "dry_run", False)
        print(f"pfdist: Stopped.{_SAVED if resumes else ''}", file=sys.stderr)
        return stopping.exit_code() or _INTERRUPTED
    except BrokenPipeError:  # the reader of the output has ended, as `head` does
        sys.stderr.close()
        return stopping.exit_code() or _ERROR
    except (OSError, ImportError) as error:
        return _failed(str(_output_error() or error))
    except MemoryError:
        return _failed("not enough memory; fewer draws or particles need less")
    return _DONE


def _failed(reason: str, hint: str = "", code: int = _ERROR) -> int:
    """Print an error as one line, and return the exit code."""
    line = one_line(" ".join(reason.split()))
    if len(line) > _LONGEST:
        line = f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
    print(f"pfdist: {line}{hint}", file=sys.stderr)
    return stopping.exit_code() or code


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
