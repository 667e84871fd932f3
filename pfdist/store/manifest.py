"""The manifest: the content that every committed file of a run must have.

A file under ``parts/`` says so in its name. For the rest the folder ``manifest/`` has, for each
file, a folder of empty files: ``manifest/<the file's path>/<rows>-<SHA-256>``. Names cannot be half
written. A file that is about to get its name has ``<rows>-<SHA-256>.new`` before, so that one
which is not there yet is told from one that is gone; where it replaces another, it may be either.
"""

import errno
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.strange import strange_entries
from pfdist.store.tables import signed_by

FOLDER, QUARANTINE = "manifest", "quarantine"
_STAMP = re.compile(r"\d+-[0-9a-f]{64}")
_NEW = ".new"
_MISSING = "is missing"
_UNKNOWN = f"0-{'0' * 64}"
_PUBLISHED = re.compile(r"[a-z][a-z0-9_]*-\d{5}\.parquet")


@dataclass(frozen=True)
class Damage:
    """A file that is not what was committed.

    Parameters
    ----------
    path : Path
        Relative to the run's folder.
    what : str
        The damage.
    """

    path: Path
    what: str

    @property
    def is_missing(self) -> bool:
        """Whether the file is not there, so that nothing has to be moved: the job makes it."""
        return self.what == _MISSING


class Manifest:
    """The expected contents of the files of one run.

    Parameters
    ----------
    folder : Path
        The run's.
    run_key : str, optional
        The key that every file of a table must carry.
    """

    def __init__(self, folder: Path, run_key: str | None = None) -> None:
        self.folder, self._run_key = folder, run_key

    def exists(self) -> bool:
        """Whether the folder has a manifest; a folder without a run has none."""
        return (self.folder / FOLDER).is_dir()

    def expect(self, path: Path, stamp: str) -> list[Path]:
        """Record the content that a file will have, before it gets its name.

        Returns
        -------
        list of Path
            Former statements about the file, which `settle` removes.
        """
        entry = self._entry(path)
        before = [other for other in entry.glob("*") if other.name != stamp]
        if not (entry / stamp).exists():
            files.touch(entry / f"{stamp}{_NEW}")
        return before

    def settle(self, path: Path, stamp: str, before: list[Path]) -> None:
        """Record that a file got its name, and remove the records of its earlier contents."""
        entry = self._entry(path)
        files.touch(entry / stamp)
        for other in (*before, entry / f"{stamp}{_NEW}"):
            files.remove(other)

    def forget_lost(self) -> None:
        """Remove the records of missing files, after everything that can be made was made again."""
        for path in self.lost():
            for entry in self._entry(self.folder / path).glob("*"):
                files.remove(entry)

    def lost(self) -> list[Path]:
        """Files that are expected and not there, relative to the run's folder."""
        return sorted(path for path in self._entries() if not (self.folder / path).exists())

    def stamps(self) -> dict[Path, set[str]]:
        """The contents that each file may have, by its path relative to the run's folder."""
        return {
            path: {name.removesuffix(_NEW) for name in names}
            for path, names in self._entries().items()
        }

    def stamps_of(self, path: Path) -> set[str]:
        """The contents that one file may have."""
        return {entry.name.removesuffix(_NEW) for entry in self._entry(path).glob("*")}

    def damages(self) -> Iterator[Damage]:
        """Read every file of the run and give those that are not what was committed.

        Where the folder holds strange entries (see `pfdist.store.strange`), these alone are given:
        nothing is read past them.

        Raises
        ------
        StoreError
            A file cannot be read.
        """
        strange = [Damage(path, wrong) for path, wrong in strange_entries(self.folder)]
        if strange:
            yield from strange
            return
        entries, stamps = self._entries(), self.stamps()
        present = {file.relative_to(self.folder) for file in self._files()}
        for path in sorted(present | entries.keys()):
            if path not in present:
                if any(not name.endswith(_NEW) for name in entries[path]):
                    yield Damage(path, _MISSING)
                continue
            expected = {_own_stamp(path)} if path.parts[0] == "parts" else stamps.get(path, set())
            if wrong := self._wrong(path, expected):
                yield Damage(path, wrong)

    def quarantine(self, damage: Damage) -> Path | None:
        """Move a damaged file out of the way, never delete it; give its new place, if it was there.

        It is expected from now on, if it is one that the run could have made.
        """
        path, folder = self.folder / damage.path, self.folder / QUARANTINE / damage.path.parent
        if not os.path.lexists(path):
            return None
        if damage.path.parts[0] in (FOLDER, QUARANTINE):
            raise StoreError(f"{path} {damage.what}: pfdist moves nothing out of it; remove it")
        if damage.path.parts[0] == "tables" and _PUBLISHED.fullmatch(path.name):
            files.touch(self._entry(path) / _UNKNOWN)
        place, number = folder / path.name, 1
        while os.path.lexists(place):
            place, number = folder / f"{path.name}.{number}", number + 1
        files.move(path, place)
        return place

    def _wrong(self, path: Path, expected: set[str]) -> str:
        """Say what is wrong with an existing file; empty if nothing is wrong."""
        if not any(map(_STAMP.fullmatch, expected)):
            return "is not a file of this run"
        try:
            digest = files.digest(self.folder / path)
            if digest not in {stamp.partition("-")[2] for stamp in expected}:
                return "is not what was committed: its SHA-256 differs"
            key = signed_by(self.folder / path) if path.suffix == ".parquet" else self._run_key
        except FileNotFoundError:  # published meanwhile
            return ""
        except StoreError:
            return "is not a Parquet file"
        except OSError as error:
            if error.errno != errno.EIO:  # the disk's fault, and not that of who asks
                raise StoreError(f"cannot read {path}: {error.strerror}") from error
            return f"cannot be read: {error.strerror}"
        return "" if key == self._run_key else "belongs to another run"

    def _entry(self, path: Path) -> Path:
        return self.folder / FOLDER / path.relative_to(self.folder)

    def _entries(self) -> dict[Path, set[str]]:
        found: dict[Path, set[str]] = {}
        root = self.folder / FOLDER
        try:
            for entry in root.rglob("*"):
                if _STAMP.fullmatch(entry.name.removesuffix(_NEW)):
                    found.setdefault(entry.parent.relative_to(root), set()).add(entry.name)
        except OSError as error:
            raise StoreError(f"cannot read {root}: {error.strerror}") from error
        return found

    def _files(self) -> Iterator[Path]:
        for name in ("job.toml", "run.json"):
            if (self.folder / name).exists():
                yield self.folder / name
        for folder in ("parts", "tables"):
            for path in (self.folder / folder).rglob("*"):
                if path.is_file() and not files.is_temporary(path):
                    yield path


def _own_stamp(path: Path) -> str:
    """The content that the name of a part promises."""
    return path.name.removesuffix(".parquet").rpartition(".")[2]
