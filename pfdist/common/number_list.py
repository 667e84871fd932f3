"""Whole numbers as users list them: numbers and ranges, for instance ``0,6,12`` or ``0:60:3``."""

import re

from pfdist.common.parsing import whole_number
from pfdist.errors import shown

SPELLING = "numbers and ranges FIRST:LAST or FIRST:LAST:STEP, both ends included"
"""What `whole_numbers` reads, for errors and help."""
MOST_NUMBERS = 1_000_000
_SEPARATOR = re.compile(r"\s*,\s*|\s+")


def whole_numbers(text: str) -> list[int]:
    """Give the whole numbers that a text lists, in the order in which it lists them.

    The text holds numbers and ranges, with commas or spaces between them. ``FIRST:LAST`` stands for
    all numbers from FIRST to LAST, and ``FIRST:LAST:STEP`` for each STEP-th of these.

    Raises
    ------
    ValueError
        The text is spelt otherwise, or lists more than a million numbers.

    Examples
    --------
    >>> whole_numbers("0, 6, 12"), whole_numbers("5:8"), whole_numbers("0:12:6 20")
    ([0, 6, 12], [5, 6, 7, 8], [0, 6, 12, 20])
    >>> whole_numbers("8:5")
    Traceback (most recent call last):
        ...
    ValueError: must have ranges from a number to a larger one in steps of at least 1, got '8:5'
    """
    numbers: list[int] = []
    for entry in _SEPARATOR.split(text.strip().removesuffix(",").rstrip()):
        first, last, step = _ends(entry, text)
        if len(numbers) + (last - first) // step >= MOST_NUMBERS:
            raise ValueError(f"must be at most {MOST_NUMBERS:,} numbers, got more: {shown(text)}")
        numbers += range(first, last + 1, step)
    return numbers


def _ends(entry: str, text: str) -> tuple[int, int, int]:
    """Give the first and the last number, and the step, of an entry of a text."""
    got = shown(text) if entry == text else f"{shown(entry)} in {shown(text)}"
    try:
        first, *others = map(whole_number, entry.split(":"))
        last, step = [*others, *(first, 1)[len(others) :]]
    except ValueError as error:
        raise ValueError(f"must be {SPELLING}, for instance 0:60:3 or 0,6,12, got {got}") from error
    if last < first or step < 1:
        raise ValueError(
            f"must have ranges from a number to a larger one in steps of at least 1, got {got}"
        )
    return first, last, step
