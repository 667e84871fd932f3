"""The leaves of nested data, such as the sections of a job, by their dotted keys."""

from collections.abc import Iterator, Mapping
from typing import Any


def leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the leaves of nested mappings, and of lists of mappings, with their dotted keys.

    Mappings in a list have the names that they give themselves, and the key ``order`` holds the
    names in their order. A list without mappings is a leaf. `key` stands before each key of a leaf.

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
