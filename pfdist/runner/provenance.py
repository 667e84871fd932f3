"""The provenance of a run: who started it, with which libraries, on which machine."""

import os
import platform
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pfdist.runner.build import Built
from pfdist.runner.processor import processor
from pfdist.store import holds_run, read_run

_LIBRARIES = ("numpy", "scipy", "numba", "ray", "pandas", "pyarrow", "matplotlib")


def provenance(built: Built) -> dict[str, Any]:
    """Where, when and with what a run is started; no result depends on it.

    Parameters
    ----------
    built : Built
    """
    job = built.job
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "folder": _folder_of_models(job.path.parent),  # paths of models are relative to it
        "files": {  # the files of each model, by their paths relative to the model's folder
            "model": built.source.model.source.sha256,
            "filter_model": built.source.filter_model.source.sha256,
        },
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in _LIBRARIES},
        "machine": {
            "node": platform.node(),
            "system": platform.platform(),
            "cores": len(os.sched_getaffinity(0)),
        },
        "processor": processor(),
        # Compiled code that calls no function of the C library gives the same bytes everywhere.
        "libm_functions": list(built.source.libm_functions()),
        "execution": job.execution.model_dump(mode="json"),
    }


def _folder_of_models(folder: Path) -> str:
    """Give the folder of a job file; for the job in a run's folder, what that run records."""
    if not holds_run(folder):
        return str(folder.absolute())
    provenance = read_run(folder)[0].get("provenance")
    recorded = provenance.get("folder") if isinstance(provenance, Mapping) else None
    return recorded if isinstance(recorded, str) else str(folder.absolute())
