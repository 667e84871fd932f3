"""Standard streams that may be closed, full or unable to encode a text; a stream of JSON alone."""

import codecs
import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any

from pfdist.errors import PfdistError

_NAMES = ("stdin", "stdout", "stderr")
_REPLACEMENTS = {"±": "+-"}  # of characters that an encoding lacks; others become "?"


class _Forgiving(io.FileIO):
    """A file to which every write succeeds, even if nothing can be written."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


class _Answer(io.FileIO):
    """The file of a command's answer: its first error is raised, and later writes are discarded.

    At its end the interpreter could no longer report an error.
    """

    _failed = False

    def write(self, data: Any) -> int:
        if self._failed:
            return memoryview(data).nbytes
        try:
            return super().write(data)
        except OSError as error:
            self._failed = True
            if isinstance(error, BrokenPipeError):
                raise
            reason = (error.strerror or "").lower().removesuffix(" on device")
            raise PfdistError(f"cannot write the answer: {reason}") from error


def make_harmless() -> None:
    """Connect closed standard streams to nothing, and let no write to standard error fail.

    A write to standard output that fails is a `PfdistError`: the answer is lost.

    A file that is opened gets the lowest free descriptor. Without this function, a file of a run
    could get the descriptor of a closed standard error, and libraries would write messages to it.
    """
    for number, name in enumerate(_NAMES):
        try:
            os.fstat(number)
        except OSError:  # closed; all lower descriptors are open, so the next file gets this one
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w" if number else "r", encoding="utf-8"))  # noqa: SIM115
    if sys.stderr is sys.__stderr__ and isinstance(sys.stderr, io.TextIOWrapper):
        encoding, errors = sys.stderr.encoding, sys.stderr.errors
        quiet: Any = _Forgiving(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = io.TextIOWrapper(quiet, encoding, errors, write_through=True)
    if sys.stdout is sys.__stdout__ and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout = _answers(sys.stdout.fileno(), sys.stdout, closefd=False)


def _answers(descriptor: int, stream: Any, *, closefd: bool) -> io.TextIOWrapper:
    """A text stream to a descriptor that encodes and flushes as another one."""
    writer = io.BufferedWriter(_Answer(descriptor, "w", closefd=closefd))
    lines = stream.line_buffering or stream.write_through
    return io.TextIOWrapper(writer, stream.encoding, stream.errors, line_buffering=lines)


def encode_all_text() -> None:
    """Replace characters that the encoding of a standard stream lacks, instead of failing."""
    codecs.register_error("pfdist", _replacement)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="pfdist")


def _replacement(error: UnicodeError) -> tuple[str | bytes, int]:
    """The bytes of a path as they are, and a replacement for each other character."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    try:
        return lacking.encode("ascii", "surrogateescape"), error.end
    except UnicodeEncodeError:
        return "".join(_REPLACEMENTS.get(character, "?") for character in lacking), error.end


@contextlib.contextmanager
def stream_for_json(*, ends: bool) -> Iterator[Any]:
    """A stream that gets the JSON object of ``--json``, and nothing that a model prints.

    All other output goes to standard error, also that of compiled code and of child processes.

    Parameters
    ----------
    ends : bool
        Whether the process ends after this command. If so, later output goes to standard error,
        too.
    """
    with (
        _separate_stream(sys.stdout, ends=ends) as separate,
        contextlib.redirect_stdout(sys.stderr),
    ):
        yield separate


@contextlib.contextmanager
def _separate_stream(stream: Any, *, ends: bool) -> Iterator[Any]:
    """A new stream with the target of a stream, whose old descriptors are redirected to 2."""
    try:
        stream.flush()
        copies = {number: os.dup(number) for number in {1, stream.fileno()}}
    except (AttributeError, OSError):  # closed, or without a descriptor, as in a notebook
        yield stream
        return
    for number in copies:
        try:
            os.dup2(2, number)
        except OSError:  # standard error is closed
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
    answers = os.dup(copies[stream.fileno()])
    try:
        with _answers(answers, stream, closefd=True) as separate:
            yield separate
    finally:
        for number, copy in copies.items():
            if not ends:
                os.dup2(copy, number)
            os.close(copy)
