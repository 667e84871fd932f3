"""An index of the files of the draws table: which files hold an evaluation."""

from collections import defaultdict
from collections.abc import Callable, Container, Iterable
from pathlib import Path

import pyarrow as pa


class DrawFiles:
    """The files that hold the draws of each evaluation.

    The files are read at the first question. From then on the store reports every change, or has
    the folder looked at again.

    Parameters
    ----------
    read : callable
        Gives each file of the draws table, but those that it is told, with its column of
        evaluations.
    """

    def __init__(
        self, read: Callable[[Container[Path]], Iterable[tuple[Path, pa.ChunkedArray]]]
    ) -> None:
        self._read = read
        self._found: dict[str, set[Path]] | None = None
        self._known: set[Path] = set()

    def holding(self, evaluations: Iterable[str]) -> set[Path]:
        """Files that hold draws of these evaluations.

        Raises
        ------
        FileNotFoundError
            A file vanished while the files were read.
        """
        if self._found is None:
            self._found, self._known = defaultdict(set), set()
            self.look_again()
        return set().union(*(self._found.get(id_, set()) for id_ in evaluations))

    def look_again(self) -> None:
        """Read the files that another driver has written since.

        Raises
        ------
        FileNotFoundError
            A file vanished while the files were read.
        """
        for path, ids in self._read(frozenset(self._known)):
            self.add(path, ids)

    def add(self, path: Path, ids: pa.ChunkedArray) -> None:
        """Add a file that was written. Before the first question nothing needs to be added."""
        if self._found is not None:
            self._known.add(path)
            for id_ in ids.unique().to_pylist():
                self._found[id_].add(path)

    def remove(self, paths: Iterable[Path]) -> None:
        """Remove files that no longer exist."""
        gone = set(paths)
        for holders in (self._found or {}).values():
            holders.difference_update(gone)

    def forget(self) -> None:
        """Forget everything, because another process has moved files."""
        self._found = None
