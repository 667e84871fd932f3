"""Whole numbers as users list them: numbers and ranges, for instance ``0,6,12`` or ``0:60:3``."""

import re
from collections.abc import Callable
from typing import Any

from pfdist.common.parsing import whole_number
from pfdist.errors import shown

SPELLING = "numbers and ranges FIRST:LAST or FIRST:LAST:STEP, both ends included"
"""What `whole_numbers` reads, for errors and help."""
MOST_NUMBERS = 1_000_000
_SEPARATOR = re.compile(r"\s*,\s*|\s+")


def whole_numbers(text: str) -> list[int]:
    """The whole numbers that a text lists, in the order in which it lists them.

    The text holds numbers and ranges, with commas or spaces between them. ``FIRST:LAST`` stands for
    all numbers from FIRST to LAST, and ``FIRST:LAST:STEP`` for each STEP-th of these. A ValueError
    says that the text is spelt otherwise, or lists more than a million numbers.

    >>> whole_numbers("0, 6, 12"), whole_numbers("5:8"), whole_numbers("0:12:6 20")
    ([0, 6, 12], [5, 6, 7, 8], [0, 6, 12, 20])
    >>> whole_numbers("8:5")
    Traceback (most recent call last):
        ...
    ValueError: must have ranges from a number to a larger one in steps above 0, got '8:5'
    """
    entries = ranges(text, whole_number, by_ones=True)
    return [number for first, last, step in entries for number in range(first, last + 1, step or 1)]


def ranges(
    text: str, number: Callable[[str], Any], *, by_ones: bool = False
) -> list[tuple[Any, Any, Any]]:
    """The first and the last number, and the step, of each entry of a text as for `whole_numbers`.

    `number` reads a number, and raises ValueError for any other text. A single number is a range
    from it to itself. The step is 0 if none is written: `by_ones` then means steps of 1. Otherwise
    such a range stands for whatever lies between its ends, and lists no numbers itself. Errors are
    those of `whole_numbers`.
    """
    entries = _SEPARATOR.split(text.strip().removesuffix(",").rstrip())
    ends_of_entries = [_ends(entry, text, number) for entry in entries]
    listed = sum(
        1 + ((last - first) // (step or 1) if step or by_ones else 0)
        for first, last, step in ends_of_entries
    )
    if listed > MOST_NUMBERS:
        raise ValueError(f"must be at most {MOST_NUMBERS:,} numbers, got more: {shown(text)}")
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
            f"must have ranges from a number to a larger one in steps above 0, got {got}"
        )
    return first, last, step
