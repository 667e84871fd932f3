"""What a model's code does to end the process, turned into an error that has a place."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any

from pfdist.mistakes.places import is_a_models

_ENDS = ("_exit", "abort")  # of `os`


class EndedError(Exception):
    """A model's code called what ends a process."""


@contextlib.contextmanager
def kept_alive() -> Iterator[None]:
    """Have ``os._exit`` and ``os.abort`` raise an `EndedError` where a model's code calls them.

    Other callers end the process as ever: a second Ctrl-C, and processes that the model starts.
    """
    originals = {name: getattr(os, name) for name in _ENDS}
    for name, original in originals.items():
        setattr(os, name, _instead_of(name, original))
    try:
        yield
    finally:
        for name, original in originals.items():
            setattr(os, name, original)


def _instead_of(name: str, original: Any) -> Any:
    process = os.getpid()

    def end(*arguments: Any) -> None:
        caller = sys._getframe(1).f_code.co_filename
        if os.getpid() != process or not is_a_models(caller):
            original(*arguments)
        told = ", ".join(repr(argument)[:20] for argument in arguments)
        raise EndedError(f"os.{name}({told}) would end the process")

    return end


def is_interrupt(error: BaseException) -> bool:
    """Whether it is the user's Ctrl-C, or a batch system's signal, and no error of the model."""
    return type(error) is KeyboardInterrupt


def told(error: BaseException) -> str:
    """Say what a model raised, in a line: its kind and the beginning of its text."""
    kind = "" if isinstance(error, EndedError) else type(error).__name__
    return ": ".join(part for part in (kind, text_of(error)) if part)


def text_of(error: BaseException) -> str:
    """Give an error's text as a line; empty where it has none that can be told."""
    try:
        text = " ".join(_formatted(error).split())
    except Exception:  # a model may raise what cannot even be told
        return ""
    return f"{text[:_LONGEST]} ..." if len(text) > _LONGEST else text


def _formatted(error: BaseException) -> str:
    """An error's text; compiled code cannot put integers into it, so it is done here."""
    text, *values = error.args or ("",)
    formatted = isinstance(text, str) and values and text.count("{}") == len(values)
    return str(text.format(*values)) if formatted else str(error)


_LONGEST = 500  # characters
