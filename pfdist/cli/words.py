"""The words of a command line before argparse takes them: lists with spaces, unknown options."""

import argparse
import os
import re
from collections.abc import Iterable, Sequence

from pfdist.cli.arguments import argument_type
from pfdist.common.parsing import finite_number, ranges, whole_numbers
from pfdist.errors import JobError, shown

_GOES_ON = re.compile(r",|[0-9.:,]*[0-9][0-9.:,]*([eE][+-]?[0-9]+)?,?")
"""A word after a list of numbers that belongs to the list, unless a folder has this name."""
_SENSOR = re.compile(r"(?<=[0-9]) +[A-Za-z][\w-]*(,|$| )")  # after times: "12 x-ray"
_OPTION = re.compile(r"-[^0-9. ][^ ]*")  # argparse takes other words for values


number_list = argument_type(whole_numbers)
"""The numbers that an option lists: the type of options such as ``--times``."""


@argument_type
def time_list(text: str) -> str:
    """The times that an option lists, as they are written: the clock of the job reads them."""
    ranges(_SENSOR.sub(" ", text), finite_number)
    return text


def named_times(text: str) -> tuple[str, str]:
    """The name and the times of a set, as in ``clinic=0,6,12``; the name may be missing.

    The word ``regular`` alone is a set of this name.

    Raises
    ------
    ArgumentTypeError
        The text lists no times.
    """
    # Not above: it imports NumPy, and the words of every command line are read here.
    from pfdist.times.measurement_times import REGULAR  # noqa: PLC0415

    if text == REGULAR:
        return REGULAR, REGULAR
    name, equals, times = text.rpartition("=")
    if equals and not name:
        raise argparse.ArgumentTypeError(f"needs a name before '=', got {shown(text)}")
    return name, times if name and times == REGULAR else time_list(times)


def add_named_times(
    parser: argparse.ArgumentParser, description: str, *, required: bool = False
) -> None:
    """Add ``--times``, which may be given several times.

    Parameters
    ----------
    parser : ArgumentParser
    description : str
        The help of the option.
    required : bool
        Whether the option must be given.
    """
    parser.add_argument(
        "--times",
        type=named_times,
        action="append",
        default=[],
        metavar="TIMES",
        help=description,
        required=required,
    )


def sets_by_name(named: Iterable[tuple[str, str]]) -> dict[str, str]:
    """The sets of ``--times`` by name.

    Raises
    ------
    JobError
        A set has no name, or a name is used twice.
    """
    sets = dict[str, str]()
    for name, times in named:
        if not name:
            raise JobError(
                f"times of several sets must be NAME=TIMES, as mine={times}, got {shown(times)}",
                argument="times",
            )
        if name in sets:
            raise JobError(
                f"names of times must differ from each other, got {name!r} twice", argument="times"
            )
        sets[name] = times
    return sets


_LISTS = (number_list, time_list, named_times)


def joined(words: Iterable[str], actions: Iterable[argparse.Action]) -> list[str]:
    """A command line in which each list of numbers is one word.

    ``--times 0 6 12 JOB`` becomes ``--times "0 6 12" JOB``. argparse itself would take JOB for one
    of the times. A word that is the name of a folder is never joined to a list: ``2024`` may be a
    run.

    Parameters
    ----------
    words : iterable of str
        A command line.
    actions : iterable of Action
        The arguments of the parser. Those of the types `number_list`, `time_list` and
        `named_times` take a list.
    """
    lists = [name for action in actions if action.type in _LISTS for name in action.option_strings]
    joined_words: list[str] = []
    begins = goes_on = False  # whether a list is expected, or may go on
    for word in words:
        if goes_on and _GOES_ON.fullmatch(word) and not os.path.isdir(word):
            joined_words[-1] += f" {word}"
            continue
        joined_words.append(word)
        name, equals, _ = word.partition("=")
        is_list = len(name) > 2 and any(option.startswith(name) for option in lists)
        begins, goes_on = is_list and not equals, begins or (is_list and bool(equals))
    return joined_words


def unknown_option(words: Iterable[str], options: Sequence[str]) -> str:
    """The first option of a command line that a parser does not know; empty if there is none.

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
