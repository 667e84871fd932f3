"""An index of the files of the draws table: which files hold an evaluation."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import pyarrow as pa


class DrawFiles:
    """The files that hold the draws of each evaluation.

    The files are read at the first question. From then on the store reports every change.

    Parameters
    ----------
    read : callable
        Gives each file of the draws table with its column of evaluations.
    """

    def __init__(self, read: Callable[[], Iterable[tuple[Path, pa.ChunkedArray]]]) -> None:
        self._read = read
        self._found: dict[str, set[Path]] | None = None

    def holding(self, evaluations: Iterable[str]) -> set[Path]:
        """Files that hold draws of these evaluations.

        Raises
        ------
        FileNotFoundError
            A file vanished while the files were read.
        """
        if self._found is None:
            found: dict[str, set[Path]] = defaultdict(set)
            for path, ids in self._read():
                for id_ in ids.unique().to_pylist():
                    found[id_].add(path)
            self._found = found
        return set().union(*(self._found.get(id_, set()) for id_ in evaluations))

    def add(self, path: Path, ids: pa.ChunkedArray) -> None:
        """Add a file that was written. Before the first question nothing needs to be added."""
        if self._found is not None:
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
