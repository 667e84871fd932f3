"""Checked arguments of functions: paths, texts and lists; an iterator is read once."""

import re
from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from pfdist.common.measurement_times import REGULAR
from pfdist.common.parsing import MOST_NUMBERS
from pfdist.errors import ArgumentError, JobError, shown

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


def names_argument(name: str, value: Any) -> list[str]:
    """Names in a text with commas, as ``worst_instant,"quantile 0.9"``, or in a list of texts.

    Raises `ArgumentError` as `texts_argument`.
    """
    texts = texts_argument(name, value)
    return [each.strip(' "') for text in texts for each in text.split(",")]


def columns_argument(value: Any) -> dict[str, str]:
    """The names of columns in ``y0=conc,t=time``, in a list of such texts, or in a mapping.

    Raises `ArgumentError` for anything else.
    """
    if value is None or isinstance(value, Mapping):
        pairs: list[tuple[Any, ...]] = [*(value or {}).items()]
    else:
        texts = names_argument("columns", value)
        pairs = [tuple(map(str.strip, each.split("=", 1))) for each in texts]
    for pair in pairs:
        if len(pair) < 2 or not all(isinstance(each, str) and each for each in pair):
            rule = "columns must be NAME=COLUMN, as y0=conc,t=time, got "
            raise ArgumentError(rule + ": ".join(map(shown, pair)), argument="columns")
    return dict(pairs)


def sets_argument(value: Any, argument: str = "times") -> dict[str, Any]:
    """Sets of times by name: of a mapping, of a text ``clinic=0,6,12``, or of a list of these.

    The word ``regular`` is a set of this name. Raises `JobError` for anything else.
    """
    if isinstance(value, Mapping):
        return {**value}
    sets = dict[str, str]()
    try:
        texts = texts_argument(argument, value)
    except ArgumentError as error:
        rule = f'{argument} must name sets, as {{"mine": [0, 6, 12], "paper": "0:60:3"}}'
        raise JobError(f"{rule}, got {shown(value)}", argument=argument) from error
    for text in texts:
        name, equals, times = text.rpartition("=")
        if equals and not name:
            raise JobError(f"times need a name before '=', got {shown(text)}", argument=argument)
        name = name or REGULAR * (times == REGULAR)
        if not name:
            raise JobError(
                f"times of several sets must be NAME=TIMES, as mine={times}, got {shown(times)}",
                argument=argument,
            )
        if name in sets:
            raise JobError(
                f"names of times must differ from each other, got {name!r} twice", argument=argument
            )
        sets[name] = times
    return sets


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
