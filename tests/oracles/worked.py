"""A command in a process of its own, whose work is counted: ``python worked.py COUNTS WORD ...``.

It writes what was counted into the file COUNTS. No number depends on the clock: tasks are cut as if
a particle-step took 10 ns. Calls by compiling, and in other threads, are not counted.
"""

import json
import sys
from collections import Counter
from pathlib import Path

import pfdist
from pfdist.cli.main import main
from pfdist.kernels.cached import _with_code_kept
from pfdist.kernels.lowering import MachineCode
from pfdist.models.tracing import trace
from pfdist.runner.door import RunSession
from pfdist.runner.pace import Pace
from pfdist.store.files import _flush, give_name, open_plain
from pfdist.store.parquet import Store

_ROOT = str(Path(pfdist.__file__).parent)
_KINDS = {
    _with_code_kept.__code__: "kernels loaded",
    MachineCode.__init__.__code__: "blocks compiled",
    trace.__code__: "formulas traced",
    give_name.__code__: "files written",
    open_plain.__code__: "files read",
    _flush.__code__: "flushes",
    Store.commit.__code__: "commits",
    RunSession.update_pace.__code__: "tasks",
}
_COMPILING = ("kernels loaded", "blocks compiled")


def worked(words):
    """Counts of a command."""
    counts, steps, calls, sessions = Counter(), Counter(), 0, []
    compiling = None  # the frame in which code is compiled, or found on the disk

    def count(frame, event, _):
        nonlocal calls, compiling
        if event == "return" and frame is compiling:
            compiling = None
        if event != "call" or compiling is not None:
            return
        code = frame.f_code
        if code.co_filename.startswith(_ROOT):
            calls += 1
            if kind := _KINDS.get(code):
                counts[kind] += 1
                compiling = frame if kind in _COMPILING else None

    begin, update = RunSession.__init__, Pace.update

    def begun(session, *arguments):
        begin(session, *arguments)
        sessions.append(session)

    RunSession.__init__ = begun
    Pace.update = lambda pace, steps, seconds: update(pace, steps, 1e-8 * steps)
    sys.setprofile(count)
    try:
        code = main(words)
    finally:
        sys.setprofile(None)
    assert code == 0
    for session in sessions:
        steps.update(session.done)
    of_parts = {f"{part} steps": steps[part] for part in sorted(steps)}
    return of_parts | dict(sorted(counts.items())) | {"calls": calls}


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(worked(sys.argv[2:])))
