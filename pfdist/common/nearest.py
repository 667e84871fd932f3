"""The correct name that is most similar to a misspelt name."""

import contextlib
import difflib
import re
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path

from pfdist.errors import shown

_LONGEST = 80  # characters of a misspelt word
_MOST_ENTRIES = 1000  # of a folder that is searched
_QUOTED = re.compile(r"'([^']*)'")


def nearest_name(word: object, names: Iterable[str]) -> str:
    """The name that is spelt most like a user's word; empty if no name is similar.

    Only a string can be a misspelt name.

    >>> nearest_name("suvivors", ["random", "survivors"])
    'survivors'
    >>> nearest_name("Genetic", ["genetic"]), nearest_name("x", ["genetic"]), nearest_name(3, ["3"])
    ('genetic', '', '')
    >>> nearest_name("budget", ["horizon", "measurement_budget"])
    'measurement_budget'
    """
    if not isinstance(word, str) or len(word) > _LONGEST:
        return ""
    by_lower_case = {name.lower(): name for name in names}
    matches = difflib.get_close_matches(word.lower(), by_lower_case, n=1)
    matches = matches or [name for name in by_lower_case if word.lower() in name.split("_")]
    return by_lower_case[matches[0]] if len(matches) == 1 else ""


def did_you_mean(word: object, names: Iterable[str]) -> str:
    """The end of an error about a name that is not allowed; empty if no allowed name is similar.

    >>> "got 'suvivors'" + did_you_mean("suvivors", ["random", "survivors"])
    "got 'suvivors'; did you mean 'survivors'?"
    """
    name = nearest_name(word, names)
    return f"; did you mean {name!r}?" if name else ""


def allowed_names(names: Iterable[str], meant: str) -> str:
    """The end of an error that lists the allowed names, after a suggestion of `did_you_mean`."""
    listed = ", ".join(names) or "none"
    return f"{meant} Allowed: {listed}" if meant else f", allowed: {listed}"


def must_be(name: str, rule: str, got: object, names: Iterable[str]) -> str:
    """The error about a value that breaks a rule; if it is a misspelt name, this comes first.

    >>> must_be("noise", "'fresh' or 'common'", "comon", ["fresh", "common"])
    "noise: got 'comon'; did you mean 'common'? Allowed: 'fresh' or 'common'"
    """
    if meant := did_you_mean(got, names):
        return f"{name}: got {shown(got)}{meant} Allowed: {rule.removeprefix('one of ')}"
    return f"{name} must be {rule}, got {shown(got)}"


def did_you_mean_path(path: Path, folders: Iterable[Path], is_meant: Callable[[Path], bool]) -> str:
    """The end of an error about a file or folder that is not there; empty if no name is similar.

    The folders are searched for paths with a similar name that `is_meant` accepts.
    """
    paths_by_name: dict[str, str] = {}
    for folder in folders:
        with contextlib.suppress(OSError):
            for near in islice(folder.iterdir(), _MOST_ENTRIES):
                if near != path and is_meant(near):
                    paths_by_name.setdefault(near.name, str(near))
    name = nearest_name(path.name, sorted(paths_by_name))
    return f"; did you mean {paths_by_name[name]!r}?" if name else ""


def quoted_names(text: str) -> list[str]:
    """The names between single quotes in a text, for instance ``'a' or 'b'``."""
    return _QUOTED.findall(text)
