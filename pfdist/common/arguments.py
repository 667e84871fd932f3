"""Checks of arguments of public functions, with errors in one line."""

from collections.abc import Iterable
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from pfdist.errors import ArgumentError, shown


def whole_argument(name: str, value: Any, least: int, most: int) -> int:
    """An argument as an int; an `ArgumentError` if it is no integer or lies outside least..most.

    >>> whole_argument("draws", 1, 2, 100)
    Traceback (most recent call last):
        ...
    pfdist.errors.ArgumentError: draws must be at least 2, got 1
    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ArgumentError(f"{name} must be an integer, got {shown(value)}", argument=name)
    number = int(value)
    if not least <= number <= most:
        allowed = f"at least {least:,}" if number < least else f"at most {most:,}"
        raise ArgumentError(f"{name} must be {allowed}, got {shown(number)}", argument=name)
    return number


def number_argument(name: str, value: Any) -> float:
    """An argument as a float; an `ArgumentError` if it is no number."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ArgumentError(f"{name} must be a number, got {shown(value)}", argument=name)
    return float(value)


def path_argument(name: str, value: Any) -> Path:
    """An argument as an absolute path, because a model may change the working folder later.

    An `ArgumentError` says that it is neither a text nor a path, or holds the character NUL.
    """
    if not isinstance(value, str | Path) or "\0" in str(value):
        raise ArgumentError(f"{name} must be a path, got {shown(value)}", argument=name)
    return Path(value).absolute()


def paths_argument(name: str, value: Any) -> list[Path]:
    """An argument as a list of paths; an `ArgumentError` if it holds something else.

    A single path becomes a list with one path.
    """
    return [path_argument(name, path) for path in _listed(name, value, str | Path, "paths")]


def texts_argument(name: str, value: Any) -> list[str]:
    """An argument as a list of texts; an `ArgumentError` if it holds something else.

    A single text becomes a list with one text.
    """
    return _listed(name, value, str, "texts")


def _listed(name: str, value: Any, kind: Any, what: str) -> list[Any]:
    """An argument with entries of some kind as a list; an iterator is read once."""
    if isinstance(value, kind):
        return [value]
    entries = [*value] if isinstance(value, Iterable) else [None]
    if not all(isinstance(each, kind) for each in entries):
        raise ArgumentError(f"{name} must be a list of {what}, got {shown(value)}", argument=name)
    return entries


def called_argument(name: str, value: Any) -> None:
    """Raise an `ArgumentError` if an argument cannot be called."""
    if not callable(value):
        raise ArgumentError(f"{name} must be a function, got {shown(value)}", argument=name)
