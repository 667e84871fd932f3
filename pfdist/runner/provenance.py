"""The provenance of a run: who started it, with which libraries, on which machine."""

import os
import platform
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from pfdist.runner.build import Built, folder_of_models
from pfdist.runner.processor import processor

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
        "folder": str(folder_of_models(job).absolute()),  # paths of models are relative to it
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in _LIBRARIES},
        "machine": {
            "node": platform.node(),
            "system": platform.platform(),
            "cores": len(os.sched_getaffinity(0)),
        },
        "processor": processor(),
        # Compiled code that calls no function of the C library gives the same bytes everywhere.
        "libm_functions": list(built.evaluator.libm_functions),
        "execution": job.execution.model_dump(mode="json"),
    }
