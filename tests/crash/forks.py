"""Many runs of one job, each in a fork of one process that has imported and compiled all it needs.

    python forks.py JOB

For each line on standard input, ``RUN LOG``, it prints the process that computes the run, and, once
that has ended, its exit code. The log gets a line for each piece of work: how many draws it
filtered, and in how many seconds. So an instant at which to end a run falls into the run, and not
into the imports of Python.
"""

import os
import sys
import time
from typing import Any

import matplotlib.pyplot as plt

from pfdist import load_job
from pfdist.cli.main import main
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import FilterWork
from pfdist.pages import figure as figures
from pfdist.runner.build import build


def compute(job: str, run: str, log: str) -> int:
    do = Evaluator.filtered
    with open(log, "a", buffering=1, encoding="ascii") as lines:

        def logged(self: Evaluator, work: FilterWork) -> Any:
            start = time.perf_counter()
            result = do(self, work)
            filtered = (work.draws[1] - work.draws[0]) * len(work.measurement_times)
            lines.write(f"{filtered} {time.perf_counter() - start}\n")
            return result

        Evaluator.filtered = logged  # type: ignore[method-assign]
        figures._OWN = "svg"
        return main(["run", job, "--results", run, "--pool", "serial"])


if __name__ == "__main__":
    job = sys.argv[1]
    assert build(load_job(job)).evaluator.engine == "compiled"
    plt.close(plt.figure())
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            os._exit(compute(job, *line.split()))
        sys.stdout.write(f"{child}\n")
        sys.stdout.flush()
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        sys.stdout.write(f"{code}\n")
        sys.stdout.flush()
