"""Which processors computed a run, and what may differ between two of them."""

import os
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

from llvmlite import binding

from pfdist.runner.build import Built
from pfdist.store import add_to_provenance, read_run

CONTINUED = "continued_on"


def processor() -> dict[str, str]:
    """Give the name that compiled code is made for, and the processor's own."""
    return {
        "compiled_for": os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name(),
        "model": _model(),
    }


def _model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # another system than Linux
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def note_processor(path: Path, built: Built, say: Callable[[str], Any]) -> None:
    """Record the processor that goes on with a run, and say what may differ from the run's start.

    Parameters
    ----------
    path : Path
        The run's folder, held.
    built : Built
    say : callable
        Is told in a line, if anything may differ.
    """
    provenance, here = read_run(path)[0].get("provenance", {}), processor()
    before = provenance.get("processor")
    if before is None or here == before:
        return
    others = provenance.get(CONTINUED, [])
    if here not in others:
        add_to_provenance(path, {CONTINUED: [*others, here]})
    differs = what_may_differ(built)
    if differs:
        say(f"this run was started on {_told(before)} and goes on on {_told(here)}: {differs}")


def what_may_differ(built: Built) -> str:
    """What another processor may compute otherwise; empty if it computes the same bytes."""
    engine, called = built.source.engine, built.source.libm_functions()
    if engine != "compiled":
        return f"figures of filter.engine = {engine!r} agree to about 12 digits, not to the last"
    if called:
        names = ", ".join(called)
        return f"the last digits may differ, because the formulas call {names} of the C library"
    return ""


def _told(processor: dict[str, str]) -> str:
    return f"{processor['model']} ({processor['compiled_for']})"
