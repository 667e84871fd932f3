"""The words of a command line before argparse takes them: lists with spaces, unknown options."""

import argparse
import re
from collections.abc import Iterable, Sequence

from pfdist.common.number_list import whole_numbers

_GOES_ON = re.compile(r"[0-9:,]+")  # a word after a list of numbers that belongs to the list
_OPTION = re.compile(r"-[^0-9. ][^ ]*")  # argparse takes other words for values


def number_list(text: str) -> list[int]:
    """Give the numbers that an option lists: the type of options such as ``--times``.

    Raises
    ------
    ArgumentTypeError
        The text lists no numbers.
    """
    try:
        return whole_numbers(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def joined(words: Iterable[str], actions: Iterable[argparse.Action]) -> list[str]:
    """Give a command line in which each list of numbers is one word.

    ``--times 0 6 12 JOB`` becomes ``--times "0 6 12" JOB``. argparse itself would take JOB for one
    of the times.

    Parameters
    ----------
    words : iterable of str
        A command line.
    actions : iterable of Action
        The arguments of the parser. Those of the type `number_list` take a list.
    """
    lists = [
        name for action in actions if action.type is number_list for name in action.option_strings
    ]
    found: list[str] = []
    begins = goes_on = False  # whether a list is expected, or may go on
    for word in words:
        if goes_on and _GOES_ON.fullmatch(word):
            found[-1] += f" {word}"
            continue
        found.append(word)
        name, equals, _ = word.partition("=")
        is_list = len(name) > 2 and any(option.startswith(name) for option in lists)
        begins, goes_on = is_list and not equals, begins or (is_list and bool(equals))
    return found


def unknown_option(words: Iterable[str], options: Sequence[str]) -> str:
    """Give the first option of a command line that a parser does not know; empty if there is none.

    argparse names unknown options only after all other mistakes, so a misspelt option that is
    required would be called missing.

    Parameters
    ----------
    words : iterable of str
        A command line.
    options : sequence of str
        The options that the parser knows. They may be shortened.
    """
    for word in words:
        if word == "--":
            break
        name = word.partition("=")[0]
        if _OPTION.fullmatch(name) and not any(option.startswith(name) for option in options):
            return name
    return ""
