"""Find what is wrong with a run's files, and put it out of the way."""

from collections.abc import Iterator
from pathlib import Path

from pfdist.errors import StoreError
from pfdist.store import (
    Damage,
    Store,
    check_not_held,
    held,
    holds_run,
    lacking_evaluations,
    read_run,
    strange_entries,
    verify,
)


def verify_run(path: Path) -> Iterator[Damage]:
    """Look at every byte, row and key of a run; see `pfdist.store.verify`.

    Raises
    ------
    StoreError
        The folder holds no run, one without checksums, or one that is being computed; or a file
        cannot be read.
    """
    store = _store(path)
    check_not_held(path)
    yield from verify(store)


def repair_run(path: Path) -> Iterator[str]:
    """Move what is damaged to quarantine, and say what going on will compute.

    Raises
    ------
    StoreError
        As `verify_run`; or another process computes the run, or a file cannot be moved.
    """
    store = _store(path)
    with held(path):
        strange = [Damage(*entry) for entry in strange_entries(path)]
        yield from _moved(store, strange)  # first: nothing is read past a link
        damages = list(store.manifest.damages())
        yield from _moved(store, damages)
        if strange or damages:
            yield f"the job, run again with --results {path}, makes it again: {_to_do(store)}"


def _moved(store: Store, damages: list[Damage]) -> Iterator[str]:
    """Move damaged files to quarantine, and say of each what was wrong and where it is now."""
    for damage in damages:
        place = store.manifest.quarantine(damage)
        moved = f": it is now {place.relative_to(store.path)}" if place else ""
        yield f"{damage.path} {damage.what}{moved}"


def _to_do(store: Store) -> str:
    lost = {path.parent.name or path.name for path in store.manifest.lost()}
    parts = []
    if store.has("evaluations") and (lacking := lacking_evaluations(store)):
        parts.append(f"{len(lacking):,} evaluations")
    if "comparison" in lost or store.has_parts("comparison"):
        there = int(store.present("comparison", "draw").sum())
        parts.append(f"what the comparison lacks ({there:,} draws are there)")
    parts += sorted(lost - {"draws", "comparison", "timings"})
    return ", ".join(parts) or "nothing that takes time"


def _store(path: Path) -> Store:
    store = Store(path)
    if not holds_run(path) and not store.manifest.exists():
        raise StoreError(f"{path} holds no run: there is no run.json in it")
    if not store.manifest.exists():
        run, _ = read_run(path)
        raise StoreError(
            f"{path} was written by schema version 1, which kept no checksums: it can be read, "
            "but not verified"
            if run["schema_version"] == 1
            else f"{path} has lost its folder manifest, which says what its files must hold"
        )
    return store
