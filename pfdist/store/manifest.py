"""The manifest: the content that every committed file of a run must have, and whose run it is.

A file under ``parts/`` has its SHA-256 in its name. All others have lines in ``manifest``::

    run <key>                   the run to which all files belong
    next <path> <SHA-256>       a file that is about to get its name
    now <path> <SHA-256>        a file that has got it
    gone <path> <SHA-256>       a file that is not expected any more

A line is appended and never changed, because drivers that no lock keeps apart may write at the same
time. A line that a kill cut short means nothing.

A kill between ``next`` and ``now`` does no harm: the file may be the new one, the one before, or
not be there yet. Without ``next``, a file that has just got its name would look damaged. Without
``now``, the content before would be accepted for ever, and a lost file would not be missed.
"""

import errno
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.folder import (
    ABOUT,
    MANIFEST,
    MISSING,
    QUARANTINE,
    Damage,
    is_plain_file,
    strange_entries,
)
from pfdist.store.tables import rows_and_run

_TABLE = r"tables/[a-z_]+/[a-z][a-z0-9_.]*-\d{5}\.parquet"
# No other path: otherwise a changed manifest could have any file moved to quarantine.
_LINE = re.compile(
    rf"(next|now|gone) (job\.toml|run\.json|{_TABLE}) ([0-9a-f]{{64}})|run ([0-9a-f]{{16}})"
)
_PART = re.compile(r"parts/.*\.([0-9a-f]{64})\.parquet", re.DOTALL)
_UNKNOWN = "0" * 64  # SHA-256 of no file: for a file that is expected, whatever its content was
_PUBLISHED = re.compile(_TABLE)


