"""Compiled functions that are handed the arrays they work in."""

from collections.abc import Callable
from typing import Any


class WithScratch:
    """A compiled function whose arrays are made before it is called.

    Compiled code that raises an error frees no array of its own.

    Parameters
    ----------
    compiled : compiled function
    call : callable
        Makes the arrays and calls the compiled function with them.
    """

    def __init__(self, compiled: Any, call: Callable[..., None]) -> None:
        self.compiled = compiled
        self._call = call

    def __call__(self, *arguments: Any) -> None:
        """Make the arrays, and call the compiled function."""
        self._call(*arguments)
