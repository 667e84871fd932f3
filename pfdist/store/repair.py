"""Verifies the files of a run, and moves damaged files to quarantine."""

from collections.abc import Iterator
from pathlib import Path

from pfdist.errors import StoreError
from pfdist.store import (
    ABOUT,
    Damage,
    Manifest,
    Store,
    check_not_held,
    held,
    holds_run,
    keep_key,
    kept_keys,
    lacking_evaluations,
    own_key,
    run_key,
    strange_entries,
    verify,
)
from pfdist.store.about import no_run
from pfdist.store.keys import check_version_of


def verify_run(path: Path) -> Iterator[Damage]:
    """Check every byte, row and key of a run; see `pfdist.store.verify`.

    Raises
    ------
    StoreError
        The folder holds no run, one of another schema version, or one that is being computed; or a
        file cannot be read.
    """
    _check_verifiable(path)
    check_not_held(path)
    yield from verify(Store(path))


def repair_run(path: Path) -> Iterator[str]:
    """Move damaged files to quarantine, and say what the next start will compute.

    Raises
    ------
    StoreError
        As `verify_run`; or another process computes the run, or a file cannot be moved.
    """
    _check_verifiable(path)
    with held(path):
        manifest = Manifest(path)
        strange = [Damage(*entry) for entry in strange_entries(path)]
        moved = list(_moved(manifest, strange))  # first: nothing is read past a link
        moved += _with_one_key(path)
        store = Store(path)
        moved += _moved(store.manifest, list(store.manifest.damages()))
        yield from moved
        if moved:
            yield f"{run_again(path)} to compute what is missing: {_to_do(store)}"


def run_again(path: Path) -> str:
    """Say which command computes what the run in a folder lacks."""
    job = path / "job.toml"
    return f"run `pfdist run {job}`" if job.is_file() else f"run its job with --results {path}"


def _with_one_key(path: Path) -> Iterator[str]:
    """Make a folder hold the key of one run only, and say what was done."""
    keys, own = kept_keys(path), own_key(path)
    try:
        run_key(path)
    except StoreError:
        kept = ", ".join(keys[:3]) + (", ..." if len(keys) > 3 else "") if keys else "no key"
    else:
        return
    if own is not None:
        keep_key(path, own)
        yield f"manifest/run held {kept}: it holds {own} now, which job.toml and run.json give"
        return
    yield f"manifest/run holds {kept}, and job.toml and run.json do not say which is the run's own"
    found = [Path(name) for name in ABOUT]
    found += [file.relative_to(path) for file in sorted(path.glob("tables/*/*.parquet"))]
    found += [file.relative_to(path) for file in sorted(path.glob("parts/*/*.parquet"))]
    yield from _moved(Manifest(path), [Damage(file, "may be another run's") for file in found])


def _moved(manifest: Manifest, damages: list[Damage]) -> Iterator[str]:
    """Move damaged files to quarantine; say what was wrong with each and where it is now."""
    for damage in damages:
        place = manifest.quarantine(damage)
        moved = f": it is now {place.relative_to(manifest.folder)}" if place else ""
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


def _check_verifiable(path: Path) -> None:
    check_version_of(path)
    if Manifest(path).exists():
        return
    if not holds_run(path):
        raise no_run(path)
    raise StoreError(f"{path} has lost its folder manifest, which says what its files must hold")
