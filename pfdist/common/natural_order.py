"""The order of names that people expect, in which n10 follows n9."""

import re

_NUMBER = re.compile("([0-9]+)")


def natural_key(name: str) -> list[tuple[int, str]]:
    """A key by which names are sorted, with numbers in them ordered as numbers, and then as text.

    >>> sorted(["n10", "n9", "n9b", "m", "n09"], key=natural_key)
    ['m', 'n09', 'n9', 'n9b', 'n10']
    """
    parts = _NUMBER.split(name)
    return [(int(part), "") if index % 2 else (0, part) for index, part in enumerate(parts)] + [
        (0, name)
    ]
