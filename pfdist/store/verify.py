"""Checks every byte, row and key of a run."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from pfdist.store.arrow_files import count_rows
from pfdist.store.manifest import Damage
from pfdist.store.parquet import Store
from pfdist.store.schema import KEYS


def verify(store: Store) -> Iterator[Damage]:
    """Give every problem of a run's files.

    First each file's SHA-256; of those that are what was committed, the number of rows; then each
    table's keys.

    Parameters
    ----------
    store : Store

    Raises
    ------
    StoreError
        A file cannot be read.
    """
    damages = list(store.manifest.damages())
    yield from damages
    wrong = {damage.path for damage in damages}
    for path, stamps in store.manifest.stamps().items():
        if path not in wrong and path.suffix == ".parquet" and (store.path / path).exists():
            rows = count_rows(store.path / path)
            if rows not in {int(stamp.partition("-")[0]) for stamp in stamps}:
                yield Damage(path, f"has {rows:,} rows, which is not what was committed")
    if not wrong:
        yield from _keys(store)


def _keys(store: Store) -> Iterator[Damage]:
    if store.has("evaluations"):
        evaluations = store.read("evaluations")
        if evaluations.duplicated(KEYS["evaluations"]).any():
            yield Damage(Path("tables/evaluations"), "has an evaluation twice")
        lacking = lacking_evaluations(store)
        if lacking:
            text = f"lacks draws of {len(lacking):,} evaluations, {lacking[0]} among them"
            yield Damage(Path("tables/draws"), text)
    if store.has("comparison") and not store.has_parts("comparison"):
        present = store.present("comparison", "draw")
        counted = sum(piece.num_rows for piece in store.pieces("comparison", ["draw"]))
        if not present.all() or counted != present.size:
            text = f"must have each draw once, got {counted:,} rows of {int(present.sum()):,} draws"
            yield Damage(Path("tables/comparison"), f"{text} up to {present.size:,}")


def lacking_evaluations(store: Store) -> list[str]:
    """Ids of evaluations that lack some of their draws."""
    rows: Counter[str] = Counter()
    for piece in store.pieces("draws", ["evaluation"]):
        for count in piece["evaluation"].value_counts().to_pylist():
            rows[count["values"]] += count["counts"]
    evaluations = store.read("evaluations")
    wanted = dict(zip(evaluations["evaluation"], evaluations["draws"], strict=True))
    return [id_ for id_, draws in wanted.items() if rows[id_] < draws]
