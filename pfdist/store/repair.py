"""Verifies the files of a run, and moves damaged files to quarantine."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from pfdist.errors import StoreError
from pfdist.store.about import check_version_of, own_key, run_key
from pfdist.store.folder import ABOUT, Damage, holds_run, no_run, strange_entries
from pfdist.store.lock import check_not_held, held
from pfdist.store.manifest import Manifest
from pfdist.store.parquet import Store
from pfdist.store.schema import KEYS


def verify_run(path: Path) -> Iterator[Damage]:
    """Every file and row of a run that is wrong: each byte, row and key is checked.

    First each file's SHA-256 and key; if all files are what was committed, the keys of the rows.
    Raises `StoreError` if the folder holds no run, one of another schema version, or one that is
    being computed, or if a file cannot be read.
    """
    _check_verifiable(path)
    check_not_held(path)
    store = Store(path)
    # Rows are read only if every file is what was committed: a damaged table cannot be trusted.
    damages = list(store.manifest.damages())
    yield from damages or _wrong_rows(store)


def repair_run(path: Path) -> Iterator[str]:
    """Move damaged files to quarantine, and say what the next start will compute.

    Errors are those of `verify_run`; or another process computes the run, or a file cannot be
    moved.

    The order matters: links and pipes go first, because nothing may be read past them. Then the
    manifest gets the run's own key, without which no file can be said to belong to the run. Then
    every file is read. A kill at any point leaves a folder that can be repaired again.
    """
    _check_verifiable(path)
    with held(path):
        manifest = Manifest(path)
        moved = list(_moved(manifest, strange_entries(path)))
        moved += _with_own_key(path)
        store = Store(path)
        moved += _moved(store.manifest, store.manifest.damages())
        yield from moved
        if moved:
            yield f"{run_again(path)} to compute what is missing: {_to_do(store)}"


def run_again(path: Path) -> str:
    """The words that say which command computes the missing parts of a run."""
    job = path / "job.toml"
    return f"run `pfdist run {job}`" if job.is_file() else f"run its job with --results {path}"


def _with_own_key(path: Path) -> Iterator[str]:
    """Make the manifest hold the run's own key, and say what was done.

    If neither the manifest nor job.toml and run.json say the key, all files go to quarantine: they
    may be those of two runs.
    """
    manifest, own = Manifest(path), own_key(path)
    try:
        run_key(path)
    except StoreError:
        old_key = manifest.recorded_key() or "no key"
    else:
        return
    if own is not None:
        manifest.record_key(own)
        yield f"manifest held {old_key}: it holds {own} now, which job.toml and run.json give"
        return
    yield f"manifest holds {old_key}, and job.toml and run.json do not say which is the run's own"
    paths = [Path(name) for name in ABOUT]
    for files in ("tables/*/*.parquet", "parts/*/*.parquet"):
        paths += [file.relative_to(path) for file in sorted(path.glob(files))]
    yield from _moved(manifest, [Damage(file, "may be another run's") for file in paths])
    # After all files were moved: until then they are expected. Now either run may begin here again.
    manifest.forget(manifest.lost())


def _moved(manifest: Manifest, damages: Iterable[Damage]) -> Iterator[str]:
    """Move damaged files to quarantine; yield what was wrong with each and where it is now."""
    for damage in list(damages):
        place = manifest.quarantine(damage)
        moved = f": it is now {place.relative_to(manifest.folder)}" if place else ""
        yield f"{damage.path} {damage.what}{moved}"


def _to_do(store: Store) -> str:
    lost = {path.parent.name or path.name for path in store.manifest.lost()}
    parts = []
    if store.has("evaluations") and (lacking := _lacking_evaluations(store)):
        parts.append(f"{len(lacking):,} evaluations")
    if "comparison" in lost or store.has_parts("comparison"):
        there = int(store.present("comparison", "draw").sum())
        parts.append(f"what the comparison lacks ({there:,} draws are there)")
    parts += sorted(lost - {"draws", "comparison", "timings"})
    return ", ".join(parts) or "nothing that takes time"


def _check_verifiable(path: Path) -> None:
    check_version_of(path)
    if Manifest(path).exists():
        return
    if not holds_run(path):
        raise no_run(path)
    raise StoreError(f"{path} has lost its manifest, which says what its files must hold")


def _wrong_rows(store: Store) -> Iterator[Damage]:
    """Keys of rows that are there twice, or missing."""
    if store.has("evaluations"):
        evaluations = store.read("evaluations")
        if evaluations.duplicated(KEYS["evaluations"]).any():
            yield Damage(Path("tables/evaluations"), "has an evaluation twice")
        lacking = _lacking_evaluations(store)
        if lacking:
            text = f"lacks draws of {len(lacking):,} evaluations, {lacking[0]} among them"
            yield Damage(Path("tables/draws"), text)
    if store.has("comparison") and not store.has_parts("comparison"):
        present = store.present("comparison", "draw")
        counted = sum(piece.num_rows for piece in store.pieces("comparison", ["draw"]))
        if not present.all() or counted != present.size:
            text = f"must have each draw once, got {counted:,} rows of {int(present.sum()):,} draws"
            yield Damage(Path("tables/comparison"), f"{text} up to {present.size:,}")


def _lacking_evaluations(store: Store) -> list[str]:
    """Ids of evaluations that lack some of their draws."""
    rows = store.evaluations("draws")
    evaluations = store.read("evaluations")
    wanted = dict(zip(evaluations["evaluation"], evaluations["draws"], strict=True))
    return [id_ for id_, draws in wanted.items() if rows.get(id_, 0) < draws]
