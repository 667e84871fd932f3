"""The part of a run that must not depend on how it was computed."""

import hashlib
from pathlib import Path


def hashes(run: Path) -> dict[str, str]:
    """SHA-256 of job.toml, of every table's files but timings', and of the figures' SVG."""
    files = [run / "job.toml", *(run / "tables").rglob("*.parquet"), *run.glob("figures/*.svg")]
    return {
        str(path.relative_to(run)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(files)
        if "timings" not in path.parts
    }
