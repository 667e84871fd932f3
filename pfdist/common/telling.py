"""Lines for a user who waits at a terminal, from work that may take long."""

import sys
import time

SECONDS = 2.0


def tell(line: str) -> None:
    """Print a line if the standard error is a terminal."""
    if sys.stderr is not None and sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)  # noqa: T201  a line of progress, no result


class Waiting:
    """Tells every few seconds at how many instants some work is done.

    Parameters
    ----------
    doing : str
        For instance ``"Tracing transition"``.
    total : int
        How many instants it has.
    """

    def __init__(self, doing: str, total: int) -> None:
        self._doing, self._total, self._told = doing, total, time.monotonic()

    def step(self, done: int) -> None:
        """Tell how many instants are done, if it is time."""
        if time.monotonic() - self._told > SECONDS:
            self._told = time.monotonic()
            tell(f"{self._doing}: {done:,} of {self._total:,} instants")
