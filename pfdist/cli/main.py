"""The command line: parse, call, and say what went wrong; no logic."""

import codecs
import contextlib
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any

from pfdist.cli.parser import make_parser
from pfdist.cli.streams import flush_output, make_harmless
from pfdist.errors import EngineWarning, PfdistError, TaskError, one_line

_GO_ON = "what was done is committed; the same command goes on from there"
_LONGEST = 1200  # characters of an error's line: longer ones lose their middle
_SPELT = {"±": "+-"}  # where the encoding lacks it


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
    _write_what_can_be_encoded()
    options = make_parser().parse_args(arguments)
    _preempted.clear()
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, _preempt)
    if listens:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        with _warnings_as_lines():
            # Here and not above: importing what a command needs takes a second.
            commands = importlib.import_module("pfdist.cli.commands")
            with commands.answers_alone(options, ends=arguments is None):
                getattr(commands, options.command)(options)
            flush_output()
    except PfdistError as error:
        if options.debug:
            raise
        hint = " (--debug shows the traceback)" if isinstance(error, TaskError) else ""
        return _failed(str(error), f" (--{error.argument})" if error.argument else hint)
    except KeyboardInterrupt:
        ended = "asked to end" if _preempted else "interrupted"
        go_on = f"; {_GO_ON}" if options.goes_on else ""
        print(f"pfdist: {ended}{go_on}", file=sys.stderr)
        return 75 if _preempted else 130
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        sys.stderr.close()
        return 1
    except (OSError, ImportError) as error:
        return _failed(str(_unwritten() or error))
    except MemoryError:
        return _failed("not enough memory: fewer draws or particles need less")
    return 0


def _failed(reason: str, hint: str = "") -> int:
    line = one_line(" ".join(reason.split()))
    if len(line) > _LONGEST:
        line = f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"
    print(f"pfdist: {line}{hint}", file=sys.stderr)
    return 1


def _write_what_can_be_encoded() -> None:
    """Let no character end the program that the terminal's encoding lacks."""
    codecs.register_error("pfdist", _replacement)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="pfdist")


def _replacement(error: UnicodeError) -> tuple[str | bytes, int]:
    """Give what is written where characters cannot be encoded: a path's bytes as they are."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    try:
        return lacking.encode("ascii", "surrogateescape"), error.end
    except UnicodeEncodeError:
        return "".join(_SPELT.get(character, "?") for character in lacking), error.end


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
        print(f"pfdist: warning: {one_line(str(message))}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", EngineWarning)
        warnings.showwarning = show
        yield
