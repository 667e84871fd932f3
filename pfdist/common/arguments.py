"""Checks of arguments of public functions, with errors in one line."""

from collections.abc import Callable, Iterable
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
    """An argument as a path; an `ArgumentError` if it is neither a text nor a path."""
    if not isinstance(value, str | Path):
        raise ArgumentError(f"{name} must be a path, got {shown(value)}", argument=name)
    return Path(value)


def paths_argument(name: str, value: Any) -> list[Path]:
    """An argument as a list of paths; an `ArgumentError` if it holds something else.

    A single path becomes a list with one path.
    """
    paths = [value] if isinstance(value, str | Path) else value
    if not isinstance(paths, Iterable):
        raise ArgumentError(f"{name} must be a list of paths, got {shown(value)}", argument=name)
    return [path_argument(name, path) for path in paths]


def texts_argument(name: str, value: Any) -> list[str]:
    """An argument as a list of texts; an `ArgumentError` if it holds something else.

    A single text becomes a list with one text.
    """
    texts = [value] if isinstance(value, str) else value
    if not isinstance(texts, Iterable) or not all(isinstance(each, str) for each in texts):
        raise ArgumentError(f"{name} must be a list of texts, got {shown(value)}", argument=name)
    return list(texts)


def called_argument(name: str, value: Any) -> Callable[..., Any]:
    """An argument that is to be called; an `ArgumentError` if it cannot be called."""
    if not callable(value):
        raise ArgumentError(f"{name} must be a function, got {shown(value)}", argument=name)
    return value  # type: ignore[no-any-return]