class Manifest:
    """The expected contents of the files of one run.

    Every file of a table must carry the key of the run; None: it must carry none.
    """

    def __init__(self, folder: Path, run_key: str | None = None) -> None:
        self.folder, self._run_key = folder, run_key

    def exists(self) -> bool:
        """Whether the folder has a manifest; a folder without a run has none."""
        return os.path.lexists(self.folder / MANIFEST)

    def recorded_key(self) -> str | None:
        """The key of the run, by the last such line; None if the manifest has none."""
        keys = [key for *_, key in self._lines() if key]
        return keys[-1] if keys else None

    def record_key(self, key: str) -> None:
        """Record the key of the run, if the manifest does not have it."""
        if self.recorded_key() != key:
            self._add([f"run {key}"])

    def give_name(self, prepared: files.Prepared, path: Path) -> None:
        """Rename a prepared file to its final name, and record its content before and after.

        The content is announced first: a reader or a restart that finds the new file finds it
        announced.
        """
        what = f"{path.relative_to(self.folder)} {prepared.sha256}"
        self._add([f"next {what}"])
        files.give_name(prepared, path)
        self._add([f"now {what}"])

    def confirm(self, path: Path) -> None:
        """Record the content of a file as committed, if a kill prevented it before."""
        name = path.relative_to(self.folder)
        with files.reading(path):
            sha256 = files.digest(path)
        if self.expected().get(name) != {sha256: True}:
            self._add([f"{word} {name} {sha256}" for word in ("next", "now")])

    def forget(self, lost: Iterable[Path]) -> None:
        """Expect some missing files no more.

        The caller has made everything again that can be made. Before that, a line ``gone`` would
        hide a file that the next start must still compute.
        """
        self._add([f"gone {path} {_UNKNOWN}" for path in lost])

    def lost(self) -> list[Path]:
        """Files that are expected and not there, relative to the run's folder."""
        return sorted(path for path in self.expected() if not (self.folder / path).exists())

    def expected(self) -> dict[Path, dict[str, bool]]:
        """The contents that each file may have, and whether it had them once.

        Files are named by their paths relative to the run's folder, contents by their SHA-256. The
        contents are in the order of their lines. False: the content was only announced, so it need
        not be there.
        """
        contents_of_files: dict[Path, dict[str, bool]] = {}
        for word, name, sha256, _ in self._lines():
            if not name:
                continue
            contents = contents_of_files.setdefault(Path(name), {})
            if word == "gone":
                del contents_of_files[Path(name)]
            elif word == "next":  # moved to the end: `now` ends all contents announced before it
                contents[sha256] = contents.pop(sha256, False)
            else:
                # Another driver may have announced contents since this one: they stay possible.
                since = list(contents)
                for former in since[: since.index(sha256) if sha256 in since else 0]:
                    del contents[former]
                contents.pop(sha256, None)
                contents[sha256] = True
        return contents_of_files

    def damages(self) -> Iterator[Damage]:
        """Read every file of the run and yield those that are not what was committed.

        If the folder holds strange entries (see `pfdist.store.folder`), only these are yielded:
        nothing is read past them. Raises `StoreError` if a file cannot be read.
        """
        if strange := list(strange_entries(self.folder)):
            yield from strange
            return
        present = {file.relative_to(self.folder) for file in self._files()}
        # The files are listed before the manifest is read, never after: each file was announced
        # before it was there. So a file that a driver publishes meanwhile is announced, or not
        # listed.
        expected = self.expected()
        for path in sorted(present | expected.keys()):
            if path not in present:
                if any(expected[path].values()):
                    yield Damage(path, MISSING)
            elif wrong := self._wrong(path, _PART.findall(str(path)) or expected.get(path, {})):
                yield Damage(path, wrong)

    def quarantine(self, damage: Damage) -> Path | None:
        """The new place of a damaged file, which is moved, never deleted; None if it was missing.

        If it is a published file, the manifest expects it from now on, so the next start makes it
        again. Raises `StoreError` if the entry is the manifest or the quarantine, out of which
        nothing is moved.
        """
        path, folder = self.folder / damage.path, self.folder / QUARANTINE / damage.path.parent
        if not os.path.lexists(path):
            return None
        if damage.path.parts[0] in (MANIFEST, QUARANTINE):
            raise StoreError(f"{path} {damage.what}: pfdist moves nothing out of it; remove it")
        # Expected first, moved then. A kill in between leaves a file of unknown content, which is
        # still damage. In the other order, a file that was never announced would not be missed.
        if _PUBLISHED.fullmatch(damage.path.as_posix()):
            self._add([f"now {damage.path} {_UNKNOWN}"])
        place, number = folder / path.name, 1
        while os.path.lexists(place):
            place, number = folder / f"{path.name}.{number}", number + 1
        files.move(path, place)
        return place

    def _wrong(self, path: Path, expected: Iterable[str]) -> str:
        """The fault of an existing file; empty if nothing is wrong."""
        possible = {sha256 for sha256 in expected if sha256 != _UNKNOWN}
        if not possible:
            return "is not a file of this run"
        try:
            if files.digest(self.folder / path) not in possible:
                return "is not what was committed: its SHA-256 differs"
            return self._wrong_table(path) if path.suffix == ".parquet" else ""
        except FileNotFoundError:  # a part that was published meanwhile
            return ""
        except OSError as error:
            if error.errno != errno.EIO:  # only EIO is the disk's fault, and so damage
                raise StoreError(f"cannot read {path}: {error.strerror}") from error
            return f"cannot be read: {error.strerror}"

    def _wrong_table(self, path: Path) -> str:
        try:
            rows, key = rows_and_run(self.folder / path)
        except StoreError:
            return "is not a Parquet file"
        if key != self._run_key:
            return "belongs to another run"
        return "" if rows or path.parts[0] == "parts" else "has no rows"

    def _add(self, lines: list[str]) -> None:
        if lines:
            files.add_lines(self.folder / MANIFEST, lines)

    def _lines(self) -> Iterator[tuple[str, str, str, str]]:
        """Word, path, SHA-256 and key of each whole line; the key or the others are empty."""
        path = self.folder / MANIFEST
        if not is_plain_file(path):
            return
        with files.reading(path):
            text = path.read_text(encoding="utf-8", errors="replace")
        for line in text.splitlines():
            if match := _LINE.fullmatch(line):
                word, name, sha256, key = match.groups(default="")
                yield word, name, sha256, key

    def _files(self) -> Iterator[Path]:
        for name in ABOUT:
            if (self.folder / name).exists():
                yield self.folder / name
        for folder in ("parts", "tables"):
            for path in (self.folder / folder).rglob("*"):
                if path.is_file() and not files.is_temporary(path):
                    yield path
