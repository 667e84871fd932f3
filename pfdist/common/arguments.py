"""Checked arguments of functions: paths, texts and lists; an iterator is read once."""

import re
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from pfdist.common.parsing import MOST_NUMBERS
from pfdist.errors import ArgumentError, shown

T = TypeVar("T")


def path_argument(name: str, value: Any) -> Path:
    """An argument as an absolute path, because a model may change the working folder later.

    Raises `ArgumentError` if it is neither a text nor a path, contains the character NUL, or is an
    address.
    """
    if not isinstance(value, str | Path) or "\0" in str(value):
        without = " without NUL" if isinstance(value, str | Path) else ""
        raise ArgumentError(f"{name} must be a path{without}, got {shown(value)}", argument=name)
    if fault := address_fault(value):
        raise ArgumentError(f"{name} {fault}", argument=name)
    return Path(value).absolute()


def address_fault(path: str | Path) -> str:
    """The fault in a path that is an address, which would become folders; empty for other paths.

    >>> address_fault("s3://bucket/run")[:52], address_fault("results/run")
    ("must be a path of this machine, got the address 's3:", '')
    """
    start = r"[A-Za-z][\w+.-]+:/" + "/" * isinstance(path, str)  # a `Path` has lost the second
    return (
        f"must be a path of this machine, got the address {shown(str(path))}: mount its storage as "
        "a folder, or copy the file or the finished run"
    ) * bool(re.match(start, str(path)))


def paths_argument(name: str, value: Any) -> list[Path]:
    """An argument as a list of paths; raises `ArgumentError` if an entry is not a path.

    A single path becomes a list with one path.
    """
    return [path_argument(name, path) for path in _listed(name, value, str | Path, "paths")]


def texts_argument(name: str, value: Any) -> list[str]:
    """An argument as a list of texts; raises `ArgumentError` if an entry is not a text.

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


def listed_argument(name: str, values: Iterable[T]) -> list[T]:
    """An argument as a list; raises `ArgumentError` if it has more than a million entries.

    >>> listed_argument("times", range(10**9))
    Traceback (most recent call last):
        ...
    pfdist.errors.ArgumentError: times must have at most 1,000,000 numbers, got range(0, 1000000000)
    """
    listed = list(islice(values, MOST_NUMBERS + 1))
    if len(listed) > MOST_NUMBERS:
        raise ArgumentError(
            f"{name} must have at most {MOST_NUMBERS:,} numbers, got {shown(values)}", argument=name
        )
    return listed
