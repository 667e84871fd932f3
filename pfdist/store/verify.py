"""Verification of the files and rows of a run."""

from collections.abc import Iterator
from pathlib import Path

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.about import check_models, check_version_of, read_listed, read_run
from pfdist.store.folder import ANSWERS, REPORT, SUMMARY, check_entries
from pfdist.store.listing import read_listing
from pfdist.store.lock import check_not_held
from pfdist.store.parquet import Store
from pfdist.store.schema import KEYS, QUESTIONS


def verify_run(path: Path) -> Iterator[str]:
    """The faults of a run, one line each; every byte, row and key is checked.

    Files are checked by hashes and keys, then rows by their keys if all files are right, and last
    the pages. Raises `StoreError` if the folder does not hold a run, if the run has another schema
    version or is being computed, or if a file cannot be read.
    """
    check_not_held(path)
    check_version_of(path)
    try:
        check_entries(path)
        read_run(path)
        check_models(path)
    except StoreError as error:
        if not (path / "run.json").exists():
            raise
        yield str(error)
        return
    store = Store(path)
    damages = list(store.damages())
    yield from damages or _wrong_rows(store)
    for stranger in store.strangers():
        yield f"{stranger} is not in files.json, so it is not a file of this run: remove it"
    listing = read_listing(path)
    for name in ANSWERS.keys() & listing.about if listing is not None else ():
        try:
            read_listed(path, name)
        except StoreError as error:
            yield str(error)
    for name, sha256 in listing.pages.items() if listing is not None else ():
        page = path / name
        with files.reading(page):
            differs = page.exists() and files.digest(page) != sha256
        if differs:
            command = "report" if name == REPORT else "plot"
            remedy = f"`pfdist {command} {path}` makes it again"
            yield f"{page} has changed: {'remove it' if name == SUMMARY else remedy}"


def _wrong_rows(store: Store) -> Iterator[str]:
    """Keys of rows that are there twice, or missing; parts may lack rows, which are computed."""
    tables = store.path / "tables"
    if store.has_parts(without=QUESTIONS):
        return
    if store.has("evaluations"):
        evaluations = store.read("evaluations")
        if evaluations.duplicated(KEYS["evaluations"]).any():
            yield f"{tables / 'evaluations'} has an evaluation twice"
        rows = store.evaluations("draws")
        wanted = dict(zip(evaluations["evaluation"], evaluations["draws"], strict=True))
        lacking = [id_ for id_, draws in wanted.items() if rows.get(id_, 0) < draws]
        if lacking:
            yield (
                f"{tables / 'draws'} lacks draws of {len(lacking):,} evaluations, {lacking[0]} "
                "among them"
            )
    if store.has("comparison"):
        ranges = store.draws("comparison")
        draws, end = sum(map(len, ranges)), max((each.stop for each in ranges), default=0)
        counted = sum(piece.num_rows for piece in store.pieces("comparison", ["draw"]))
        if not counted == draws == end:
            yield (
                f"{tables / 'comparison'} must have each draw up to {end - 1:,} once, got "
                f"{counted:,} rows of {draws:,} draws"
            )
