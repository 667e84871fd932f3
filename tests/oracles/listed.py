"""A run's files, changed as if pfdist had written them: files.json lists the change."""

from pathlib import Path

from pfdist.store import run_key, write_about
from pfdist.store.listing import change_listing, read_listing


def rewrite(file: Path, text: str) -> None:
    """Give job.toml or run.json another content."""
    write_about(file.parent, run_key(file.parent) or "", {file.name: text})


def forget(run: Path, table: str) -> None:
    """Remove a table, as if it had never been published."""
    listing = read_listing(run)
    assert listing is not None
    of_table = [name for name in listing.files if f"/{table}/" in name]
    assert of_table
    change_listing(run, files=tuple(name for name in listing.files if name not in of_table))
    for name in of_table:
        (run / name).unlink()
