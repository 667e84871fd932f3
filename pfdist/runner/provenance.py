"""The provenance of a run: every machine, with its libraries and its processor, that computed it.

The last digits of some results differ between processors. So results that may differ are not reused
on another processor.
"""

import os
import platform
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from llvmlite import binding

from pfdist.errors import StoreError
from pfdist.filters.engines import COMPILED
from pfdist.models import squared_error
from pfdist.models.recorded import declarations
from pfdist.pools.cores import affinity
from pfdist.runner.build import Built
from pfdist.store import Store, add_to_provenance, read_run

CONTINUED = "continued_on"
_LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "ray", "pandas", "pyarrow", "matplotlib")


def provenance(built: Built) -> dict[str, Any]:
    """Place, time and libraries of a run's start; no result depends on them."""
    job, model, believed = built.job, built.evaluator.model, built.evaluator.believed
    declared = declarations(model, believed)
    return {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "name_of_model": model.name,
        "names": {"z": [*model.z_names], "y": [*model.y_names]},
        "angles": [*model.is_angle] if model.error is squared_error else [],
        **_here(built),
        "taken": built.taken,
        "execution": job.execution.model_dump(mode="json"),
        **({"declared": declared} if declared else {}),
    }


def _here(built: Built) -> dict[str, Any]:
    """The machine of this process, and the versions that compute on it."""
    return {
        "python": platform.python_version(),
        "libraries": _versions(_LIBRARIES + built.evaluator.computed_by.libraries),
        "machine": {
            "node": platform.node(),
            "system": platform.platform(),
            "cores": affinity(),
        },
        "processor": processor(),
    }


@cache
def _versions(libraries: tuple[str, ...]) -> dict[str, str]:
    return {name: version(name) for name in libraries}


@cache
def processor() -> dict[str, str]:
    """The processor's name, and the target name of compiled code."""
    return {
        "compiled_for": os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name(),
        "model": _model(),
    }


def _model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def note_machine(path: Path, built: Built, say: Callable[[str], Any]) -> None:
    """Record the machine and the versions that resume a run, and warn that results may differ.

    This process must hold the run's folder.
    """
    provenance, here = read_run(path)[0]["provenance"], _here(built)
    others = provenance.get(CONTINUED, [])
    if here not in ({key: provenance[key] for key in here}, *others):
        add_to_provenance(path, {CONTINUED: [*others, here]})
    before, differs = provenance["processor"], what_may_differ(built)
    if differs and before != processor():
        processors = f"was started on {_described(before)} and resumes on {_described(processor())}"
        say(f"this run {processors}: {differs}")


def what_may_differ(built: Built) -> str:
    """The difference that another processor may cause; empty if it computes the same bytes."""
    engine = built.evaluator.engine
    if engine == COMPILED.name:
        return ""
    return f"numbers of filter.engine = {engine!r} depend on the processor"


def lender(path: Path, built: Built | None = None) -> Store:
    """The store of a run whose evaluations other runs may use.

    `built` is the job of the run that uses them. Without it, a run on another processor is not
    accepted. Raises `StoreError` if the last digits may differ from those computed here, if a file
    is damaged, or if there is no run.
    """
    about = read_run(path)[0]["provenance"]
    processors = [each["processor"] for each in (about, *about.get(CONTINUED, []))]
    here = all(each == processor() for each in processors)
    differs = "the last digits may differ" if built is None else what_may_differ(built)
    if differs and not here:
        raise StoreError(
            f"{path} was computed on another processor ({_described(about['processor'])}), so its "
            f"evaluations cannot be reused: {differs}"
        )
    store = Store(path)
    store.check_published()  # before the run that takes them begins
    return store


def _described(processor: dict[str, str]) -> str:
    return f"{processor['model']} ({processor['compiled_for']})"
