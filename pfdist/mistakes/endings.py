"""Turns an attempt of a model's code to end the process into an error with a place."""

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any

from pfdist.mistakes.places import is_a_models

_ENDS = ("_exit", "abort")  # of `os`


class EndedError(Exception):
    """A model's code called a function that ends the process."""


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
    """Whether an exception is the user's Ctrl-C or a batch system's signal, not a model's error."""
    return type(error) is KeyboardInterrupt


def told(error: BaseException) -> str:
    """Describe an exception of a model in a line: its class and the beginning of its text."""
    kind = "" if isinstance(error, EndedError) else type(error).__name__
    return ": ".join(part for part in (kind, text_of(error)) if part)


def text_of(error: BaseException) -> str:
    """Give an error's text as a line; empty if there is no text or it cannot be made."""
    try:
        text = " ".join(_formatted(error).split())
    except Exception:  # the text of a model's own exception may fail, too
        return ""
    return f"{text[:_LONGEST]} ..." if len(text) > _LONGEST else text


def _formatted(error: BaseException) -> str:
    """An error's text, with the integers that compiled code could not insert."""
    text, *values = error.args or ("",)
    formatted = isinstance(text, str) and values and text.count("{}") == len(values)
    return str(text.format(*values)) if formatted else str(error)


_LONGEST = 500  # characters
