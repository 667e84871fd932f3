"""Answers as JSON can hold them."""

import math
from typing import Any


def finite(value: Any) -> Any:
    """The same value with None for floats that are not finite, and with lists for tuples."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
