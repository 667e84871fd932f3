"""Standard streams that may be closed, full or unable to encode a text; a stream of JSON alone."""

import codecs
import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any

_NAMES = ("stdin", "stdout", "stderr")
_REPLACEMENTS = {"±": "+-"}  # of characters that an encoding lacks; others become "?"


class _Forgiving(io.FileIO):
    """A file to which every write succeeds, even if nothing can be written."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


def make_harmless() -> None:
    """Connect closed standard streams to nothing, and let no write to standard error fail.

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


def flush_output() -> None:
    """Write all that was printed; at its end the interpreter could no longer report an error.

    Raises
    ------
    OSError
        Standard output cannot be written; the unwritten text is discarded.
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
        with open(answers, "w", encoding=stream.encoding, errors=stream.errors) as separate:
            yield separate
    finally:
        for number, copy in copies.items():
            if not ends:
                os.dup2(copy, number)
            os.close(copy)
