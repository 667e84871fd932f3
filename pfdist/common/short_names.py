"""Short names of dotted keys, for tables and folders."""

from collections.abc import Sequence

_VAGUE = {"name", "order", "method", "draws"}  # words that need the word before them


def short_names(keys: Sequence[str]) -> dict[str, str]:
    """The short name of each dotted key: as few of its last words as identify it.

    No other key ends with the same words. A vague word, such as ``name``, has the word before it.

    >>> short_names(["seed", "model.name", "filter.particles"])
    {'seed': 'seed', 'model.name': 'model.name', 'filter.particles': 'particles'}
    >>> short_names(["model.name", "model.filter.name"])
    {'model.name': 'model.name', 'model.filter.name': 'filter.name'}
    """
    return {key: _short_name(key, keys) for key in keys}


def _short_name(key: str, keys: Sequence[str]) -> str:
    words, others = key.split("."), [f".{other}" for other in keys if other != key]
    for first in reversed(range(len(words))):
        tail = ".".join(words[first:])
        if tail not in _VAGUE and not any(other.endswith(f".{tail}") for other in others):
            return tail
    return key
