"""The program `pfdist`: parse the arguments, call the command, and print what went wrong.

A signal of the user or of a batch system ends a command as an error would, so that it cleans up;
see `pfdist.common.stopping`.
"""

import contextlib
import gc
import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from inspect import signature
from traceback import format_exception
from typing import TYPE_CHECKING, Any

from cyclopts import CycloptsError

from pfdist.cli.commands import COMMANDS
from pfdist.cli.program import complaint, line_of, welcome
from pfdist.cli.streams import encode_all_text, make_harmless, stream_for_json
from pfdist.common import stopping
from pfdist.common.parent import report_code
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

if TYPE_CHECKING:  # the help of the program imports none of what a command needs
    from pfdist.cli.words import Line

# Exit codes. 75 is EX_TEMPFAIL: a batch script may start the same command again.
_DONE, _ERROR, _WRONG_WORDS, _INTERRUPTED, _AGAIN = 0, 1, 2, 130, 75
_LONGEST = 1200  # characters of an error's line; longer lines lose their middle
# Imports and compilation make so many objects that Python would look for unused ones among them
# hundreds of times: a tenth of the processor time of a short command.
_OBJECTS_BETWEEN_LOOKS = 100_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after ``pfdist``; by default those of this process.

    Returns
    -------
    int
        The exit code: 0; 1 after an error; 2 after wrong arguments; 130 after Ctrl-C; or 75 if the
        same command may be started again, because a batch system ended it, its workers no longer
        answered, or a library ended its process.
    """
    make_harmless()
    os.umask(os.umask(0o077) & 0o077)  # the user must be able to use what a command writes
    encode_all_text()
    if arguments is not None:
        return _main(list(arguments), ends=False)
    gc.set_threshold(_OBJECTS_BETWEEN_LOOKS)
    stopping.listen(forks=True)
    code = _ERROR
    try:
        code = _main(sys.argv[1:], ends=True)
    finally:
        report_code(code)
    return code


def _main(words: list[str], *, ends: bool) -> int:
    """The exit code of a command line; the process ends afterwards if `ends` is true."""
    try:
        started_in(_working_folder())  # a model may change it
        # Not above: the package itself makes this check, before anything imports Numba.
        from pfdist.kernels import check_settings  # noqa: PLC0415

        check_settings()
        line = line_of(words) if words else print(welcome())
        sys.stdout.flush()
    except CycloptsError as error:
        print(complaint(error), file=sys.stderr)
        return _WRONG_WORDS
    except BrokenPipeError:
        return _unread()
    except Exception as error:
        return _error(error, debug="--debug" in words)
    return _DONE if line is None else _run(line, ends=ends)


def _working_folder() -> str:
    try:
        return os.getcwd()
    except OSError as error:
        raise PfdistError(
            f"the working folder cannot be read ({error.strerror}): change into another"
        ) from error


def _run(line: "Line", *, ends: bool) -> int:
    """The exit code of a command, whose answer is shown; an error becomes a line.

    The process ends afterwards if `ends` is true.
    """
    try:
        with _warnings_as_lines():
            try:
                _show(line, ends=ends)
            except PoolError:  # the workers have received the signal, too
                stopping.check()
                raise
            sys.stdout.flush()
        stopping.check()  # the exit code shows a signal that was received, even at the very end
    except KeyboardInterrupt:
        resumes = COMMANDS[line.name].resumes and not line.options.get("dry_run")
        print(f"pfdist: Stopped.{stopping.SAVED if resumes else ''}", file=sys.stderr)
        return stopping.exit_code() or _INTERRUPTED
    except BrokenPipeError:
        return _unread()
    except SilenceError as error:
        code = _error(error, debug=line.debug)
        if ends:  # threads of a lost cluster could end the process with another code
            with contextlib.suppress(OSError, PfdistError):
                sys.stdout.flush()
            os._exit(report_code(code))
        return code
    except Exception as error:
        return _error(error, debug=line.debug)
    return _DONE


def _show(line: "Line", *, ends: bool) -> None:
    # Not above: commands that show no run need none of its libraries.
    from pfdist.cli.shown import show  # noqa: PLC0415

    with stream_for_json(ends=ends) if line.json else contextlib.nullcontext(sys.stdout) as stream:
        show(_answer(line), line, stream)


def _answer(line: "Line") -> Any:
    """The answer of a command's function; its progress and its messages are shown meanwhile."""
    taken = signature(line.function).parameters
    if "say" not in taken:
        return line.function(*line.arguments, **line.options)
    from pfdist.questions.display import Display  # noqa: PLC0415  rich takes long to load

    with Display(verbose=line.verbose) as display:
        heard: dict[str, Any] = {"say": display.say}
        if "progress" in taken:
            heard["progress"] = display.show
        return line.function(*line.arguments, **line.options, **heard)


def _unread() -> int:
    """The exit code after the reader of the output has ended, as ``head`` does; without a line."""
    sys.stderr.close()
    return stopping.exit_code() or _ERROR


def _error(error: Exception, *, debug: bool) -> int:
    """The exit code of an error, which is printed as one line, after its traceback if wanted."""
    reason, hint = str(error), ""
    if isinstance(error, PfdistError) and error.argument:
        option = f"--{error.argument.replace('_', '-')}"
        reason = re.sub(rf"^(measurement_)?{error.argument}(?=[ :])", option, reason)
        reason = reason if reason.startswith(option) else f"{option}: {reason}"
    elif isinstance(error, MemoryError):
        reason = "not enough memory; fewer draws or particles need less"
    elif isinstance(error, OSError | ImportError) and not isinstance(error, PfdistError):
        reason = str(error.__cause__ or error)
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


@contextlib.contextmanager
def _warnings_as_lines() -> Iterator[None]:
    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"pfdist: warning: {one_line(str(message))}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", PfdistWarning)
        warnings.showwarning = show
        yield
