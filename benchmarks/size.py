"""The seconds and the memory of large problems: whole commands with many draws or long horizons.

The memory is the largest of the process. Kernels are on disk: a small problem runs first.
"""

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED

TITLE = "Large problems"
TABLES: tuple[str, ...] = ("size",)

JOB = Path(__file__).parents[1] / "jobs" / "plan.toml"
_MIB = 1024  # the kernel counts in KiB
# A process keeps the largest memory of the one that it was forked from, so a small one starts it.
_LARGEST = """
import resource, subprocess, sys
quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
subprocess.run(sys.argv[1:], check=True, **quiet)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


@dataclass(frozen=True)
class Case:
    """A command, and the number that is varied."""

    varied: str
    value: int
    command: str
    words: tuple[str, ...]


def cases(quick: bool) -> list[Case]:
    """Give all cases, the small ones first."""
    draws = [100, 200] if quick else [100_000, 1_000_000, 10_000_000]
    horizons = [20] if quick else [60, 200, 600, 2000]
    compared = [
        _case(
            "draws", count, "compare", "problem.horizon=15", "problem.measurement_budget=6",
            "filter.particles=50", f"comparison.draws={count}",
        )
        for count in draws
    ]  # fmt: skip
    planned = [
        _case(
            "horizon", horizon, "plan", f"problem.horizon={horizon}",
            f"problem.measurement_budget={horizon // 10}", "comparison.draws=2000",
        )
        for horizon in horizons
    ]  # fmt: skip
    return compared + planned


def _case(varied: str, value: int, command: str, *changes: str) -> Case:
    times = ["--times", "mine=0:15:3", "--times", "early=0:5:1"] if command == "compare" else []
    return Case(varied, value, command, (*times, *(w for each in changes for w in ("--set", each))))


def measure(quick: bool, say: Say) -> Tables:
    """Time all cases on threads, each in a process of its own.

    Parameters
    ----------
    quick : bool
        Small problems.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        size: a row for each case, with varied, value, seconds and mebibytes.
    """
    rows = []
    with tempfile.TemporaryDirectory(prefix="size-") as folder:
        for number, case in enumerate([cases(True)[0], cases(True)[-1], *cases(quick)]):
            seconds, mebibytes = _timed(case, Path(folder, str(number)))
            if number > 1:
                row = {"varied": case.varied, "value": case.value}
                rows.append(row | {"seconds": seconds, "mebibytes": mebibytes})
                say(f"{case.varied} {case.value:,}: {seconds:.1f} s, {mebibytes:,.0f} MiB")
    return {"size": pd.DataFrame(rows)}


def _timed(case: Case, results: Path) -> tuple[float, float]:
    """Seconds of a command, and the largest memory of its process."""
    words = (case.command, str(JOB), *case.words, "--results", str(results), "--no-report")
    program = (sys.executable, "-c", _LARGEST, sys.executable, "-m", "pfdist")
    start = perf_counter()
    done = subprocess.run([*program, *words], check=True, stdout=subprocess.PIPE)  # noqa: S603  our own text
    return perf_counter() - start, int(done.stdout) / _MIB


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    lines = [
        [row["varied"], f"{row['value']:,}", f"{row['seconds']:.1f}", f"{row['mebibytes']:,.0f}"]
        for _, row in tables["size"].iterrows()
    ]
    return "\n\n".join(
        [
            "On threads. Draws: a set is compared with regular times, T = 15, 50 particles. "
            "Horizon: `plan` of the growth model with T / 10 measurements, 500 particles, 2,000 "
            "draws.",
            markdown(["what is varied", "value", "seconds", "largest memory, MiB"], lines),
        ]
    )


def plot(tables: Tables) -> Figure:
    """Draw seconds and memory against each number."""
    figure = Figure(figsize=(2 * COLUMN_INCHES, 0.8 * COLUMN_INCHES), layout="constrained")
    panels = figure.subplots(1, 2)
    for axes, (varied, rows) in zip(panels, tables["size"].groupby("varied"), strict=True):
        axes.plot(rows["value"], rows["seconds"], color=RED, marker="o", label="seconds")
        axes.plot(rows["value"], rows["mebibytes"], color=BLUE, marker="s", label="MiB")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(str(varied))
    panels[0].legend()
    return figure
