"""Reads TOML and JSON, which somebody may have edited or damaged, as plain data within limits.

Every file and every option that a user writes comes in through these functions. Whatever the text
holds, they give data that is not nested deeply, or raise a `ValueError` of one line.
"""

import json
import re
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from pfdist.errors import shown

MOST_BYTES = 16_000_000  # of a file: a job that names every time takes less than one million
MOST_LEVELS = 16  # a job has four
_INTEGER = re.compile(r"[+-]?[0-9]{1,40}")
_DECIMAL = re.compile(r"[+-]?[0-9]{1,40}(\.[0-9]{1,40})?([eE][+-]?[0-9]{1,2})?")
_LONGEST = 80  # characters of a key that an error shows


def read_text(path: Path) -> str:
    """Read a text file.

    Raises
    ------
    ValueError
        It is too large, or not UTF-8.
    OSError
        It cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f"a file of at most {MOST_BYTES:,} bytes is read, got a larger one")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"text must be UTF-8, got byte 0x{content[error.start]:02x} at {error.start}"
        ) from error


def parse_toml(text: str) -> dict[str, Any]:
    """Give the data of a TOML text; see the module for what is refused."""
    found: dict[str, Any] = _parsed(tomllib.loads, text)
    return found


def parse_json(text: str) -> Any:
    """Give the data of a JSON text; see the module for what is refused."""
    return _parsed(json.loads, text)


def _parsed(parse: Callable[[str], Any], text: str) -> Any:
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
    """Raise a `ValueError` where data nests too deeply or has numbers of more than 64 bits."""
    level = [("", data)]
    for _ in range(MOST_LEVELS):
        for key, value in level:
            if isinstance(value, int) and not -(2**63) <= value < 2**63:
                where = f"{key[:_LONGEST]} " if key else ""
                raise ValueError(f"{where}must be a number of 64 bits, got {shown(value)}")
        level = [(key or name, inner) for name, value in level for key, inner in _inner(value)]
        if not level:
            return
    raise _too_deep()


def _inner(value: Any) -> Iterable[tuple[str, Any]]:
    """Give the values in a section or a list, each with its key; in a list no value has a key."""
    if isinstance(value, dict):
        return value.items()
    return (("", inner) for inner in value) if isinstance(value, list) else ()


def _too_deep() -> ValueError:
    return ValueError(f"sections and lists must nest at most {MOST_LEVELS} deep, got more")


def _first_line(error: ValueError) -> str:
    text = str(error).partition("\n")[0]
    return text if len(text) <= 200 else f"{text[:120]}...{text[-60:]}"


def whole_number(text: str) -> int:
    """Give the whole number that ASCII digits spell, with a sign before them or none.

    Raises
    ------
    ValueError
        It is spelt otherwise, or has more than 40 digits.

    Examples
    --------
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
    """Give the number that a text spells with digits, a decimal point and perhaps an exponent.

    Raises
    ------
    ValueError
        It spells no number, or spells it otherwise.

    Examples
    --------
    >>> finite_number("0.25"), finite_number("1.7e+12")
    (0.25, 1700000000000.0)
    """
    if not _DECIMAL.fullmatch(text):
        raise ValueError(f"must be a number, with the digits 0-9 and a point, got {shown(text)}")
    return float(text)
