"""Plain data from TOML and JSON that may be edited or damaged, within limits; numbers from text.

Every TOML and JSON text, and every option that a user writes, is read by these functions;
`pfdist.store.user_tables` reads tables. If the text is wrong or the data nests too deeply, a
`ValueError` with a message of one line is raised.
"""

import errno
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Callable
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

from pfdist.errors import shown, shown_text

MOST_BYTES = 16_000_000  # of a file: a job that names every time takes less than a million
MOST_BYTES_OF_MODELS = 256_000_000  # of the model.json of a run
MOST_LEVELS = 16  # a job has four, model.json eleven
_INTEGER = re.compile(r"[+-]?[0-9]{1,40}")
_DECIMAL = re.compile(r"[+-]?[0-9]{1,40}(\.[0-9]{1,40})?([eE][+-]?[0-9]{1,2})?")
_LINE = re.compile(r"at line (\d{1,9}),")  # in an error of tomllib
_WITHOUT_SECONDS = re.compile(r"""(?<!["'\w.-])\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?![\d:])""")
_LONGEST = 80  # characters of a key that an error shows
_NESTED = (dict, list)


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a file.

    Raises ValueError if it is not a plain file or has too many bytes, and OSError if it cannot be
    read.
    """
    about = path.stat()
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(about.st_mode):  # a pipe might never end
        raise ValueError("must be a plain file, got a pipe, a socket or a device")
    if about.st_size > most:
        raise ValueError(f"must be a file of at most {most:,} bytes, got {about.st_size:,}")
    with path.open("rb") as file:
        return file.read(most)


def read_text(path: Path) -> str:
    """The content of a text file; raises as `read_bytes`, and ValueError if it is not UTF-8."""
    return text_of(read_bytes(path, MOST_BYTES))


def text_of(content: bytes) -> str:
    """The text in the bytes of a file; raises ValueError if it is not UTF-8."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"text must be UTF-8, got byte 0x{content[error.start]:02x} at {error.start}"
        ) from error


def parse_toml(text: str) -> dict[str, Any]:
    """The data of a TOML text, within the limits of this module, with texts for dates."""
    try:
        data: dict[str, Any] = with_texts(_parsed(tomllib.loads, text))
    except ValueError as error:
        number = _LINE.search(str(error))
        line = text.splitlines()[int(number[1]) - 1 :][:1] if number else []
        if found := _WITHOUT_SECONDS.search("".join(line)):
            hint = f"a date needs seconds, {found[0]}:00, or quotes"
            raise ValueError(f"{error}: {hint}") from error
        raise
    return data


def with_texts(value: Any) -> Any:
    """The data of a job file with texts for dates."""
    if isinstance(value, dict):
        return {key: with_texts(each) for key, each in value.items()}
    return type(value)(map(with_texts, value)) if type(value) in (list, tuple) else as_text(value)


def as_text(value: Any) -> Any:
    """A value that Python, pandas or TOML reads from a text of ISO 8601, as this text."""
    return value.isoformat() if hasattr(value, "isoformat") else value


def parse_json(text: str | bytes, *, finite: bool = True) -> Any:
    """The data of a JSON text, within the limits of this module; its numbers are finite."""
    number = _finite if finite else float
    return _parsed(partial(json.loads, parse_float=number, parse_constant=number), text)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):  # NaN and Infinity are no JSON, and 1e999 is too large
        raise ValueError(f"numbers must be finite, got {shown_text(text)}")
    return number


def _parsed(parse: Callable[[Any], Any], text: str | bytes) -> Any:
    try:
        data = parse(text)
    except RecursionError as error:
        raise _too_deep() from error
    except ValueError as error:
        if "integer string conversion" in str(error):  # Python's limit, against slow conversions
            raise ValueError("whole numbers must have at most 19 digits, got more") from error
        raise ValueError(_first_line(error)) from error
    _check(data)
    return data


def _check(data: Any) -> None:
    """Raise a `ValueError` if data nests too deeply or has numbers of more than 64 bits."""
    filled: list[tuple[str, Any]] = [("", [data])]  # sections and lists that are not empty
    for _ in range(MOST_LEVELS):
        inside = []
        for name, box in filled:
            for key, value in box.items() if isinstance(box, dict) else zip(repeat(name), box):
                if isinstance(value, int):
                    if not -(2**63) <= value < 2**63:
                        where = f"{key[:_LONGEST]} " if key else ""
                        raise ValueError(f"{where}must be a number of 64 bits, got {shown(value)}")
                elif isinstance(value, _NESTED) and value:
                    inside.append((key, value))
        if not inside:
            return
        filled = inside
    raise _too_deep()


