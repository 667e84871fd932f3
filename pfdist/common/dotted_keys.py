"""Dotted keys of nested data: the leaves that they name, and short names for them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any


def leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the leaves of nested mappings, and of lists of mappings, with their dotted keys.

    Mappings in a list are named by their entry ``name``, and the key ``order`` lists these names. A
    list without mappings is a leaf. `key` is the prefix of every dotted key.

    >>> dict(leaves({"seed": 1, "search": [{"name": "a", "steps": 3}]}))
    {'seed': 1, 'search.order': 'a', 'search.a.name': 'a', 'search.a.steps': 3}
    """
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from leaves(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and any(isinstance(inner, Mapping) for inner in value):
        names = [inner.get("name") for inner in value if isinstance(inner, Mapping)]
        yield f"{key}.order", ", ".join(map(str, names))
        for index, inner in enumerate(value):
            name = inner.get("name", index) if isinstance(inner, Mapping) else index
            yield from leaves(inner, f"{key}.{name}")
    else:
        yield key, value


_VAGUE = {"name", "order", "method", "draws"}  # words that need the word before them


def short_names(keys: Sequence[str]) -> dict[str, str]:
    """The short name of each dotted key: the fewest of its last words that identify it.

    No other key ends with the same words. A vague word, such as ``name``, keeps the word before it.

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
