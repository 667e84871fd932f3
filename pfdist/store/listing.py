"""files.json: the list of a run's files, and the key of the run.

It names every published file of a table; the name of such a file ends with the hash of its content.
It has the hashes that job.toml, model.json, run.json and answers may have, and those of the
pages: the figures and the report, while they are made from the tables as they are. It is replaced
as a whole, so a reader sees the list before a change or the list after it.

Only the process that holds the run's lock writes it. These are the orders, and what a kill between
two steps costs:

- A table is published: its files get their names, files.json lists them, the files that are not
  listed any more are removed, and last the parts. A kill before the list costs nothing: the parts
  or the former files are still there, and the next start removes what is not listed. After a kill
  behind the list, parts may be left: their phase is published again, with the same bytes.
  Several tables may take each of these steps together.
- job.toml, model.json, run.json or an answer is replaced: files.json lists the hashes of the old
  and the new content, then the file gets its name. The next list keeps only the hash of the file
  that is there.
- Tables change: the pages leave the list first. Their files stay until new ones replace them, which
  are listed once they are there. So the next run makes again what a kill has left unlisted.
"""

import contextlib
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pfdist.common.parsing import MOST_BYTES, parse_json, text_of
from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.folder import FILES, LISTED, REPORT, figures_in, has_report
from pfdist.store.lock import held
from pfdist.store.tables import REMEDY

_known = dict[Path, tuple[tuple[int, ...], "Listing | None"]]()
"""The listings that this process has read or written, and the versions of their files."""

_PUBLISHED = re.compile(r"tables/[a-z_]+/[a-z0-9_.]+-\d{5}-[0-9a-f]{16}\.parquet")


@dataclass(frozen=True)
class Listing:
    """The content of files.json; paths are relative to the run's folder."""

    run: str  # key of the run, which each file of a table carries
    files: tuple[str, ...] = ()  # published files of tables
    about: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # SHA-256 by name
    pages: Mapping[str, str] = field(default_factory=dict)  # SHA-256 by path


def read_listing(folder: Path) -> Listing | None:
    """The content of files.json; None if there is no such file.

    A file that has not been replaced since is not read again. Raises `StoreError` if it is damaged:
    it also contains a hash of its own content.
    """
    path = folder / FILES
    with files.reading(path):
        try:
            version = files.stamp_of(path)
        except (FileNotFoundError, NotADirectoryError):
            return None
    known = _known.get(path)
    if known is None or known[0] != version:
        known = _known[path] = version, _read(path)
    return known[1]


def _read(path: Path) -> Listing | None:
    with files.reading(path):
        try:
            content = parse_json(text_of(files.read_plain(path, MOST_BYTES)))
            listing = Listing(
                content["run"],
                tuple(content["files"]),
                {name: tuple(hashes) for name, hashes in content["about"].items()},
                dict(content["pages"]),
            )
            if content == _content(listing) and all(map(_PUBLISHED.fullmatch, listing.files)):
                return listing
        except FileNotFoundError:
            return None
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise _damaged(path) from error
    raise _damaged(path)


def change_listing(folder: Path, key: str | None = None, **changes: Any) -> None:
    """Replace parts of files.json, which is created if it is missing.

    It keeps the hashes of the current files that `LISTED` names, and drops older ones.
    """
    listing = read_listing(folder)
    there = {name: files.digest(folder / name) for name in LISTED if (folder / name).exists()}
    if listing is None:
        listing = Listing(key or "", about={name: (now,) for name, now in there.items()})
    about = dict(listing.about)
    about |= {name: (now,) for name, now in there.items() if now in about.get(name, ())}
    added = changes.pop("about", {})
    about |= {name: (*about.get(name, ()), *hashes) for name, hashes in added.items()}
    listing = replace(listing, run=key or listing.run, about=about, **changes)
    text = json.dumps(_content(listing), indent=1) + "\n"
    path = folder / FILES
    files.write_file(path, lambda file: file.write_text(text, encoding="utf-8"))
    _known[path] = files.stamp_of(path), listing


def listed_pages(folder: Path) -> set[Path]:
    """The figures and the report of a run that were made from its tables as they are now."""
    listing = read_listing(folder)
    names = listing.pages if listing is not None else {}
    there = (*figures_in(folder), *([folder / REPORT] if has_report(folder) else []))
    return {page for page in there if str(page.relative_to(folder)) in names}


def record_pages(
    folder: Path, made: Iterable[Path], *, locked: bool = False, without: str = ""
) -> None:
    """List pages that were made from the tables, unless another command may write to the run.

    `locked` is whether the caller holds the run's lock. If a page cannot be listed, no error is
    raised, because a command can make it again. The page `without` will be replaced and is left
    out, so that a kill leaves no wrong hash.
    """
    lock = nullcontext(True) if locked else held(folder, patience=0.0)
    with contextlib.suppress(StoreError, OSError), lock as is_locked:
        listing, new = read_listing(folder), {str(page.relative_to(folder)): page for page in made}
        if is_locked and listing is not None:
            pages = dict(listing.pages) | {name: files.digest(page) for name, page in new.items()}
            pages.pop(without, None)
            if pages != listing.pages:
                change_listing(folder, pages=pages)


def forget_pages(folder: Path, *names: str) -> None:
    """List some pages of a run no longer, or none, as they will be made again; needs the lock.

    The files stay until then: they show fewer draws.
    """
    listing = read_listing(folder)
    if listing is not None and listing.pages:
        stay = set(listing.pages).difference(names) if names else ()
        change_listing(folder, pages={name: listing.pages[name] for name in stay})


def _content(listing: Listing) -> dict[str, Any]:
    about = {name: [*hashes] for name, hashes in listing.about.items()}
    content = {**vars(listing), "files": sorted(listing.files), "about": about}
    text = json.dumps(content, sort_keys=True)
    return {"sha256": hashlib.sha256(text.encode()).hexdigest(), **content}


def _damaged(path: Path) -> StoreError:
    return StoreError(f"{path} is damaged: its content has another hash; {REMEDY}")
