"""The manifest: the content that every committed file of a run must have, and whose run it is.

A file under ``parts/`` has its SHA-256 in its name. All others have lines in ``manifest``::

    run <key>                   the run to which all files belong
    next <path> <SHA-256>       a file that is about to get its name
    now <path> <SHA-256>        a file that has got it
    gone <path> <SHA-256>       a file that is not expected any more

A line is appended and never changed, because drivers that no lock keeps apart may write at the same
time. A line that a kill cut short means nothing. Between ``next`` and ``now`` a file may be the new
one, the one before, or not be there yet.
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
# No other path: whoever changed the manifest could have any file moved to quarantine.
_LINE = re.compile(
    rf"(next|now|gone) (job\.toml|run\.json|{_TABLE}) ([0-9a-f]{{64}})|run ([0-9a-f]{{16}})"
)
_PART = re.compile(r"parts/.*\.([0-9a-f]{64})\.parquet", re.DOTALL)
_UNKNOWN = "0" * 64
_PUBLISHED = re.compile(_TABLE)


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
        return os.path.lexists(self.folder / MANIFEST)

    def kept_key(self) -> str | None:
        """The key of the run; None if the manifest has none."""
        keys = [key for *_, key in self._lines() if key]
        return keys[-1] if keys else None

    def keep_key(self, key: str) -> None:
        """Record the key of the run."""
        if self.kept_key() != key:
            self._add([f"run {key}"])

    def give_name(self, prepared: files.Prepared, path: Path) -> None:
        """Give a prepared file its name, and record what it holds, before and after."""
        what = f"{path.relative_to(self.folder)} {prepared.sha256}"
        self._add([f"next {what}"])
        files.give_name(prepared, path)
        self._add([f"now {what}"])

    def confirm(self, path: Path) -> None:
        """Record what a file holds, if a kill prevented it before."""
        name = path.relative_to(self.folder)
        with files.reading(path):
            sha256 = files.digest(path)
        if self.expected().get(name) != {sha256: True}:
            self._add([f"{word} {name} {sha256}" for word in ("next", "now")])

    def forget(self, lost: Iterable[Path]) -> None:
        """Expect missing files no more, after everything that can be made was made again."""
        self._add([f"gone {path} {_UNKNOWN}" for path in lost])

    def lost(self) -> list[Path]:
        """Files that are expected and not there, relative to the run's folder."""
        return sorted(path for path in self.expected() if not (self.folder / path).exists())

    def expected(self) -> dict[Path, dict[str, bool]]:
        """The contents that each file may have, and whether it had them once.

        Files are named by their paths relative to the run's folder, contents by their SHA-256.
        """
        found: dict[Path, dict[str, bool]] = {}
        for word, name, sha256, _ in self._lines():
            if not name:
                continue
            contents = found.setdefault(Path(name), {})
            if word == "gone":
                del found[Path(name)]
            elif word == "next":  # the last one from here on, as `now` needs it
                contents[sha256] = contents.pop(sha256, False)
            else:
                # Another driver may have announced contents since then: they may be there, too.
                since = list(contents)
                for former in since[: since.index(sha256) if sha256 in since else 0]:
                    del contents[former]
                contents.pop(sha256, None)
                contents[sha256] = True
        return found

    def damages(self) -> Iterator[Damage]:
        """Read every file of the run and give those that are not what was committed.

        Where the folder holds strange entries (see `pfdist.store.folder`), these alone are given:
        nothing is read past them.

        Raises
        ------
        StoreError
            A file cannot be read.
        """
        if strange := list(strange_entries(self.folder)):
            yield from strange
            return
        present = {file.relative_to(self.folder) for file in self._files()}
        expected = self.expected()  # after the files: each was announced before it was there
        for path in sorted(present | expected.keys()):
            if path not in present:
                if any(expected[path].values()):
                    yield Damage(path, MISSING)
            elif wrong := self._wrong(path, _PART.findall(str(path)) or expected.get(path, {})):
                yield Damage(path, wrong)

    def quarantine(self, damage: Damage) -> Path | None:
        """Move a damaged file out of the way, never delete it; give its new place, if it was there.

        It is expected from now on, if it is one that the run could have made.
        """
        path, folder = self.folder / damage.path, self.folder / QUARANTINE / damage.path.parent
        if not os.path.lexists(path):
            return None
        if damage.path.parts[0] in (MANIFEST, QUARANTINE):
            raise StoreError(f"{path} {damage.what}: pfdist moves nothing out of it; remove it")
        if _PUBLISHED.fullmatch(damage.path.as_posix()):
            self._add([f"now {damage.path} {_UNKNOWN}"])
        place, number = folder / path.name, 1
        while os.path.lexists(place):
            place, number = folder / f"{path.name}.{number}", number + 1
        files.move(path, place)
        return place

    def _wrong(self, path: Path, expected: Iterable[str]) -> str:
        """Say what is wrong with an existing file; empty if nothing is wrong."""
        known = {sha256 for sha256 in expected if sha256 != _UNKNOWN}
        if not known:
            return "is not a file of this run"
        try:
            if files.digest(self.folder / path) not in known:
                return "is not what was committed: its SHA-256 differs"
            return self._wrong_table(path) if path.suffix == ".parquet" else ""
        except FileNotFoundError:  # published meanwhile
            return ""
        except OSError as error:
            if error.errno != errno.EIO:  # the disk's fault, and not that of who asks
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
            if found := _LINE.fullmatch(line):
                word, name, sha256, key = found.groups(default="")
                yield word, name, sha256, key

    def _files(self) -> Iterator[Path]:
        for name in ABOUT:
            if (self.folder / name).exists():
                yield self.folder / name
        for folder in ("parts", "tables"):
            for path in (self.folder / folder).rglob("*"):
                if path.is_file() and not files.is_temporary(path):
                    yield path
