"""The part of a run that must not depend on how it was computed."""

import hashlib
from pathlib import Path


def hashes(run: Path) -> dict[str, str]:
    """SHA-256 of job.toml, model.json, tables but `timings`, and the SVG of figures.

    A file of a table must have the beginning of its hash in its name.
    """
    about = [
        path
        for path in (run / "job.toml", run / "model.json", *run.glob("figures/*.svg"))
        if path.exists()
    ]
    files = [path for path in run.glob("tables/*/*.parquet") if path.parent.name != "timings"]
    found = {
        path: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted([*about, *files])
    }
    assert all(found[file][:16] in file.name for file in files)
    return {str(path.relative_to(run)): sha256 for path, sha256 in found.items()}
