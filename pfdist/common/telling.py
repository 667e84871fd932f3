"""Progress lines at a terminal, for work that may take long."""

import sys
import time

SECONDS = 2.0


def tell(line: str) -> None:
    """Print a line to standard error if it is a terminal."""
    if sys.stderr is not None and sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)  # noqa: T201  a line of progress, no result


class Waiting:
    """Prints every few seconds for how many instants some work is done.

    Parameters
    ----------
    doing : str
        For instance ``"Tracing transition"``.
    total : int
        Number of instants.
    """

    def __init__(self, doing: str, total: int) -> None:
        self._doing, self._total, self._told = doing, total, time.monotonic()

    def step(self, done: int) -> None:
        """Print the number of finished instants, if some seconds have passed."""
        if time.monotonic() - self._told > SECONDS:
            self._told = time.monotonic()
            tell(f"{self._doing}: {done:,} of {self._total:,} instants")