def _too_deep() -> ValueError:
    return ValueError(f"sections and lists must nest at most {MOST_LEVELS} deep, got more")


def _first_line(error: ValueError) -> str:
    text = str(error).partition("\n")[0]
    return text if len(text) <= 200 else f"{text[:120]}...{text[-60:]}"


def whole_number(text: str) -> int:
    """The whole number in a text of at most 40 ASCII digits, with or without a sign.

    Any other text raises a ValueError.

    >>> whole_number("12")
    12
    >>> whole_number("1_0")
    Traceback (most recent call last):
        ...
    ValueError: must be a whole number in digits 0-9, got '1_0'
    """
    if not _INTEGER.fullmatch(text):
        raise ValueError(f"must be a whole number in digits 0-9, got {shown(text)}")
    return int(text)


def finite_number(text: str) -> float:
    """The number in a text of digits, with or without a decimal point and an exponent.

    Any other text raises a ValueError.

    >>> finite_number("0.25"), finite_number("1.7e+12")
    (0.25, 1700000000000.0)
    """
    if not _DECIMAL.fullmatch(text):
        raise ValueError(f"must be a number in digits 0-9, such as 0.25, got {shown(text)}")
    return float(text)


SPELLING = "numbers and ranges FIRST:LAST or FIRST:LAST:STEP, both ends included"
"""What `whole_numbers` reads, for errors and help."""
MOST_NUMBERS = 1_000_000
_SEPARATOR = re.compile(r"\s*,\s*|\s+")


def whole_numbers(text: str) -> list[int]:
    """The whole numbers that a text lists, in the order of the text.

    The text holds numbers and ranges, with commas or spaces between them. ``FIRST:LAST`` means all
    numbers from FIRST to LAST, and ``FIRST:LAST:STEP`` every STEP-th of these. Raises ValueError
    for any other text, or if there are more than a million numbers.

    >>> whole_numbers("0, 6, 12"), whole_numbers("5:8"), whole_numbers("0:12:6 20")
    ([0, 6, 12], [5, 6, 7, 8], [0, 6, 12, 20])
    >>> whole_numbers("8:5")
    Traceback (most recent call last):
        ...
    ValueError: must have ranges FIRST:LAST with FIRST <= LAST and steps above 0, got '8:5'
    """
    entries = ranges(text, whole_number, by_ones=True)
    return [number for first, last, step in entries for number in range(first, last + 1, step or 1)]


def ranges(
    text: str, number: Callable[[str], Any], *, by_ones: bool = False
) -> list[tuple[Any, Any, Any]]:
    """The first number, last number and step of each entry of a text as for `whole_numbers`.

    `number` reads a number, and raises ValueError for any other text. A single number is a range
    from it to itself. The step is 0 if none is written. With `by_ones`, this means steps of 1;
    otherwise such a range is everything between its ends, and its numbers are not counted. Raises
    as `whole_numbers`.
    """
    entries = _SEPARATOR.split(text.strip().removesuffix(",").rstrip())
    ends_of_entries = [_ends(entry, text, number) for entry in entries]
    listed = sum(
        1 + ((last - first) // (step or 1) if step or by_ones else 0)
        for first, last, step in ends_of_entries
    )
    if listed > MOST_NUMBERS:
        raise ValueError(f"must have at most {MOST_NUMBERS:,} numbers, got more: {shown(text)}")
    return ends_of_entries


def _ends(entry: str, text: str, number: Callable[[str], Any]) -> tuple[Any, Any, Any]:
    got = shown(text) if entry == text else f"{shown(entry)} in {shown(text)}"
    try:
        first, *others = map(number, entry.split(":"))
        last, step = [*others, *(first, number("0"))[len(others) :]]
    except ValueError as error:
        raise ValueError(f"must be {SPELLING}, for instance 0:60:3 or 0,6,12, got {got}") from error
    has_step = len(others) > 1
    if last < first or (has_step and step <= 0):
        raise ValueError(
            f"must have ranges FIRST:LAST with FIRST <= LAST and steps above 0, got {got}"
        )
    return first, last, step
